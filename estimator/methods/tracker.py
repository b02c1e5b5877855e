"""All six parameters, recursively: an extended Kalman filter that takes every sample once, in order.

Its states and equations are in tracker_kernel.py, the detection of other soil in soil_change.py. This module
decides what may be learned, adapts the noise of ground and sensors, and reports. A segment is processed when
the next one is there: if the latency is smaller than that of the machine file, later wheel angles are needed.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.driving import DRIVING
from tilth.estimator.filters import fit_covariance, likelihood, soil_change, unknowns
from tilth.estimator.filters.drift import added_covariance, drift, retained_share
from tilth.estimator.filters.predictor import run_ticks
from tilth.estimator.filters.priors import PRIOR
from tilth.estimator.filters.propagation import GroundNoise, first_covariance
from tilth.estimator.filters.rig_setup import RigSetup, rig_setup
from tilth.estimator.filters.soil_change import SOIL_CHANGE, Checkpoint
from tilth.estimator.filters.soil_field import At
from tilth.estimator.filters.states import DT, N_STATES, START, X_BANK, X_DISTURBANCE, X_PSI, X_ROLL
from tilth.estimator.filters.tracker_kernel import (
    BAD,
    GATED,
    GROUND,
    SENSORS,
    USED,
    JointEstimate,
    RowTally,
    SegmentArrays,
    over_segment,
    track_segment,
)
from tilth.estimator.filters.unknowns import (
    AT,
    NAMES,
    NEED_STEERING,
    NOISE,
    SIX,
)
from tilth.estimator.methods import pem
from tilth.estimator.methods.pem import of_masses, with_known_masses
from tilth.estimator.models.load import by_another_load
from tilth.estimator.record.record import INPUTS, PSI, WHEEL_ANGLE, Record, Segment, U
from tilth.estimator.results import advice
from tilth.estimator.results.advice import Advisor
from tilth.estimator.results.method_state import SixState, is_due, step_clock
from tilth.estimator.results.recommend import LEANS, SINCE_CHANGE
from tilth.estimator.results.reporting import REPORTING, age_s, six_parameter_estimate, stale_reason
from tilth.estimator.state_json import Shape
from tilth.estimator.ties import exceeds
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import PARAMETERS, Estimate, EventKind, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.notices import NoticeCode, notice
from tilth.schemas.plausible import GRAVITY
from tilth.schemas.reasons import Code
from tilth.schemas.tolerances import MADE

Array = NDArray[np.float64]
MotionVector = Annotated[Array, Shape((N_STATES,))]

METHOD = "tracker"


@dataclass(frozen=True, slots=True)
class TrackerTuning:
    """What the tracker learns from, and how fast it adapts."""

    sd_factor: float = tuned(1.25, "1", "on the reported sds, for the part that comes from data")
    """The ground's waves and the receivers' slow errors are correlated for longer than in the filter's model.
    From Monte Carlo over uneven ground."""
    steering: float = tuned(math.radians(1.5), "rad", "least recent rms of the wheels to learn soil from")
    """With less, the apparent information comes mostly from the ground's forces."""
    steering_memory: float = tuned(6.0, "segments", "over which it is averaged, 1.2 s")
    held_within: float = tuned(math.radians(1.5), "rad", "wheels that stay within so much are held")
    longest_held: int = tuned(25, "segments", "for which they may be held, 5 s")
    initial_phase_s: float = tuned(
        10.0, "s", "learned from first, with slopes where the rig is estimated to be"
    )
    """Slopes by steering alone need tyres that are roughly right; with those of the prior one rig in twelve
    was lost."""
    initial_phase_sd: float = tuned(0.3, "1", "that the six have after it at least, correlated with nothing")
    far_off: Array = tuned(
        3.0 * np.array(START[:X_ROLL]), "m/s, rad/s, rad", "from the estimated state, by steering alone"
    )
    settles: int = tuned(5, "segments", "after a restart of x (1 s) in which soil is not learned either")
    """Errors of the initial slip angles would be taken for stiffness."""
    disturbance_length: float = tuned(0.45, "m", "over which disturbances last; pem finds 0.1 s at 4.5 m/s")
    sensor_noise_memory: float = tuned(30.0, "segments", "over which the sensors' noise is averaged, 6 s")
    disturbance_variance_memory: float = tuned(
        50.0, "segments", "same for the disturbance forces' variances, 10 s"
    )
    initial_disturbances: float = tuned(
        15.0, "segments", "memory for larger disturbances after a start; it grows"
    )
    """Until rough ground is taken for what it is, its forces are learned as tyres."""
    disturbance_forgetting: float = tuned(1000.0, "segments", "over which disturbances return to their prior")
    largest_disturbance: float = tuned(5.0, "1", "largest observed over expected variance of one segment")
    low_noise: float = tuned(0.3, "1", "smallest factor on a stated sd")
    high_noise: float = tuned(3.0, "1", "largest factor on a stated sd")
    largest_change: float = tuned(0.7, "1", "of a logarithm, that is applied at a change of soil")


TRACKER: Final = TrackerTuning()


@dataclass(slots=True)
class TrackerState(SixState):
    """x in the order of filters.states. `distance` is all over which it has run, `window_s` since the last
    change of soil."""

    x: MotionVector = field(default_factory=lambda: np.zeros(N_STATES))
    instrument: MotionVector = field(default_factory=lambda: np.zeros(N_STATES))
    """x as it would be by steering alone, with the unknowns as they are estimated."""
    P_xx: Annotated[Array, Shape((N_STATES, N_STATES))] = field(
        default_factory=lambda: np.zeros((N_STATES, N_STATES))
    )
    P_xtheta: Annotated[Array, Shape((N_STATES, len(NAMES)))] = field(
        default_factory=lambda: np.zeros((N_STATES, len(NAMES)))
    )
    residual_ratio: Annotated[Array, Shape((SENSORS,))] = field(default_factory=lambda: np.ones(SENSORS))
    """Variances of yaw rates, velocities, positions and rolls over the stated ones, running means."""
    disturbance: Annotated[Array, Shape((4,))] = field(
        default_factory=lambda: np.square([*PRIOR.disturbance, PRIOR.uneven])
    )
    """Variances of the ground's pushes and of its unevenness."""
    segments_adapted: int = 0  # to which `disturbance` has been adapted
    running: bool = False  # x is the state at the start of the next segment
    segments_since_start: int = 0  # segments since the last restart of x
    pending: Record | None = None
    ticks_before: Annotated[Array, Shape((-1, len(INPUTS)))] = field(  # ticks before those that wait
        default_factory=lambda: np.zeros((0, len(INPUTS)))
    )
    steering: float = 0.0  # recent mean square of the wheel angle, rad^2
    held_at: float = 0.0  # rad, wheel angle at which the wheels came to be held
    held: int = 0  # segments for which they have been held there
    checkpoints: list[Checkpoint] = field(default_factory=list)
    segments_since_checkpoint: int = 0
    counts: Annotated[Array, Shape((3,))] = field(
        default_factory=lambda: np.zeros(3)
    )  # rows by USED, GATED, BAD
    tight_s: float = 0.0  # duration of tight turns in `window_s`
    hard: float = 0.0  # integral of the squared lateral acceleration over it, m^2/s^3
    excess: Annotated[Array, Shape((6,))] = field(default_factory=lambda: np.zeros(6))
    """Sds of the six from what is wrong with the model of the ground, as `pem` has found."""
    apart: Annotated[Array, Shape((6,))] = field(default_factory=lambda: np.zeros(6))
    """Sds of the six by which it differed, beyond chance, from the last fit of `pem`."""
    changed_ns: int = 0
    restarts: int = 0
    advisor: Advisor = field(default_factory=Advisor)
    considered: list[int] = field(default_factory=lambda: list(unknowns.MASSES))  # unknowns never learned
    needs_steering: list[int] = field(
        default_factory=lambda: list(NEED_STEERING)
    )  # unknowns learned only with steering
    by_steering: bool = True  # slopes are those of steering alone, after a first look
    map_mean: Annotated[Array, Shape((6,))] | None = None  # what the field's map says of where the rig is
    map_information: Annotated[Array, Shape((6, 6))] = field(default_factory=lambda: np.zeros((6, 6)))
    """That has come from the map, as a prior."""
    map_ns: int = 0  # when its last data were taken


_USUAL_DISTURBANCE: Final = np.log(np.square([*PRIOR.disturbance, PRIOR.uneven]))  # of the variances
_GROUNDS: Final = np.arange(4)  # first row of each in RowTally.sums; both bodies' unevenness has one sd

KERNELS: Final = (over_segment, run_ticks, first_covariance)  # that `take` calls


def initial(machine: Machine) -> TrackerState:
    """The state before any data, at the priors of the machine file.

    Masses are those of the file: stiffnesses are learned over them, and `reported_covariance` adds what is
    not known of them. When they were considered only, a file that tells the implement's mass to 50 % made
    C_ai 9 sds too small: small forces between the bodies seemed to tell the one from the other.
    """
    mean, sd = unknowns.prior(machine)
    covariance = with_known_masses(np.diag(sd**2))
    covariance[NOISE, NOISE] = 0.0
    return TrackerState(mean.copy(), covariance, mean, sd)


def prepare(machine: Machine) -> None:
    """Compile what `take` needs: run a segment of straight driving, and the advice after it."""
    ticks = np.tile([0.0, 4.0, *[0.0] * 6], (10, 1))
    rows = np.array([[k, 0.0, 0.0, k % 2, 0.0, 0.01] for k in range(10)], dtype=np.float64)
    state = initial(machine)
    _learn(state, machine, Record(0, ticks, rows), None)
    advice.renew(state.advisor, machine, state.mean, state.covariance, 4.0, 0, False)


def take(state: TrackerState, machine: Machine, pose: Pose, segment: Segment | None) -> Estimate | None:
    """Take one segment; an estimate each REPORTING.publish_ns."""
    state.last_pose_ns = pose.t_ns
    if segment is not None:
        take_segment(state, machine, segment)
    if not is_due(state, pose.t_ns, REPORTING.publish_ns):
        return None
    speed = abs(pose.tractor.forward_velocity or 0.0)
    advice.renew(state.advisor, machine, state.mean, state.covariance, speed, pose.t_ns, False)
    return estimate(state, machine, pose.t_ns)


def take_segment(state: TrackerState, machine: Machine, segment: Segment) -> None:
    """Store a segment and process the one before it."""
    state.reason = None
    if state.pending is not None:
        _learn(state, machine, state.pending, segment.record.ticks if segment.follows else None)
        state.ticks_before = np.concatenate([state.ticks_before, state.pending.ticks])[
            -2 * len(state.pending.ticks) :
        ]
        state.pending = None
    if not segment.follows:
        state.running = False
        state.ticks_before = np.zeros((0, 8))
    if segment.reason:
        _refuse(state, segment.reason)
    else:
        state.pending = segment.record


def _refuse(state: TrackerState, reason: Code) -> None:
    state.refused[reason] = state.refused.get(reason, 0) + 1
    state.reason = reason


def _learn(state: TrackerState, machine: Machine, record: Record, after: Array | None) -> None:
    """Run the filter over one segment. after: the ticks that follow it, shape (n, 8), if there are any."""
    if not np.isfinite(record.ticks).all():
        _refuse(state, Code.INPUTS_NOT_FINITE)
        state.running = False
        return
    setup = rig_setup(machine)
    sds = np.sqrt(state.disturbance)
    speed = max(float(np.abs(record.ticks[:, U]).mean()), DRIVING.under_way)
    ground = GroundNoise(sds[:3], TRACKER.disturbance_length / speed, float(sds[3]))
    if not state.running:
        _restart(state, record, setup, ground)
    learnable = _check_learnable(state, record)
    _keep_near(state)
    _drift(state, float(np.sum(np.abs(record.ticks[:, 1]))) * DT)
    first, count = len(state.ticks_before), len(record.ticks)
    ticks = np.concatenate([state.ticks_before, record.ticks, record.ticks[:0] if after is None else after])
    active = np.flatnonzero(np.diag(state.covariance) > 0.0)
    fixed = state.considered + ([] if learnable else state.needs_steering)
    considered = np.zeros(N_STATES + len(NAMES))
    considered[N_STATES + np.array(fixed, dtype=np.int64)] = 1.0
    considered = considered[np.concatenate([np.arange(N_STATES), N_STATES + active])]
    tally = RowTally(np.zeros(3), np.zeros((SENSORS + GROUND, 2)))
    prior_estimate = (state.mean.copy(), state.covariance.copy())
    by_map = bool(state.map_information.any())  # the tyres are roughly right from the beginning
    track_segment(
        SegmentArrays(ticks, first, count, np.ascontiguousarray(record.rows)),
        JointEstimate(state.x, state.mean, state.P_xx, state.P_xtheta, state.covariance, state.instrument),
        setup, active, considered, ground, tally,
        state.by_steering and (by_map or state.window_s >= TRACKER.initial_phase_s),
    )  # fmt: skip
    state.counts += tally.counts
    if not _is_sound(state):
        state.mean, state.covariance = prior_estimate
        state.running = False
        _refuse(state, Code.FILTER_OUT_OF_BOUNDS)
        return
    _adapt_noise(state, tally.sums)
    if tally.counts[GATED] + tally.counts[BAD] > tally.counts[USED]:
        state.running = False
        _refuse(state, Code.MOST_SAMPLES_REJECTED)
    if learnable:
        tight = is_tight(state, record)
        if tight:  # there errors of the model look like another soil
            state.checkpoints.clear()
        else:
            _detect_soil_change(state, machine)
        state.informed_ns = record.end_ns
        _count(state, record, tight)


def _restart(state: TrackerState, record: Record, setup: RigSetup, ground: GroundNoise) -> None:
    """Initialise x from the ticks, with its initial covariance and no correlation with the unknowns."""
    state.x = likelihood.first_state(record, setup)
    state.instrument = state.x.copy()
    state.P_xx = first_covariance(float(record.ticks[0, U]), ground, setup)
    state.P_xtheta = np.zeros((N_STATES, len(NAMES)))
    state.running, state.segments_since_start, state.steering = True, 0, 0.0
    state.restarts += 1


def _keep_near(state: TrackerState) -> None:
    """Begin `instrument` anew where it has run away from x: with some tyres, a rig turns round by itself."""
    off = state.instrument - state.x
    articulation = off[X_PSI] - off[X_PSI + 1]
    if (np.abs(off[:X_ROLL]) > TRACKER.far_off).any() or abs(articulation) > TRACKER.far_off[1]:
        state.instrument[:] = 0.0
        state.instrument[:X_DISTURBANCE] = state.x[:X_DISTURBANCE]


def _check_learnable(state: TrackerState, record: Record) -> bool:
    """Whether soil and tyres may be learned from a segment; a refusal is counted with its reason."""
    wheel = record.ticks[:, WHEEL_ANGLE] - state.mean[AT["wheel_zero"]]
    state.steering += (float(wheel @ wheel) / len(wheel) - state.steering) / TRACKER.steering_memory
    state.segments_since_start += 1
    _note_held(state, float(record.ticks[:, WHEEL_ANGLE].mean()))
    if state.segments_since_start <= TRACKER.settles:
        _refuse(state, Code.FILTER_SETTLING)
    elif exceeds(TRACKER.steering**2, state.steering):
        _refuse(state, Code.TOO_LITTLE_STEERING)
    elif state.held > TRACKER.longest_held and not state.by_steering:  # all that moves the rig is the ground
        _refuse(state, Code.HELD)
    return not state.reason


def _note_held(state: TrackerState, wheel: float) -> None:
    """wheel: mean reading of a segment, rad. After a restart of x the same circle goes on."""
    if exceeds(abs(wheel - state.held_at), TRACKER.held_within, MADE):
        state.held_at, state.held = wheel, 0
    state.held += 1


def _count(state: TrackerState, record: Record, tight: bool) -> None:
    """Count what was learned from. When the first look is over, it is where to begin, and tells no more."""
    seconds = len(record.ticks) * DT
    state.hard += seconds * fit_covariance.lateral_square(record)
    before, state.window_s = state.window_s, state.window_s + seconds
    state.tight_s += seconds if tight else 0.0
    if (
        state.by_steering
        and not state.map_information.any()
        and before < TRACKER.initial_phase_s <= state.window_s
    ):
        sds = np.maximum(np.sqrt(state.covariance.diagonal()[SIX]), TRACKER.initial_phase_sd)
        _decorrelate_six(state, sds)


def _decorrelate_six(state: TrackerState, sds: Array) -> None:
    """Give the six these sds, (6,), and no correlation with anything."""
    state.covariance[SIX, :] = state.covariance[:, SIX] = 0.0
    state.covariance[SIX, SIX] = np.diag(sds**2)
    state.P_xtheta[:, SIX] = 0.0
    state.checkpoints.clear()


def expect(state: TrackerState, there: At, told_ns: int) -> None:
    """What earlier runs tell of the soil where the rig is now, before the wheels learn it, told_ns: when.

    Once, before anything is learned today, it is the prior of the six in place of all that is known, where it
    is sure enough; then only how soil differs from place to place is followed, which is no information on
    what it is.
    """
    if state.map_mean is not None:
        moved = there.mean - state.map_mean
        state.mean[SIX] += moved
        for checkpoint in state.checkpoints:
            checkpoint.mean += moved
    elif not state.counts[USED] and np.diag(there.covariance)[:3].max() <= TRACKER.initial_phase_sd**2:
        prior_sd = state.prior_sd[SIX]
        state.mean[SIX] = state.prior_mean[SIX] + there.mean
        _decorrelate_six(state, prior_sd)
        state.covariance[SIX, SIX] = there.covariance
        state.map_information = advice.information_of(there.covariance, prior_sd)
        state.informed_ns, state.window_s, state.tight_s, state.hard = 0, 0.0, 0.0, 0.0
    state.map_mean, state.map_ns = there.mean, told_ns


def _articulation(record: Record) -> float:
    return float(np.abs(record.ticks[:, PSI] - record.ticks[:, PSI + 1]).max())


def is_tight(state: TrackerState, record: Record) -> bool:
    """Whether a segment is of a sharp turn: wheels or articulation beyond FIT_COVARIANCE.tight."""
    wheel = np.abs(record.ticks[:, WHEEL_ANGLE] - state.mean[AT["wheel_zero"]])
    return exceeds(max(float(wheel.max()), _articulation(record)), fit_covariance.FIT_COVARIANCE.tight)


def _is_sound(state: TrackerState) -> bool:
    values = (state.mean, state.covariance, state.x, state.P_xx, state.P_xtheta)
    # A sum of squares is finite where all are; of numbers of 1e150 nothing is lost.
    if not all(math.isfinite(float(np.vdot(value, value))) for value in values):
        return False
    plausible = (
        np.abs(state.mean[SIX] - state.prior_mean[SIX]) < REPORTING.largest_deviation * state.prior_sd[SIX]
    )
    variances = state.covariance.diagonal().min() >= 0.0 and state.P_xx.diagonal().min() > 0.0
    return bool(plausible.all() and variances)


def _drift(state: TrackerState, metres: float) -> None:
    """Propagate the six over distance: a drift whose stationary covariance is the prior's."""
    state.distance += metres
    share = retained_share(metres)
    drift(state.covariance, SIX, share, state.prior_sd)
    state.P_xtheta[:, SIX] *= share
    added = added_covariance(share, state.prior_sd[SIX])
    for checkpoint in state.checkpoints:
        checkpoint.covariance = share**2 * checkpoint.covariance + added


def _adapt_noise(state: TrackerState, sums: Array) -> None:
    """Adapt the noise of the sensors to the residuals, and that of the ground to the estimated pushes."""
    residuals = sums[:SENSORS]
    measured = residuals[:, 1] > 0.0
    state.residual_ratio[measured] += (
        residuals[measured, 0] / residuals[measured, 1] - state.residual_ratio[measured]
    ) / TRACKER.sensor_noise_memory
    stated = np.minimum(np.maximum(state.residual_ratio, TRACKER.low_noise**2), TRACKER.high_noise**2)
    state.mean[AT["s_yaw_rate"] : AT["s_roll"] + 1] = 0.5 * np.log(stated)
    seen, expected = np.add.reduceat(sums[SENSORS:], _GROUNDS, axis=0).T
    ratio = np.minimum(np.maximum(seen / np.maximum(expected, 1e-12), 0.0), TRACKER.largest_disturbance)
    state.segments_adapted += 1
    short = min(
        max(float(state.segments_adapted), TRACKER.initial_disturbances), TRACKER.disturbance_variance_memory
    )
    memory = np.where(ratio > 1.0, short, TRACKER.disturbance_variance_memory)
    # The observed variance of a weakly observable push grows with the square of its true one: hence the half.
    logs = np.log(state.disturbance) + 0.5 * (ratio - 1.0) / memory
    state.disturbance = np.exp(logs + (_USUAL_DISTURBANCE - logs) / TRACKER.disturbance_forgetting)


def _detect_soil_change(state: TrackerState, machine: Machine) -> None:
    """If the soil has changed since a checkpoint, reset what was learned of it; else add a checkpoint."""
    change = soil_change.likeliest_change(state.checkpoints, state.mean[SIX], state.covariance[SIX, SIX])
    if change is not None and exceeds(change.ratio, soil_change.limit(math.sqrt(state.disturbance[3]))):
        odds = _odds_of_load(state, machine, change.since)
        of_load = exceeds(odds, -SOIL_CHANGE.sure)
        if of_load:
            _load_changed(state, odds)
        if exceeds(SOIL_CHANGE.sure, odds):
            _forget_soil(state, change.logs, told=not of_load)
        return
    state.segments_since_checkpoint += 1
    if state.segments_since_checkpoint >= soil_change.SOIL_CHANGE.checkpoint_segments:
        state.segments_since_checkpoint = 0
        state.checkpoints.append(Checkpoint(state.mean[SIX].copy(), state.covariance[SIX, SIX].copy()))
        del state.checkpoints[: -soil_change.SOIL_CHANGE.most_checkpoints]


def _odds_of_load(state: TrackerState, machine: Machine, since: Checkpoint) -> float:
    """As soil_change.Odds; of an implement that carries nothing, that it is the soil."""
    if machine.implement.load is None:
        return -math.inf
    before, after = (since.mean, since.covariance), (state.mean[SIX], state.covariance[SIX, SIX])
    return soil_change.odds(before, after, by_another_load(machine), np.zeros((6, 6))).of_load


def _load_changed(state: TrackerState, odds: float) -> None:
    """The fold opens up what all methods have learned of the implement."""
    code = NoticeCode.LOAD_CHANGED if exceeds(odds, SOIL_CHANGE.sure) else NoticeCode.LOAD_OR_SOIL
    state.events.append((EventKind.LOAD, notice(code)))
    state.running = False
    state.checkpoints.clear()
    state.changed_ns = state.last_pose_ns


def _forget_soil(state: TrackerState, logs: Array, told: bool) -> None:
    """Reset the six to the prior's covariance, with means shifted by the change; nuisances stay. told: as an
    event."""
    state.mean[SIX] += np.clip(logs, -TRACKER.largest_change, TRACKER.largest_change)
    _decorrelate_six(state, state.prior_sd[SIX])
    state.running = False  # what the wrong soil has made of the motion would be learned as tyres
    state.changes += 1
    state.changed_ns = state.last_pose_ns
    state.apart = np.zeros(6)  # of the soil before
    state.window_s = state.tight_s = state.hard = 0.0
    state.map_information = np.zeros((6, 6))  # it is not what the map knows
    # That something has changed is known seconds before it is known what, and by how much.
    if told:
        state.events.append((EventKind.SOIL_CHANGE, notice(NoticeCode.SOIL_CHANGING)))


def stood(state: TrackerState) -> None:
    """As of estimators.Estimator: the segment that waits and the motion state are of before."""
    state.pending, state.running = None, False
    state.ticks_before = np.zeros((0, 8))


def clock_stepped(state: TrackerState, by_ns: int) -> None:
    """The log's clock stepped back: discard the motion state, keep the posterior and its age."""
    stood(state)
    step_clock(state, by_ns)
    state.last_pose_ns = 0
    state.changed_ns += by_ns if state.changed_ns else 0
    state.map_ns += by_ns if state.map_ns else 0


def learn(state: TrackerState, job: Any, made: Any) -> bool:
    """Take what a fit of `pem` has shown of the model of the ground, since this method has the same, and how
    far the two differ: `pem` uses all of each window at once, and is rarely lost. A change of soil is not
    foreseen here."""
    if isinstance(made, pem.Fit) and made.refused is None:
        state.excess, state.apart = made.contrast.excess, np.zeros(6)
        if state.changed_ns <= job.record.t_ns:
            by_chance = np.diag(reported_covariance(state) + made.covariance[SIX, SIX])
            state.apart = np.sqrt(np.maximum((state.mean - made.mean)[SIX] ** 2 - by_chance, 0.0))
    return False


def reported_covariance(state: TrackerState, of_map: bool = True) -> Array:
    """Reported covariance of the six logarithms, (6, 6): the information of the data over `sd_factor`
    squared, errors of the model, and what is not known of the masses. of_map: with what the map has told."""
    prior_sd = state.prior_sd[SIX]
    information = advice.information_of(state.covariance[SIX, SIX], prior_sd)
    if not state.map_information.any():
        information = information / TRACKER.sd_factor**2
    else:
        sizes, axes = np.linalg.eigh(information - state.map_information)
        information = (axes * np.maximum(sizes, 0.0)) @ axes.T / TRACKER.sd_factor**2
        information = information + state.map_information * of_map
    covariance = np.asarray(np.linalg.inv(information + np.diag(prior_sd**-2.0)), np.float64)
    tight = state.tight_s > fit_covariance.FIT_COVARIANCE.tight_share * state.window_s
    lateral = math.sqrt(state.hard / max(state.window_s, DT))
    room = fit_covariance.model_sd(
        tight,
        lateral,
        math.sqrt(state.disturbance[3]),
        state.mean[SIX],
        fit_covariance.FIT_COVARIANCE.tracked_tight_sd,
    )
    room = np.hypot(room, np.hypot(state.excess, state.apart))
    masses = of_masses(np.diag(state.prior_sd**2))[SIX, SIX]
    return np.asarray((covariance + covariance.T) / 2.0 + np.diag(room**2) + masses, np.float64)


def estimate(state: TrackerState, machine: Machine, t_ns: int) -> Estimate:
    """The estimate at t_ns."""
    return six_parameter_estimate(
        state, machine, t_ns, METHOD, reported_covariance(state), Code.NOTHING_LEARNED,
        _excitation(state, t_ns), state.advisor.advice,
        stale_reason(Code.NOT_LEARNED_FOR, age_s(state.informed_ns, t_ns)),
        reported_covariance(state, of_map=False) if state.map_information.any() else None,
    )  # fmt: skip


def _excitation(state: TrackerState, t_ns: int) -> dict[str, float]:
    disturbance_t, disturbance_i, disturbance_yaw, _ = np.sqrt(state.disturbance).tolist()
    excitation = {
        "distance_m": state.distance,
        "soil_changes": float(state.changes),
        "restarts": float(state.restarts),
        "rows": float(state.counts[USED]),
        "beyond_belief": float(state.counts[GATED]),
        "no_numbers": float(state.counts[BAD]),
        "steering_deg": math.degrees(math.sqrt(state.steering)),
        "push_t": disturbance_t,
        "push_i": disturbance_i,
        "push_yaw": disturbance_yaw,
    }
    if state.running:
        slope = math.asin(max(-1.0, min(1.0, float(state.x[X_BANK]) / GRAVITY)))
        leans = (float(state.x[X_ROLL]), float(state.x[X_ROLL + 1]), slope)
        excitation |= {name: math.degrees(angle) for name, angle in zip(LEANS, leans, strict=True)}
    if state.map_mean is not None:
        excitation["map_age_s"] = (t_ns - state.map_ns) * 1e-9
    if state.changed_ns:
        excitation[SINCE_CHANGE] = (t_ns - state.changed_ns) * 1e-9
    return excitation


assert NAMES[:6] == PARAMETERS
