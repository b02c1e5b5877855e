"""Makes measurements from the signals of a message.

`MAKERS` is a table over signals: a new message of known signals needs no row here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from tilth.schemas.flow import (
    Attitude,
    Curvature,
    Fix,
    FixType,
    HandWheelAngle,
    Heading,
    Measurement,
    Origin,
    Position,
    UtcTime,
    VehicleSpeed,
    Velocity,
    Weight,
    YawRate,
)
from tilth.schemas.identity import Deviation
from tilth.schemas.pgn_table import Pgn
from tilth.schemas.rejections import Rejection

Head = tuple[int, int, Origin, int, int | None]
"""t_ns, rx_ns, origin, pgn, sid."""

# Before its first fix a receiver says 1980-01-06 (GPS week 0) or a date about 2000.
EARLIEST_UTC_NS = 1_262_304_000_000_000_000  # 2010-01-01

LOWEST_M, HIGHEST_M = -1000.0, 10_000.0  # of an altitude on land

Values = Mapping[str, Any]
Made = Measurement | Rejection | None
"""A measurement; the reason why there is none; or None: its signals were not available."""


def _position(head: Head, values: Values, sd: Deviation, repeat: bool) -> Made:
    latitude, longitude = values.get("latitude_deg"), values.get("longitude_deg")
    if latitude is None or longitude is None:
        return None
    altitude = values.get("altitude_m")
    # A receiver's nonsense here (5000 km has been seen) does not spoil its latitude and longitude.
    if altitude is not None and not LOWEST_M < altitude < HIGHEST_M:
        altitude = None
    return Position(*head, latitude, longitude, sd.position, altitude, repeat)


def _velocity(head: Head, values: Values, sd: Deviation, repeat: bool) -> Made:
    course, speed = values.get("course_rad"), values.get("speed_mps")
    if course is None or speed is None:
        return None
    return Velocity(*head, course, speed, sd.velocity)


def _referred(make: Callable[[Head, Values, Deviation, bool], Made]) -> Callable[..., Made]:
    """For messages that name the north they count from: only true north makes a measurement."""

    def made(head: Head, values: Values, sd: Deviation, repeat: bool) -> Made:
        measurement = make(head, values, sd, repeat)
        reference = values.get("heading_reference")
        if measurement is None or reference == "true":
            return measurement
        return Rejection.MAGNETIC if reference == "magnetic" else Rejection.NO_REFERENCE

    return made


def _heading(head: Head, values: Values, sd: Deviation, repeat: bool) -> Made:
    heading = values.get("heading_rad")
    return None if heading is None else Heading(*head, heading, sd.heading)


def _yaw_rate(head: Head, values: Values, sd: Deviation, repeat: bool) -> Made:
    yaw_rate = values.get("yaw_rate_radps")
    return None if yaw_rate is None else YawRate(*head, yaw_rate, sd.yaw_rate)


def _attitude(head: Head, values: Values, sd: Deviation, repeat: bool) -> Made:
    roll, pitch = values.get("roll_rad"), values.get("pitch_rad")
    return None if roll is None and pitch is None else Attitude(*head, roll, pitch, sd.roll)


def _fix(head: Head, values: Values, sd: Deviation, repeat: bool) -> Made:
    fix = values.get("fix")
    return None if fix is None else Fix(*head, FixType(fix), values.get("satellites"), values.get("hdop"))


def _hand_wheel(head: Head, values: Values, sd: Any, repeat: bool) -> Made:
    angle = values.get("hand_wheel_angle_rad")
    return None if angle is None else HandWheelAngle(*head, angle)


def _curvature(head: Head, values: Values, sd: Any, repeat: bool) -> Made:
    curvature = values.get("curvature_per_m")
    return None if curvature is None else Curvature(*head, curvature)


def _vehicle_speed(head: Head, values: Values, sd: Any, repeat: bool) -> Made:
    speed = values.get("speed_mps")
    return None if speed is None else VehicleSpeed(*head, speed, values.get("direction"))


def _weight(head: Head, values: Values, sd: Any, repeat: bool) -> Made:
    whole, carried = values.get("whole_mass_kg"), values.get("carried_mass_kg")
    if whole is None and carried is None:
        return None
    return Weight(*head, whole, carried) if whole != 0.0 else Rejection.OUT_OF_RANGE


def _time_of(row: Pgn) -> Callable[..., Made]:
    # A message of parts (seconds in 0.25 s) is as fine as its finest one.
    finest = next((f for f in row.fields if f.key in ("second_s", "time_s")), None)
    resolution = finest.resolution() if finest is not None else 0.0

    def utc_time(head: Head, values: Values, sd: Deviation, repeat: bool) -> Made:
        utc_ns = values.get("utc_ns")
        if utc_ns is None:
            return None
        return UtcTime(*head, utc_ns, resolution) if utc_ns >= EARLIEST_UTC_NS else Rejection.EARLY_DATE

    return utc_time


@dataclass(frozen=True, slots=True)
class Maker:
    """What one kind of measurement is made of."""

    signals: frozenset[str]  # that the message must be able to carry
    anyone: bool  # from any sender; else only from receivers of the machine file
    make: Callable[[Pgn], Callable[..., Made]]


def _plain(make: Callable[..., Made]) -> Callable[[Pgn], Callable[..., Made]]:
    return lambda row: make


def _north(make: Callable[..., Made]) -> Callable[[Pgn], Callable[..., Made]]:
    return lambda row: _referred(make) if "heading_reference" in row.signals else make


MAKERS: tuple[Maker, ...] = (
    Maker(frozenset({"latitude_deg", "longitude_deg"}), False, _plain(_position)),
    Maker(frozenset({"course_rad", "speed_mps"}), False, _north(_velocity)),
    Maker(frozenset({"heading_rad"}), False, _north(_heading)),
    Maker(frozenset({"yaw_rate_radps"}), False, _plain(_yaw_rate)),
    Maker(frozenset({"roll_rad"}), False, _plain(_attitude)),
    Maker(frozenset({"pitch_rad"}), False, _plain(_attitude)),
    Maker(frozenset({"fix"}), False, _plain(_fix)),
    Maker(frozenset({"utc_ns"}), False, _time_of),
    Maker(frozenset({"hand_wheel_angle_rad"}), True, _plain(_hand_wheel)),
    Maker(frozenset({"curvature_per_m"}), True, _plain(_curvature)),
    Maker(frozenset({"speed_mps", "direction"}), True, _plain(_vehicle_speed)),
    Maker(frozenset({"whole_mass_kg", "carried_mass_kg"}), True, _plain(_weight)),
)


def makers_of(row: Pgn, anyone: bool) -> tuple[Callable[..., Made], ...]:
    """What makes the measurements of a message: those from anyone, or those from known receivers only."""
    makes: dict[Callable[..., Made], None] = {}
    for maker in MAKERS:
        if maker.anyone == anyone and maker.signals <= set(row.signals):
            makes[maker.make(row)] = None
    return tuple(makes)
