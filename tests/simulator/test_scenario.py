"""Scenario files: the shipped ones are right, and a wrong one gets one sentence that names it."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import MACHINE_FILE, ROOT

from tilth.estimator.models.manoeuvres import MANOEUVRES
from tilth.logger.machine_file import read_machine
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import PARAMETERS, Mount
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.receivers import FAULTS
from tilth.simulator.scenario import (
    DrivenManoeuvre,
    FaultKind,
    Parameter,
    Scenario,
    ScenarioError,
    check_mounts,
    parse_scenario,
)
from tilth.simulator.traffic import simulate

FILES = sorted((ROOT / "examples" / "scenarios").rglob("*.toml"))
TEXT = (ROOT / "examples" / "scenarios" / "bad_day.toml").read_text()


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_shipped_scenarios_say_what_they_are_for_and_can_be_driven(path: Path) -> None:
    scenario = parse_scenario(path.read_text())
    assert scenario.purpose.endswith((".", "?")) and len(scenario.purpose) > 40
    assert ". " not in scenario.purpose  # one sentence
    machine, _ = read_machine(MACHINE_FILE if scenario.machine is None else path.parent / scenario.machine)
    check_mounts(scenario, [receiver.mount for receiver in machine.receiver])
    decoder = Decoder(machine)
    found = [m for frame in simulate(machine, 1, 2.0, scenario) for m in decoder.measurements(frame)]
    assert len(found) > 400


def test_there_is_a_handful_of_them_and_no_two_for_the_same() -> None:
    purposes = {parse_scenario(path.read_text()).purpose for path in FILES}
    assert len(purposes) == len(FILES) >= 10


def test_the_demos_file_is_the_default() -> None:
    demo = parse_scenario((ROOT / "examples" / "scenarios" / "demo.toml").read_text())
    assert replace(demo, purpose="") == Scenario()


def test_names_here_are_those_of_the_tables() -> None:
    assert set(get_args(FaultKind)) == set(FAULTS)
    assert get_args(Parameter) == PARAMETERS
    kinds = get_args(DrivenManoeuvre.__annotations__["kind"])
    assert set(kinds) <= {row.name for row in MANOEUVRES}


WRONG = [
    ("seconds = 180.0", "secnds = 180.0", ["secnds", "did you mean", "seconds"]),
    ("seconds = 180.0", 'seconds = "long"', ["seconds", "long", "number"]),
    ("seconds = 180.0", "seconds = -1.0", ["seconds", "-1.0", "greater than 0"]),
    ("gain = 0.96", "gain = 3.0", ["wheel.gain", "3.0", "less than or equal to 2"]),
    ("gain = 0.96", "gian = 0.96", ["wheel.gian", "did you mean", "gain"]),
    ("gain = 0.96", "gain = nan", ["wheel.gain", "finite"]),
    ('kind = "rtk_float"', 'kind = "rtkfloat"', ["faults[1].kind", "rtkfloat", "rtk_float"]),
    ('mount = "tractor_front"', 'mount = "cab"', ["faults[1].mount", "cab", "tractor_front"]),
    ("end_s = 40.0", "end_s = 4.0", ["faults[1]", "end_s = 4", "start_s = 30"]),
    ("source = 200", "source = 254", ["reclaims[1].source", "254", "253"]),
    ("seconds = 180.0", 'swapped = ["implement_front"]', ["swapped[2]", "missing"]),
    ("[link]", '[steering]\nkind = "rows"\n[link]', ["steering.kind", "rows", "did you mean", "row"]),
    ("[link]", "[steering]\nlength = 1\n[link]", ["steering.kind", "field"]),
    ("[link]", '[steering]\nkind = "row"\noffst = 1\n[link]', ["steering.offst", "did you mean", "offset"]),
    ("[link]", '[steering]\nkind = "field"\nturn_radius = 2\n[link]', ["steering.turn_radius", "2", "5"]),
    ("[link]", "[ground]\nband = [5.0, 3.0]\n[link]", ["ground", "band = [5.0, 3.0]", "shortest"]),
    ("seconds = 180.0", 'steering = [[1, "left"]]', ["steering[1][2]", "left", "random"]),
    ("seconds = 180.0", "steering = 8", ["steering", "8", "rows"]),
    ("seconds = 180.0", "steering = []", ["steering", "at least 1"]),
    ("seconds = 180.0", "speed = [[1.0, 99.0]]", ["speed[1][2]", "99", "15"]),
    ("[link]", '[steering]\nkind = "row"\n[link]', ["reverse"]),
    ("grip = 0.7", "[[soil.changes]]\nC_af = 0.5", ["soil.changes[1]", "at_s", "north"]),
    ("grip = 0.7", "parameters = { C_a = 1.0 }", ["soil.parameters.C_a", "C_af"]),
    ("[link]", "[spatial]\ndraw = true\n[link]", ["spatial is of the spatial plant", 'plant = "spatial"']),
    ("[link]", "[ground]\nrms = 0.01\n[link]", ["ground.rms is of the spatial plant"]),
    ("[link]", "[ground]\nwaves = [9.0, 3.0]\n[link]", ["waves = [9.0, 3.0]", "shortest"]),
    ("seconds = 180.0", 'plant = "spacial"', ["plant", "spacial", "planar", "spatial"]),
    ("seconds = 180.0", 'plant = "spatial"\nroll_deg = [1, 0]', ["roll_deg is of the planar", "ground.rms"]),
    (
        "seconds = 180.0",
        'plant = "spatial"\nground = { roll_sd_deg = 1 }',
        ["ground.roll_sd_deg is of the planar plant"],
    ),
    ("seconds = 180.0", 'plant = "spatial"\nplanar = { w_f = 2 }', ["planar is of the planar plant"]),
    (
        "seconds = 180.0",
        'plant = "spatial"\nloads = [{ at_s = 1, mass = 2, exponent = 0.7 }]',
        ["loads.exponent is of the planar", "spatial.load_exponent"],
    ),
    ("seconds = 180.0", "planar = { w_g = 2 }", ["planar.w_g", "w_f"]),
    ("seconds = 180.0", 'spatial = { tyre = "brsh" }', ["spatial.tyre", "brsh", "brush", "magic"]),
    ("seconds = 180.0", "spatial = { pin_hight = 1 }", ["spatial.pin_hight", "did you mean", "pin_height"]),
    ("seconds = 180.0", "spatial = { track = [1.9, 9.0, 2.2] }", ["spatial.track[2]", "9.0", "6"]),
    ("seconds = 180.0", "spatial = { step = 0.01 }", ["spatial.step", "0.01", "0.0025"]),
    ("seconds = 180.0", "ground = { bumps = [{ north = 1 }] }", ["ground.bumps[1]", "missing"]),
    ("seconds = 180.0", "roll_sensor = { zero_deg = 9.0 }", ["roll_sensor.zero_deg", "9.0", "5"]),
    (
        "seconds = 180.0",
        "ground.bumps = { north = 3 }",
        ["ground.bumps: give [[ground.bumps]] with its keys"],
    ),
    ("seconds = 180.0", "ground.bumps = [[3.0, 1.0]]", ["ground.bumps[1]: give [[ground.bumps]]", "each"]),
    ("seconds = 180.0", "ground = 3", ["ground = 3: is a section: give [ground] with its keys"]),
    ("seconds = 180.0", "steering = { kind = 'field', turns = 3 }", ["give [[steering.turns]]"]),
    ("seconds = 180.0", "spatial.track = 2", ["spatial.track = 2: give a list, in [ ]"]),
    ("grip = 0.7", "parameters = 3", ["soil.parameters = 3: give a table, in { }"]),
    ("seconds = 180.0", "swapped = ['a', 'b', 'c']", ["swapped: give at most 2"]),
    ("seconds = 180.0", "machine = 3", ["machine = 3: give a text in quotes"]),
    ("seconds = 180.0", "claims = 3", ["claims = 3: give true or false"]),
    ("seconds = 180.0", "utc_start_ns = -1", ["utc_start_ns", "-1"]),
    ("seconds = 180.0", "clock_offset_s = 1e12", ["clock_offset_s", "1000000000000"]),
    ("[link]", "[link", ["not a TOML file"]),
]


@pytest.mark.parametrize(("old", "new", "words"), WRONG, ids=[w[1] or f"no {w[0]}" for w in WRONG])
def test_a_wrong_file_gets_one_sentence_that_names_it(old: str, new: str, words: list[str]) -> None:
    assert old in TEXT
    text = TEXT.replace(old, new, 1)
    if words == ["reverse"]:
        text = text.replace("seconds = 180.0", "speed = -1.0", 1)
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text)
    error = str(caught.value)
    assert "\n" not in error
    for word in words:
        assert word in error
    for foreign in ("Input", "Tuple", "tuple", "dictionary", "instance", "valid", "validation"):  # pydantic's
        assert foreign not in error


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.integers(0, len(TEXT) - 1), st.text(max_size=3))
def test_no_damage_raises_anything_but_a_sentence(at: int, junk: str) -> None:
    try:
        parse_scenario(TEXT[:at] + junk + TEXT[at + len(junk) + 1 :])
    except ScenarioError as error:
        assert str(error) and "\n" not in str(error)


def test_a_receiver_that_the_machine_lacks_is_named() -> None:
    text = MACHINE_FILE.read_text()
    start = text.index('[[receiver]]\nmount = "implement_rear"')
    three = parse_machine(text[:start] + text[text.index("[wheel_angle]") :])
    mounts = [receiver.mount for receiver in three.receiver]
    with pytest.raises(ScenarioError, match="no receiver implement_rear; it has tractor_front"):
        check_mounts(parse_scenario(TEXT), mounts)
    check_mounts(parse_scenario(TEXT), list(Mount))


def test_random_steering_is_a_word_in_toml() -> None:
    scenario = parse_scenario('steering = [[2.0, 1.5], [3.0, "random"]]')
    assert scenario.steering == ((2.0, 1.5), (3.0, None))
