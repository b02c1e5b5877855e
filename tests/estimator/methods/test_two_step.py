"""The dissertation's two steps: what they find, what they cannot find, and that they say so."""

import math
from dataclasses import replace

import numpy as np
import pytest
from circle import START_NS, demo_machine
from drives import QUIET, Changes, driven
from numpy.typing import NDArray

from tilth.estimator.filters import two_step_fit, unknowns
from tilth.estimator.filters.two_step_fit import Window, identify, merge_scalar
from tilth.estimator.fold import initial
from tilth.estimator.methods import two_step
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import simulate
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.record.record import EAST, HEADING, NORTH, TICK_NS, YAW_RATE, Record, Segment
from tilth.estimator.snapshot import restore, snapshot
from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.schemas.flow import BodyPose, Pose, Status
from tilth.schemas.reasons import Code, Reason

Array = NDArray[np.float64]

MACHINE = demo_machine()
RIG = rig_of(MACHINE)
TRUTH = np.asarray(RIG.theta)
SPEED = 4.5
TICKS = 1500
STEP_AT = 400


def record_of(wheel: Array, noise: float = 0.0, zero: float = 0.0, seed: int = 1) -> Record:
    """What the relaxation model does at that wheel angle, with yaw rates and headings at 5 Hz."""
    rng = np.random.default_rng(seed)
    n = len(wheel)
    x = simulate(
        model_named("relaxation"), RIG, SPEED, np.column_stack([wheel, np.zeros((n, 2))]), np.zeros(9), 0.02,
        linear=True,
    )  # fmt: skip
    ticks = np.zeros((n, 8))
    ticks[:, 0], ticks[:, 1] = wheel + zero + noise * rng.normal(0, 0.001, n), SPEED
    ticks[:, 2:4], ticks[:, 4:6] = x[:n, 7:9], x[:n, 1:3]
    rows = []
    for k in range(0, n, 10):
        for body in (0, 1):
            rate, heading = x[k, 1 + body], x[k, 7 + body]
            rows.append((k, 0.0, YAW_RATE, body, rate + noise * rng.normal(0, 0.004), 0.004))
            rows.append((k, 0.0, HEADING, body, heading + noise * rng.normal(0, 0.005), 0.005))
    return Record(START_NS, ticks, np.array(rows, dtype=np.float64))


def step_run(degrees: float = 8.0) -> Array:
    wheel = np.zeros(TICKS)
    wheel[STEP_AT:] = math.radians(degrees) * np.minimum(np.arange(TICKS - STEP_AT) / 16, 1.0)
    return wheel


def window(record: Record, start: Array) -> Window:
    return Window(record, unknowns.base_geometry(MACHINE), start, unknowns.levers(MACHINE))


def test_merging_gives_the_dissertations_table() -> None:
    """Table 7.5: relaxation lengths of the first two trials, to the digits that are printed."""
    trials = {
        (1.5, 0.4, 1.0, 0.8): (1.4, 0.4),
        (2.1, 0.4, 2.6, 0.7): (2.2, 0.3),
        (1.3, 0.9, 1.7, 1.0): (1.5, 0.7),
    }
    for (one, sd_one, other, sd_other), (mean, sd) in trials.items():
        found = merge_scalar([one, other], [sd_one, sd_other])
        assert (round(found[0], 1), round(found[1], 1)) == (mean, sd)
    # In whatever order; and as inverse variances.
    values, sds = [600.0, 550.0, 560.0], [40.0, 70.0, 40.0]
    weights = np.array(sds) ** -2
    expected = float(np.average(values, weights=weights)), float(weights.sum() ** -0.5)
    assert merge_scalar(values, sds) == pytest.approx(expected)
    assert merge_scalar(values[::-1], sds[::-1]) == pytest.approx(expected)
    with pytest.raises(ValueError, match="no estimate"):
        merge_scalar([], [])


def test_scalar_merging_leans_low_as_its_docstring_says() -> None:
    """The sd of a stiffness goes with its value, so low estimates weigh more."""
    rng = np.random.default_rng(3)
    merged = []
    for _ in range(200):
        values = np.exp(rng.normal(0.0, 0.3, 6))
        merged.append(merge_scalar(list(values), list(0.3 * values))[0])
    assert np.mean(merged) < 0.93


def test_relaxation_lengths_are_found_where_the_stiffnesses_are_right() -> None:
    start = TRUTH * np.array([1.0, 1.0, 1.0, 1.4, 0.7, 1.5])
    found = identify(window(record_of(step_run()), start))
    assert found.found == (True, True) and found.reason is None
    assert found.values[:3] == pytest.approx(TRUTH[:3], rel=0.02)
    assert found.values[3:] == pytest.approx(TRUTH[3:], rel=0.03)


def test_with_a_free_gain_the_intervals_are_too_narrow() -> None:
    """With the stiffnesses given, sensor noise alone, and 12 runs of steps."""
    wheel = np.repeat(np.radians([0.0, 8.0, -8.0, 4.0, -6.0]), TICKS // 5)
    inside = []
    for seed in range(12):
        outputs = two_step_fit._outputs(window(record_of(wheel, 1.0, seed=seed), TRUTH))
        assert outputs is not None
        lengths, sds, within = two_step_fit._relaxation_lengths(
            outputs, unknowns.base_geometry(MACHINE), TRUTH
        )
        assert within
        inside += (np.abs(lengths - TRUTH[3:]) < 1.96 * sds).tolist()
    assert 0.35 < np.mean(inside) < 0.9


def test_two_outputs_leave_the_stiffnesses_on_a_line_and_it_says_so() -> None:
    record = record_of(step_run(), noise=1.0)
    ends = []
    for factors in ((0.7, 0.6, 0.6), (1.4, 1.7, 1.6)):
        start = TRUTH * np.array([*factors, 1.0, 1.0, 1.0])
        found = identify(window(record, start))
        assert found.rank == 2
        ends.append(found)
    one, other = (np.log(found.values[:3] / TRUTH[:3]) for found in ends)
    assert np.abs(one - other).max() > 0.3  # where it began decides where it ends
    # Its own sds admit it.
    assert min((found.sds[:3] / found.values[:3]).min() for found in ends) > 0.5


def test_the_zero_of_the_wheel_angle_is_taken_off_where_it_goes_straight() -> None:
    found = identify(window(record_of(step_run(), zero=math.radians(0.3)), TRUTH))
    assert found.zero == pytest.approx(math.radians(0.3), abs=1e-4)
    assert found.straight_s == pytest.approx(STEP_AT * 0.02, abs=0.3)
    assert found.values[3:] == pytest.approx(TRUTH[3:], rel=0.05)


@pytest.mark.parametrize(
    ("wheel", "drop", "reason"),
    [
        (np.zeros(TICKS), None, Code.NO_STEADY_TURN),
        (0.1 * np.sin(np.arange(TICKS) * 0.02), None, Code.NO_STEADY_TURN),
        (step_run(), YAW_RATE, Code.OUTPUTS_NOT_MEASURED),
    ],
    ids=["straight", "weaving", "no yaw rate"],
)
def test_a_run_that_cannot_tell_gives_a_reason(wheel: Array, drop: float | None, reason: Code) -> None:
    record = record_of(wheel)
    record.rows = record.rows[record.rows[:, 2] != drop]
    found = identify(window(record, TRUTH))
    assert found.reason == reason and found.found == (False, False)


def test_headings_come_from_two_antennas_whatever_their_places() -> None:
    levers = np.array([[1.6, 0.2], [-1.1, -0.3], [1.3, 0.0], [-1.3, 0.0]])
    heading = np.linspace(3.0, 3.5, 50)  # across the wrap
    rows = []
    for k, psi in enumerate(heading):
        for place in range(4):
            forward, right = levers[place]
            north = forward * math.cos(psi) - right * math.sin(psi)
            east = forward * math.sin(psi) + right * math.cos(psi)
            rows += [(k * 10, 0.0, NORTH, place, north, 0.02), (k * 10, 0.0, EAST, place, east, 0.02)]
    at = np.arange(0, 500, 10)
    for body in (0, 1):
        found = two_step_fit._heading(np.array(rows), body, at, levers, heading + 0.02)
        assert found == pytest.approx(heading, abs=1e-9)


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


def test_it_changes_no_other_method_and_is_never_recommended() -> None:
    usual, run = driven(QUIET, 42.0), driven(QUIET, 42.0, ENABLED)
    estimate = run.estimates(two_step.METHOD)
    assert any(p.value is not None for p in estimate[-1].parameters)
    assert {p.status for e in estimate for p in e.parameters} == {Status.UNESTIMATED, Status.INVALID}
    topic = f"/soil_tire/{two_step.METHOD}"
    assert [p for p in run.publications if p.topic != topic] == usual.publications


def test_unless_the_machine_file_asks_for_it_it_is_not_there() -> None:
    usual = driven(QUIET, 42.0)
    assert not usual.estimates(two_step.METHOD) and two_step.METHOD not in usual.state.estimators
    asking = demo_machine(**dict(ENABLED))
    taken_up = restore(asking, snapshot(initial(MACHINE)))  # a log of before, replayed with such a file
    assert set(taken_up.estimators) == {*usual.state.estimators, two_step.METHOD}
