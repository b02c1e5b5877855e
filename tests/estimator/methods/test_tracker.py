"""The recursive estimate of all six: its equations, its intervals, changes of soil, what it must not learn
from."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from logs import MACHINE
from scipy.linalg import solve_discrete_lyapunov
from stretches import ACTIVE, SETUP, Array, somewhere

from tilth.estimator import fold
from tilth.estimator.filters import fit_covariance, soil_change, unknowns
from tilth.estimator.filters.contrast import Contrast
from tilth.estimator.filters.measurement_model import predict_measurement
from tilth.estimator.filters.priors import PRIOR
from tilth.estimator.filters.propagation import (
    first_covariance,
    ground_at,
    set_bank,
)
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.sensors.observation import Observation
from tilth.estimator.filters.states import (
    BANK_LENGTH,
    BANK_STATES,
    N_STATES,
    X_ALPHA,
    X_DISTURBANCE,
    X_POSITION,
    X_PSI,
    X_R,
    X_ROLL,
    X_V,
)
from tilth.estimator.filters.tracker_kernel import (
    BAD,
    GATED,
    USED,
)
from tilth.estimator.filters.transition import empty_transition
from tilth.estimator.filters.unknowns import AT, SIX
from tilth.estimator.methods import pem, tracker
from tilth.estimator.methods.learned import into_tracker, of_tracker
from tilth.estimator.methods.tracker import TrackerState
from tilth.estimator.record import record_builder
from tilth.estimator.record.record import (
    EAST,
    HEADING,
    NORTH,
    ROLL_ANGLE,
    TICK_NS,
    VELOCITY,
    YAW_RATE,
    Record,
    Segment,
)
from tilth.estimator.results import advice
from tilth.schemas.flow import PARAMETERS, Estimate, Event, Pose, Status
from tilth.schemas.reasons import Code
from tilth.schemas.sentences import event_sentence
from tilth.simulator import scenario
from tilth.simulator.drive import drive
from tilth.simulator.scenario import DrivenManoeuvre, Fieldwork, HeadlandTurn, Scenario, Soil, SoilChange
from tilth.simulator.traffic import traffic

Given = list[tuple[Pose, Segment | None]]

TICKS = 10  # of a segment
FIELD = Soil(grip=0.7, rolling=0.06)
ROUGH = scenario.Ground(roll_sd_deg=0.7, force_sd=0.015)
RANDOM = Scenario(
    seconds=30.0, steering=DrivenManoeuvre("random"), soil=FIELD, ground=ROUGH, other_traffic=False
)
HEADLANDS = Scenario(
    seconds=400.0, speed=((400.0, 2.0),), soil=FIELD, ground=ROUGH, other_traffic=False,
    steering=Fieldwork(length=60.0, turns=(HeadlandTurn(18.0, 8.9), HeadlandTurn(6.1, 4.8))),
    steering_limit_deg=32.5,
)  # fmt: skip
KINDS = (
    (YAW_RATE, 1),
    (VELOCITY, 1),
    (VELOCITY, 2),
    (NORTH, 0),
    (NORTH, 3),
    (EAST, 1),
    (EAST, 2),
    (HEADING, 0),
    (ROLL_ANGLE, 0),
    (ROLL_ANGLE, 3),
)


# The filter's equations


@pytest.mark.parametrize("speed", [2.0, 4.5])
def test_cross_slopes_keep_the_spread_of_the_prior_and_go_together(speed: float) -> None:
    step, setup = empty_transition(0, 0, 1), rig_setup(MACHINE)
    set_bank.interpreted()(speed, setup, step)
    found = solve_discrete_lyapunov(step.bank, step.bank_noise)
    sds = np.sqrt(np.diag(found))
    assert sds[:2] == pytest.approx(setup.bank_sd, rel=0.05)
    assert sds[2] == pytest.approx(setup.bank_sd * speed / BANK_LENGTH, rel=0.05)
    assert 0.9 < found[0, 1] / (sds[0] * sds[1]) < 0.999
    ground = ground_at.interpreted()(unknowns.prior(MACHINE)[0])
    at_first = first_covariance.interpreted()(speed, ground, setup)[np.ix_(BANK_STATES, BANK_STATES)]
    assert np.linalg.eigvalsh(at_first).min() > 0.0
    assert (np.diag(at_first) > 0.95 * np.diag(found)).all()  # a run may begin in a turn on a slope


@pytest.mark.parametrize(("place", "by", "kept"), [
    (X_V, 1.0, True), (X_V, 1.4, False), (X_R, -0.4, False), (X_ALPHA + 2, 0.4, False), (X_PSI, 3.0, False),
    (X_ROLL, 1.0, True), (X_POSITION, 100.0, True),
])  # fmt: skip
def test_what_steering_alone_would_do_begins_anew_where_it_runs_away(
    place: int, by: float, kept: bool
) -> None:
    state = tracker.initial(MACHINE)
    state.x, _ = somewhere(1)
    state.instrument = state.x.copy()
    state.instrument[place] += by
    before = state.instrument.copy()
    tracker._keep_near(state)
    if kept:
        np.testing.assert_array_equal(state.instrument, before)
        return
    np.testing.assert_array_equal(state.instrument[:X_DISTURBANCE], state.x[:X_DISTURBANCE])
    assert not state.instrument[X_DISTURBANCE:].any()


def test_the_first_look_is_where_to_begin_and_tells_no_more() -> None:
    _, given, _, _ = driven(RANDOM, 0)
    state, widened = tracker.initial(MACHINE), 0
    for pose, segment in given:
        before, mean = state.window_s, state.mean[SIX].copy()
        tracker.take(state, MACHINE, pose, segment)
        if before < tracker.TRACKER.initial_phase_s <= state.window_s:
            widened += 1
            six, others = state.covariance[SIX, SIX], np.delete(state.covariance[SIX], range(6), axis=1)
            assert np.all(np.sqrt(np.diag(six)) >= tracker.TRACKER.initial_phase_sd)
            assert not others.any() and not (six - np.diag(np.diag(six))).any()
            assert np.all(np.abs(state.mean[SIX] - mean) < 0.2)
    assert widened == 1 and np.all(np.sqrt(np.diag(state.covariance)[SIX]) < tracker.TRACKER.initial_phase_sd)


@pytest.mark.parametrize(("kind", "place"), KINDS)
def test_slopes_of_a_measurement_are_those_of_differences(kind: int, place: int) -> None:
    x, point = somewhere(3)
    run = predict_measurement.interpreted()

    def at(x: Array, point: Array) -> tuple[float, Array]:
        h = np.zeros(N_STATES + len(point))
        return run(x, Observation(kind, place, 0.0, 4.5, 0.3, 0.0), point, SETUP, h), h

    h = at(x, point)[1]
    states, constants = 1e-4 * np.eye(N_STATES), 1e-4 * np.eye(len(point))
    found = [at(x + step, point)[0] - at(x - step, point)[0] for step in states]
    found += [at(x, point + step)[0] - at(x, point - step)[0] for step in constants]
    np.testing.assert_allclose(h, np.array(found) / 2e-4, atol=1e-7)


# On frames of the virtual tractor


@cache
def driven(
    scenario: Scenario, seed: int
) -> tuple[fold.State, list[tuple[Pose, Segment | None]], list[Event], Array]:
    """(the fold at the end, what the tracker was given, soil changes, true logarithms before any change)."""
    truth = drive(MACHINE, seed, scenario.seconds, scenario)
    state, recording = fold.initial(MACHINE), record_builder.initial(MACHINE)
    given: Given = []
    events: list[Event] = []
    for frame in traffic(MACHINE, truth):
        for publication in fold.step(state, frame):
            value = publication.value
            if isinstance(value, Pose):
                given.append((value, record_builder.observe(recording, state.aligner, value)))
            elif isinstance(value, Event) and value.kind == "soil_change":
                events.append(value)
    return state, given, events, np.log([truth.parameters[name] for name in PARAMETERS])


def learned(given: Given) -> TrackerState:
    state = tracker.initial(MACHINE)
    for pose, segment in given:
        tracker.take(state, MACHINE, pose, segment)
    return state


def last(state: fold.State) -> Estimate:
    return state.estimates[tracker.METHOD]


def sds(estimate: Estimate) -> Array:
    return np.sqrt(np.diag(np.reshape(estimate.log_covariance, (6, 6))))


@pytest.mark.coverage
def test_intervals_cover_on_frames_of_the_virtual_tractor() -> None:
    """Nonlinear plant on uneven ground, coloured RTK noise, latencies and survey errors that the machine file
    does not have."""
    scores = []
    for seed in range(5):
        state, _, events, truth = driven(RANDOM, seed)
        estimate = last(state)
        assert [p.status for p in estimate.parameters] == [Status.ESTIMATED] * 6
        assert estimate.rank == 6
        assert events == []
        scores.append((np.log([p.value or 1.0 for p in estimate.parameters]) - truth) / sds(estimate))
        assert np.all(sds(estimate) < 0.25)
    z = np.array(scores)
    assert np.mean(np.abs(z) < 1.96) > 0.8  # of 30; 97 % of many
    assert np.all(np.abs(z) < 3.5)
    assert np.sqrt(np.mean(z**2)) > 0.3


@pytest.mark.coverage
def test_headland_turns_do_not_make_tyres_soft(monkeypatch: pytest.MonkeyPatch) -> None:
    """In slow turns what the ground does is as large as what steering does; with slopes where the rig is
    estimated to be, tyres came out a third too soft there."""
    errors, scores, own = [], [], []
    for seed in range(3):
        driven_to, given, events, truth = driven(HEADLANDS, seed)
        assert events == []
        state = driven_to.estimators[tracker.METHOD]
        errors.append(state.mean[SIX] - truth)
        scores.append(errors[-1] / np.sqrt(np.diag(tracker.reported_covariance(state))))
        with monkeypatch.context() as patch:
            patch.setattr(tracker, "TRACKER", replace(tracker.TRACKER, initial_phase_s=math.inf))
            own.append(learned(given).mean[SIX] - truth)
    assert np.mean(np.abs(scores) < 1.96) > 0.9  # of 18
    assert np.mean(errors, axis=0)[:3].mean() > -0.3
    assert np.mean(own, axis=0)[:3].mean() < -0.35


def test_the_fold_and_its_stretches_give_the_same() -> None:
    state, given, _, _ = driven(RANDOM, 0)
    method_state = learned(given)
    assert method_state.mean.tobytes() == state.estimators[tracker.METHOD].mean.tobytes()


def test_what_nobody_reads_is_not_made_and_the_same_is_learned() -> None:
    _, given, _, _ = driven(RANDOM, 0)
    advised = learned(given)
    with advice.unread():
        unread = learned(given)
        of_unread = tracker.estimate(unread, MACHINE, unread.last_pose_ns)
    assert advised.advisor.table and advised.advisor.advice
    assert not unread.advisor.table and unread.advisor.advice is None
    for name in ("mean", "covariance", "P_xtheta"):
        assert getattr(unread, name).tobytes() == getattr(advised, name).tobytes()
    of_all = tracker.estimate(advised, MACHINE, advised.last_pose_ns)
    assert of_all.bound and of_all.determined
    assert of_unread == replace(of_all, bound=(), determined=(), advice=None)
    assert learned(given[: len(given) // 2]).advisor.table  # read again from here on


# Another soil

CHANGED = replace(
    RANDOM,
    seconds=62.0,
    steering=((40.0, None), (5.0, 0.0), (30.0, None)),
    soil=replace(FIELD, changes=(SoilChange(at_s=42.0, C_af=0.7, C_ar=0.7, C_ai=0.7),)),
)
TURNS_AGAIN_S = 45.0


def test_another_soil_is_noticed_within_seconds_and_learned() -> None:
    state, given, events, truth = driven(CHANGED, 1)
    assert len(events) == 1
    after_s = (events[0].t_ns - given[0][0].t_ns) * 1e-9 - TURNS_AGAIN_S
    assert 0.0 < after_s < 3.0
    assert events[0].latitude_deg is not None
    assert "discarded" in event_sentence(events[0])
    estimate = last(state)
    now = truth + np.log([0.7, 0.7, 0.7, 1.0, 1.0, 1.0])
    off = np.log([p.value or 1.0 for p in estimate.parameters]) - now
    assert np.all(np.abs(off) < 3.0 * sds(estimate))
    assert np.all(np.abs(off[:2]) < 0.15)
    assert estimate.excitation["soil_changes"] == 1.0


# What nothing may be learned from


def straight(seconds: float, seed: int) -> list[Segment]:
    """A straight row to the north, steered by small corrections, over ground that pushes."""
    rng = np.random.default_rng(seed)
    n, start_ns = TICKS, 10**15
    segments = []
    for k in range(round(seconds / 0.2)):
        ticks = np.zeros((n, 8))
        ticks[:, 1] = 4.5
        ticks[:, 0] = math.radians(0.4) * math.sin(0.9 * k) + 1e-3 * rng.normal(size=n)
        rows = []
        for tick in range(0, n, 5):
            for place, ahead in enumerate(SETUP.levers[:, 0]):
                body = place // 2
                back = 0.0 if body == 0 else -SETUP.geometry[2] - SETUP.geometry[3]
                north = 4.5 * (k * 0.2 + tick * 0.02) + ahead + back
                east = SETUP.levers[place, 1]
                rows += [
                    (tick, 0.0, YAW_RATE, body, 0.004 * rng.normal(), 0.01),
                    (tick, 0.0, VELOCITY, place, 0.02 * rng.normal(), 0.03),
                    (tick, 0.0, NORTH, place, north + 0.01 * rng.normal(), 0.025),
                    (tick, 0.0, EAST, place, east + 0.01 * rng.normal(), 0.025),
                ]
        segments.append(Segment(Record(start_ns + k * n * TICK_NS, ticks, np.array(rows)), k > 0, None))
    return segments


@pytest.mark.parametrize(
    ("uneven", "least", "most"), [(0.003, 1.0, 1.05), (0.006, 1.4, 1.6), (0.01, 5.0, 5.0)]
)
def test_rough_ground_asks_for_a_larger_change_of_soil(uneven: float, least: float, most: float) -> None:
    assert least <= soil_change.limit(uneven) / soil_change.SOIL_CHANGE.changed <= most


def test_rough_ground_widens_what_is_said_of_stiffnesses_and_of_nothing_else() -> None:
    state = tracker.initial(MACHINE)
    state.disturbance[3] = 0.003**2
    before = np.diag(tracker.reported_covariance(state))
    state.disturbance[3] = PRIOR.rough**2
    wider = np.diag(tracker.reported_covariance(state)) - before
    assert wider[:3] == pytest.approx(0.1**2, rel=0.02)
    assert wider[3:] == pytest.approx(0.0, abs=1e-15)


def test_what_the_fits_show_of_the_model_of_the_ground_widens_this_method_too_and_the_next_run() -> None:
    state, after, excess = tracker.initial(MACHINE), tracker.initial(MACHINE), np.linspace(0.0, 0.25, 6)
    state.covariance[SIX, SIX] = 1e-4 * np.eye(6)
    before = np.diag(tracker.reported_covariance(state))
    job = pem.Job(0, 0, Record(0, np.zeros((0, 8)), np.zeros((0, 6))), state.mean, state.covariance)
    made = pem.Fit(
        state.mean, state.covariance, None, 0.0, 0.0, 0.0, 1, 9, False, False, None, Contrast(excess=excess)
    )
    state.mean = made.mean.copy()
    tracker.learn(state, job, made)
    assert np.diag(tracker.reported_covariance(state)) - before == pytest.approx(excess**2, abs=1e-12)
    into_tracker(after, of_tracker(state))
    assert np.all(np.sqrt(np.diag(tracker.reported_covariance(after))) >= excess)
    state.mean[0] += 0.8  # lost
    tracker.learn(state, job, made)
    assert 0.7 < math.sqrt(tracker.reported_covariance(state)[0, 0]) < 0.85
    assert state.apart[1:] == pytest.approx(0.0)
    state.changed_ns = 1  # while the window was driven
    tracker.learn(state, job, made)
    assert state.apart == pytest.approx(0.0)


def test_what_tight_turns_told_stays_as_uncertain_in_the_next_run() -> None:
    before, after = tracker.initial(MACHINE), tracker.initial(MACHINE)
    before.covariance[SIX, SIX] = 1e-4 * np.eye(6)
    before.window_s, before.tight_s = 60.0, 20.0
    into_tracker(after, of_tracker(before))
    for state in (before, after):
        assert np.all(
            np.sqrt(np.diag(tracker.reported_covariance(state)))
            >= fit_covariance.FIT_COVARIANCE.tracked_tight_sd
        )


def test_what_moves_further_than_the_prior_lets_expect_is_less_sure() -> None:
    state = tracker.initial(MACHINE)
    place, sd = AT["roll_zero_tractor_front"], state.prior_sd[AT["roll_zero_tractor_front"]]
    state.covariance[place, place] *= 1e-6
    for moved, expected in (
        (0.5, 1.0),
        (-1.0, math.hypot(1.0, 0.5)),
        (4.0, math.hypot(1.0, 3.5)),
        (-4.0, math.hypot(1.0, 3.5)),
    ):
        state.mean[place] = state.prior_mean[place] + moved * sd
        said = tracker.estimate(state, MACHINE, 1).nuisances["roll_zero_tractor_front"]
        assert said[1] == pytest.approx(expected * sd, rel=1e-6)


def test_the_yaw_of_a_pair_is_as_unknown_as_the_survey_of_its_antennas() -> None:
    loose = [receiver.model_copy(update={"survey_sd": 0.05}) for receiver in MACHINE.receiver]
    machine = MACHINE.model_copy(update={"receiver": loose})
    at = [AT["pair_t"], AT["pair_i"]]
    known, unknown = (unknowns.prior(one)[1][at] for one in (MACHINE, machine))
    assert (known >= math.radians(0.2)).all()
    for sd, body in zip(unknown, ("tractor", "implement"), strict=True):
        one, other = (r.position[:2] for r in loose if r.mount.body == body)
        assert sd == pytest.approx(
            math.hypot(math.radians(0.2), 0.05 * math.sqrt(2.0) / math.dist(one, other))
        )


def test_rough_ground_is_believed_at_once_and_smooth_ground_slowly() -> None:
    """Ten segments, 2 s, in which the pushes' variances are three times what is expected, or a third."""
    changed = []
    for ratio in (3.0, 1.0 / 3.0):
        state = tracker.initial(MACHINE)
        before = state.disturbance.copy()
        for _ in range(10):
            tracker._adapt_noise(state, np.vstack([np.zeros((4, 2)), np.tile([ratio, 1.0], (5, 1))]))
        changed.append(state.disturbance / before)
    assert (changed[0] > 1.8).all()
    assert (changed[1] > 0.9).all()
    assert (changed[1] < 1.0).all()


def follow(state: TrackerState, segments: list[Segment]) -> None:
    for segment in segments:
        state.last_pose_ns = segment.record.end_ns
        tracker.take_segment(state, MACHINE, segment)


@pytest.mark.long
def test_straight_rows_teach_zero_and_alignment_but_not_the_soil() -> None:
    state = learned(driven(RANDOM, 1)[1])
    mean, sd = state.mean[SIX].copy(), np.sqrt(np.diag(state.covariance)[SIX])
    said = np.sqrt(np.diag(tracker.reported_covariance(state)))
    zero = state.covariance[AT["wheel_zero"], AT["wheel_zero"]]
    follow(state, straight(400.0, 5))
    assert np.all(np.abs(state.mean[SIX] - mean) < 0.2 * said)
    assert np.all(np.sqrt(np.diag(state.covariance)[SIX]) >= sd)
    assert state.covariance[AT["wheel_zero"], AT["wheel_zero"]] < zero
    assert state.refused[Code.TOO_LITTLE_STEERING] > 1900
    assert state.changes == 0
    assert np.all(np.linalg.eigvalsh(state.covariance[np.ix_(ACTIVE, ACTIVE)]) > 0.0)
    assert np.all(np.diag(state.P_xx)[:8] < 1.0)


@pytest.mark.parametrize("column", [4, 5, 1])
def test_a_row_that_is_not_finite_is_left_out(column: int) -> None:
    given = driven(RANDOM, 1)[1]
    k = next(k for k, (_, s) in enumerate(given) if s is not None and not s.reason) + 60
    pose, segment = given[k]
    assert segment is not None
    rows = segment.record.rows.copy()
    rows[5, column] = math.nan
    spoilt = Segment(Record(segment.record.t_ns, segment.record.ticks, rows), segment.follows, None)
    clean, state = learned(given), learned([*given[:k], (pose, spoilt), *given[k + 1 :]])
    assert clean.counts[BAD] == 0.0 and state.counts[BAD] == 1.0
    assert state.counts[USED] + 1.0 == pytest.approx(clean.counts[USED], abs=3.0)
    assert np.all(np.abs(state.mean - clean.mean)[SIX] < 0.3 * np.sqrt(np.diag(clean.covariance)[SIX]))


def test_an_input_that_is_no_number_costs_one_stretch() -> None:
    given = driven(RANDOM, 1)[1]
    pose, segment = given[80]
    assert segment is not None
    ticks = segment.record.ticks.copy()
    ticks[3, 0] = math.inf
    spoilt = Segment(Record(segment.record.t_ns, ticks, segment.record.rows), segment.follows, None)
    state = learned([*given[:80], (pose, spoilt), *given[81:]])
    assert state.refused[Code.INPUTS_NOT_FINITE] == 1
    assert state.restarts == 2
    assert np.all(np.isfinite(state.mean)) and np.all(np.isfinite(state.P_xx))


def test_an_outlier_is_gated() -> None:
    given = driven(RANDOM, 1)[1]
    pose, segment = given[80]
    assert segment is not None
    rows = segment.record.rows.copy()
    rows[np.flatnonzero(rows[:, 2] == EAST)[0], 4] += 2.0
    spoilt = Segment(Record(segment.record.t_ns, segment.record.ticks, rows), segment.follows, None)
    clean, state = learned(given), learned([*given[:80], (pose, spoilt), *given[81:]])
    assert state.counts[GATED] == clean.counts[GATED] + 1.0
    assert np.all(np.abs(state.mean - clean.mean)[SIX] < 0.3 * np.sqrt(np.diag(clean.covariance)[SIX]))


def test_after_a_gap_nothing_jumps() -> None:
    given = driven(RANDOM, 1)[1]
    gap = [
        (pose, replace(segment, reason=Code.NO_RTK) if segment else None) for pose, segment in given[60:80]
    ]
    state = learned([*given[:60], *gap])
    mean, sd = state.mean[SIX].copy(), np.sqrt(np.diag(state.covariance)[SIX])
    pose, segment = given[80]
    assert segment is not None
    tracker.take(state, MACHINE, pose, replace(segment, follows=False))
    largest = 0.0
    for pose, segment in given[81:]:
        tracker.take(state, MACHINE, pose, segment)
        largest = max(largest, float(np.max(np.abs(state.mean[SIX] - mean) / sd)))
        mean, sd = state.mean[SIX].copy(), np.sqrt(np.diag(state.covariance)[SIX])
    assert state.refused[Code.NO_RTK] == 20
    assert state.refused[Code.FILTER_SETTLING] == 2 * tracker.TRACKER.settles
    assert largest < 1.0


# The reported estimate


def test_a_number_comes_goes_stale_and_is_never_given_without_support() -> None:
    state, _, _, _ = driven(RANDOM, 2)
    method_state = state.estimators[tracker.METHOD]
    fresh = tracker.initial(MACHINE)
    assert {p.status for p in tracker.estimate(fresh, MACHINE, 5).parameters} == {Status.UNESTIMATED}
    late = tracker.estimate(method_state, MACHINE, method_state.informed_ns + 301 * 10**9)
    assert {p.status for p in late.parameters} == {Status.STALE}
    assert all(p.reason is not None and p.reason.code is Code.NOT_LEARNED_FOR for p in late.parameters)
    method_state.covariance[SIX, SIX] = (0.5 * method_state.prior_sd[0]) ** 2 * np.eye(
        6
    )  # is reported as 0.58 of the prior's
    method_state.has_number[0] = True
    first = tracker.estimate(method_state, MACHINE, method_state.informed_ns).parameters[0]
    assert first.status is Status.ESTIMATED  # not yet beyond LOST
    method_state.has_number[0] = False
    again = tracker.estimate(method_state, MACHINE, method_state.informed_ns).parameters[0]
    assert again.status is Status.UNESTIMATED and again.reason is not None and again.reason.code is Code.WIDE
    assert again.value is None


def test_wheels_are_held_until_they_have_moved_away_from_where_that_began() -> None:
    state = tracker.initial(MACHINE)
    small, far = 0.9 * tracker.TRACKER.held_within, 1.1 * tracker.TRACKER.held_within
    for wheel, held in ((0.2, 1), (0.2 + small, 2), (0.2 - small, 3), (0.2 + far, 1), (0.2, 1), (0.2, 2)):
        tracker._note_held(state, wheel)
        assert state.held == held
