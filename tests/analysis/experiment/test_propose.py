"""A proposed plan is one that can be driven, says what it is worth, and is read back as it was written."""

import numpy as np
import pytest
from logs import MACHINE
from numpy.random import default_rng

from tilth.analysis.experiment.plan_text import text_of, worth
from tilth.analysis.experiment.predict import from_machine
from tilth.analysis.experiment.propose import WantedPlan, compared, propose
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.models.planned_run import check, drives
from tilth.schemas.experiment import ChirpRun, DrivingLimits, PlanError, Rectangle, edited, parse_plan
from tilth.schemas.flow import PARAMETERS

KNOWN = from_machine(MACHINE)


def wanted(**changes: object) -> WantedPlan:
    fields = {
        "name": "try", "speed": 4.5, "seconds": 12.0, "replicates": 1, "seed": 1,
        "field": Rectangle(length=300, width=60), "limits": DrivingLimits(), "kinds": ("chirp", "turn"),
        "count": 2,
    } | changes  # fmt: skip
    return WantedPlan(**fields)  # type: ignore[arg-type]


def test_a_proposal_can_be_driven_and_is_better_than_held_steps() -> None:
    said: list[str] = []
    found = propose(KNOWN, wanted(), said.append)
    check(found.plan, rig_of(MACHINE), drives(found.plan, default_rng))
    assert {run.kind for run in found.plan.run} == {"chirp", "turn"}
    assert [run.speed for run in found.plan.run if run.kind == "turn"] == [2.0]
    assert np.all(found.sd < found.before)
    assert set(found.plan.predicted) == set(PARAMETERS) == set(found.plan.run[0].predicted)
    assert found.held is not None and found.held.seconds > found.seconds
    assert found.swung is not None and found.swung.seconds > 0.0
    assert "searching the best chirp" in said
    text = text_of(found, "PLAN.toml", "a.mcap")
    assert parse_plan(text) == found.plan and found.plan.predicted_for and not edited(found.plan)
    assert edited(parse_plan(text.replace("speed = 4.5", "speed = 4.4", 1)))
    chirp = next(run for run in found.plan.run if isinstance(run, ChirpRun))
    assert f"# swinging from {chirp.low_hz:g} to {chirp.high_hz:g} Hz\n" in text
    assert "speed = 4.5  # m/s\n" in text and "length = 300  # m, along the runs\n" in text
    assert "from a.mcap" in text and worth(found) in text
    assert "held steps take" in worth(found)


def test_on_a_narrow_field_there_is_nothing_to_compare_with() -> None:
    narrow = wanted(field=Rectangle(length=300, width=30))
    assert compared(KNOWN, narrow, 0.1, "step", {}) is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"field": Rectangle(length=80, width=60)}, ("field is too small", "4.5 m/s", "--field")),
        ({"field": Rectangle(length=400, width=11), "kinds": ("step",)}, ("too small", "11 m")),
        ({"limits": DrivingLimits(lateral_acceleration=0.05)}, ("the limits leave less than",)),
        ({"seconds": 7.0}, ("give more --seconds",)),
    ],
)
def test_what_cannot_be_is_refused_with_what_to_change(
    changes: dict[str, object], words: tuple[str, ...]
) -> None:
    with pytest.raises(PlanError) as refused:
        propose(KNOWN, wanted(**({"kinds": ("chirp",)} | changes)))
    for word in words:
        assert word in str(refused.value)
