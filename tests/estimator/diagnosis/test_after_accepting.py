"""After a value has been accepted no false change of soil is told, and a real one is found.

A rig whose receivers or sensor are not where the file says; a run before, when they were; and an accepted
value that is off by 1.5 of its sds, as one in eight is.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from circle import demo_machine
from numpy.typing import NDArray

from tilth.estimator import fold
from tilth.estimator.diagnosis.accepted import corrected
from tilth.estimator.methods.estimators import rows_for
from tilth.estimator.rig.numbers import DRAWBAR, PAIRS, WHEEL
from tilth.estimator.snapshot import restore, snapshot
from tilth.estimator.state_json import to_json_data
from tilth.estimator.warm_start import SavedPosterior
from tilth.logger.guarded_fold import GuardedFold
from tilth.schemas.flow import PARAMETERS, Accepted, Estimate, Event, Frame, Status
from tilth.schemas.machine import Machine
from tilth.simulator.drive import drive
from tilth.simulator.scenario import DrivenManoeuvre, Ground, Scenario, Soil, SoilChange
from tilth.simulator.traffic import host_clock, traffic

Array = NDArray[np.float64]

MACHINE = demo_machine()
SEED = 1
MOVED: Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "tractor_front": ((0.1, 0.0), (0.016, 0.007)),
    "tractor_rear": ((0.0, -0.1), (0.016, 0.007)),
    "implement_front": ((-0.1, 0.0), (0.016, 0.007)),
    "implement_rear": ((0.0, 0.1), (0.016, 0.007)),
    PAIRS[0]: ((0.0175,), (0.0045,)),
    PAIRS[1]: ((-0.0175,), (0.0045,)),
    WHEEL: ((0.0175,), (0.0024,)),
    DRAWBAR: ((0.1,), (0.02,)),
}
"""What was moved -> by how much, and the sds with which the watch finds it in fields; m or rad."""
# One of each kind, and each way: what is done for one receiver, or one pair, is done for the others.
EACH = [
    pytest.param(WHEEL, marks=pytest.mark.long),
    *(
        pytest.param(name, marks=pytest.mark.coverage)
        for name in ("tractor_front", "implement_rear", PAIRS[1], DRAWBAR)
    ),
]
OFF = 1.5  # sds by which the accepted value is wrong
ACCEPT_S, CHANGE_S, TURNS_AGAIN_S = 2.0, 38.0, 41.0
FACTOR = 0.65  # of the stiffnesses, from CHANGE_S on
SAME = Scenario(
    seconds=51.0,
    steering=((36.0, None), (5.0, 0.0), (30.0, None)),
    soil=Soil(grip=0.7, rolling=0.06),
    ground=Ground(roll_sd_deg=0.7, force_sd=0.015),
    other_traffic=False,
)
CHANGED = replace(
    SAME, soil=replace(SAME.soil, changes=(SoilChange(at_s=CHANGE_S, C_af=FACTOR, C_ar=FACTOR, C_ai=FACTOR),))
)
BEFORE = replace(SAME, seconds=40.0, steering=DrivenManoeuvre("random"))


def accepted(name: str, t_ns: int, off: float) -> Accepted:
    """off: by how many of its sds it is wrong."""
    amounts, sds = MOVED[name]
    return Accepted(t_ns, name, tuple(a + off * sd for a, sd in zip(amounts, sds, strict=True)), sds)


def as_it_stands(name: str) -> Machine:
    """A file of the rig after `name` was moved."""
    amounts, _ = MOVED[name]
    return corrected(MACHINE, [Accepted(0, name, amounts, (0.0,) * len(amounts))])


@cache
def learned_before() -> Mapping[str, SavedPosterior]:
    """What a run has learned in which all was as the file says; as sure as after ten minutes."""
    run = GuardedFold(MACHINE)
    truth = drive(MACHINE, SEED, BEFORE.seconds, BEFORE)
    frame: Frame | None = None
    for frame in traffic(MACHINE, truth):
        run.take(frame)
    assert frame is not None
    kept = run.keep(frame.t_ns)
    assert {"tracker", "pem"} <= set(kept)
    return {method: replace(one, covariance=one.covariance / 16.0) for method, one in kept.items()}


@cache
def few_frames() -> list[Frame]:
    return list(traffic(MACHINE, drive(MACHINE, SEED, 1.5, SAME)))


def off_by(estimate: Estimate, logs: Array) -> float:
    """Largest error of its numbers, in sds; 0 without any."""
    sds = np.sqrt(np.diag(np.reshape(estimate.log_covariance, (6, 6))))
    errors = [
        abs(math.log(p.value) - log) / sd
        for p, log, sd in zip(estimate.parameters, logs, sds, strict=True)
        if p.value is not None and p.status is Status.ESTIMATED
    ]
    return max(errors, default=0.0)


@pytest.mark.parametrize("name", EACH)
def test_no_other_soil_and_no_wrong_number_until_the_soil_is_another(name: str) -> None:
    stands = as_it_stands(name)
    truth = drive(stands, SEED, CHANGED.seconds, CHANGED)
    logs = np.log(np.array([truth.parameters[key] for key in PARAMETERS], np.float64))
    clock = host_clock(truth)
    run = GuardedFold(MACHINE)
    changes: list[float] = []
    worst: dict[str, float] = {}
    first, told = True, False
    for frame in traffic(stands, truth):
        if first:
            assert not any(run.warm(learned_before(), 3600.0, frame.t_ns).values())
            first = False
        if not told and frame.t_ns >= clock(ACCEPT_S):
            told = True
            run.accept(accepted(name, frame.t_ns, OFF))
        for publication, _ in run.take(frame):
            value = publication.value
            if isinstance(value, Event) and value.kind == "soil_change":
                changes.append((value.t_ns - clock(0.0)) * 1e-9)
            elif isinstance(value, Estimate) and told and value.t_ns < clock(CHANGE_S):
                worst[value.method] = max(worst.get(value.method, 0.0), off_by(value, logs))
    assert run.faults == 0
    assert worst["recommended"] > 0.0  # there are numbers again
    assert all(off < 3.0 for off in worst.values()), worst
    assert changes and TURNS_AGAIN_S < changes[0] < TURNS_AGAIN_S + 5.0


@pytest.mark.parametrize("name", MOVED)
def test_all_that_is_learned_begins_from_the_file_with_the_value(name: str) -> None:
    state = fold.initial(MACHINE)
    frames = few_frames()
    fold.resume(state, learned_before(), 3600.0, frames[0].t_ns)
    for frame in frames:
        fold.step(state, frame)
    assert state.previous_run and state.record.knots
    latencies = state.aligner.latency.tau.tolist()
    said = accepted(name, frames[-1].t_ns, 0.0)
    fold.accept(state, said)
    now = corrected(MACHINE, [said])
    for again in (state, restore(MACHINE, snapshot(state))):
        assert again.machine == now and again.record.knots == [] and not again.diagnosis.consistency.confirmed
        for row in rows_for(now):
            assert to_json_data(again.estimators[row.method]) == to_json_data(row.initial(now))
    kept = state.aligner.latency.tau.tolist() == latencies
    assert kept == (name == WHEEL)  # it is no length, which would have been taken for latency
    assert state.previous_run == {}  # what is discarded later does not bring it back either
