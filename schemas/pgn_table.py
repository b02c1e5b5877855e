"""The table of messages.

`PGNS` is an extension point: a row is a message, and decoder, encoder, simulator, tests and the fields of
`tilth decode --json` follow from it. Layouts are cited as facts/can.md cites them.
"""

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field

from tilth.schemas.fields import DEG, KMH, Composed, Field, Group, Layout, Rows
from tilth.schemas.flow import Word
from tilth.schemas.signals import SIGNALS


@dataclass(frozen=True, slots=True)
class Pgn:
    """One message."""

    pgn: int
    title: str
    family: str  # a key of fields.FAMILIES
    priority: int
    interval_ms: int  # nominal; 0: on request or event
    size: int  # bytes of its payload
    source: str  # of the layout
    fields: tuple[Field, ...]
    composed: tuple[Composed, ...] = ()
    fast: bool = False  # NMEA 2000 fast packet, else a single frame
    groups: tuple[Group, ...] = ()  # what it repeats behind its fields
    selector: int | None = None  # byte 0 of a manufacturer's own message
    manufacturer: int | None = None  # whose own it is; without a selector its first two bytes say so
    wish: bool = False  # asks for something: no measurement, from whomever
    decode_only: bool = False  # for people: no measurement is made of it, the fold does not read it
    layout: Layout = field(init=False, repr=False, compare=False)
    signals: tuple[str, ...] = field(init=False, repr=False, compare=False)  # that it can carry
    position: slice | None = field(init=False, repr=False, compare=False)  # bytes of latitude and longitude
    telling: frozenset[str] = field(init=False, repr=False, compare=False)  # without any of them it is empty
    has_sid: bool = field(init=False, repr=False, compare=False)  # byte 0 is a sequence identifier

    def __post_init__(self) -> None:
        ranges = {key: signal.range for key, signal in SIGNALS.items()}
        measured = frozenset(key for key, signal in SIGNALS.items() if signal.measured)
        layout = Layout(self.fields, self.composed, self.family, self.size, ranges, measured, self.groups)
        keys = {f.key for f in self.fields} | {rule.key for rule in self.composed}
        where = [f for f in self.fields if f.key in ("latitude_deg", "longitude_deg")]
        span = slice(min(f.start for f in where) // 8, max(f.end for f in where) // 8) if where else None
        object.__setattr__(self, "layout", layout)
        object.__setattr__(self, "telling", keys & measured or keys & SIGNALS.keys())
        object.__setattr__(self, "signals", tuple(key for key in SIGNALS if key in keys))
        object.__setattr__(self, "position", span)
        object.__setattr__(self, "has_sid", any(f.key == "sid" for f in self.fields))

    def encode(self, values: Mapping[str, Word], groups: Mapping[str, Rows] | None = None) -> bytes:
        """Payload of signals; what is absent is written as not available. Raises ValueError."""
        if self.manufacturer is not None and self.selector is None:
            values = {**values, "own_of": self.manufacturer, "own_in": MARINE}
        payload = self.layout.encode(values, groups)
        return payload if self.selector is None else bytes([self.selector]) + payload[1:]


DAY_NS = 86_400_000_000_000
_EPOCH_DAY = datetime.date(1970, 1, 1).toordinal()


def _of_day(nanoseconds: int) -> int:
    # 86 400 s to 86 401 s is a leap second.
    if not 0 <= nanoseconds < DAY_NS + 1_000_000_000:
        raise ValueError("no time of day")
    return nanoseconds


def _join_nmea2000(parts: Mapping[str, Word]) -> int:
    return int(parts["date_days"]) * DAY_NS + _of_day(round(float(parts["time_s"]) * 1e9))


def _split_nmea2000(utc_ns: Word) -> dict[str, Word]:
    days, of_day = divmod(int(utc_ns), DAY_NS)
    return {"date_days": days, "time_s": of_day / 1e9}


NMEA2000_TIME = Composed("utc_ns", ("date_days", "time_s"), _join_nmea2000, _split_nmea2000)

_LOCAL_TIME = 125  # hours of offset that mean: a local time, not said how far from UTC (SPN 1602)


def _join_j1939(parts: Mapping[str, Word]) -> int | None:
    if parts.get("local_offset_h") == _LOCAL_TIME:
        return None
    # 0.25 d a bit and counted from 1: 1 to 4 are the quarters of the first day (SPN 962).
    day = (int(parts["quarter_days"]) + 3) // 4
    date = datetime.date(int(parts["year"]), int(parts["month"]), day)
    hour, minute, second = int(parts["hour"]), int(parts["minute"]), float(parts["second_s"])
    if hour > 23 or minute > 59 or second >= 61.0:
        raise ValueError("no time of day")
    of_day = (hour * 3600 + minute * 60) * 1_000_000_000 + round(second * 1e9)
    return (date.toordinal() - _EPOCH_DAY) * DAY_NS + of_day


def _split_j1939(utc_ns: Word) -> dict[str, Word]:
    quarters = round(int(utc_ns) / 250_000_000)  # so that 59.9 s becomes the next minute, not its second 60
    days, of_day = divmod(quarters, 4 * 86_400)
    date = datetime.date.fromordinal(_EPOCH_DAY + days)
    hour, of_hour = divmod(of_day, 4 * 3600)
    minute, of_minute = divmod(of_hour, 4 * 60)
    return {
        "year": date.year, "month": date.month, "quarter_days": (date.day - 1) * 4 + hour // 6 + 1,
        "hour": hour, "minute": minute, "second_s": of_minute / 4,
    }  # fmt: skip


J1939_TIME = Composed(
    "utc_ns",
    ("year", "month", "quarter_days", "hour", "minute", "second_s"),
    _join_j1939,
    _split_j1939,
    also=("local_offset_h",),
)

REFERENCE = {0: "true", 1: "magnetic"}
DIRECTION = {0: "reverse", 1: "forward"}
COMMAND_STATUS = {0: "not_intended", 1: "intended"}
METHOD = {
    0: "none", 1: "gnss", 2: "dgnss", 3: "precise", 4: "rtk_fixed", 5: "rtk_float", 6: "dead_reckoning",
    7: "manual", 8: "simulated",
}  # fmt: skip
# 1 differential, 2 Deere's own, 3 WAAS; 4 SF1, 5 SF2; 6 RTK-X bridges a lost correction; 7 RTK. The encoder
# writes the first row of a signal.
STARFIRE_FIX = {
    0: "none", 1: "dgnss", 2: "dgnss", 3: "dgnss", 4: "precise", 5: "precise", 6: "rtk_float", 7: "rtk_fixed",
}  # fmt: skip
DEERE = 33
FURUNO = 1855
MARINE = 4  # industry group of NMEA 2000's own devices
GNSS_MODE = {0: "1D", 1: "2D", 2: "3D", 3: "auto"}
GNSS_SYSTEM = {
    0: "gps", 1: "glonass", 2: "gps_glonass", 3: "gps_sbas", 4: "gps_sbas_glonass", 5: "chayka",
    6: "integrated", 7: "surveyed", 8: "galileo",
}  # fmt: skip
SATELLITE_SYSTEM = {0: "gps", 1: "glonass", 2: "galileo", 3: "beidou", 4: "qzss"}
SATELLITE_STATUS = {
    0: "not_tracked", 1: "tracked", 2: "used", 3: "not_tracked_differential", 4: "tracked_differential",
    5: "used_differential",
}  # fmt: skip
INTEGRITY = {0: "unchecked", 1: "safe", 2: "caution"}  # 3, unsafe, is what many send for "not available"
DIRECTION_ORDER = {0: "none", 1: "starboard", 2: "port"}
TIME_SOURCE = {0: "gps", 1: "glonass", 2: "radio", 3: "cesium", 4: "rubidium", 5: "crystal"}
RANGE_RESIDUAL_MODE = {0: "used_in_solution", 1: "computed_after"}
CERTIFICATION_LEVEL = {0: "A", 1: "B"}

# What devices send for pitch in place of "not available" (facts/can.md 1.1).
CFX_750 = (0,)  # -200 deg
STARFIRE_NO_FIX = (0x6400,)  # 0 deg, while bearing, speed and altitude are not available

_CANBOAT = "canboat docs/canboat.json"
_STARFIRE = "torriem/gps_j1939, FarmLogs/pysobus #9, NeptuneGPS_Triton: confirm signs on traffic"
_SID = Field("sid", 0, 8)

# fmt: off
PGNS: tuple[Pgn, ...] = (
    Pgn(65267, "Vehicle Position", "j1939", 6, 200, 8, "SAE J1939-71; nominally 5 s, receivers send 5 Hz", (
        Field("latitude_deg", 0, 32, 1e-7, -210.0),
        Field("longitude_deg", 32, 32, 1e-7, -210.0),
    )),
    Pgn(65256, "Vehicle Direction/Speed", "j1939", 6, 200, 8, "SAE J1939-71", (
        Field("course_rad", 0, 16, 1 / 128, 0.0, DEG),
        Field("speed_mps", 16, 16, 1 / 256, 0.0, KMH),
        Field("pitch_rad", 32, 16, 1 / 128, -200.0, DEG, no_data=CFX_750, no_data_alone=STARFIRE_NO_FIX),
        Field("altitude_m", 48, 16, 0.125, -2500.0),
    )),
    Pgn(65254, "Time/Date", "j1939", 6, 200, 8, "SAE J1939-71, SPN 959 to 964, 1601, 1602", (
        Field("second_s", 0, 8, 0.25),
        Field("minute", 8, 8),
        Field("hour", 16, 8),
        Field("month", 24, 8),
        Field("quarter_days", 32, 8),
        Field("year", 40, 8, 1.0, 1985.0),
        Field("local_offset_min", 48, 8, 1.0, -125.0),
        Field("local_offset_h", 56, 8, 1.0, -125.0),
    ), (J1939_TIME,)),
    Pgn(65535, "StarFire TCM", "j1939", 6, 200, 8, _STARFIRE, (
        Field("roll_rad", 16, 16, 1 / 128, -200.0, DEG),
        Field("yaw_rate_radps", 32, 16, 1 / 128, -200.0, DEG),
    ), selector=0xE1, manufacturer=DEERE),
    Pgn(65535, "StarFire quality", "j1939", 6, 200, 8, _STARFIRE, (
        Field("accuracy", 24, 4),
        Field("fix", 28, 4, names=STARFIRE_FIX),
    ), selector=0x53, manufacturer=DEERE),
    Pgn(65096, "Wheel-based Speed and Distance", "j1939", 3, 100, 8, "ISO 11783-7; AgIsoStack", (
        Field("speed_mps", 0, 16, 0.001),
        Field("direction", 56, 2, names=DIRECTION),
    )),
    Pgn(65097, "Ground-based Speed and Distance", "j1939", 3, 100, 8, "ISO 11783-7; AgIsoStack", (
        Field("speed_mps", 0, 16, 0.001),
        Field("direction", 56, 2, names=DIRECTION),
    )),
    Pgn(65258, "Vehicle Weight", "j1939", 7, 1000, 8, "SAE J1939-71, SPN 180 and 181", (
        Field("whole_mass_kg", 24, 16, 2.0),
        Field("carried_mass_kg", 40, 16, 2.0),
    )),
    Pgn(44032, "Guidance Machine Info", "j1939", 3, 100, 8, "ISO 11783-7; AgIsoStack", (
        Field("curvature_per_m", 0, 16, 0.25, -8032.0, 1e-3),
    )),
    Pgn(44288, "Guidance System Command", "j1939", 3, 100, 8, "ISO 11783-7; AgIsoStack", (
        Field("commanded_curvature_per_m", 0, 16, 0.25, -8032.0, 1e-3),
        Field("command_status", 16, 2, names=COMMAND_STATUS),
    ), wish=True),
    # J1939 counts both positive to the left, the yaw rate as far as is known: confirm on traffic.
    Pgn(61449, "Vehicle Dynamic Stability Control 2", "j1939", 6, 10, 8, "SAE J1939-71, SPN 1807, 1808", (
        Field("hand_wheel_angle_rad", 0, 16, 1 / 1024, -31.374, -1.0),
        Field("yaw_rate_radps", 24, 16, 1 / 8192, -3.92, -1.0),
    )),
    Pgn(60928, "Address Claimed", "name", 6, 0, 8, "ISO 11783-5; canboat docs/canboat.json", (
        Field("identity", 0, 21),
        Field("manufacturer", 21, 11),
        Field("device_instance", 32, 3),
        Field("function_instance", 35, 5),
        Field("function", 40, 8),
        Field("device_class", 49, 7),
        Field("system_instance", 56, 4),
        Field("industry_group", 60, 3),
        Field("arbitrary_address", 63, 1),
    )),
    Pgn(129025, "Position, Rapid Update", "nmea2000", 2, 100, 8, _CANBOAT, (
        Field("latitude_deg", 0, 32, 1e-7, signed=True),
        Field("longitude_deg", 32, 32, 1e-7, signed=True),
    )),
    Pgn(129026, "COG & SOG, Rapid Update", "nmea2000", 2, 250, 8, _CANBOAT, (
        _SID,
        Field("heading_reference", 8, 2, names=REFERENCE),
        Field("course_rad", 16, 16, 1e-4),
        Field("speed_mps", 32, 16, 0.01),
    )),
    Pgn(129029, "GNSS Position Data", "nmea2000", 3, 1000, 43, _CANBOAT, (
        _SID,
        Field("date_days", 8, 16),
        Field("time_s", 24, 32, 1e-4),
        Field("latitude_deg", 56, 64, 1e-16, signed=True),
        Field("longitude_deg", 120, 64, 1e-16, signed=True),
        Field("altitude_m", 184, 64, 1e-6, signed=True),
        Field("gnss_system", 248, 4, names=GNSS_SYSTEM),
        Field("fix", 252, 4, names=METHOD),
        Field("integrity", 256, 2, names=INTEGRITY),
        Field("satellites", 264, 8),
        Field("hdop", 272, 16, 0.01, signed=True),
        Field("pdop", 288, 16, 0.01, signed=True),
        Field("geoid_separation_m", 304, 32, 0.01, signed=True),
        Field("reference_stations", 336, 8),
    ), (NMEA2000_TIME,), fast=True, groups=(Group("stations", "reference_stations", 43, 4, (
        Field("gnss_system", 0, 4, names=GNSS_SYSTEM),
        Field("station", 4, 12),
        Field("correction_age_s", 16, 16, 0.01),
    )),)),
    Pgn(129539, "GNSS DOPs", "nmea2000", 6, 1000, 8, _CANBOAT, (
        _SID,
        Field("desired_mode", 8, 3, names=GNSS_MODE),
        Field("actual_mode", 11, 3, names=GNSS_MODE),
        Field("hdop", 16, 16, 0.01, signed=True),
        Field("vdop", 32, 16, 0.01, signed=True),
        Field("tdop", 48, 16, 0.01, signed=True),
    ), decode_only=True),
    Pgn(129540, "GNSS Sats in View", "nmea2000", 6, 1000, 3, _CANBOAT, (
        _SID,
        Field("range_residual_mode", 8, 2, names=RANGE_RESIDUAL_MODE),
        Field("satellites_in_view", 16, 8),
    ), fast=True, decode_only=True, groups=(Group("sky", "satellites_in_view", 3, 12, (
        Field("prn", 0, 8),
        Field("elevation_rad", 8, 16, 1e-4, signed=True),
        Field("azimuth_rad", 24, 16, 1e-4),
        Field("snr_db", 40, 16, 0.01, signed=True),
        Field("range_residual_m", 56, 32, 1e-5, signed=True),
        Field("status", 88, 4, names=SATELLITE_STATUS),
        Field("satellite_system", 92, 4, names=SATELLITE_SYSTEM),
    )),)),
    Pgn(127250, "Vessel Heading", "nmea2000", 2, 100, 8, _CANBOAT, (
        _SID,
        Field("heading_rad", 8, 16, 1e-4),
        Field("deviation_rad", 24, 16, 1e-4, signed=True),
        Field("variation_rad", 40, 16, 1e-4, signed=True),
        Field("heading_reference", 56, 2, names=REFERENCE),
    )),
    Pgn(127251, "Rate of Turn", "nmea2000", 2, 100, 8, _CANBOAT, (
        _SID,
        Field("yaw_rate_radps", 8, 32, 3.125e-8, signed=True),
    )),
    Pgn(127257, "Attitude", "nmea2000", 3, 1000, 8, _CANBOAT, (
        _SID,
        Field("yaw_rad", 8, 16, 1e-4, signed=True),
        Field("pitch_rad", 24, 16, 1e-4, signed=True),
        Field("roll_rad", 40, 16, 1e-4, signed=True),
    )),
    Pgn(127245, "Rudder", "nmea2000", 2, 100, 8, _CANBOAT, (
        Field("instance", 0, 8),
        Field("direction_order", 8, 3, names=DIRECTION_ORDER),
        Field("angle_order_rad", 16, 16, 1e-4, signed=True),
        Field("wheel_angle_rad", 32, 16, 1e-4, signed=True),
    )),
    Pgn(126992, "System Time", "nmea2000", 3, 1000, 8, _CANBOAT, (
        _SID,
        Field("time_source", 8, 4, names=TIME_SOURCE),
        Field("date_days", 16, 16),
        Field("time_s", 32, 32, 1e-4),
    ), (NMEA2000_TIME,)),
    Pgn(129033, "Time & Date", "nmea2000", 3, 1000, 8, _CANBOAT, (
        Field("date_days", 0, 16),
        Field("time_s", 16, 32, 1e-4),
        Field("local_offset_s", 48, 16, 60.0, signed=True),
    ), (NMEA2000_TIME,)),
    Pgn(126996, "Product Information", "nmea2000", 6, 0, 134, _CANBOAT, (
        Field("nmea2000_version", 0, 16, 0.001),
        Field("product_code", 16, 16),
        Field("model", 32, 256, text=True),
        Field("software_version", 288, 256, text=True),
        Field("model_version", 544, 256, text=True),
        Field("serial_number", 800, 256, text=True),
        Field("certification_level", 1056, 8, names=CERTIFICATION_LEVEL),
        Field("load_equivalency", 1064, 8),
    ), fast=True, decode_only=True),
    # Further fields of it are not known to anybody. It is not smoothed where 127251 of the same device is.
    Pgn(130842, "Furuno Six Degrees Of Freedom Movement", "nmea2000", 7, 0, 29, _CANBOAT, (
        Field("own_of", 0, 11),
        Field("own_in", 13, 3),
        Field("roll_rate_radps", 120, 32, 1e-3, 0.0, DEG, signed=True),
        Field("pitch_rate_radps", 152, 32, 1e-3, 0.0, DEG, signed=True),
        Field("yaw_rate_radps", 184, 32, 1e-3, 0.0, DEG, signed=True),
    ), fast=True, decode_only=True, manufacturer=FURUNO),
)
# fmt: on

ROW: dict[tuple[int, int | None], Pgn] = {(row.pgn, row.selector): row for row in PGNS}
"""Rows by (PGN, selector)."""


def row(pgn: int, selector: int | None = None) -> Pgn:
    """The row of a message. Raises ValueError where there is none."""
    found = ROW.get((pgn, selector))
    if found is None:
        at = "" if selector is None else f" with selector 0x{selector:02X}"
        raise ValueError(f"the table has no PGN {pgn}{at}; add a row to PGNS")
    return found
