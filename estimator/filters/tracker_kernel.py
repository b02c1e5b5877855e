"""Kernel of the tracker: an extended Kalman filter over one segment, whose state includes all unknowns.

Measurements are processed one by one, each at its instant between two ticks, and each is gated. An unknown
that may not be learned is only considered (Schmidt-Kalman filter): its uncertainty counts, but its value and
variance stay.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inline_kernel, inner_kernel
from tilth.estimator.filters.gates import GATES
from tilth.estimator.filters.joint_update import (
    JointState,
    UpdateWork,
    empty_work,
    propagate_covariances,
    update,
)
from tilth.estimator.filters.measurement_model import (
    NOISE_LEVELS,
    Expected,
    innovation,
    noise_factor,
    observation,
)
from tilth.estimator.filters.propagation import (
    EVERY,
    GroundNoise,
    Plant,
    empty_plant,
    jacobian_at_instrument,
    linearise,
    propagate,
    propagate_mean,
    set_bank,
    set_plant,
    set_processes,
    state_rates,
)
from tilth.estimator.filters.record_loop import over_ticks
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.sensors.wheel_angle import drive_at, set_wheel_noise
from tilth.estimator.filters.states import N_STATES, X_DISTURBANCE, X_UNEVEN, Places
from tilth.estimator.filters.transition import Transition, empty_transition
from tilth.estimator.filters.unknowns import AT_S_YAW_RATE, N_UNKNOWNS
from tilth.estimator.record.record import SD, VALUE

Array = NDArray[np.float64]

USED, GATED, BAD = 0, 1, 2  # indices into RowTally.counts: updated, outlier, not a finite number
SENSORS, GROUND = 4, 5  # rows of RowTally.sums: sensors, then what the ground does


class SegmentArrays(NamedTuple):
    """A segment with its neighbours: the filter runs over ticks `first` to `first + size` and the rows in
    them."""

    ticks: Array  # [n, 8], as record.Record
    first: int
    size: int
    rows: Array  # [m, 6], as record.Record, whose ticks count from `first`


class JointEstimate(NamedTuple):
    """Mean and covariance of the joint state, prior before the run, posterior after it."""

    x: Array  # (30,)
    unknowns: Array  # (n,), in the order of unknowns.NAMES
    P_xx: Array  # (30, 30)
    P_xtheta: Array  # (30, n), of x with the unknowns
    P_theta: Array  # (n, n)
    instrument: Array  # (30,), x as it would be by steering alone


class RowTally(NamedTuple):
    """Counts and sums over the rows of a run; added to."""

    counts: Array  # (3,), rows by USED, GATED, BAD
    sums: Array  # (9, 2)
    """Rows 0 to 3, by noise level (yaw rates, velocities, positions, rolls): sum of the squares of the
    residuals over the stated sds, and number. Rows 4 to 8, pushes and unevenness: sum of the squares of their
    estimates, and of the expected values of these."""


@inner_kernel
def pack_covariance(estimate: JointEstimate, places: Places, P: Array) -> None:
    """Fill the joint covariance of x and the active unknowns, (30 + a, 30 + a)."""
    for i in range(N_STATES):
        for j in range(N_STATES):
            P[i, j] = estimate.P_xx[i, j]
        for j in range(places.shape[0]):
            P[i, N_STATES + j] = P[N_STATES + j, i] = estimate.P_xtheta[i, places[j]]
    for i in range(places.shape[0]):
        for j in range(places.shape[0]):
            P[N_STATES + i, N_STATES + j] = estimate.P_theta[places[i], places[j]]


@inner_kernel
def unpack_covariance(P: Array, places: Places, estimate: JointEstimate) -> None:
    """The reverse of `pack_covariance`, made symmetric."""
    for i in range(N_STATES):
        for j in range(N_STATES):
            estimate.P_xx[i, j] = 0.5 * (P[i, j] + P[j, i])
        for j in range(places.shape[0]):
            estimate.P_xtheta[i, places[j]] = 0.5 * (P[i, N_STATES + j] + P[N_STATES + j, i])
    for i in range(places.shape[0]):
        for j in range(places.shape[0]):
            both = P[N_STATES + i, N_STATES + j] + P[N_STATES + j, N_STATES + i]
            estimate.P_theta[places[i], places[j]] = 0.5 * both


@inner_kernel
def add_residual(
    kind: int, error: float, noise_variance: float, variance: float, stated_sd: float, sums: Array
) -> None:
    """Add the square of what is left of an innovation after its update to the tally of its sensor."""
    remaining = noise_variance / variance
    residual = remaining * remaining * error * error + (1.0 - remaining) * noise_variance
    group = NOISE_LEVELS[kind] - AT_S_YAW_RATE
    sums[group, 0] += residual / (stated_sd * stated_sd)
    sums[group, 1] += 1.0


@inner_kernel
def add_ground(x: Array, P: Array, ground: GroundNoise, sums: Array) -> None:
    """Add what the ground does to its tally."""
    for i in range(GROUND):
        place = X_DISTURBANCE + i if i < 3 else X_UNEVEN + i - 3
        sd = ground.disturbance[i] if i < 3 else ground.uneven
        sums[SENSORS + i, 0] += x[place] ** 2
        sums[SENSORS + i, 1] += sd**2 - P[place, place]


class SegmentRun(NamedTuple):
    """What a run over a segment works with."""

    segment: SegmentArrays
    setup: RigSetup
    ground: GroundNoise
    tally: RowTally
    by_steering: bool
    estimate: JointEstimate
    state: JointState
    plant: Plant
    step: Transition
    work: UpdateWork
    at: Expected  # H is (30 + a,), over the joint state: H_unknowns is its last part
    error: Array  # (1,), innovation
    variance: Array  # (1,), of its noise, then of it


def segment_run(
    segment: SegmentArrays, estimate: JointEstimate, setup: RigSetup, places: Places, considered: Array,
    ground: GroundNoise, tally: RowTally, by_steering: bool,
) -> SegmentRun:  # fmt: skip
    """At the first tick. The arguments are those of `track_segment`."""
    x, unknowns, na = estimate.x, estimate.unknowns, places.shape[0]
    n = N_STATES + na
    P, H = np.zeros((1, n, n)), np.zeros(n)  # of one filter
    state = JointState(x, np.zeros(N_STATES), unknowns, places, considered, P)
    step, work = empty_transition(na, na, P.shape[0]), empty_work(P.shape[0], n)
    return SegmentRun(
        segment, setup, ground, tally, by_steering, estimate,
        state, empty_plant(setup, na), step, work,
        Expected(np.zeros(N_STATES), np.zeros(N_STATES + N_UNKNOWNS), H, H[N_STATES:]),
        np.zeros(1), np.zeros(1),
    )  # fmt: skip


@inline_kernel
def linearise_anew(k: int, u: float, on: SegmentRun) -> None:
    """At what is known by tick k, at speed u, m/s."""
    ticks, unknowns, plant, step = on.segment.ticks, on.state.unknowns, on.plant, on.step
    set_plant(plant, unknowns, on.setup, on.state.places)
    set_bank(u, on.setup, step)
    for c in range(on.state.P.shape[0]):
        set_processes(u, on.ground, on.setup, step, c)
    linearise(on.state.x, ticks, k, unknowns, plant, step)
    if on.by_steering:
        jacobian_at_instrument(on.estimate.instrument, ticks, k, unknowns, plant, step)


@inline_kernel
def begin_tick(k: int, on: SegmentRun) -> float:
    """Propagate the state, and what steering alone makes of it, to the next tick; the speed, m/s."""
    state, step, tick = on.state, on.step, on.segment.first + k
    drive = drive_at(on.segment.ticks, tick, state.unknowns)
    if k % EVERY == 0:
        linearise_anew(tick, drive.u, on)
    state_rates(on.estimate.instrument, drive, on.plant, step.rates)
    propagate_mean(on.estimate.instrument, drive.u, step, state.following)
    for i in range(N_STATES):
        on.estimate.instrument[i] = state.following[i]
    propagate(state.x, drive, state.unknowns, on.plant, state.places, step, state.following)
    return drive.u


@inline_kernel
def take_row(row: int, k: int, u: float, on: SegmentRun) -> None:
    """Update the state with a row of the segment, after its tick k at speed u, m/s; add to the tally."""
    state, counts, measured = on.state, on.tally.counts, on.segment.rows[row]
    tick = on.segment.first + k
    obs = observation(on.segment.ticks, measured, tick, u, state.x, state.following, state.unknowns)
    error = innovation(measured[VALUE], obs, state, state.places, on.setup, on.step, on.at)
    noise_variance = (measured[SD] * noise_factor(obs.kind, state.unknowns)) ** 2
    if not (math.isfinite(error) and math.isfinite(noise_variance)):
        counts[BAD] += 1.0
        return
    on.error[0], on.variance[0] = error, noise_variance
    if not update(on.error, on.variance, on.at.H, state, on.step, GATES[obs.kind], on.work):
        counts[GATED] += 1.0
        return
    counts[USED] += 1.0
    add_residual(obs.kind, on.error[0], noise_variance, on.variance[0], measured[SD], on.tally.sums)


@inline_kernel
def end_tick(u: float, on: SegmentRun) -> None:
    """Propagate all else."""
    state, step = on.state, on.step
    set_wheel_noise(u, state.unknowns, on.setup.sds, step)
    add_ground(state.x, state.P[0], on.ground, on.tally.sums)
    propagate_covariances(state, step)
    for i in range(N_STATES):
        state.x[i] = state.following[i]


track_ticks = over_ticks.with_steps(begin_tick=begin_tick, take_row=take_row, end_tick=end_tick)


@inner_kernel
def over_segment(on: SegmentRun) -> None:
    """From the estimate before a segment to the one after it."""
    places, P = on.state.places, on.state.P[0]
    pack_covariance(on.estimate, places, P)
    track_ticks(on.segment.size, on.segment.rows, on)
    unpack_covariance(P, places, on.estimate)


def track_segment(
    segment: SegmentArrays, estimate: JointEstimate, setup: RigSetup, places: Places, considered: Array,
    ground: GroundNoise, tally: RowTally, by_steering: bool,
) -> None:  # fmt: skip
    """Run the filter over a segment: updates the estimate and adds to the tally.

    places: (a,), indices of the active ones of unknowns.NAMES. considered: (30 + a,), 1.0 for what may not be
    learned. by_steering: whether slopes by the unknowns are those of `propagation.jacobian_at_instrument`.
    """
    over_segment(segment_run(segment, estimate, setup, places, considered, ground, tally, by_steering))
