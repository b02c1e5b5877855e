"""The table's rows of J1939 against what others say of SAE J1939-71 and ISO 11783-7.

Where bits stand: the public J1939 DBC that PyPI `canmatrix` ships (positions and lengths; it has no scales).
What they mean: SPN, position, length, offset and the range of the data as PyPI `cancat` 2.9.5 lists them
(cancatlib/J1939db.py), copied here as facts; of 65097's speed it has none, so that is held against 65096's. A
scale follows from the range: its top is raw 0xFA, 0xFAFF or 0xFAFFFFFF.
The two guidance messages (44032, 44288) are in neither, nor are Deere's own: their source is what the table
says (AgIsoStack, facts of recorded traffic).
"""

import warnings
from importlib.resources import files
from typing import Any

import cantools
import pytest

from tilth.schemas.can_id import split
from tilth.schemas.fields import DEG, KMH, Field
from tilth.schemas.pgn_table import PGNS, Pgn, row

ROWS = [known for known in PGNS if known.family == "j1939"]
ELSEWHERE = {44032, 44288, 65535}

# PGN, our field, SPN, name in the DBC, first bit, bits, lowest and highest value, and our unit in theirs.
MPH = 1.609344 * KMH
FACTS: list[tuple[int, str, int, str | None, int, int, float, float, float]] = [
    (65267, "latitude_deg", 584, "Latitude", 0, 32, -210.0, 211.108122, 1.0),
    (65267, "longitude_deg", 585, "Longitude", 32, 32, -210.0, 211.108122, 1.0),
    (65256, "course_rad", 165, "Compass_Bearing", 0, 16, 0.0, 501.99, DEG),
    (65256, "speed_mps", 517, "Navigation_Based_Vehicle_Speed", 16, 16, 0.0, 155.961635516, MPH),
    (65256, "pitch_rad", 583, "Pitch", 32, 16, -200.0, 301.992, DEG),
    (65256, "altitude_m", 580, "Altitude", 48, 16, -2500.0, 5531.875, 1.0),
    (65254, "second_s", 959, "Seconds", 0, 8, 0.0, 62.5, 1.0),
    (65254, "minute", 960, "Minutes", 8, 8, 0.0, 250.0, 1.0),
    (65254, "hour", 961, "Hours", 16, 8, 0.0, 250.0, 1.0),
    (65254, "month", 963, "Month", 24, 8, 0.0, 250.0, 1.0),
    (65254, "quarter_days", 962, "Day", 32, 8, 0.0, 62.5, 4.0),  # we count quarters of a day
    (65254, "year", 964, "Year", 40, 8, 1985.0, 2235.0, 1.0),
    (65254, "local_offset_min", 1601, "Local_minute_offset", 48, 8, -125.0, 125.0, 1.0),
    (65254, "local_offset_h", 1602, "Local_hour_offset", 56, 8, -125.0, 125.0, 1.0),
    (65096, "speed_mps", 1862, None, 0, 16, 0.0, 64.255, 1.0),
    (65096, "direction", 1864, None, 56, 2, 0.0, 3.0, 1.0),
    (65097, "speed_mps", 1859, None, 0, 16, 0.0, 64.255, 1.0),
    (65097, "direction", 1861, None, 56, 2, 0.0, 3.0, 1.0),
    (65258, "whole_mass_kg", 180, "Trailer_Weight", 24, 16, 0.0, 128510.0, 1.0),
    (65258, "carried_mass_kg", 181, "Cargo_Weight", 40, 16, 0.0, 128510.0, 1.0),
    (61449, "hand_wheel_angle_rad", 1807, "Steering_Wheel_Angle", 0, 16, -31.374, 31.374, -1.0),
    (61449, "yaw_rate_radps", 1808, "Yaw_Rate", 24, 16, -3.92, 3.92, -1.0),
]


@pytest.fixture(scope="module")
def database() -> dict[int, Any]:
    """Messages of canmatrix's DBC by PGN."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        text = files("canmatrix").joinpath("j1939.dbc").read_text("latin-1")
        found: Any = cantools.database.load_string(text, "dbc", strict=False)
    return {split(message.frame_id).pgn: message for message in found.messages}


def field_of(known: Pgn, key: str) -> Field:
    return next(field for field in known.fields if field.key == key)


def test_every_field_of_j1939_is_compared() -> None:
    ours = {(known.pgn, field.key) for known in ROWS for field in known.fields if known.pgn not in ELSEWHERE}
    assert {(pgn, key) for pgn, key, *_ in FACTS} == ours
    assert {known.pgn for known in ROWS} == {pgn for pgn, _ in ours} | ELSEWHERE


@pytest.mark.parametrize(("pgn", "key", "spn", "name", "start", "bits", "low", "high", "unit"), FACTS)
def test_a_field_means_what_others_say(
    pgn: int,
    key: str,
    spn: int,
    name: str | None,
    start: int,
    bits: int,
    low: float,
    high: float,
    unit: float,
) -> None:
    field = field_of(row(pgn), key)
    assert (field.start, field.bits, field.signed) == (start, bits, False), spn
    if field.names is not None:  # 0 reverse, 1 forward, 2 error, 3 not available (facts/can.md 1.3)
        assert field.names == {0: "reverse", 1: "forward"}
        return
    top = field.limit("j1939") - 1
    collected = [(raw * field.scale + field.offset) * field.factor for raw in (0, top)]
    assert collected[0] == pytest.approx(low * unit, abs=field.resolution() / 2)
    # Their ends are rounded, to two digits the yaw rate.
    assert collected[1] - collected[0] == pytest.approx((high - low) * unit, rel=5e-4)


def test_bits_stand_where_the_public_dbc_has_them(database: dict[int, Any]) -> None:
    compared = 0
    for pgn, key, _, name, *_ in FACTS:
        if name is None:
            assert pgn not in database  # 65096 and 65097 are of ISO 11783
            continue
        signal = database[pgn].get_signal_by_name(name)
        field = field_of(row(pgn), key)
        assert (signal.start, signal.length, signal.byte_order) == (field.start, field.bits, "little_endian")
        compared += 1
    assert compared == 18
