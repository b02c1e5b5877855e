"""A proposed plan is one that can be driven, says what it is worth, and is read back as it was written."""

from dataclasses import replace

import numpy as np
import pytest
from logs import MACHINE
from numpy.random import default_rng

from tilth.analysis.experiment.plan_text import text_of, worth
from tilth.analysis.experiment.predict import Known, from_machine, told_of
from tilth.analysis.experiment.propose import WantedPlan, compared, propose
from tilth.analysis.fit.joint import Linearised
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.models.planned_run import DT, check, drives
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
    found = propose(KNOWN, wanted(), lambda text, done, of: said.append(text))
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


def driven(seconds: int) -> Known:
    """What a log of weaving told; of no driving the prior."""
    angles = np.radians(8) * np.sin(
        0.8 * np.sin(0.05 * np.arange(seconds * 20)) * np.arange(seconds * 20) * DT
    )
    told = told_of(KNOWN, 4.5, angles)
    return replace(KNOWN, before=Linearised(KNOWN.point, (told,), (), (float(seconds),)), cache={})


@pytest.mark.parametrize("seconds", [20, 600])
def test_after_a_log_no_plan_is_worse_than_none_and_no_way_to_drive_takes_less_than_no_time(
    seconds: int,
) -> None:
    found = propose(driven(seconds), wanted(kinds=("chirp",), count=1, replicates=4))
    # Errors of the model differ from one way to drive to another, and are not averaged.
    assert np.all(found.sd < 1.06 * found.before) and found.plan.predicted_with_log
    assert seconds > 100 or np.all(found.sd < found.before)
    for other in (found.held, found.swung):
        assert other is not None and other.seconds >= 0.0
    said = worth(found)
    assert found.told_already == (seconds > 100)
    words = ("could tell", "stays known least") if found.told_already else ("log alone leaves", "held steps")
    assert all(word in said for word in words)
    plan = parse_plan(text_of(found, "PLAN.toml", "a.mcap"))
    alone, joint = (
        np.array([row[name] for name in PARAMETERS]) for row in (plan.predicted, plan.predicted_with_log)
    )
    assert np.all(joint < alone)
    assert plan.run[0].predicted == plan.predicted  # one kind: its replicates are all runs


def test_on_a_narrow_field_there_is_nothing_to_compare_with() -> None:
    narrow = wanted(field=Rectangle(length=300, width=30))
    assert compared(KNOWN, narrow, 0.1, 3, "step", {}) is None


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
