"""Each tuning constant of estimator/ is in a record, with its unit and what it means."""

import ast
import dataclasses
import json
from collections.abc import Iterator, Mapping
from importlib import import_module

import numpy as np
import pytest
from paths import ROOT

from tilth.cli import main
from tilth.estimator.components import Component, components
from tilth.estimator.tuning import plain, rows, tuned

ESTIMATOR = ROOT / "estimator"
COUNTED = {
    "averages", "bins", "bits", "blocks", "checkpoints", "comparisons", "directions", "epochs",
    "explanations",
    "fits", "frames", "instants", "intervals", "iterations", "measurements", "passes", "poses", "positions",
    "readings", "rounds", "rows", "runs", "samples", "segments", "senders", "spikes", "steps", "stretches",
    "swings", "ticks", "tries",
}  # fmt: skip
UNITS = COUNTED | {
    "°", "1", "1/rad", "h", "1/s", "by unknown", "chi^2", "m", "m/s", "m/s^0.5", "m/s^2", "nat", "ns",
    "m/kg^(1/3)", "rad", "rad/s", "rad/s^0.5", "rad/s^2", "rad s^2/m", "s", "s/s", "s/s^0.5", "sd",
}  # fmt: skip
NO_TUNING: Mapping[str, tuple[str, ...]] = {
    # layouts of arrays, and codes; no limit
    "filters/gates": ("UNLIMITED",),
    "filters/likelihood": ("NOTHING", "NO_READINGS"),
    "filters/row_fit": ("OF_BODIES",),
    "filters/soil_change": ("DIRECTIONS",),
    "filters/straight_driving": ("NOBODY", "PLACES"),
    "filters/tracker_kernel": ("BAD", "GATED", "GROUND", "SENSORS", "USED"),
    "methods/tracker": ("_GROUNDS",),
    "filters/two_step_fit": ("OUTPUT_STATES", "PREDICTOR_STATES"),
    "models/nonlinear": ("DYNAMIC",),
    "models/rolling_terms": ("SPEEDS",),
    "pose/latency": ("_DIFFERENCES",),
    "pose/pose": ("BODIES",),
    "pose/screen": ("STILL",),
    "record/measured_rows": ("_HEADING", "_POSITION", "_ROLL", "_VELOCITY", "_YAW_RATE"),
    "record/record": (
        "EAST", "HEADING", "KIND", "NORTH", "OFFSET", "PLACE", "PSI", "R", "ROLL", "ROLL_ANGLE", "SD", "TICK",
        "TICK_NS", "U", "VALUE", "VELOCITY", "WHEEL_ANGLE", "YAW_RATE",
    ),
    "record/record_builder": ("_HALVES",),
    "record/windows": ("AWAITED", "DROPPED", "OPEN", "TAKEN"),
    "snapshot": ("VERSION",),
    "state_json": ("LONGEST_LIST",),
    "calibration/assignment": ("PAIRINGS",),
    "calibration/calibrate": ("AS_STATED",),
    "calibration/changes": ("BODY",),
    "diagnosis/information": ("CRAB", "FORWARD", "KINDS"),
    "rig/residuals": ("HITCH",),
    "calibration/steering_response": ("NO_LIMIT",),
    # what is asked of a model, beside its sensors
    "models/identifiability": ("DISTURBANCES",),
    "models/planned_run": ("DT",),
    # mathematics and units
    "diagnosis/hypotheses": ("SMALL",),
    "rig/adjustments": ("SHORTEST_LATENCY_S",),
    "rig/numbers": ("DEG",),
    "models/step_responses": ("AHEAD", "PACKED", "_DOUBLINGS", "_NORM", "_TERMS", "_TWO_PI", "_WHOLE"),
    # clocks and messages as they are
    "pose/aligner": ("LEAP_SECONDS_NS", "WHEEL_BASED_PGN"),
    # looks of a drawing
    "pose/body_frames": ("_BLACK", "_CART", "_FRONT", "_GREEN", "_REAR", "_VIOLET", "_WHITE", "_YELLOW"),
}  # fmt: skip
"""File in estimator/ -> its constants of numbers that are no tuning."""


def bare(source: str) -> Iterator[str]:
    """Constants of a module, in capitals, whose value is written in numbers only."""
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign):
            targets: list[ast.expr] = node.targets
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets = [node.target]
        else:
            continue
        names = [item.id for target in targets for item in ast.walk(target) if isinstance(item, ast.Name)]
        if names and names[0].isupper() and node.value is not None and _of_numbers(node.value):
            yield from names


def _of_numbers(value: ast.expr) -> bool:
    """Whether there is a number in it, and no name but those of functions of numbers."""
    names = {ast.unparse(node).partition(".")[0] for node in ast.walk(value) if isinstance(node, ast.Name)}
    leaves = [node.value for node in ast.walk(value) if isinstance(node, ast.Constant)]
    numbers = [leaf for leaf in leaves if isinstance(leaf, (int, float)) and not isinstance(leaf, bool)]
    return bool(numbers) and names <= {"math", "np", "float", "range"}


def records(source: str) -> Iterator[tuple[str, str]]:
    """(name, class) of the records of a module."""
    for node in ast.parse(source).body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Call):
            kind = ast.unparse(node.value.func)
            if kind.endswith("Tuning"):
                yield ast.unparse(node.target), kind


def modules() -> dict[str, str]:
    """Name in estimator/ without the ending -> source, but what is generated."""
    paths = (path for path in ESTIMATOR.rglob("*.py") if "generated" not in path.parts)
    return {path.relative_to(ESTIMATOR).with_suffix("").as_posix(): path.read_text() for path in paths}


def test_no_tuning_constant_is_outside_of_a_record() -> None:
    found = {
        name: sorted(set(bare(source)) - set(NO_TUNING.get(name, ()))) for name, source in modules().items()
    }
    assert {name: names for name, names in found.items() if names} == {}


def test_the_list_of_what_is_no_tuning_is_not_longer_than_needed() -> None:
    sources = modules()
    assert {name: sorted(set(names) - set(bare(sources[name]))) for name, names in NO_TUNING.items()} == {
        name: [] for name in NO_TUNING
    }


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("SLOWEST = 1.0", ["SLOWEST"]),
        ("_SLOWEST: Final = -1", ["_SLOWEST"]),
        ("LOW, HIGH = 0.3, 3.0", ["LOW", "HIGH"]),
        ("LIMIT = math.radians(3.0) ** 2", ["LIMIT"]),
        ("SDS = np.array([0.1, 0.2])", ["SDS"]),
        ("GATE: Final = {2: 13.8, 'x': 16.3}", ["GATE"]),
        ("GATE: Final = SCREEN.gate", []),
        ("BOTH = 2 * SCREEN.gate", []),
        ("NAME = 'a'\nON = True\nROWS = (Row(3.0),)\nslow = 3.0", []),
    ],
)
def test_the_check_sees_a_bare_constant(source: str, names: list[str]) -> None:
    assert list(bare(source)) == names


def test_each_record_is_a_row_under_the_name_of_its_file() -> None:
    expected = {
        (name, id(getattr(import_module(f"tilth.estimator.{name.replace('/', '.')}"), record)))
        for name, source in modules().items() for record, _ in records(source)
    }  # fmt: skip
    assert {(component.name, id(component.record)) for component in components()} == expected
    assert len(components()) == len(expected)


@pytest.mark.parametrize("component", components(), ids=lambda component: component.name)
def test_each_constant_has_a_unit_and_a_meaning(component: Component) -> None:
    assert type(component.record).__doc__, "say what they are for"
    for row in rows(component.record):
        assert set(row.unit.split(", ")) <= UNITS, row
        assert len(row.meaning.split()) > 1 and not row.meaning.endswith("."), row
        flat = np.array(list(row.value.values()) if isinstance(row.value, Mapping) else row.value, float)
        assert flat.size and not np.isnan(flat).any(), row


@pytest.mark.parametrize("component", components(), ids=lambda component: component.name)
def test_no_record_can_be_changed(component: Component) -> None:
    name = rows(component.record)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(component.record, name, 0.0)


def test_a_field_without_unit_is_refused() -> None:
    @dataclasses.dataclass(frozen=True)
    class Incomplete:
        gate: float = tuned(5.0, "sd", "a larger innovation is an outlier")
        slowest: float = 1.0

    with pytest.raises(KeyError, match="unit"):
        rows(Incomplete())


def test_every_constant_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["model", "--parameters", "--json"]) == 0
    told = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)["parameters"]
    assert [(row["component"], row["name"], row["value"], row["unit"], row["meaning"]) for row in told] == [
        (component.name, row.name, plain(row.value), row.unit, row.meaning)
        for component in components()
        for row in rows(component.record)
    ]
    assert main(["model", "--parameters"]) == 0
    text = capsys.readouterr().out
    assert all(f"  {row['name']} " in text and row["meaning"] in text for row in told)
    assert "unknown_tilt                 0.02618 rad (1.5°)" in text


def test_without_a_machine_file_it_says_what_to_give(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["model"]) == 2
    assert "--parameters" in capsys.readouterr().err
