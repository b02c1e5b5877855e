"""The table of messages: layouts, signs, not-available rules, and decode(encode(x)) == x over every row."""

import math
import operator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilth.schemas import can_id, flow
from tilth.schemas.decode import encode, frames_of
from tilth.schemas.fields import FAMILIES, Field, Group
from tilth.schemas.pgn_table import PGNS, Pgn, row
from tilth.schemas.signals import SIGNALS

ROWS = [pytest.param(row, id=f"{row.pgn}-{row.selector or 0:02X}") for row in PGNS]
FIELDS = [
    pytest.param(row, field, id=f"{row.pgn}-{row.selector or 0:02X}-{field.key}")
    for row in PGNS
    for field in row.fields
]
BOUNDED = settings(derandomize=True, max_examples=60, deadline=None)


def words(pgn: int, data: str, selector: int | None = None) -> dict[str, flow.Word]:
    return row(pgn, selector).layout.decode(bytes.fromhex(data), {})


def payload_with(row: Pgn, field: Field, raw: int) -> bytes:
    """All ones but for one field."""
    mask = (1 << field.bits) - 1 << field.start
    whole = (1 << 8 * row.size) - 1 & ~mask | raw << field.start
    return whole.to_bytes(row.size, "little")


# The payloads are put together by hand from the tables of the documents, not by the encoder.
VECTORS = [
    (65267, None, "3D422397722E724B", {"latitude_deg": 43.5670333, "longitude_deg": -83.4225806}),
    (65256, None, "C47C300000648354", {
        "course_rad": math.radians(249.53125), "speed_mps": 0.1875 / 3.6, "pitch_rad": 0.0,
        "altitude_m": 204.375,
    }),
    # 10.5 s, 41 min, 15 h, June, day 21 (raw 83: its third quarter), 2015, UTC
    (65254, None, "2A290F06531E7D7D", {"utc_ns": 1_434_901_270_500_000_000}),
    # A quarter of a day raw 1 to 4 is the first of the month; not available offsets mean UTC.
    (65254, None, "000000010127FFFF", {"utc_ns": 1_704_067_200_000_000_000}),
    (65535, 0xE1, "E1FF006600620000", {"roll_rad": math.radians(4.0), "yaw_rate_radps": math.radians(-4.0)}),
    (65535, 0x53, "53FFFF7AFFFFFFFF", {"fix": "rtk_fixed"}),
    (65535, 0x53, "53FFFF6AFFFFFFFF", {"fix": "rtk_float"}),
    (65535, 0x53, "53FFFF5AFFFFFFFF", {"fix": "precise"}),
    (65535, 0x53, "53FFFF4AFFFFFFFF", {"fix": "precise"}),
    (65535, 0x53, "53FFFF3AFFFFFFFF", {"fix": "dgnss"}),
    (65535, 0x53, "53FFFF2AFFFFFFFF", {"fix": "dgnss"}),
    (65535, 0x53, "53FFFF1AFFFFFFFF", {"fix": "dgnss"}),
    (65535, 0x53, "53FFFF0AFFFFFFFF", {"fix": "none"}),
    (65096, None, "B80BFFFFFFFFFFFD", {"speed_mps": 3.0, "direction": "forward"}),
    (65097, None, "B80BFFFFFFFFFFFC", {"speed_mps": 3.0, "direction": "reverse"}),
    (65097, None, "B80BFFFFFFFFFFFE", {"speed_mps": 3.0}),  # direction: error
    (65258, None, "FFFFFFE00FB80BFF", {"whole_mass_kg": 8128.0, "carried_mass_kg": 6000.0}),
    # 32128 is straight on; 10 per km more is a right-hand curve of 100 m radius
    (44032, None, "807DFFFFFFFFFFFF", {"curvature_per_m": 0.0}),
    (44032, None, "A87DFFFFFFFFFFFF", {"curvature_per_m": 0.01}),
    # Asked to steer such a curve; then: no wish to steer
    (44288, None, "A87DFDFFFFFFFFFF", {"commanded_curvature_per_m": 0.01, "command_status": "intended"}),
    (44288, None, "807DFCFFFFFFFFFF", {"commanded_curvature_per_m": 0.0, "command_status": "not_intended"}),
    # J1939 counts to the left: raw above the middle is a left turn, negative here
    (61449, None, "7F81FF5F7DFFFFFF", {
        "hand_wheel_angle_rad": -(33151 / 1024 - 31.374), "yaw_rate_radps": -(32095 / 8192 - 3.92),
    }),
    (129025, None, "A7DF521F4A624103", {"latitude_deg": 52.5524903, "longitude_deg": 5.4616650}),
    (129026, None, "5AFC4F6B6400FFFF", {"heading_reference": "true", "course_rad": 2.7471, "speed_mps": 1.0}),
    (127250, None, "FF2CC2FF7FFF7FFD", {"heading_rad": 4.9708, "heading_reference": "magnetic"}),
    (127251, None, "8C005A6202FFFFFF", {"yaw_rate_radps": 1.25}),
    (127257, None, "8CF4FE64000CFEFF", {"yaw_rad": -0.0268, "pitch_rad": 0.01, "roll_rad": -0.05}),
    (127245, None, "00F8FF7F0CFEFFFF", {"instance": 0, "direction_order": "none", "wheel_angle_rad": -0.05}),
    (126992, None, "8CF0034290A6CD23", {
        "time_source": "gps", "utc_ns": (16899 * 86400 + 60068) * 10**9 + 8 * 10**6,
    }),
    (129033, None, "034290A6CD23C4FF", {
        "utc_ns": (16899 * 86400 + 60068) * 10**9 + 8 * 10**6, "local_offset_s": -3600,
    }),
    # The StarFire of facts/can.md 1.4
    (60928, None, "40E2210400170080", {
        "identity": 123456, "manufacturer": 33, "device_instance": 0, "function_instance": 0, "function": 23,
        "device_class": 0, "system_instance": 0, "industry_group": 0, "arbitrary_address": 1,
    }),
    (129539, None, "07D3460078008C00", {
        "desired_mode": "auto", "actual_mode": "3D", "hdop": 0.7, "vdop": 1.2, "tdop": 1.4,
    }),
]  # fmt: skip


@pytest.mark.parametrize(("pgn", "selector", "data", "expected"), VECTORS)
def test_bytes_of_the_documents(
    pgn: int, selector: int | None, data: str, expected: dict[str, flow.Word]
) -> None:
    decoded = words(pgn, data, selector)
    assert decoded.keys() == expected.keys()
    for key, value in expected.items():
        assert decoded[key] == (
            value if isinstance(value, str) else pytest.approx(value, rel=1e-12, abs=1e-15)
        )


def test_gnss_position_of_a_moored_boat() -> None:
    decoded = words(
        129029,
        "5d0442 50cdcd23 4033b504af0a4b07 5095fed66d08c200 b00c8affffffffff 10 fc 0c 3c00 6e00 52120000 00",
    )
    assert decoded == {
        "utc_ns": (16900 * 86_400 + 60069) * 10**9,
        "latitude_deg": pytest.approx(52.55, abs=0.1),
        "longitude_deg": pytest.approx(5.46, abs=0.1),
        "altitude_m": pytest.approx(-7.730000, abs=1e-3),
        "fix": "gnss",
        "satellites": 12,
        "hdop": 0.6,
        "pdop": 1.1,
        "geoid_separation_m": 46.9,
        "gnss_system": "gps",
        "integrity": "unchecked",
        "reference_stations": 0,
    }


@pytest.mark.parametrize("row", ROWS)
def test_a_row_is_complete(row: Pgn) -> None:
    taken = 0
    for field in row.fields:
        mask = (1 << field.bits) - 1 << field.start
        assert not taken & mask, f"{field.key} overlaps another field"
        taken |= mask
        assert field.end <= 8 * row.size
    keys = [field.key for field in row.fields]
    assert len(keys) == len(set(keys))
    assert {part for rule in row.composed for part in (*rule.parts, *rule.also)} <= set(keys)
    assert row.source and row.title and row.family in FAMILIES and 0 <= row.priority <= 7
    assert (row.manufacturer is None) == (row.pgn not in (65535, 130842))
    assert (row.selector is None) == (row.pgn != 65535)
    assert row.size == 8 or row.fast
    assert row.signals
    for group in row.groups:
        count = next(field for field in row.fields if field.key == group.count)
        assert (count.bits, count.start % 8) == (8, 0) and row.size == group.start
        assert max(field.end for field in group.fields) <= 8 * group.size


def test_every_word_is_carried_and_the_words_are_those_of_the_command_line() -> None:
    assert {word for row in PGNS for word in row.signals} == set(SIGNALS)
    assert " ".join(SIGNALS) == (
        "latitude_deg longitude_deg altitude_m course_rad speed_mps heading_rad heading_reference "
        "yaw_rate_radps roll_rad pitch_rad yaw_rad wheel_angle_rad hand_wheel_angle_rad curvature_per_m "
        "commanded_curvature_per_m command_status direction whole_mass_kg carried_mass_kg utc_ns fix "
        "satellites hdop pdop vdop tdop "
        "desired_mode actual_mode gnss_system integrity geoid_separation_m reference_stations "
        "satellites_in_view range_residual_mode deviation_rad variation_rad instance direction_order "
        "angle_order_rad time_source local_offset_s roll_rate_radps pitch_rate_radps nmea2000_version "
        "product_code model software_version model_version serial_number certification_level "
        "load_equivalency identity manufacturer device_instance function_instance function device_class "
        "system_instance industry_group arbitrary_address"
    )
    fixes = {
        name for row in PGNS for f in row.fields if f.key == "fix" and f.names for name in f.names.values()
    }
    assert fixes == {fix.value for fix in flow.FixType}


# First raw value that is none, from the facts sheet, by family, width and sign.
LIMITS = [
    ("nmea2000", 1, False, 2), ("nmea2000", 2, False, 3), ("nmea2000", 3, False, 7),
    ("nmea2000", 4, False, 14), ("nmea2000", 7, False, 126), ("nmea2000", 8, False, 0xFD),
    ("nmea2000", 16, False, 0xFFFD), ("nmea2000", 32, False, 0xFFFFFFFD),
    ("nmea2000", 16, True, 0x7FFD), ("nmea2000", 32, True, 0x7FFFFFFD),
    ("nmea2000", 64, True, 0x7FFFFFFFFFFFFFFD),
    ("j1939", 2, False, 2), ("j1939", 8, False, 251), ("j1939", 16, False, 0xFB00),
    ("j1939", 32, False, 0xFB000000), ("name", 21, False, 1 << 21),
]  # fmt: skip


@pytest.mark.parametrize(("family", "bits", "signed", "limit"), LIMITS)
def test_where_values_end(family: str, bits: int, signed: bool, limit: int) -> None:
    assert FAMILIES[family](bits, signed) == limit


@pytest.mark.parametrize(("row", "field"), FIELDS)
def test_not_available_is_absent(row: Pgn, field: Field) -> None:
    limit, top = field.limit(row.family), (1 << field.bits - field.signed) - 1
    if field.text:
        limit = top
    for raw in {limit, (limit + top) // 2, top} if limit <= top else set():
        assert field.key not in row.layout.fields(payload_with(row, field, raw))
    if field.names is None and not field.text:
        rejected: dict[str, int] = {}
        decoded = row.layout.fields(payload_with(row, field, limit - 1))
        row.layout.decode(payload_with(row, field, limit - 1), rejected)
        assert field.key in decoded or "out_of_range" in rejected  # the last one that is a value


@pytest.mark.parametrize("row", ROWS)
def test_a_message_of_nothing_but_not_available_has_no_words(row: Pgn) -> None:
    if row.pgn == 60928:
        return  # every pattern of a NAME is a value
    payload = row.encode({})
    assert row.layout.decode(payload, {}) == {}
    if not any(field.signed for field in row.fields):
        assert payload[1:] == b"\xff" * (row.size - 1)


# 65256: bearing, speed, pitch, altitude
VENDORS = [
    (
        "0000000000000000",
        {"course_rad": 0.0, "speed_mps": 0.0, "altitude_m": -2500.0},
    ),  # CFX-750: pitch raw 0
    ("FFFFFFFF0000FFFF", {}),
    ("FFFFFFFF0064FFFF", {}),  # StarFire before its fix
    ("FFFFFFFF0164FFFF", {"pitch_rad": math.radians(1 / 128)}),
    ("FFFF00010064FFFF", {"speed_mps": 1 / 3.6, "pitch_rad": 0.0}),
]


@pytest.mark.parametrize(("data", "expected"), VENDORS)
def test_what_vendors_send_for_no_data(data: str, expected: dict[str, float]) -> None:
    rejected: dict[str, int] = {}
    assert row(65256).layout.decode(bytes.fromhex(data), rejected) == pytest.approx(expected)
    assert rejected == {}  # no data, not something impossible


# A message, what is wrong with it, and the words that are left.
IMPOSSIBLE = [
    (129025, "00000040000000F0", {"longitude_deg"}),  # 107 deg north
    (129025, "0000001000000080", {"latitude_deg"}),  # 214 deg west
    (65267, "000000E0FFFFFFFF", set()),
    (65256, "00C8FFFFFFFFFFFF", set()),  # 400 deg
    (127251, "FFFFFFFF1FFFFFFF", set()),  # 16 rad/s
    (129033, "0342FFFFFF7FFF7F", set()),  # 59 h
    (65254, "0000001E0427FFFF", set()),  # month 30
    (65254, "000000020027FFFF", set()),  # day 0
    (65254, "00003C010427FFFF", set()),  # 60 h
    (65254, "F00000010427FFFF", {"utc_ns"}),  # second 60: a leap second
    (65254, "F80000010427FFFF", set()),  # second 62
]


@pytest.mark.parametrize(("pgn", "data", "expected"), IMPOSSIBLE)
def test_what_cannot_be_is_rejected_with_its_reason(pgn: int, data: str, expected: set[str]) -> None:
    rejected: dict[str, int] = {}
    assert row(pgn).layout.decode(bytes.fromhex(data), rejected).keys() == expected
    assert rejected == ({} if "utc_ns" in expected else {"out_of_range": 1})


def test_a_local_time_is_no_utc() -> None:
    assert words(65254, "2A290F06531E7DFA") == {}


def test_a_short_message_tells_what_is_whole() -> None:
    rejected: dict[str, int] = {}
    decoded = row(129026).layout.decode(bytes.fromhex("5AFC4F6B64"), rejected)
    assert decoded.keys() == {"heading_reference", "course_rad"}
    assert rejected == {"short_frame": 1}


def word_values(row: Pgn, word: str) -> st.SearchStrategy[flow.Word]:
    """Values of a word that its field can hold."""
    if word == "utc_ns":
        quarter = 250_000_000 if row.pgn == 65254 else 100_000
        days = 42_000 if row.family == "nmea2000" else 47_000
        first = 0 if row.family == "nmea2000" else 6_000
        return st.integers(first * 86_400 * 10**9 // quarter, days * 86_400 * 10**9 // quarter).map(
            lambda ticks: ticks * quarter
        )
    field = next(field for field in row.fields if field.key == word)
    if field.text:
        letters = st.text(st.characters(min_codepoint=33, max_codepoint=126, exclude_characters="@"))
        return letters.filter(lambda decoded: 0 < len(decoded) <= field.bits // 8)
    if field.names is not None:
        return st.sampled_from(sorted(set(field.names.values())))
    lowest = -(1 << field.bits - 1) if field.signed else 0
    ends = [
        (raw * field.scale + field.offset) * field.factor for raw in (lowest, field.limit(row.family) - 1)
    ]
    allowed = SIGNALS[word].range
    # Rounding to the field's resolution may leave the range that the word allows.
    below = field.resolution() if math.isfinite(allowed.low) and allowed.low != 0 else 0.0
    above = field.resolution() if math.isfinite(allowed.high) and field.resolution() != 1 else below
    low, high = max(min(ends), allowed.low + below), min(max(ends), allowed.high - above)
    return st.floats(low, high) if field.resolution() != 1 else st.integers(int(low), int(high))


@pytest.mark.parametrize("row", ROWS)
@BOUNDED
@given(data=st.data())
def test_decode_gives_back_what_was_encoded(row: Pgn, data: st.DataObject) -> None:
    given = row.pgn == 60928  # a NAME has every part
    output = {
        word: data.draw(word_values(row, word)) for word in row.signals if given or data.draw(st.booleans())
    }
    payload = row.layout.decode(row.encode(output), {})
    if payload.keys() != output.keys():
        # Only what a vendor says for "no data" may get lost: the pitch of 65256.
        assert row.pgn == 65256 and output.keys() - payload.keys() == {"pitch_rad"}
    for word, value in payload.items():
        if isinstance(value, str) or word == "utc_ns":
            assert value == output[word]
        else:
            field = next(field for field in row.fields if field.key == word)
            requested = output[word]
            assert not isinstance(requested, str)
            # Half a bit, and what a float cannot hold of 1e-16 deg.
            assert abs(value - requested) <= 0.51 * field.resolution() + 1e-14 * abs(requested)


REPEATED = [pytest.param(row, group, id=f"{row.pgn}-{group.key}") for row in PGNS for group in row.groups]


def a_repetition(group: Group) -> st.SearchStrategy[dict[str, flow.Word]]:
    """Any of its fields, as raw values would give them."""
    ways: dict[str, st.SearchStrategy[flow.Word]] = {}
    for field in group.fields:
        if field.names is not None:
            ways[field.key] = st.sampled_from(sorted(set(field.names.values())))
        else:
            low = -(1 << field.bits - 1) if field.signed else 0
            raws = st.integers(low, field.limit("nmea2000") - 1)
            ways[field.key] = st.builds(operator.mul, raws, st.just(field.scale))
    return st.fixed_dictionaries({}, optional=ways)


@pytest.mark.parametrize(("row", "group"), REPEATED)
@BOUNDED
@given(data=st.data())
def test_what_is_repeated_comes_back(row: Pgn, group: Group, data: st.DataObject) -> None:
    output = data.draw(st.lists(a_repetition(group), max_size=18))
    payload = row.encode({}, {group.key: output})
    rejected: dict[str, int] = {}
    decoded = row.layout.groups(payload, rejected)[group.key]
    assert len(payload) == row.size + len(output) * group.size and not rejected
    assert row.layout.decode(payload, {})[group.count] == len(output)
    assert [there.keys() for there in decoded] == [there.keys() for there in output]
    for ours, theirs in zip(decoded, output, strict=True):
        assert ours == {
            key: value if isinstance(value, str) else pytest.approx(value, rel=1e-12)
            for key, value in theirs.items()
        }


@pytest.mark.parametrize(("row", "group"), REPEATED)
def test_what_is_repeated_but_cut_off(row: Pgn, group: Group) -> None:
    """What is whole is told, and the rest counted; no number of them is no list."""
    whole = row.encode({}, {group.key: [{}, {}, {}]})
    for size in range(len(whole) + 1):
        rejected: dict[str, int] = {}
        decoded = row.layout.groups(whole[:size], rejected)
        if size < row.size:  # its last byte says how often
            assert decoded == {}
            continue
        assert len(decoded[group.key]) == (size - row.size) // group.size
        assert rejected == ({} if size == len(whole) else {"short_frame": 1})
    assert row.layout.groups(row.encode({}), {}) == {}
    with pytest.raises(ValueError, match="repeats no moons"):
        row.encode({}, {"moons": []})


@pytest.mark.parametrize(
    ("characters", "expected"),
    [
        (b"WS320" + b" " * 27, "WS320"),
        (b"WS320" + b"\xff" * 27, "WS320"),
        (b"WS320\0rest of a buffer", "WS320"),
        (b"@" * 32, None),
        (b"\x1b[2Jgone", "?[2Jgone"),  # nothing may reach a person's terminal but letters
        (b"Bj\xf6rn", "Björn"),
    ],
)
def test_texts(characters: bytes, expected: str | None) -> None:
    field = next(field for field in row(126996).fields if field.key == "model")
    payload = bytearray(row(126996).encode({}))
    payload[field.start // 8 : field.end // 8] = characters.ljust(32, b"\0")
    assert row(126996).layout.decode(bytes(payload), {}).get("model") == expected
    with pytest.raises(ValueError, match="more than 32 characters"):
        encode(126996, {"model": "x" * 33})


@pytest.mark.parametrize(("pgn", "data", "expected"), IMPOSSIBLE)
def test_what_is_dropped_can_be_seen(pgn: int, data: str, expected: set[str]) -> None:
    dropped: dict[str, flow.Word] = {}
    row(pgn).layout.decode(bytes.fromhex(data), {}, dropped)
    assert len(dropped) == (0 if "utc_ns" in expected else 1) and not dropped.keys() & expected


@pytest.mark.parametrize("row", ROWS)
@BOUNDED
@given(data=st.data())
def test_any_bytes_are_told_and_said_again(row: Pgn, data: st.DataObject) -> None:
    whole = 8 if row.pgn == 60928 else 0  # else what is missing of a NAME would be told as ones
    payload = data.draw(st.binary(min_size=whole, max_size=row.size + 8))
    decoded = row.layout.decode(payload, {})
    assert set(decoded) <= set(row.signals)
    for word, value in decoded.items():
        assert isinstance(value, str) or SIGNALS[word].range.low <= value <= SIGNALS[word].range.high
    if row.pgn != 65254 or "utc_ns" not in decoded:  # a quarter of the day that contradicts the hour is lost
        again = row.layout.decode(row.encode(decoded), {})
        assert again.keys() == decoded.keys()
        for word, value in decoded.items():
            assert again[word] == (value if isinstance(value, str) else pytest.approx(value, rel=1e-13))


@pytest.mark.parametrize(
    ("pgn", "values", "complaint"),
    [
        (129026, {"speed_mps": 700.0}, "speed_mps = 700.0 does not fit"),
        (129026, {"speed_mps": -1.0}, "does not fit"),
        (129026, {"speed_mps": math.nan}, "is not a number"),
        (129026, {"fix": "none"}, "this message has no fix; it has sid,"),
        (129029, {"fix": "perfect"}, "none of none, gnss"),
        (129999, {}, "the table has no PGN 129999"),
    ],
)
def test_what_cannot_be_said(pgn: int, values: dict[str, flow.Word], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        encode(pgn, values)


def test_frames_of_a_fast_packet_and_of_a_single_frame() -> None:
    payload = encode(129029, {"latitude_deg": 1.0}, sid=7)
    frames = frames_of(129029, payload, 40, sequence=9)
    assert len(frames) == 7 and {identifier for identifier, _ in frames} == {0x0DF80528}
    assert [data[0] for _, data in frames] == [0x20 | index for index in range(7)]
    assert frames[0][1][1:3] == b"\x2b\x07"
    assert b"".join([frames[0][1][2:], *(data[1:] for _, data in frames[1:])])[:43] == payload
    assert frames_of(44032, encode(44032, {}), 0x13, 0x1E) == [(0x0CAC1E13, b"\xff" * 8)]
    with pytest.raises(ValueError, match="single frame of 8 bytes"):
        frames_of(129025, bytes(9), 40)


@pytest.mark.parametrize(
    ("identifier", "parts"),
    [
        (0x18FEF31C, (6, 65267, 28, 255)),
        (0x0CAC1E13, (3, 44032, 0x13, 0x1E)),
        (0x0DF8052B, (3, 129029, 43, 255)),
        (0x18EEFFFE, (6, 60928, 254, 255)),
    ],
)
def test_identifiers(identifier: int, parts: tuple[int, int, int, int]) -> None:
    assert can_id.split(identifier) == parts
    assert can_id.join(*parts) == identifier


@BOUNDED
@given(st.integers(0, (1 << 29) - 1))
def test_every_identifier_comes_back(identifier: int) -> None:
    assert can_id.join(*can_id.split(identifier)) == identifier
