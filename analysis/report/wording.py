"""How numbers are written in tables and sentences: people's units, 95 % intervals, UTC."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from tilth.analysis.report.document import ReportCell
from tilth.logger.clock import utc_text
from tilth.replay.estimates_json import ParameterEntry
from tilth.schemas.fields import KMH
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.spread import of_parameter, scale_of, unit_of

NOTHING: Final = "–"
SAYS: Final = " (95 %)"
SYMBOLS: Final[Mapping[str, str]] = dict(
    zip(PARAMETERS, ("C_αf", "C_αr", "C_αi", "σ_f", "σ_r", "σ_i"), strict=True)
)
METHODS: Final = {
    "recommended": "recommended",
    "pem": "pem",
    "tracker": "tracker",
    "steady_state": "steady state",
    "pem_two_step": "two steps",
}
AXLES: Final = {"f": "front axle", "r": "rear axle", "i": "implement's axle"}


def heading_of(parameter: str) -> str:
    """Of a table's column, such as C_af, kN/rad."""
    return f"{parameter}, {unit_of(parameter)}"


def meaning_of(parameter: str) -> str:
    """Such as: cornering stiffness, front axle."""
    what = "cornering stiffness" if parameter.startswith("C_") else "relaxation length"
    return f"{what}, {AXLES[parameter[-1]]}"


def parameter_text(parameter: str, value: float | None, sd: float | None, unit: bool = False) -> str:
    """Estimate and 95 % interval; who shows it says that it is 95 %."""
    if value is None or sd is None:
        return NOTHING
    text = of_parameter(parameter, value, sd, bare=not unit)
    return text.removesuffix(SAYS)


def parameter_cell(parameter: str, found: ParameterEntry) -> ReportCell:
    """Of an estimate; a status other than estimated is named."""
    value, sd, status = found["value"], found["sd"], found["status"]
    if value is None:
        return ReportCell(status)
    text = parameter_text(parameter, value, sd) if sd is not None else number(value * scale_of(parameter))
    return ReportCell(text if status == "estimated" else f"{text} ({status})", value, sd)


def number(value: float | None, digits: int = 3, unit: str = "") -> str:
    """To so many significant digits, never in powers of ten where people would not write them so."""
    if value is None or not math.isfinite(value):
        return NOTHING
    places = digits - 1 - math.floor(math.log10(abs(value))) if value else digits - 1
    text = f"{value:,.{max(0, places)}f}".replace(",", " ")
    return f"{text} {unit}" if unit else text


def fixed(value: float | None, places: int = 1, unit: str = "") -> str:
    """With so many places after the point."""
    if value is None or not math.isfinite(value):
        return NOTHING
    return f"{value:.{places}f} {unit}".rstrip()


def kmh(speed_mps: float | None, unit: str = "km/h") -> str:
    """A speed as people say it."""
    return fixed(None if speed_mps is None else speed_mps / KMH, 1, unit)


def probability(value: float | None) -> str:
    """A p-value."""
    if value is None:
        return NOTHING
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def degrees(value: float | None, places: int = 1) -> str:
    """Of rad."""
    return NOTHING if value is None else f"{math.degrees(value):+.{places}f}°"


def clock(utc_s: float | None, pattern: str = "%H:%M:%S") -> str:
    """UTC of seconds since 1970."""
    return NOTHING if utc_s is None else utc_text(int(utc_s * 1e9), pattern)


def dates(instants_ns: Iterable[int]) -> str:
    """From the first to the last day, UTC, of instants in ns since 1970; "" without any."""
    found = sorted(utc_text(at, "%Y-%m-%d") for at in instants_ns)
    return " to ".join(dict.fromkeys((found[0], found[-1]))) if found else ""


def seconds(value: float) -> str:
    """A length of time."""
    if value < 120:
        return f"{value:.0f} s"
    minutes, rest = divmod(round(value), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"


def distance(metres: float) -> str:
    """Of a drive."""
    return f"{metres:.0f} m" if metres < 1000 else f"{metres / 1000:.2f} km"


def many(count: int, word: str) -> str:
    """Such as: 1 gap, 3 gaps."""
    return f"{count} {word}" if count == 1 else f"{count} {word}s"


def sentences(parts: Sequence[str]) -> str:
    """Of parts that begin small and have no full stop."""
    return " ".join(f"{text[0].upper()}{text[1:]}." for text in parts)


def listed(words: list[str]) -> str:
    """Such as: a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
