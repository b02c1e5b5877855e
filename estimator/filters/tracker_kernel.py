"""Kernel of the tracker: an extended Kalman filter over one segment, whose state includes all unknowns.

Measurements are processed one by one, each at its instant between two ticks, and each is gated. An unknown
that may not be learned is only considered (Schmidt-Kalman filter): its uncertainty counts, but its value and
variance stay.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.filters.joint_update import JointState, between, empty_work, unknowns_between, update
from tilth.estimator.filters.measurement_model import (
    noise_factor,
    observation,
    predict_joint_measurement,
)
from tilth.estimator.filters.propagation import (
    EVERY,
    Active,
    GroundNoise,
    drive_at,
    empty_plant,
    linearise,
    propagate,
    propagate_mean,
    set_geometry_slopes,
    set_plant,
    set_processes,
    set_slopes,
    set_wheel_noise,
    slopes_of_steering,
    state_rates,
)
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.states import N_STATES, X_PSI, X_PUSH, X_UNEVEN, Places, Point
from tilth.estimator.filters.transition import empty_transition, propagate_covariance
from tilth.estimator.filters.unknowns import geometry as geometry_at
from tilth.estimator.record.record import ROLL_ANGLE, SD, TICK, VALUE, VELOCITY, YAW_RATE

Array = NDArray[np.float64]

GATE: Final = 5.0  # sds of the innovation; a larger one is an outlier
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
    steered: Array  # (30,), x as it would be by steering alone


class RowTally(NamedTuple):
    """Counts and sums over the rows of a run; added to."""

    counts: Array  # (3,), rows by USED, GATED, BAD
    sums: Array  # (9, 2)
    """Rows 0 to 3, yaw rates, velocities, positions, rolls: sum of the squares of the residuals over the
    stated sds, and number. Rows 4 to 8, pushes and unevenness: sum of the squares of their estimates, and of
    the expected values of these."""


@kernel
def pack_covariance(estimate: JointEstimate, places: Places) -> Array:
    """The joint covariance of x and the active unknowns, shape (1, 30 + a, 30 + a): of one filter."""
    P_xx, P_xtheta, P_theta = estimate.P_xx, estimate.P_xtheta, estimate.P_theta
    na = places.shape[0]
    P = np.zeros((N_STATES + na, N_STATES + na))
    P[:N_STATES, :N_STATES] = P_xx
    for j in range(na):
        for i in range(N_STATES):
            P[i, N_STATES + j] = P[N_STATES + j, i] = P_xtheta[i, places[j]]
        for i in range(na):
            P[N_STATES + i, N_STATES + j] = P_theta[places[i], places[j]]
    return P.reshape(1, N_STATES + na, N_STATES + na)


@kernel
def unpack_covariance(P: Array, places: Places, estimate: JointEstimate) -> None:
    """The reverse of `pack_covariance`, made symmetric."""
    P_xx, P_xtheta, P_theta = estimate.P_xx, estimate.P_xtheta, estimate.P_theta
    na = places.shape[0]
    for i in range(N_STATES):
        for j in range(N_STATES):
            P_xx[i, j] = 0.5 * (P[i, j] + P[j, i])
        for j in range(na):
            P_xtheta[i, places[j]] = 0.5 * (P[i, N_STATES + j] + P[N_STATES + j, i])
    for i in range(na):
        for j in range(na):
            P_theta[places[i], places[j]] = 0.5 * (
                P[N_STATES + i, N_STATES + j] + P[N_STATES + j, N_STATES + i]
            )


@kernel
def add_residual(
    kind: int, error: float, noise_variance: float, variance: float, stated_sd: float, sums: Array
) -> None:
    """Add the square of what is left of an innovation after its update to the tally of its sensor."""
    remaining = noise_variance / variance
    residual = remaining * remaining * error * error + (1.0 - remaining) * noise_variance
    group = 2
    if kind == YAW_RATE:
        group = 0
    elif kind == VELOCITY:
        group = 1
    elif kind == ROLL_ANGLE:
        group = 3
    sums[group, 0] += residual / (stated_sd * stated_sd)
    sums[group, 1] += 1.0


@kernel
def add_ground(x: Array, P: Array, ground: GroundNoise, sums: Array) -> None:
    """Add what the ground does to its tally."""
    for i in range(GROUND):
        place = X_PUSH + i if i < 3 else X_UNEVEN + i - 3
        sd = ground.push[i] if i < 3 else ground.uneven
        sums[SENSORS + i, 0] += x[place] ** 2
        sums[SENSORS + i, 1] += sd**2 - P[place, place]


@kernel
def track_segment(
    segment: SegmentArrays, estimate: JointEstimate, setup: RigSetup, places: Places, considered: Array,
    ground: GroundNoise, tally: RowTally, by_steering: bool,
) -> None:  # fmt: skip
    """Run the filter over a segment: updates the estimate and adds to the tally.

    places: (a,), indices of the active ones of unknowns.NAMES. considered: (30 + a,), 1.0 for what may not be
    learned. by_steering: whether slopes by the unknowns are those of `propagation.slopes_of_steering`.
    """
    ticks, first, length, rows = segment
    x, unknowns, steered, counts = estimate.x, estimate.unknowns, estimate.steered, tally.counts
    na = places.shape[0]
    P, n = pack_covariance(estimate, places), N_STATES + na
    active, step = Active(places, np.zeros((na, 9))), empty_transition(na, na, 1)
    point = Point(unknowns, np.zeros(6), geometry_at(setup.geometry, unknowns))
    plant = empty_plant(setup, na)
    set_geometry_slopes(point, active)
    state = JointState(x, np.zeros(N_STATES), unknowns, places, considered, P)
    following, x_at = state.following, np.zeros(N_STATES)
    h, H, work = np.zeros(n), np.zeros(n), empty_work(1, n)
    error, variance, row, m = np.zeros(1), np.zeros(1), 0, rows.shape[0]
    for k in range(first, first + length):
        for i in range(6):
            point.theta[i] = math.exp(unknowns[i])
        drive = drive_at(ticks, k, unknowns)
        if (k - first) % EVERY == 0:
            point = Point(unknowns, point.theta, geometry_at(setup.geometry, unknowns))
            set_plant(plant, point, setup, active)
            set_slopes(drive.u, setup, step)
            set_processes(drive.u, ground, setup, step, 0)
            linearise(x, ticks, k, point, plant, active, step)
            if by_steering:
                slopes_of_steering(steered, ticks, k, point, plant, active, step)
        state_rates(steered, drive, plant, step.rates)
        propagate_mean(steered, drive.u, step, following)
        steered[:] = following
        propagate(x, drive, plant, active, step, following)
        while row < m and rows[row, TICK] <= k - first:
            obs = observation(ticks, rows[row], k, drive.u)
            for i in range(N_STATES):
                x_at[i] = x[i] + obs.share * (following[i] - x[i])
            error[0] = rows[row, VALUE] - predict_joint_measurement(x_at, obs, point, active, setup, h)
            noise_variance = (rows[row, SD] * noise_factor(obs.kind, unknowns)) ** 2
            variance[0] = noise_variance
            row += 1
            if not (math.isfinite(error[0]) and math.isfinite(noise_variance)):
                counts[BAD] += 1.0
                continue
            between(obs.share, h, step, H)
            unknowns_between(obs.share, h, step, H[N_STATES:])
            if not update(error, variance, H, state, step, GATE, work):
                counts[GATED] += 1.0
                continue
            counts[USED] += 1.0
            add_residual(obs.kind, error[0], noise_variance, variance[0], rows[row - 1, SD], tally.sums)
        set_wheel_noise(drive.u, point.theta[3], setup.sds, step)
        add_ground(x, P[0], ground, tally.sums)
        propagate_covariance(P[0], 0, step, x[X_PSI])
        x[:] = following
    unpack_covariance(P[0], places, estimate)
