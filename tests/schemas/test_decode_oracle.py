"""Recorded traffic of real devices, decoded and compared with others' decoders.

Every field of every message of the table in every canboat file is compared with what PyPI `nmea2000` says.
Deliberate differences:
- its time fields' `value` is cut to whole seconds: `raw_value` is compared;
- an enumeration keeps its code there where it means nothing: here it is absent;
- the top values of a NAME's parts, not available there, are values here: they tell devices apart;
- of 130842 only Furuno's is in the table;
- a fast packet in the midst of which the recorder's clock jumps is none here: theirs is given no time.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import pytest
from nmea2000 import NMEA2000Decoder
from nmea2000.input_formats import N2KFormat
from paths import shared, shared_files

from tilth.replay.readers.any_log import frames
from tilth.replay.readers.log import LogError
from tilth.schemas import can_id
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Frame, Message
from tilth.schemas.pgn_table import DAY_NS, PGNS, ROW
from tilth.schemas.reassembly import Assembler

RECORDED = [path.name for path in shared_files("data/canboat")]
# Hold little of the table: four stray messages, or nothing but who is on the bus.
FEW = {"boatkit-fusion-menu.raw", "sample-YDWG02.txt", "actisense1.ebl", "actisense-523.rx.ebl"}

# PGN -> our field -> theirs, for all but reserved ones.
THEIRS: dict[int, dict[str, str]] = {
    129025: {"latitude_deg": "latitude", "longitude_deg": "longitude"},
    129026: {"sid": "sid", "heading_reference": "cogReference", "course_rad": "cog", "speed_mps": "sog"},
    129029: {
        "sid": "sid", "date_days": "date", "time_s": "time", "latitude_deg": "latitude",
        "longitude_deg": "longitude", "altitude_m": "altitude", "gnss_system": "gnssType", "fix": "method",
        "integrity": "integrity", "satellites": "numberOfSvs", "hdop": "hdop", "pdop": "pdop",
        "geoid_separation_m": "geoidalSeparation", "reference_stations": "referenceStations",
    },
    127250: {
        "sid": "sid", "heading_rad": "heading", "deviation_rad": "deviation", "variation_rad": "variation",
        "heading_reference": "reference",
    },
    127251: {"sid": "sid", "yaw_rate_radps": "rate"},
    127257: {"sid": "sid", "yaw_rad": "yaw", "pitch_rad": "pitch", "roll_rad": "roll"},
    127245: {
        "instance": "instance", "direction_order": "directionOrder", "angle_order_rad": "angleOrder",
        "wheel_angle_rad": "position",
    },
    126992: {"sid": "sid", "time_source": "source", "date_days": "date", "time_s": "time"},
    129033: {"date_days": "date", "time_s": "time", "local_offset_s": "localOffset"},
    126996: {
        "nmea2000_version": "nmea2000Version", "product_code": "productCode", "model": "modelId",
        "software_version": "softwareVersionCode", "model_version": "modelVersion",
        "serial_number": "modelSerialCode", "certification_level": "certificationLevel",
        "load_equivalency": "loadEquivalency",
    },
    129539: {
        "sid": "sid", "desired_mode": "desiredMode", "actual_mode": "actualMode", "hdop": "hdop",
        "vdop": "vdop", "tdop": "tdop",
    },
    129540: {
        "sid": "sid", "range_residual_mode": "rangeResidualMode", "satellites_in_view": "satsInView",
    },
    130842: {
        "own_of": "manufacturerCode", "own_in": "industryCode", "roll_rate_radps": "rollRate",
        "pitch_rate_radps": "pitchRate", "yaw_rate_radps": "yawRate",
    },
    60928: {
        "identity": "uniqueNumber", "manufacturer": "manufacturerCode", "function": "deviceFunction",
        "device_instance": "deviceInstanceLower", "function_instance": "deviceInstanceUpper",
        "device_class": "deviceClass", "system_instance": "systemInstance", "industry_group": "industryGroup",
        "arbitrary_address": "arbitraryAddressCapable",
    },
}  # fmt: skip
# PGN -> what it repeats: our key -> theirs.
REPEATED: dict[int, dict[str, str]] = {
    129029: {
        "gnss_system": "referenceStationType", "station": "referenceStationId",
        "correction_age_s": "ageOfDgnssCorrections",
    },
    129540: {
        "prn": "prn", "elevation_rad": "elevation", "azimuth_rad": "azimuth", "snr_db": "snr",
        "range_residual_m": "rangeResiduals", "status": "status", "satellite_system": "gnssSystem",
    },
}  # fmt: skip
# Their words for what we tell in words.
LABELS = {
    "certification_level": {"Level A": "A", "Level B": "B"},
    "desired_mode": {"1D": "1D", "2D": "2D", "3D": "3D", "Auto": "auto"},
    "actual_mode": {"1D": "1D", "2D": "2D", "3D": "3D", "Auto": "auto"},
    "gnss_system": {
        "GPS": "gps", "GLONASS": "glonass", "GPS+GLONASS": "gps_glonass", "GPS+SBAS/WAAS": "gps_sbas",
        "GPS+SBAS/WAAS+GLONASS": "gps_sbas_glonass", "Chayka": "chayka", "integrated": "integrated",
        "surveyed": "surveyed", "Galileo": "galileo",
    },
    "satellite_system": {
        "GPS": "gps", "GLONASS": "glonass", "Galileo": "galileo", "BeiDou": "beidou", "QZSS": "qzss",
    },
    "status": {
        "Not tracked": "not_tracked", "Tracked": "tracked", "Used": "used",
        "Not tracked+Diff": "not_tracked_differential", "Tracked+Diff": "tracked_differential",
        "Used+Diff": "used_differential",
    },
    "integrity": {"No integrity checking": "unchecked", "Safe": "safe", "Caution": "caution"},
    "direction_order": {"No Order": "none", "Move to starboard": "starboard", "Move to port": "port"},
    "time_source": {
        "GPS": "gps", "GLONASS": "glonass", "Radio Station": "radio", "Local Cesium clock": "cesium",
        "Local Rubidium clock": "rubidium", "Local Crystal clock": "crystal",
    },
    "range_residual_mode": {
        "Range residuals were used to calculate data": "used_in_solution",
        "Range residuals were calculated after the position": "computed_after",
    },
    "heading_reference": {"True": "true", "Magnetic": "magnetic"},
    "fix": {
        "no GNSS": "none", "GNSS fix": "gnss", "DGNSS fix": "dgnss", "Precise GNSS": "precise",
        "RTK Fixed Integer": "rtk_fixed", "RTK float": "rtk_float", "Estimated (DR) mode": "dead_reckoning",
        "Manual Input": "manual", "Simulate mode": "simulated",
    },
}  # fmt: skip


def oracle_line(frame: Frame) -> str:
    """The frame in canboat's plain text, which tells assembled messages and single frames apart by length."""
    head = can_id.split(frame.can_id)
    octets = ",".join(f"{octet:02x}" for octet in frame.data)
    return (
        f"2020-01-01T00:00:00.000Z,{head.priority},{head.pgn},{head.source},{head.destination},"
        f"{len(frame.data)},{octets}"
    )


def frames_of_recorded(name: str) -> Iterator[Frame]:
    try:
        yield from frames(shared("data/canboat") / name)
    except LogError as error:
        pytest.skip(str(error))


def both(name: str) -> Iterator[tuple[Message, bytes, Any]]:
    """Our message, its payload, their message: for each one of the table."""
    ours, theirs = Decoder(), NMEA2000Decoder(bound_format=N2KFormat.BASIC_STRING)
    assembler = Assembler(frozenset(), {})
    missed = stale = 0
    for frame in frames_of_recorded(name):
        head = can_id.split(frame.can_id)
        decoded = ours.messages(frame)
        if head.pgn not in THEIRS or not frame.data:
            assert not decoded
            continue
        payload = frame.data
        if ROW[head.pgn, None].fast and len(payload) == 8:
            whole = assembler.fast(frame, head)
            payload = whole.payload if whole is not None else b""
        message = theirs.decode(oracle_line(frame))
        if (
            decoded and message is None
        ):  # theirs now and then misses a fast packet of which every frame is there
            missed += 1
            assert missed <= 2
            message = theirs.decode(oracle_line(replace(frame, data=payload)))
        if message is not None and head.pgn == 130842 and "furuno" not in message.id:
            message = None
        if message is not None and not decoded and ours.rejected.get("stale_fast_packet", 0) > stale:
            stale += 1
            continue
        assert len(decoded) == (message is not None)
        if message is not None:
            yield decoded[0], payload, message


def expected_of(pgn: int, output: Any, found: Mapping[str, Any]) -> dict[str, Any]:
    """Their message in our keys and codes; what is not available is absent. found: ours."""
    theirs = {field.id: field for field in output.fields}
    expected: dict[str, Any] = {}
    for key, id in THEIRS[pgn].items():
        field = theirs[id]
        if key in LABELS:
            if field.value in LABELS[key]:
                expected[key] = LABELS[key][field.value]
        elif isinstance(field.raw_value, bytes):
            if field.value is not None:
                expected[key] = field.value
        elif field.raw_value is not None and (pgn == 60928 or field.value is not None):
            expected[key] = field.raw_value
        elif pgn == 60928:
            expected[key] = found[key]
    return expected


def repeated_in(pgn: int, output: Any) -> list[dict[str, Any]]:
    """What their message repeats, in our keys."""
    rows = next((field.value for field in output.fields if field.id == "##list##"), None)
    if rows is None:
        theirs = {field.id: field for field in output.fields}
        rows = [theirs] if all(id in theirs for id in REPEATED[pgn].values()) else []
    collected = []
    for row in rows:
        there = {key: row[id] for key, id in REPEATED[pgn].items()}
        collected.append(
            {
                key: LABELS[key][field.value] if key in LABELS else field.raw_value
                for key, field in there.items()
                if field.value is not None
            }
        )
    return collected


@pytest.mark.parametrize("name", RECORDED)
def test_every_field_is_what_nmea2000_says(name: str) -> None:
    compared: Counter[int] = Counter()
    for decoded, payload, output in both(name):
        row = ROW[decoded.pgn, None]
        found = row.layout.fields(payload)
        expected = expected_of(decoded.pgn, output, found)
        assert found.keys() == expected.keys() - decoded.dropped.keys(), (decoded, output)
        composed = {"utc_ns"} & decoded.values.keys()
        assert (
            decoded.values.keys() == (expected.keys() & set(row.signals)) - decoded.dropped.keys() | composed
        )
        assert all(decoded.dropped[key] == pytest.approx(expected.pop(key)) for key in decoded.dropped)
        for key, value in expected.items():
            # Both are floats nearest to the same decimal, give or take the last bit.
            right = value if isinstance(value, str) else pytest.approx(value, rel=1e-14, abs=1e-18)
            assert found[key] == right, (key, decoded, output)
            assert decoded.values.get(key, value) == right
        if "date_days" in expected and "time_s" in expected:
            utc_ns = expected["date_days"] * DAY_NS + round(expected["time_s"] * 1e9)
            assert decoded.values["utc_ns"] == utc_ns
        else:
            assert "utc_ns" not in decoded.values
        for rows in decoded.groups.values():
            if not rows:  # they read one all the same; that there are none is compared above
                continue
            theirs = repeated_in(decoded.pgn, output)
            assert [dict(there) for there in rows] == [
                {k: v if isinstance(v, str) else pytest.approx(v, rel=1e-14, abs=1e-18) for k, v in t.items()}
                for t in theirs
            ]
        assert decoded.sid == expected.get("sid")
        assert decoded.origin.source == output.source
        compared[decoded.pgn] += 1
    assert name in FEW or (sum(compared.values()) > 100 and len(compared) >= 5)


def test_the_comparison_holds_every_nmea_2000_field() -> None:
    for row in PGNS:
        if row.family != "j1939":
            assert THEIRS[row.pgn].keys() == {field.key for field in row.fields}
            for group in row.groups:
                assert REPEATED[row.pgn].keys() == {field.key for field in group.fields}


@pytest.mark.parametrize("code", range(16))
def test_every_method_of_a_solution(code: int) -> None:
    payload = bytearray(ROW[129029, None].encode({"satellites": 9}))
    payload[31] = code << 4
    frame = Frame(0, 0, "can0", can_id.join(3, 129029, 5), True, False, bytes(payload))
    decoded = NMEA2000Decoder(bound_format=N2KFormat.BASIC_STRING).decode(oracle_line(frame))
    assert decoded is not None
    label = str(next(field.value for field in decoded.fields if field.id == "method"))
    (message,) = Decoder().messages(frame)
    assert message.values.get("fix") == LABELS["fix"].get(label)
    assert ("fix" in message.values) == (code <= 8)


def test_a_device_that_says_not_available_for_ever_is_counted() -> None:
    decoder = Decoder()
    collected = [
        message
        for frame in frames(shared("data/canboat") / "furuno-fap7011c-autopilot-maneuvers.raw")
        for message in decoder.messages(frame)
        if message.origin.source == 36 and message.pgn == 129025
    ]
    assert len(collected) == 856 and not any(message.values for message in collected)
    assert decoder.rejected["not_available"] >= 856


def tractor(name: str) -> Iterator[tuple[Frame, dict[str, float] | None]]:
    """Frames of a pysobus file with the values that it expects."""
    for line in (shared("data/pysobus") / name).read_text().splitlines():
        stamp, text, _, expected = line.split("\t")
        t_ns = round(float(stamp) * 1000) * 1_000_000
        frame = Frame(t_ns, t_ns, "can0", int(text[:8], 16), True, False, bytes.fromhex(text[8:]))
        yield frame, json.loads(expected)


# Their name -> our word, and our unit in theirs.
PYSOBUS = {
    "Latitude": ("latitude_deg", 1.0),
    "Longitude": ("longitude_deg", 1.0),
    "Compass Bearing": ("course_rad", 57.29577951308232),
    "Altitude": ("altitude_m", 1.0),
    "Navigation-Based Vehicle Speed": ("speed_mps", 3.6),
    "Pitch": ("pitch_rad", 57.29577951308232),
}


@pytest.mark.parametrize(("name", "messages", "unidentified"), [("jd.txt", 2, 2), ("case.txt", 3, 0)])
def test_tractors_of_pysobus(name: str, messages: int, unidentified: int) -> None:
    decoder = Decoder()
    collected: list[Message] = []
    for frame, expected in tractor(name):
        fresh = decoder.messages(frame)
        for message in fresh:
            assert expected is not None
            for theirs, value in expected.items():
                word, unit = PYSOBUS[theirs]
                found = message.values[word]
                assert not isinstance(found, str) and found * unit == pytest.approx(value, abs=1e-9)
        collected += fresh
    assert len(collected) == messages
    # No claim was heard: a manufacturer's own message (65535) is nobody's.
    assert decoder.rejected.get("unidentified", 0) == unidentified
    assert all(message.origin.name is None and message.origin.source == 28 for message in collected)


def test_a_fast_packet_of_a_tractor_is_stamped_with_its_first_frame() -> None:
    rows = [(frame, expected) for frame, expected in tractor("case.txt") if frame.can_id == 0x19F8051C]
    decoder = Decoder()
    shifted = [
        Frame(frame.t_ns + 1000 * i, frame.rx_ns + 1000 * i, "can0", frame.can_id, True, False, frame.data)
        for i, (frame, _) in enumerate(rows)
    ]
    collected = [message for frame in shifted for message in decoder.messages(frame)]
    assert [message.t_ns for message in collected] == [shifted[0].t_ns]
