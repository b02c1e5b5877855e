"""What cannot be a real rig is refused with what was meant; what is rare is said; real rigs all pass."""

import copy
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from logs import MACHINE_TEXT
from paths import ROOT
from pydantic import BaseModel

from tilth.estimator.models.parameters import rig_of
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.machine_file import read_machine
from tilth.schemas.flow import Frame
from tilth.schemas.limits import LIMITS
from tilth.schemas.machine import Implement, Machine, MachineError, Receiver, Tractor, Tyre, WheelAngle
from tilth.schemas.machine_toml import parse_machine as parse
from tilth.schemas.plausible import doubts, refuse_impossible, unusual
from tilth.simulator.scenario import Scenario
from tilth.simulator.traffic import simulate

RECEIVER = {
    "survey_sd": 0.02,
    "position_sd": 0.025,
    "velocity_sd": 0.05,
    "yaw_rate_sd": 0.3,
    "heading_sd": 0.5,
}
WHEEL = {"offset": 0.0, "gain": {"value": 1.0, "sd": 0.02}, "sd": 0.1}
FACTORS: Final = (-1.0, 0.5, 2.0, 57.3, 1 / 57.3, 1e3, 1e-3)

Path_ = tuple[str | int, ...]


def whole() -> dict[str, Any]:
    """The demo's machine file with every number that a file can have."""
    raw = tomllib.loads(MACHINE_TEXT)
    for receiver in raw["receiver"]:
        receiver |= {**RECEIVER, "roll_sd": 0.5, "latency": {"value": 0.1, "sd": 0.05}}
    for body in ("tractor", "implement"):
        raw[body] |= {"cg_sd": 0.02, "pair_yaw_sd": 0.2}
    raw["tractor"] |= {"kingpin_distance": 1.7, "wheel_speed_factor": {"value": 1.02, "sd": 0.005}}
    raw["tractor"] |= {"hitch_height": {"value": 0.5, "sd": 0.03}, "pivot_height": {"value": 0.7, "sd": 0.03}}
    for k, tyre in enumerate(raw["tyres"].values()):
        tyre |= {"track": {"value": 1.93, "sd": 0.02}, "dual_track": {"value": 3.2, "sd": 0.02}}
        tyre |= {"deflection": {"value": 0.06, "sd": 0.01}} if k else {"size": "420/85R30", "pressure": 1.2}
    raw["wheel_angle"] |= copy.deepcopy(WHEEL)
    return raw


def numbers(node: Any, path: Path_ = ()) -> Iterator[tuple[Path_, float]]:
    if isinstance(node, float):
        yield path, node
    elif isinstance(node, (dict, list)):
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            yield from numbers(value, (*path, key))


def changed(path: Path_, value: Any) -> dict[str, Any]:
    raw = whole()
    node: Any = raw
    for part in path[:-1]:
        node = node[part]
    node[path[-1]] = value
    return raw


def outcome(raw: dict[str, Any]) -> tuple[str, str]:
    """(refused | rare | passed, what was said)"""
    try:
        machine = Machine.model_validate(raw)
        refuse_impossible(machine)
    except (MachineError, ValueError) as error:
        return "refused", str(error)
    output = unusual(machine)
    return ("rare", output[0]) if output else ("passed", "")


def name(path: Path_) -> str:
    return ".".join(map(str, path))


@pytest.mark.parametrize("factor", FACTORS)
def test_every_number_of_the_file_times_a_slip(factor: float) -> None:
    """By which slip each number is refused: what is not refused is known, and is what can be true."""
    results = {
        name(path): outcome(changed(path, value * factor))[0] for path, value in numbers(whole()) if value
    }
    let_by = {key for key, result in results.items() if result != "refused"}
    assert len(results) > 60
    small_sds = {
        key for key in results if key.rpartition(".")[2] in ("sd", "cg_sd", "pair_yaw_sd", "survey_sd")
    }
    places = {f"receiver.{k}.position.0" for k in range(4)}
    match factor:
        case -1.0:
            assert let_by == {"implement.e", "receiver.1.position.0", "wheel_angle.scale"}
        case 1e3:
            assert not let_by
        case 57.3:
            assert let_by == {"wheel_angle.delay"} | {f"receiver.{k}.position_sd" for k in range(4)}
        case 1e-3:  # what is more exact than stated is no fault, nor what is nearer to where it is
            latency = {f"receiver.{k}.latency.value" for k in range(4)}
            assert let_by <= small_sds | places | latency | {"implement.e", "wheel_angle.delay"}
        case _ if factor in (0.5, 2.0):
            assert len(let_by) > 0.9 * len(results)
        case _:
            sizes = {key for key in results if key.startswith(("tractor", "tyres", "implement"))} - small_sds
            assert {key for key in let_by & sizes if not key.endswith("log_sd")} == {"implement.e"}


def test_what_is_refused_is_one_sentence_that_names_it() -> None:
    for path, value in numbers(whole()):
        for factor in (57.3, 1e3, 1e-3):
            result, output = outcome(changed(path, value * factor))
            if result == "refused" and "validation error" not in output:
                words = output.replace("tractor_front: position", "position")
                assert "\n" not in output and len(output) < 260
                key = [
                    str(part) for part in path if isinstance(part, str) and part not in ("value", "receiver")
                ]
                assert all(part in words for part in key), (path, output)


LIGHT = "e = 0.1\nmass = { value = 2127.0, sd = 200.0 }\nyaw_inertia = 6402.0"
HEAVY = "e = 3.0\nmass = 40e3\nyaw_inertia = 200e3"
FRONT = "position = [1.60, 0.0, 2.9]"
CART = "position = [1.30, 0.0, 3.1]"
ZERO = "zero = { value = 0.0, sd = 0.5 }"
SAID = [
    ("a = 1.7", "a = 1700", "tractor.a = 1700 m: must be from 0.3 to 5; did you mean 1.7 (1700 mm)?"),
    ("d = 3.62", "d = 143", "must be from 0.5 to 15; did you mean 1.43 (143 cm) or 3.632 (143 inches)?"),
    ("a = 1.7", "a = 5.58", "did you mean 1.701 (5.58 feet)?"),
    ("mass = 9391.0", "mass = 9.391", "kg: must be from 500 to 40000; did you mean 9391 (9.391 t)?"),
    ("mass = 9391.0", "mass = 93910.0", "tractor.mass = 93910 kg: must be from 500 to 40000"),
    ("yaw_inertia = 35709.0", "yaw_inertia = 623.0", "0.089 times the wheelbase, must be 0.15 to 1.3"),
    ("yaw_inertia = 35709.0", "yaw_inertia = 35.7", "did you mean 35700 (35.7 t m^2)"),
    ("= 220e3", "= 220", "did you mean 220000 (220 kN/rad)"),
    ("= 486e3", "= 8482", "load of 54.7 kN, must be 0.3 to 40; did you mean 486000 (8482 N/deg)"),
    ("= 220e3", "= 2.2e6", "58 per rad of the axle's load"),
    ("relaxation_length = 1.5", "relaxation_length = 150", "tyres.rear.relaxation_length = 150 m"),
    (FRONT, "position = [-1.90, 0.0, 2.9]", "behind tractor_rear, which is at -1.1; are the two exchanged"),
    (FRONT, "position = [1.60, 0.0, 290]", "up = 290 m: must be from 0.3 to 7; did you mean 2.9 (290 cm)"),
    (CART, "position = [6.30, 0.0, 3.1]", "forward = 6.3 m: must be from -15.1 to 4.62"),
    (CART, "position = [1.30, 45.0, 3.1]", "implement_front: position, right = 45 m"),
    ("roll_corrected = true", "roll_corrected = true\nlatency = 100", "did you mean 0.1 (100 ms)?"),
    ("roll_corrected = true", "yaw_rate_sd = 0.00524", "did you mean 0.3002 (0.00524 rad/s)?"),
    ("cg_height = 1.1", "cg_height = 2.2", "tractor.cg_height = 2.2 m: must be from 0.3 to 2"),
    ("e = 0.1", "e = 0.1\ncg_sd = 0.0004", "must be 0 (exactly known) or from 0.001 to 1"),
    ("roll_corrected = true", "position_sd = 25", "from 0.0005 to 3; did you mean 0.025 (25 mm)"),
    (LIGHT, HEAVY, "the tractor's front axle would stand off the ground"),
    ("d = 3.62\ne = 0.1", "d = 0.6\ne = -0.5", "its axle would stand at the hitch or ahead of it"),
    ("scale = 0.01", "scale = 0.573", "16 bits would tell -1.878e+04 to 1.878e+04 deg, no wheel sensor does"),
    ("scale = 0.01", "scale = 0.000175", "can only tell -5.734 to 5.734 deg, which is not both sides"),
    ("scale = 0.01", "scale = 0.000175", "did you mean 0.01003 (0.000175 rad/bit)"),
    ("signed = true", "signed = false", "can only tell 0 to 655.4 deg, which is not both sides"),
    ("scale = 0.01", "scale = 0.0", "can only tell 0 to 0 deg"),
    ("start_byte = 0", "start_byte = 7", "its field ends in byte 8, a frame has bytes 0 to 7"),
    ("not_available = 0x7FFF", "not_available = 0x17FFF", "a field of 16 bits never is"),
    ("id = 0x18FF0B15", "id = 0x18FF0B15\nextended = false", "identifiers up to 0x7FF"),
    ("scale = 0.01", "lookup = [[-40.0, -40.0], [0.0, 5.0], [40.0, 3.0]]", "must rise or fall all along"),
    ("scale = 0.01", "lookup = [[-4000.0, -4000.0], [4000.0, 4000.0]]", "wheels turn by 90 at most"),
    ("scale = 0.01", "lookup = [[50000.0, -40.0], [90000.0, 40.0]]", "none of which is in the lookup"),
    (ZERO, "zero = { value = 0.0, sd = 28.6 }", "wheel_angle.zero.sd = 28.6 deg"),
    (ZERO, "zero = 400.0", "wheel_angle.zero = 400 deg"),
    ("= 220e3", "= 220e3\ntrack = 1930", "track = 1930 m: must be from 0.8 to 4; did you mean 1.93"),
    ("= 220e3", "= 220e3\ndeflection = 60", "must be from 0.003 to 0.3; did you mean 0.06 (60 mm)"),
    ("= 220e3", '= 220e3\nsize = "420/85R30"\npressure = 120', "from 0.2 to 10; did you mean 1.2 (120 kPa)"),
    ("c = 2.1", "c = 2.1\nhitch_height = 50", "tractor.hitch_height = 50 m: must be from 0.1 to 1.5"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "words"), SAID, ids=lambda w: w[:40])
def test_what_was_probably_meant_is_said(old: str, new: str, words: str) -> None:
    assert old in MACHINE_TEXT
    with pytest.raises(MachineError) as caught:
        parse(MACHINE_TEXT.replace(old, new, 1))
    assert words in str(caught.value)


RARE = [
    ("c = 2.1", "c = 1.0", "the hitch stands ahead of the rear axle"),
    ("mass = 9391.0", "mass = 4000.0", "1 times the wheelbase, 0.3 to 0.9 is usual"),
    ("= 167e3", "= 15e3", "0.74 per rad of the axle's load of 20.3 kN, 1 to 30 is usual"),
    ("= 167e3", "= 700e3", "34 per rad of the axle's load"),
    ("log_sd = 0.7", "log_sd = 0.05", "tyres.front.log_sd = 0.05: rare, 0.1 to 1.5 is usual; check it"),
    ("scale = 0.01", "scale = 0.0005", "tell -16.38 to 16.38 deg, rarely enough for a wheel"),
    ("e = 0.1", "e = -0.1", "implement.e = -0.1 m: rare"),
    (FRONT, "position = [-1.20, 0.9, 2.9]", "stands behind tractor_rear"),
    ("= 486e3", "= 486e3\ntrack = 3.4", "tyres.rear.track = 3.4 m: rare, 1 to 3.2 is usual"),
    ("= 486e3", '= 486e3\nsize = "5.00-12"\npressure = 0.6', "presses the tyres in by 168 mm, 15 to 160 is"),
]


@pytest.mark.parametrize(("old", "new", "words"), RARE, ids=lambda w: w[:40])
def test_what_is_rare_is_said_and_not_refused(old: str, new: str, words: str) -> None:
    assert old in MACHINE_TEXT
    (output,) = unusual(parse(MACHINE_TEXT.replace(old, new, 1)))
    assert words in output and "\n" not in output


FILES = sorted([*ROOT.glob("deploy/machines/*.toml"), *ROOT.glob("examples/machines/*.toml")])


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_nothing_is_rare_in_the_files_that_are_shipped(path: Path) -> None:
    assert not doubts(read_machine(path)[0])


def rig(tractor: str, implement: str, tyres: tuple[float, float, float], places: tuple[float, ...]) -> str:
    """A machine file of another size: a, b, c, mass, yaw inertia, height; d, e and so on; stiffnesses."""
    raw = whole()
    for body, keys, values in (
        ("tractor", "a b c mass yaw_inertia cg_height", tractor),
        ("implement", "d e mass yaw_inertia cg_height", implement),
    ):
        for key, value in zip(keys.split(), values.split(), strict=True):
            raw[body][key] = float(value)
    for axle, stiffness in zip(("front", "rear", "implement"), tyres, strict=True):
        raw["tyres"][axle]["cornering_stiffness"] = stiffness
    for receiver, place in zip(raw["receiver"], places, strict=True):
        receiver["position"][0] = place
    result, output = outcome(raw)
    return f"{result}: {output}" if result == "refused" else ""


@pytest.mark.parametrize(
    "sizes",
    [
        ("0.85 0.75 1.1 1100 800 0.6", "1.8 0.1 450 250 0.6", (30e3, 40e3, 20e3), (0.8, -0.6, 0.3, -0.6)),
        (
            "1.5 1.1 1.6 4200 7000 0.9",
            "3.0 0.4 6000 14000 1.3",
            (110e3, 190e3, 260e3),
            (1.4, -0.9, 1.5, -1.5),
        ),
        ("1.7 1.8 2.9 30000 120000 1.6", "6.5 0.8 40000 260000 2.0", (9e5, 1.2e6, 2.2e6), (1.6, -1.6, 2, -2)),
        ("1.6 1.3 2.2 12000 30000 1.2", "4.5 0.3 9500 400000 1.1", (3e5, 5e5, 4e5), (1.5, -1.1, 1, -1)),
        ("1.2 0.8 1.2 2400 2600 0.7", "2.0 0.05 110 60 0.6", (60e3, 100e3, 8e3), (1.0, -0.7, 0.4, -0.4)),
    ],
    ids=["vineyard", "70 kW with a tanker", "articulated with 40 t", "36 m sprayer", "rake of 110 kg"],
)
def test_real_rigs_of_all_sizes_are_not_refused(sizes: Any) -> None:
    assert rig(*sizes) == ""


def test_every_number_of_a_section_is_judged() -> None:
    judged_together = {"receiver.position", "wheel_angle.scale", "wheel_angle.offset"}
    addresses = {
        "source",
        "manufacturer",
        "id",
        "mask",
        "instance",
        "start_byte",
        "start_bit",
        "bits",
        "sign",
    }
    sections: dict[str, type[BaseModel]] = {
        "tractor": Tractor,
        "implement": Implement,
        "tyres": Tyre,
        "receiver": Receiver,
    }
    sections["wheel_angle"] = WheelAngle
    for kind, section in sections.items():
        for key, field in section.model_fields.items():
            if key not in addresses and any(word in str(field.annotation) for word in ("float", "Quantity")):
                known = f"{kind}.{key}" in LIMITS or f"{kind}.{key}" in judged_together
                assert known or key == "lookup", f"{kind}.{key}"


# What passes does not fail later.


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return list(simulate(parse(MACHINE_TEXT), 1, 8.0, Scenario(other_traffic=False)))


def at_the_edge(seed: int) -> Machine:
    """A machine that is just allowed: a few of its numbers anywhere in their range, or at an end of it."""
    rng = np.random.default_rng(seed)
    while True:
        raw = copy.deepcopy(whole())
        keys = [(path, row) for path, _ in numbers(raw) if (row := LIMITS.get(row_of(path))) is not None]
        for k in rng.choice(len(keys), 12, replace=False):
            path, row = keys[int(k)]
            value = float(rng.choice([row.low, row.high, rng.uniform(row.low, row.high)]))
            node: Any = raw
            for part in path[:-1]:
                node = node[part]
            node[path[-1]] = value
        try:
            machine = Machine.model_validate(raw)
            refuse_impossible(machine)
        except (MachineError, ValueError):
            continue
        return machine


def row_of(path: Path_) -> str:
    words = [p for p in path if isinstance(p, str) and p != "value"]
    return ".".join(w for k, w in enumerate(words) if not (words[0] == "tyres" and k == 1))


@pytest.mark.parametrize("seed", range(3))
def test_what_is_not_refused_does_not_make_the_estimators_fail(seed: int, frames: list[Frame]) -> None:
    machine = at_the_edge(seed)
    rig_of(machine)
    guarded = GuardedFold(machine)
    for frame in frames:
        guarded.take(frame)
    assert guarded.faults == 0 and guarded.measurements > 500
    guarded.renew()
    assert guarded.faults == 0
