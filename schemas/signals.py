"""The signals of decoded messages: every key of `tilth decode --json` and of Message.values."""

import math
from dataclasses import dataclass

from tilth.schemas.fields import Range
from tilth.schemas.flow import FixType


@dataclass(frozen=True, slots=True)
class Signal:
    """What a signal means."""

    unit: str
    meaning: str
    range: Range = Range()  # noqa: RUF009 (frozen)
    measured: bool = True  # measurements are made of it; else it is only told


_ROUNDED = 1e-3  # some devices say 6.2832 for a full turn
_TURN = Range(0.0, 2.0 * math.pi + _ROUNDED)
_HALF = Range(-math.pi - _ROUNDED, math.pi + _ROUNDED)
_QUARTER = Range(-math.pi / 2 - _ROUNDED, math.pi / 2 + _ROUNDED)

_DILUTION = Range(0.0, 400.0)


def _decoded_only(meaning: str, unit: str = "") -> Signal:
    return Signal(unit, meaning, measured=False)


SIGNALS: dict[str, Signal] = {
    "latitude_deg": Signal("deg", "WGS 84, north positive", Range(-90.0, 90.0)),
    "longitude_deg": Signal("deg", "WGS 84, east positive", Range(-180.0, 180.0)),
    "altitude_m": Signal(
        "m", "129029: above the ellipsoid; 65256: above mean sea level", Range(-11_000.0, 100_000.0)
    ),
    "course_rad": Signal("rad", "direction of travel over ground, clockwise from north", _TURN),
    "speed_mps": Signal("m/s", "magnitude, over ground; of 65096 from the wheels", Range(0.0, 200.0)),
    "heading_rad": Signal("rad", "direction of facing, clockwise from north", _TURN),
    "heading_reference": Signal("", "north of heading or course: true | magnetic"),
    "yaw_rate_radps": Signal("rad/s", "positive in a right turn", Range(-10.0, 10.0)),
    "roll_rad": Signal("rad", "positive right side down", _HALF),
    "pitch_rad": Signal("rad", "positive nose up", _QUARTER),
    "yaw_rad": Signal("rad", "of 127257, clockwise from a north that the message does not name"),
    "wheel_angle_rad": Signal("rad", "road wheel (or rudder), positive right", _QUARTER),
    "hand_wheel_angle_rad": Signal("rad", "the driver's wheel, positive right (clockwise)"),
    "curvature_per_m": Signal("1/m", "of the path, positive to the driver's right"),
    "commanded_curvature_per_m": Signal(
        "1/m", "that the steering is asked for, positive to the driver's right"
    ),
    "command_status": Signal("", "of a guidance command: intended | not_intended to steer"),
    "direction": Signal("", "of travel: forward | reverse"),
    "whole_mass_kg": Signal("kg", "of what is pulled, with all that it carries"),
    "carried_mass_kg": Signal("kg", "of what it carries"),
    "utc_ns": Signal("ns", "since 1970, UTC"),
    "fix": Signal("", " | ".join(fix.value for fix in FixType)),
    "satellites": Signal("", "used in the solution"),
    "hdop": Signal("", "horizontal dilution of precision", _DILUTION),
    "pdop": Signal("", "dilution of precision in three dimensions", _DILUTION, measured=False),
    "vdop": Signal("", "vertical dilution of precision", _DILUTION, measured=False),
    "tdop": Signal("", "dilution of precision in time", _DILUTION, measured=False),
    "desired_mode": _decoded_only("of a GNSS receiver: 1D | 2D | 3D | auto"),
    "actual_mode": _decoded_only("as desired_mode"),
    "gnss_system": _decoded_only("of the solution: gps | glonass | gps_glonass | …"),
    "integrity": _decoded_only("of the solution: unchecked | safe | caution"),
    "geoid_separation_m": _decoded_only("of the geoid from the ellipsoid, positive above it", "m"),
    "reference_stations": _decoded_only("number of them; what is said of each is in stations"),
    "satellites_in_view": _decoded_only("number of them; what is said of each is in sky"),
    "range_residual_mode": _decoded_only("residuals of ranges were used_in_solution | computed_after"),
    "deviation_rad": _decoded_only("of the compass, positive east", "rad"),
    "variation_rad": _decoded_only("of magnetic north from true north, positive east", "rad"),
    "instance": _decoded_only("which of several rudders"),
    "direction_order": _decoded_only("of a rudder: none | starboard | port"),
    "angle_order_rad": _decoded_only("that a rudder is asked for, positive right", "rad"),
    "time_source": _decoded_only("gps | glonass | radio | cesium | rubidium | crystal"),
    "local_offset_s": _decoded_only("of local time from UTC", "s"),
    "roll_rate_radps": _decoded_only("of 130842, as its device counts", "rad/s"),
    "pitch_rate_radps": _decoded_only("of 130842, as its device counts", "rad/s"),
    "nmea2000_version": _decoded_only("of the standard that the device was made to"),
    "product_code": _decoded_only("NMEA's number of the product"),
    "model": _decoded_only("text"),
    "software_version": _decoded_only("text"),
    "model_version": _decoded_only("text"),
    "serial_number": _decoded_only("text"),
    "certification_level": _decoded_only("of NMEA 2000: A | B"),
    "load_equivalency": _decoded_only("current drawn from the bus, in units of 50 mA"),
    "identity": _decoded_only("of a NAME: the device's own number"),
    "manufacturer": _decoded_only("of a NAME: code of SAE J1939 or NMEA 2000"),
    "device_instance": _decoded_only("of a NAME: which of several equal control units"),
    "function_instance": _decoded_only("of a NAME: which of several equal functions"),
    "function": _decoded_only("of a NAME: code"),
    "device_class": _decoded_only("of a NAME: code of the kind of machine"),
    "system_instance": _decoded_only("of a NAME: which of several such machines"),
    "industry_group": _decoded_only("of a NAME: code"),
    "arbitrary_address": _decoded_only("of a NAME: 1 where the device may take another address"),
}
