"""What driving tells of the lengths of an implement that nobody has described."""

import math

import numpy as np
import pytest
from kinematic_drive import MACHINE, Plan, measurements
from numpy.typing import NDArray

from tilth.estimator import fold
from tilth.estimator.diagnosis.strange_implement import (
    STRANGE,
    FoundLengths,
    StrangeImplement,
    found_lengths,
    observe,
    told,
    with_found,
)
from tilth.estimator.pose import aligner
from tilth.estimator.pose.pose import poses
from tilth.estimator.rig.adjustments import Amount
from tilth.estimator.rig.numbers import changed
from tilth.estimator.snapshot import restore, snapshot
from tilth.schemas.flow import Event, Frame, Publication
from tilth.schemas.machine import Machine
from tilth.schemas.sentences import notice_sentence
from tilth.simulator.scenario import Scenario
from tilth.simulator.traffic import simulate

PLAN: Plan = (
    (6, 0.0, 0), (8, 3.0, 0), (10, 1.6, 20), (10, 1.6, -20), (10, 3.0, 8), (10, 3.0, -8), (10, 1.6, 20),
    (10, 2.5, -12), (10, 2.0, 12),
)  # fmt: skip
OFF = {"pair_i": 0.03, "aside_i": 0.15, "lever_i": 0.3, "d": 0.6, "longer_i": -0.2}


def undescribed(machine: Machine) -> Machine:
    """With sds as wide as implements are."""
    implement = machine.implement
    wide = {
        "described": False, "pair_yaw_sd": 4.0, "lever_sd": 0.5,
        "d": implement.d.model_copy(update={"sd": 1.0}), "e": implement.e.model_copy(update={"sd": 0.2}),
    }  # fmt: skip
    receivers = [
        r.model_copy(update={"survey_sd": 0.4}) if r.mount.body == "implement" else r
        for r in machine.receiver
    ]
    return machine.model_copy(update={"implement": implement.model_copy(update=wide), "receiver": receivers})


def driven(file: Machine, plan: Plan = PLAN) -> tuple[StrangeImplement, list[FoundLengths]]:
    """What is known at the end, and what was to be used."""
    state, used, now = StrangeImplement(), list[FoundLengths](), aligner.initial(file)
    for one in measurements(plan):
        aligner.take(now, one)
        for pose in poses(now, one.rx_ns):
            found = observe(state, file, now, pose)
            if found is not None:
                used.append(found)
                now = aligner.initial(with_found(file, found))
    return state, used


def drawbar(machine: Machine) -> float:
    return machine.implement.d.value + machine.implement.e.value


def middle(machine: Machine) -> NDArray[np.float64]:
    """Of the implement's receivers, from the hitch: ahead and right, m."""
    places = [r.position[:2] for r in machine.receiver if r.mount.body == "implement"]
    return np.asarray(np.mean(places, axis=0) - [machine.implement.d.value, 0.0])


@pytest.mark.parametrize(
    "off",
    [
        OFF,
        pytest.param({}, marks=pytest.mark.long),
        pytest.param({name: -by for name, by in OFF.items()}, marks=pytest.mark.long),
    ],
)
def test_driving_finds_where_receivers_and_axle_are(off: dict[str, float]) -> None:
    file = undescribed(changed(MACHINE, {name: Amount(by) for name, by in off.items()}))
    state, used = driven(file)
    assert used and used[0].drawbar_sd < STRANGE.drawbar_sd
    found = found_lengths(state, file)
    right = with_found(file, found)
    assert abs(drawbar(right) - drawbar(MACHINE)) < min(2.0 * found.drawbar_sd, 0.15)
    assert np.abs(middle(right) - middle(MACHINE)) == pytest.approx([0.0, 0.0], abs=0.05)
    spans = [
        math.dist(*(r.position[:2] for r in machine.receiver if r.mount.body == "implement"))
        for machine in (right, MACHINE)
    ]
    assert spans[0] == pytest.approx(spans[1], abs=0.03)
    assert right.implement.e.value == file.implement.e.value  # where its CG is driving does not tell
    assert right.implement.d.sd == pytest.approx(found.hitch_sd)
    assert right.implement.e.sd == pytest.approx(found.axle_sd)


def test_straight_driving_tells_no_axle() -> None:
    state, used = driven(undescribed(MACHINE), ((5, 0.0, 0), (12, 3.0, 0)))
    assert not used
    assert found_lengths(state, undescribed(MACHINE)).axle_sd > 0.3


def test_words_for_people() -> None:
    found = FoundLengths(0.0, 0.0, 0.0, 0.5, -0.1, 0.01, 0.02, 0.02, 0.05, 0.05)
    said = notice_sentence(told(MACHINE, found))
    assert f"hitch to axle {drawbar(MACHINE) + 0.4:.3f} \u00b1" in said and "tape" in said


def test_a_stored_state_has_them() -> None:
    file = undescribed(MACHINE)
    state = fold.initial(file)
    assert state.strange.used is None
    state.strange.used = FoundLengths(0.1, 0.01, 0.02, 0.5, -0.1, 0.01, 0.02, 0.02, 0.05, 0.05)
    again = restore(file, snapshot(state))
    assert again.empty == with_found(file, state.strange.used) and again.file == file
    assert snapshot(again) == snapshot(state)


@pytest.mark.long
def test_the_fold_uses_what_it_finds_and_a_stored_state_goes_on_alike() -> None:
    scenario = Scenario(
        speed=((12.0, 0.0), (30.0, 3.0), (40.0, 1.8)),
        steering=((3.0, 0.0), (9.0, 18.0), (9.0, -18.0)),
        other_traffic=False,
    )
    file = undescribed(changed(MACHINE, {name: Amount(by) for name, by in OFF.items()}))
    state, events, after = fold.initial(file), list[Event](), list[Frame]()
    state.ready = False  # poses only
    again, seen = state, list[list[Publication]]()
    for frame in simulate(MACHINE, 3, 80.0, scenario):
        out = fold.step(state, frame)
        events += [p.value for p in out if isinstance(p.value, Event) and p.value.kind == "implement"]
        if state.strange.used is None:
            continue
        if not after:
            again = restore(file, snapshot(state))
        else:
            seen.append(out)
        after.append(frame)
    assert [event.notice.code for event in events[:1]] == ["implement_lengths"]
    assert not state.diagnosis.confirmed and state.machine.implement.d.sd < 0.05
    assert abs(drawbar(state.machine) - drawbar(MACHINE)) < 0.25
    assert [fold.step(again, frame) for frame in after[1:]] == seen


def test_nothing_is_kept_for_the_next_run() -> None:
    """Another one may be hitched on then."""
    state = fold.initial(undescribed(MACHINE))
    state.diagnosis.consistency.confirmed = True
    assert fold.save_learned(state, 1) == {}
