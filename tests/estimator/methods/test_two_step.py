"""The dissertation's two steps: what they find, what they cannot find, and that they say so."""

import math
from dataclasses import replace

import numpy as np
import pytest
from circle import START_NS, demo_machine
from drives import QUIET, Changes, driven
from step_runs import MACHINE, SPEED, STEP_AT, TICKS, TRUTH, record_of, step_run

from tilth.estimator.filters import two_step_fit
from tilth.estimator.fold import initial
from tilth.estimator.methods import two_step
from tilth.estimator.record.record import TICK_NS, Record, Segment
from tilth.estimator.snapshot import restore, snapshot
from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.schemas.flow import BodyPose, Pose, Status
from tilth.schemas.reasons import Code, Reason

# The estimator's row.


def pose_at(t_ns: int) -> Pose:
    body = BodyPose(0.0, 0.0, 0.02, 0.0, 0.005, SPEED, 0.0, 0.03, 0.04, 0.0, 0.003, 0.0, 0.004)
    return Pose(t_ns, 43.5, -83.4, body, body, 0.0, 0.007, 0.0, 0.002, 1, None, 0.0, 4, ())


def segments(record: Record) -> list[Segment]:
    out = []
    for k in range(0, len(record.ticks), 10):
        in_segment = (record.rows[:, 0] >= k) & (record.rows[:, 0] < k + 10)
        rows = record.rows[in_segment] - np.array([k, 0, 0, 0, 0, 0])
        out.append(Segment(Record(record.t_ns + k * TICK_NS, record.ticks[k : k + 10], rows), k > 0, None))
    return out


def ended(run: list[Segment]) -> list[Segment]:
    """The same, with the last segment refused behind it, which ends the window."""
    return [*run, replace(run[-1], follows=False, reason=Code.REVERSE)]


def drive(state: two_step.TwoStepState, run: list[Segment]) -> int:
    """Take them all; the instant after the last."""
    for segment in run:
        two_step.take(state, MACHINE, pose_at(segment.record.end_ns), segment)
    return run[-1].record.end_ns


def test_a_window_is_requested_fitted_merged_and_never_usable() -> None:
    state = two_step.initial(MACHINE)
    record = record_of(step_run(), noise=1.0)
    t_ns = drive(state, ended(segments(record)))
    job = two_step.request_fit(state, t_ns)
    assert job is not None and job.asked_ns == t_ns and job.closed_ns == record.end_ns
    begin = STEP_AT - 100  # 2 s before the wheels turn
    later = record.rows[record.rows[:, 0] >= begin] - [begin, 0, 0, 0, 0, 0]
    assert np.array_equal(job.record.ticks, record.ticks[begin:]) and np.array_equal(job.record.rows, later)
    assert two_step.request_fit(state, t_ns) is None  # one at a time
    made = two_step.fit(MACHINE, job)
    again = two_step.fit(MACHINE, from_json_data(two_step.Job, to_json_data(job)))
    assert np.array_equal(made.values, again.values) and np.array_equal(made.sds, again.sds)
    back = from_json_data(two_step.TwoStepState, to_json_data(state))
    estimate = two_step.adopt(state, MACHINE, made, t_ns + 3 * 10**9)
    assert two_step.adopt(back, MACHINE, made, t_ns + 3 * 10**9) == estimate
    assert state.job is None
    for k, parameter in enumerate(estimate.parameters):
        if made.found[k // 3]:
            assert parameter.status is Status.INVALID and parameter.value == pytest.approx(made.values[k])
        else:
            assert parameter.status is Status.UNESTIMATED and parameter.value is None
    assert made.found[1]
    assert estimate.parameters[3].reason == Reason(Code.ON_UNIDENTIFIABLE)
    assert estimate.rank == 2
    assert estimate.parameters[3].age_s == pytest.approx(3.0)


def test_a_second_window_is_merged_number_by_number() -> None:
    state = two_step.initial(MACHINE)
    made = two_step_fit.TwoStep(TRUTH, 0.2 * TRUTH, (True, True), 2, 0.0, 5.0, 20.0, None)
    other = replace(made, values=1.5 * TRUTH, found=(False, True), reason=None)
    for found in (made, other):
        state.job = two_step.Job(START_NS, START_NS, Record(START_NS, np.zeros((TICKS, 8))))
        estimate = two_step.adopt(state, MACHINE, found, START_NS)
    assert state.values[:3] == pytest.approx(TRUTH[:3])
    assert state.values[3:] == pytest.approx(1.25 * TRUTH[3:])
    assert state.sds[3:] == pytest.approx(0.2 / math.sqrt(2) * TRUTH[3:])
    assert list(state.runs) == [1, 1, 1, 2, 2, 2]
    assert estimate.window_s == pytest.approx(60.0)


def test_a_late_fit_is_dropped_and_counted() -> None:
    state = two_step.initial(MACHINE)
    t_ns = drive(state, ended(segments(record_of(step_run()))))
    assert two_step.request_fit(state, t_ns) is not None
    estimate = two_step.adopt(state, MACHINE, None, t_ns + 3 * 10**9)
    assert state.late == 1 and state.job is None
    assert {p.status for p in estimate.parameters} == {Status.UNESTIMATED}


def test_what_may_not_teach_ends_a_window_and_is_counted() -> None:
    state = two_step.initial(MACHINE)
    run = segments(record_of(step_run()))
    run[50] = replace(run[50], reason=Code.REVERSE)  # 2 s after the step: too short to be fitted
    run[51] = replace(run[51], follows=False)
    t_ns = drive(state, run)
    assert state.refused[Code.REVERSE] == 1
    assert two_step.request_fit(state, t_ns) is None
    assert state.refused[Code.TOO_SHORT] == 1
    assert len(state.window) == 99
    two_step.clock_stepped(state, -(10**9))
    assert not state.window and state.informed_ns == 0


# Beside the others.

ENABLED: Changes = (("[zenoh]", "[estimation]\ntwo_step = true\n\n[zenoh]"),)


@pytest.mark.long
def test_it_changes_no_other_method_and_is_never_recommended() -> None:
    usual, run = driven(QUIET, 42.0), driven(QUIET, 42.0, ENABLED)
    estimate = run.estimates(two_step.METHOD)
    assert any(p.value is not None for p in estimate[-1].parameters)
    assert {p.status for e in estimate for p in e.parameters} == {Status.UNESTIMATED, Status.INVALID}
    topic = f"/soil_tire/{two_step.METHOD}"
    assert [p for p in run.publications if p.topic != topic] == usual.publications


@pytest.mark.long
def test_unless_the_machine_file_asks_for_it_it_is_not_there() -> None:
    usual = driven(QUIET, 42.0)
    assert not usual.estimates(two_step.METHOD) and two_step.METHOD not in usual.state.estimators
    asking = demo_machine(**dict(ENABLED))
    taken_up = restore(asking, snapshot(initial(MACHINE)))  # a log of before, replayed with such a file
    assert set(taken_up.estimators) == {*usual.state.estimators, two_step.METHOD}
