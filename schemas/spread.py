"""Writes a number for people: in the unit they use, with its standard deviation as the range that holds 95 %.

Messages and JSON carry standard deviations, under names that say so.
"""

import math
from typing import Final

WITHIN: Final = 1.96  # standard deviations, of a range that holds 95 %
_EVEN: Final = 0.3  # of a logarithm: up to here both sides of a log-normal range are much alike
_SAYS: Final = "(95 %)"


def interval(value: float, log_sd: float) -> tuple[float, float]:
    """95 % of what is log-normal, from its median and the sd of its natural logarithm."""
    return value * math.exp(-WITHIN * log_sd), value * math.exp(WITHIN * log_sd)


def share(*log_sds: float, bare: bool = False) -> str:
    """Sds of logarithms, such as: ±7.8 %, -55 … +122 % (95 %). bare: of a table whose head says that it is
    95 %."""
    return _said(", ".join(map(_share, log_sds)), "", bare)


def even(percent: float) -> str:
    """Of a half-width that is of 95 % already, such as: ±7.8 %. Who shows it says that it is 95 %."""
    return f"±{percent:.0f} %" if percent >= 9.5 else f"±{percent:.1f} %"


def half_width(sd: float, unit: str) -> str:
    """Of what is measured, such as: ±0.035 m (95 %)."""
    return f"±{WITHIN * sd:.2g} {unit} {_SAYS}"


def half_alone(sd: float, unit: str) -> str:
    """The same without saying that it is 95 %: for a table whose head says it."""
    half = WITHIN * sd
    return f"±{_number(half, half)} {unit}"


def plus_minus(value: float, sd: float, unit: str = "", bare: bool = False) -> str:
    """Such as: 1.20 ± 0.13 s (95 %)."""
    half = WITHIN * sd
    return _said(f"{_number(value, half)} ± {_number(half, half)}", unit, bare)


def of_logarithm(value: float, sd: float, unit: str = "", bare: bool = False) -> str:
    """Of a log-normal parameter and its sd, both in its unit: as `plus_minus` while it is known well.

    Else with both ends, such as: 220 (99 … 491) kN/rad (95 %).
    """
    half = WITHIN * sd
    if half <= _EVEN * value:
        return plus_minus(value, sd, unit, bare)
    ends = " … ".join(_number(end, half) for end in interval(value, sd / value))
    return _said(f"{_number(value, half)} ({ends})", unit, bare)


def unit_of(parameter: str) -> str:
    """Of one of flow.PARAMETERS, for people; messages, JSON and exports have N/rad."""
    return "kN/rad" if parameter.startswith("C_") else "m"


def scale_of(parameter: str) -> float:
    """From N/rad or m to `unit_of`."""
    return 1e-3 if parameter.startswith("C_") else 1.0


def of_parameter(parameter: str, value: float, sd: float, bare: bool = False) -> str:
    """One of flow.PARAMETERS in N/rad or m, such as: 220 ± 20 kN/rad (95 %). bare: of a table whose head says
    unit and 95 %."""
    scale = scale_of(parameter)
    return of_logarithm(scale * value, scale * sd, "" if bare else unit_of(parameter), bare)


def _share(log_sd: float) -> str:
    if WITHIN * log_sd > _EVEN:
        low, high = interval(100.0, log_sd)
        return f"{low - 100:.0f} … +{high - 100:.0f} %"
    return even(100 * WITHIN * log_sd)


def _number(value: float, half: float) -> str:
    """To two digits of the half-width."""
    if not (math.isfinite(half) and half > 0):
        return f"{value:.4g}"
    return f"{value:.{max(0, 1 - math.floor(math.log10(half)))}f}"


def _said(text: str, unit: str, bare: bool) -> str:
    return " ".join(part for part in (text, unit, "" if bare else _SAYS) if part)
