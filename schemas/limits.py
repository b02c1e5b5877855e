"""Possible and usual ranges of each number of a machine file, and wrong units it is often given in.

Beyond `low` and `high` a value is impossible. Beyond `usual` it is rare, and worth a second look. The table
covers tractors from a small one for orchards to an articulated one of 30 t, and implements of 100 kg to 60 t.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

FULL: Final = 57.29577951308232  # degrees in a radian
TINY: Final = 0.025  # of what is usual at most: nobody meant less
LOOSE: Final = 0.5  # an sd beyond this share of the largest that is allowed is rare


class KeyLimits(NamedTuple):
    """Of one key, in the unit of the machine file."""

    low: float
    high: float
    usual: tuple[float, float]
    unit: str
    least: float = 0.0  # beside 0, which says that it is exact, nothing below is possible

    def impossible(self, value: float) -> bool:
        """Whether no value of the key can be so."""
        return not self.low <= value <= self.high or 0.0 < value < self.least

    @property
    def range(self) -> tuple[float, float]:
        return self.low, self.high


@dataclass(frozen=True, slots=True)
class Doubt:
    """What cannot be, or is rare, in one sentence that names the key."""

    text: str
    refused: bool


def _spread(largest: float, unit: str, least: float = 0.0) -> KeyLimits:
    """Of an sd that may be 0: exactly known. Between 0 and `least` nobody can survey it."""
    return KeyLimits(0.0, largest, (0.0, LOOSE * largest), unit, least)


LIMITS: Final[Mapping[str, KeyLimits]] = {
    "tractor.a": KeyLimits(0.3, 5.0, (0.5, 3.5), "m"),
    "tractor.b": KeyLimits(0.3, 5.0, (0.3, 3.5), "m"),
    "tractor.c": KeyLimits(0.1, 8.0, (0.5, 5.0), "m"),
    "tractor.mass": KeyLimits(500.0, 40e3, (1e3, 32e3), "kg"),
    "tractor.yaw_inertia": KeyLimits(100.0, 500e3, (300.0, 300e3), "kg m^2"),
    "tractor.cg_height": KeyLimits(0.3, 2.0, (0.5, 1.6), "m"),
    "tractor.cg_sd": _spread(1.0, "m", 1e-3),
    "tractor.pair_yaw_sd": _spread(10.0, "deg", 0.01),
    "tractor.lever_sd": _spread(1.0, "m", 1e-3),
    "tractor.kingpin_distance": KeyLimits(0.5, 4.0, (0.8, 3.0), "m"),
    "tractor.ackermann": KeyLimits(-0.5, 1.5, (0.0, 1.1), "1"),
    "tractor.ackermann.sd": _spread(1.0, "1"),
    "tractor.hitch_height": KeyLimits(0.1, 1.5, (0.3, 1.1), "m"),
    "tractor.pivot_height": KeyLimits(0.1, 1.5, (0.3, 1.1), "m"),
    "tractor.wheel_speed_factor": KeyLimits(0.5, 2.0, (0.8, 1.25), "1"),
    "tractor.wheel_speed_factor.sd": _spread(0.1, "1"),
    "tractor.front_axle_mass": KeyLimits(50.0, 8e3, (150.0, 3e3), "kg"),
    "implement.d": KeyLimits(0.5, 15.0, (1.0, 10.0), "m"),
    "implement.e": KeyLimits(-2.0, 5.0, (0.0, 3.0), "m"),
    "implement.e.sd": _spread(2.0, "m"),
    "implement.mass": KeyLimits(100.0, 60e3, (200.0, 40e3), "kg"),
    "implement.yaw_inertia": KeyLimits(50.0, 1e6, (100.0, 400e3), "kg m^2"),
    "implement.cg_height": KeyLimits(0.3, 4.0, (0.4, 2.5), "m"),
    "implement.cg_sd": _spread(1.0, "m", 1e-3),
    "implement.pair_yaw_sd": _spread(10.0, "deg", 0.01),
    "implement.lever_sd": _spread(1.0, "m", 1e-3),
    "implement.working_width": KeyLimits(0.0, 60.0, (0.0, 40.0), "m"),
    "ballast.mass": KeyLimits(0.0, 50e3, (0.0, 30e3), "kg"),
    "ballast.ahead_of_axle.sd": _spread(2.0, "m"),
    "ballast.height": KeyLimits(0.0, 5.0, (0.2, 3.0), "m"),
    "ballast.length": KeyLimits(0.0, 15.0, (0.0, 8.0), "m"),
    "ballast.width": KeyLimits(0.0, 6.0, (0.0, 3.5), "m"),
    "tyres.cornering_stiffness": KeyLimits(5e3, 3e6, (10e3, 2e6), "N/rad"),
    "tyres.relaxation_length": KeyLimits(0.05, 5.0, (0.2, 3.0), "m"),
    "tyres.log_sd": KeyLimits(0.005, 3.0, (0.1, 1.5), "1"),
    "tyres.track": KeyLimits(0.8, 4.0, (1.0, 3.2), "m"),
    "tyres.track.sd": _spread(0.3, "m"),
    "tyres.dual_track": KeyLimits(1.2, 6.0, (2.0, 4.5), "m"),
    "tyres.dual_track.sd": _spread(0.3, "m"),
    "tyres.deflection": KeyLimits(0.003, 0.3, (0.015, 0.16), "m"),
    "tyres.pressure": KeyLimits(0.2, 10.0, (0.4, 6.0), "bar"),
    "receiver.survey_sd": _spread(1.0, "m", 1e-3),
    "receiver.position_sd": KeyLimits(5e-4, 3.0, (0.003, 0.15), "m"),
    "receiver.velocity_sd": KeyLimits(2e-3, 2.5, (0.005, 0.5), "m/s"),
    "receiver.yaw_rate_sd": KeyLimits(0.01, 10.0, (0.02, 3.0), "deg/s"),
    "receiver.heading_sd": KeyLimits(0.01, 20.0, (0.02, 5.0), "deg"),
    "receiver.roll_sd": KeyLimits(0.01, 20.0, (0.02, 5.0), "deg"),
    "receiver.roll_zero": KeyLimits(-45.0, 45.0, (-8.0, 8.0), "deg"),
    "receiver.roll_zero.sd": _spread(20.0, "deg"),
    "receiver.latency": KeyLimits(0.0, 2.0, (0.0, 0.6), "s"),
    "receiver.latency.sd": _spread(1.0, "s"),
    "wheel_angle.zero": KeyLimits(-360.0, 360.0, (-15.0, 15.0), "deg"),
    "wheel_angle.zero.sd": _spread(20.0, "deg"),
    "wheel_angle.gain": KeyLimits(0.5, 2.0, (0.7, 1.4), "1"),
    "wheel_angle.curve": KeyLimits(-0.3, 0.3, (-0.15, 0.15), "1"),  # up to 0.3 it is one to one within 90 deg
    "wheel_angle.curve.sd": _spread(0.3, "1"),
    "wheel_angle.sd": KeyLimits(5e-4, 3.0, (0.003, 2.0), "deg"),
    "wheel_angle.delay": KeyLimits(0.0, 2.0, (0.0, 0.3), "s"),
}
"""By section and key; what is not here is judged with others, by `plausible`. `.sd` is that of a quantity; of
one that is not here the sd may be as large as the value."""


class _Unit(NamedTuple):
    hint: str  # in which unit the machine file has such values
    others: tuple[tuple[str, float], ...]  # (what it was perhaps given in, factor to the file's unit)


_ANGLE: Final = (("rad", FULL), ("mrad", FULL / 1e3), ("minutes of arc", 1 / 60))
_LENGTH: Final = (("mm", 1e-3), ("cm", 1e-2), ("inches", 0.0254), ("feet", 0.3048), ("km", 1e3))
_INERTIA: Final = (("t m^2", 1e3), ("lb ft^2", 0.0421401), ("slug ft^2", 1.355818))
_STIFFNESS: Final = (
    ("kN/rad", 1e3), ("N/deg", FULL), ("kN/deg", 1e3 * FULL), ("lbf/deg", 4.4482216 * FULL), ("mN/rad", 1e-3),
)  # fmt: skip
_UNITS: Final[Mapping[str, _Unit]] = {
    "m": _Unit("lengths are in m", _LENGTH),
    "kg": _Unit("masses are in kg", (("t", 1e3), ("lb", 0.45359237), ("g", 1e-3))),
    "kg m^2": _Unit("inertias are in kg m^2", _INERTIA),
    "N/rad": _Unit("stiffnesses are those of whole axles, in N/rad", _STIFFNESS),
    "m/s": _Unit("speeds are in m/s", (("km/h", 1 / 3.6), ("mm/s", 1e-3), ("cm/s", 1e-2), ("mph", 0.44704))),
    "deg": _Unit("angles are in degrees", _ANGLE),
    "deg/s": _Unit("turn rates are in degrees per second", tuple((f"{u}/s", f) for u, f in _ANGLE)),
    "deg/bit": _Unit("scale is in degrees per bit", tuple((f"{u}/bit", f) for u, f in _ANGLE)),
    "bar": _Unit("pressures are in bar", (("kPa", 0.01), ("psi", 0.0689476), ("MPa", 10.0))),
    "s": _Unit("times are in s", (("ms", 1e-3), ("microseconds", 1e-6), ("minutes", 60.0))),
    "1": _Unit("it is a ratio", (("per cent", 1e-2),)),
}
_SLIPS: Final = (-1.0, 1e-3, 1e3)  # a wrong sign, thousands
_TURNED: Final = (1 / FULL, FULL)  # degrees for radians, or twice
MOST_MEANT: Final = 2


def judged(name: str, key: str, value: float) -> Doubt | None:
    """Of one value against the row of its key. name: of the key, as the person who reads it knows it."""
    row = LIMITS[key]
    fine = row.usual[0] <= value <= row.usual[1] and not row.impossible(value)
    return None if fine else doubt_of(name, value, row)


def doubt_of(name: str, value: float, row: KeyLimits) -> Doubt:
    """Of a value that is not usual."""
    refused = row.impossible(value)
    text = f"{name} = {with_unit(value, row.unit)}: "
    if refused:
        least = f"0 (exactly known) or from {row.least:g}" if row.least else f"from {row.low:g}"
        text += f"must be {least} to {row.high:g}"
    else:
        text += f"rare, {row.usual[0]:g} to {row.usual[1]:g} is usual; check it"

    def likely(other: float) -> bool:
        return row.usual[0] <= other <= row.usual[1] and abs(other) >= TINY * row.usual[1]

    return Doubt(text + meant(value, row.unit, likely), refused)


def meant(value: float, unit: str, likely: Callable[[float], bool]) -> str:
    """The end of a sentence: what may have been meant by a value, and the unit that is wanted."""
    hint, others = _UNITS[unit]
    found = [f"{_round(v)} ({value:g} {other})" for other, factor in others if likely(v := value * factor)]
    if not found:
        slips = (*_SLIPS, *_TURNED) if "deg" in unit or "rad" in unit else _SLIPS
        found = [_round(v) for factor in slips if likely(v := value * factor)][:1]
    return f"; did you mean {' or '.join(found[:MOST_MEANT])}? {hint}" if found else f"; {hint}"


def _round(value: float) -> str:
    return f"{float(f'{value:.4g}'):g}"


def with_unit(value: float, unit: str) -> str:
    """The value with its unit, for people."""
    return f"{value:g}" if unit == "1" else f"{value:g} {unit}"


def spread_judged(name: str, key: str, value: float, sd: float) -> Iterator[Doubt]:
    """Of a quantity's standard deviation."""
    row = LIMITS.get(f"{key}.sd", _spread(abs(value), LIMITS[key].unit))
    if sd > row.usual[1] and not math.isclose(sd, row.usual[1]):
        yield doubt_of(f"{name}.sd", sd, row)
