"""The machine file: every wrong key or value gets one sentence that names it."""

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import MACHINE_FILE, ROOT

from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.machine_toml import parse_machine

TEXT = MACHINE_FILE.read_text()


@pytest.mark.parametrize("path", sorted((ROOT / "deploy" / "machines").glob("*.toml")), ids=lambda p: p.name)
def test_shipped_machine_files_are_right(path: Path) -> None:
    machine = parse_machine(path.read_text())
    assert machine.name == path.stem


WRONG = [
    ("mass = 9391.0", "mas = 9391.0", ["tractor.mas", "did you mean", "mass"]),
    ("a = 1.7", "", ["tractor.a", "missing"]),
    ("a = 1.7", "a = -1.7", ["tractor.a", "-1.7", "above zero"]),
    ("a = 1.7", 'a = "1.7 m"', ["tractor.a = '1.7 m'", "a number without a unit, or { value = …, sd = … }"]),
    ("a = 1.7", "a = [1.7]", ["tractor.a", "a number without a unit"]),
    ("a = 1.7", "a = nan", ["tractor.a"]),
    ("a = 1.7", "a = { value = 1.7, s = 0.1 }", ["tractor.a.s", "did you mean", "sd"]),
    ("a = 1.7", "a = { value = 1.7, sd = -0.1 }", ["tractor.a.sd", "-0.1", "greater than or equal to 0"]),
    ("[log]", "[lgo]", ["lgo", "did you mean", "log"]),
    ('mount = "implement_rear"', 'mount = "cart"', ["receiver[4].mount", "cart", "tractor_front"]),
    ('mount = "implement_rear"', 'mount = "implement_front"', ["receiver", "implement_front"]),
    ('name = "A00017000421E240"', 'name = "12"', ["receiver[1].name", "12", "16 hexadecimal digits"]),
    ('name = "A00017000421E240"', "", ["receiver[1]", "source"]),
    ('name = "A00017000421E241"', 'name = "A00017000421E240"', ["receiver", "same bus, name"]),
    ("position = [1.60, 0.0, 2.9]", "position = [1.60, 0.0]", ["receiver[1].position"]),
    ("position = [1.60, 0.0, 2.9]", "position = [-1.10, 0.0, 2.9]", ["tractor", "0.5 m apart"]),
    ("id = 0x18FF0B15", "", ["wheel_angle", "id", "dbc", "pgn"]),
    ("start_byte = 0", "", ["wheel_angle", "start_byte"]),
    ("scale = 0.01", "sign = 2", ["wheel_angle.sign", "2"]),
    ("scale = 0.01", 'kingpin = "left"', ["kingpin_distance"]),
    ("scale = 0.01", "lookup = [[5.0, 5.0], [0.0, 0.0]]", ["wheel_angle", "ascending"]),
    ('bus = "can0"\nid', 'bus = "can7"\nid', ["wheel_angle", "can7", "can0"]),
    ('prefix = "tilth"', 'prefix = "a b"', ["zenoh.prefix", "a b"]),
    ("= 220e3", '= 220e3\nsize = "420/85R30"', ["tyres.front", "size and pressure go together"]),
    ("= 220e3", "= 220e3\npressure = 1.2", ["tyres.front", "size and pressure go together"]),
    ("= 220e3", '= 220e3\nsize = "big"\npressure = 1.2', ["tyres.front", '"big"', "520/85R42"]),
    (
        "= 220e3",
        '= 220e3\nsize = "420/85R30"\npressure = 1.2\ndeflection = 0.06',
        ["tyres.front", "deflection, or size and pressure"],
    ),
    ("= 486e3", "= 486e3\ndual_track = 3.1", ["tyres.rear", "needs track, of the inner ones"]),
    ("= 486e3", "= 486e3\ntrack = 3.1\ndual_track = 1.9", ["tyres.rear", "below it"]),
    ("c = 2.1", "c = 2.1\nhitch = 0.5", ["tractor.hitch", "did you mean", "hitch_height"]),
    ("[machine]", "[machine", ["not a TOML file"]),
]


@pytest.mark.parametrize(("old", "new", "words"), WRONG, ids=[w[1] or f"no {w[0]}" for w in WRONG])
def test_a_wrong_file_gets_one_sentence_that_names_it(old: str, new: str, words: list[str]) -> None:
    assert old in TEXT
    with pytest.raises(MachineError) as caught:
        parse_machine(TEXT.replace(old, new, 1))
    error = str(caught.value)
    assert "\n" not in error
    for word in words:
        assert word in error


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.integers(0, len(TEXT) - 1), st.text(max_size=3))
def test_no_damage_raises_anything_but_a_sentence(at: int, junk: str) -> None:
    try:
        parse_machine(TEXT[:at] + junk + TEXT[at + len(junk) + 1 :])
    except MachineError as error:
        assert str(error) and "\n" not in str(error)


def test_quantities_are_numbers_or_numbers_with_a_sd() -> None:
    machine = parse_machine(TEXT)
    assert (machine.tractor.mass.value, machine.tractor.mass.sd) == (9391.0, 0.0)
    assert (machine.implement.mass.value, machine.implement.mass.sd) == (2127.0, 200.0)
    assert machine.receiver[0].latency.sd == 0.05
    bare = parse_machine(TEXT.replace("roll_corrected = true", "latency = 0.08"))
    assert (bare.receiver[0].latency.value, bare.receiver[0].latency.sd) == (0.08, 0.05)


def test_every_key_has_a_place_in_the_shipped_schema() -> None:
    shipped = json.loads((ROOT / "schemas" / "machine.schema.json").read_text())
    assert set(shipped["properties"]) == set(Machine.model_fields)
