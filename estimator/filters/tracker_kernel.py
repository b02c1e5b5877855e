"""Kernel of the tracker: an extended Kalman filter over one segment, whose state includes all unknowns.

The joint state is that of tracker_model.py. Measurements are processed one by one, each at its instant
between two ticks, and each is gated. An unknown that may not be learned is only considered (Schmidt-Kalman
filter): its uncertainty counts, but its value and variance stay.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.filters.measurement_model import (
    Observation,
    body_of,
    noise_factor,
    observation,
    predict_measurement,
)
from tilth.estimator.filters.predictor import wheel_angle_at
from tilth.estimator.filters.propagation import Plant, add_position_noise, plant_of, rig_at, roll_at
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.states import (
    DT,
    N_TRACKER,
    PAIR_DECAY,
    SLOPE_LENGTH,
    SLOPE_SD,
    UNEVEN_LENGTH,
    UNEVEN_SD,
    X_ALPHA,
    X_ASIDE,
    X_PAIR,
    X_POSITION,
    X_PSI,
    X_PUSH,
    X_R,
    X_SLOPE,
    X_UNEVEN,
    Places,
    Point,
)
from tilth.estimator.filters.tracker_model import (
    Active,
    DriveInputs,
    RateJacobians,
    Transition,
    complete_jacobian,
    geometry_jacobian,
    integrate_exponential,
    joint_jacobian,
    propagate_mean,
    rate_jacobians,
    state_rates,
)
from tilth.estimator.filters.unknowns import (
    AT_ASIDE,
    AT_CG,
    AT_CURVATURE,
    AT_LATENCY,
    AT_LEVER,
    AT_PAIR,
    AT_ROLL_MODES,
    AT_ROLLING,
    AT_WHEEL_GAIN,
    AT_WHEEL_ZERO,
)
from tilth.estimator.filters.unknowns import geometry as geometry_at
from tilth.estimator.record.record import (
    HEADING,
    NORTH,
    ROLL,
    ROLL_ANGLE,
    SD,
    TICK,
    VALUE,
    VELOCITY,
    YAW_RATE,
    U,
)
from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]

EVERY: Final = 5  # ticks for which one set of Jacobians is used
GATE: Final = 5.0  # sds of the innovation; a larger one is an outlier
USED, GATED, BAD = 0, 1, 2  # indices into RowTally.counts: updated, outlier, not a finite number


class SegmentArrays(NamedTuple):
    """A segment with its neighbours: the filter runs over ticks `first` to `first + size` and the rows in
    them."""

    ticks: Array  # [n, 8], as record.Record
    first: int
    size: int
    rows: Array  # [m, 6], as record.Record, whose ticks count from `first`


class JointEstimate(NamedTuple):
    """Mean and covariance of the joint state, prior before the run, posterior after it."""

    x: Array  # (16,)
    unknowns: Array  # (n,), in the order of unknowns.NAMES
    P_xx: Array  # (16, 16)
    P_xtheta: Array  # (16, n), of x with the unknowns
    P_theta: Array  # (n, n)


class ProcessNoise(NamedTuple):
    """Process noise that does not come from the machine file."""

    push: Array  # (3,), sds of the ground's pushes, m/s^2, m/s^2, rad/s^2
    push_memory_s: float  # their time constant
    aside: float  # m, sd of the slow lateral error of the implement's antennas


class RowTally(NamedTuple):
    """Counts and sums over the rows of a run; added to."""

    counts: Array  # (3,), rows by USED, GATED, BAD
    sums: Array  # (6, 2)
    """Rows 0 to 2, yaw rates, velocities, positions: sum of the squares of the residuals over the stated sds,
    and number. Rows 3 to 5, pushes: sum of the squares of their estimates, and of the expected values of
    these."""


class JointState(NamedTuple):
    """The joint state during a run."""

    x: Array  # (16,)
    following: Array  # (16,), x one tick later
    unknowns: Array  # (n,), in the order of unknowns.NAMES
    places: Places  # (a,), of the active ones among them
    considered: Array  # (16 + a,), 1.0 for what may not be learned
    P: Array  # (16 + a, 16 + a)


class UpdateWork(NamedTuple):
    """Work arrays of an update."""

    P_H: Array  # (16 + a,)
    gain: Array  # (16 + a,)
    gain_after: Array  # (16,), of the state one tick later


@kernel
def propagate_joint_covariance(P: Array, F: Array, F_T: Array, q: Array, psi: float, F_P: Array) -> None:
    """Propagate P (n, n), the joint covariance, over one tick, in place. q: (16,), process noise of x.

    The slow errors of antennas only decay and the unknowns are constant, so their part of F is diagonal.
    Loops add rows to rows, so that the compiler can use vector instructions. F_P: (16, n), work array.
    """
    n = P.shape[0]
    F_P[:X_PAIR] = 0.0
    for i in range(X_PAIR):
        for k in range(n):
            if F[i, k] != 0.0:
                for j in range(n):
                    F_P[i, j] += F[i, k] * P[k, j]
    for i in range(X_PAIR, N_TRACKER):
        for j in range(X_PAIR, n):
            decay = F[i, i] * (F[j, j] if j < N_TRACKER else 1.0)
            P[i, j] *= decay
            if j >= N_TRACKER:
                P[j, i] = P[i, j]
    for i in range(X_PAIR):
        for j in range(X_PAIR):
            P[i, j] = 0.0
        for k in range(n):
            if k < X_PAIR or F_T[k, 0] != 0.0 or F_T[k, 1] != 0.0:
                for j in range(X_PAIR):
                    P[i, j] += F_P[i, k] * F_T[k, j]
        for j in range(X_PAIR, n):
            P[i, j] = F_P[i, j] * (F[j, j] if j < N_TRACKER else 1.0)
            P[j, i] = P[i, j]
    for i in range(N_TRACKER):
        P[i, i] += q[i]
    add_position_noise(P, psi)


@kernel
def lever_arms(x: Array, obs: Observation, body: int) -> tuple[float, float, float]:
    """Derivatives of a receiver's measurement, per metre: by its position forward, by the distance of the
    hitch behind the tractor's CG, by its position to the right."""
    if obs.kind == VELOCITY:
        cosine = math.cos(x[X_PSI] - obs.psi_ref)
        return (x[X_R] * cosine, 0.0, 0.0) if body == 0 else (x[X_R + 1], -x[X_R] * cosine, 0.0)
    sine, cosine = math.sin(x[X_PSI + body]), math.cos(x[X_PSI + body])
    if obs.kind == NORTH:
        return cosine, 0.0 if body == 0 else -math.cos(x[X_PSI]), -sine
    return sine, 0.0 if body == 0 else -math.sin(x[X_PSI]), cosine


@kernel
def predict_joint_measurement(
    x: Array, obs: Observation, point: Point, active: Active, setup: RigSetup, h: Array
) -> float:
    """Predicted measurement at x, (16,); fills h, (16 + a,), with its Jacobian over the joint state."""
    value: float = predict_measurement(x, obs, point, setup, h)
    if obs.kind == ROLL_ANGLE:
        for j in range(active.places.shape[0]):
            if active.places[j] == AT_ROLL_MODES + 7 + obs.place:
                h[N_TRACKER + j] = 1.0
        return value
    if obs.kind == YAW_RATE or obs.kind == HEADING:
        return value
    body = body_of(obs.kind, obs.place)
    ahead, back, aside = lever_arms(x, obs, body)
    if body == 1:
        h[X_ASIDE] = aside
        value += aside * x[X_ASIDE]
    for j in range(active.places.shape[0]):
        place = active.places[j]
        if place == AT_LEVER + body:
            h[N_TRACKER + j] = ahead
        elif place == AT_CG and body == 0:
            h[N_TRACKER + j] = -ahead
        elif place == AT_PAIR + body:
            h[N_TRACKER + j] = h[X_PAIR + body]
        elif place == AT_ASIDE and body == 1:
            h[N_TRACKER + j] = aside
        elif body == 1 and place != AT_CG + 1:  # this one shifts hitch and receivers alike: no effect
            h[N_TRACKER + j] = back * active.geometry[j, 2] - ahead * active.geometry[j, 3]
    return value


@kernel
def update(error: float, variance: float, H: Array, state: JointState, F_T: Array, work: UpdateWork) -> float:
    """Schmidt-Kalman update of the joint state with one measurement; considered unknowns stay as they are.

    error: the innovation. variance: of the measurement's noise. H: (16 + a,), Jacobian over the joint state
    at the tick. Returns the variance of the innovation; negative if it is beyond GATE and nothing was
    updated.
    """
    P, considered, (P_H, gain, gain_after) = state.P, state.considered, work
    n = P.shape[0]
    P_H[:] = 0.0
    for k in range(n):
        if H[k] != 0.0:
            for i in range(n):
                P_H[i] += H[k] * P[k, i]
    for i in range(n):
        variance += H[i] * P_H[i]
    if error * error > GATE * GATE * variance:
        return -variance
    inverse = 1.0 / variance
    gain_after[:] = 0.0
    for i in range(n):
        gain[i] = P_H[i] * inverse
        if considered[i] == 0.0:
            for j in range(n):
                P[i, j] -= gain[i] * P_H[j]
            for j in range(N_TRACKER):
                gain_after[j] += gain[i] * F_T[i, j]
        else:  # considered: its variance stays, its covariance with updated states changes
            for j in range(n):
                P[i, j] -= (1.0 - considered[j]) * gain[i] * P_H[j]
            gain[i] = 0.0
    for i in range(N_TRACKER):
        state.x[i] += gain[i] * error
        state.following[i] += gain_after[i] * error
    for j in range(state.places.shape[0]):
        state.unknowns[state.places[j]] += gain[N_TRACKER + j] * error
    return variance


@kernel
def pack_covariance(estimate: JointEstimate, places: Places) -> Array:
    """The joint covariance of x and the active unknowns, shape (16 + a, 16 + a)."""
    P_xx, P_xtheta, P_theta = estimate.P_xx, estimate.P_xtheta, estimate.P_theta
    na = places.shape[0]
    P = np.zeros((N_TRACKER + na, N_TRACKER + na))
    P[:N_TRACKER, :N_TRACKER] = P_xx
    for j in range(na):
        for i in range(N_TRACKER):
            P[i, N_TRACKER + j] = P[N_TRACKER + j, i] = P_xtheta[i, places[j]]
        for i in range(na):
            P[N_TRACKER + i, N_TRACKER + j] = P_theta[places[i], places[j]]
    return P


@kernel
def unpack_covariance(P: Array, places: Places, estimate: JointEstimate) -> None:
    """The reverse of `pack_covariance`, made symmetric."""
    P_xx, P_xtheta, P_theta = estimate.P_xx, estimate.P_xtheta, estimate.P_theta
    na = places.shape[0]
    for i in range(N_TRACKER):
        for j in range(N_TRACKER):
            P_xx[i, j] = 0.5 * (P[i, j] + P[j, i])
        for j in range(na):
            P_xtheta[i, places[j]] = 0.5 * (P[i, N_TRACKER + j] + P[N_TRACKER + j, i])
    for i in range(na):
        for j in range(na):
            P_theta[places[i], places[j]] = 0.5 * (
                P[N_TRACKER + i, N_TRACKER + j] + P[N_TRACKER + j, N_TRACKER + i]
            )


@kernel
def drive_at(ticks: Array, k: int, unknowns: Array) -> DriveInputs:
    """Inputs of the rig in the middle of tick k. unknowns: (n,)."""
    k = min(k, ticks.shape[0] - 1)
    nxt = min(k + 1, ticks.shape[0] - 1)
    scale = math.exp(-unknowns[AT_WHEEL_GAIN])
    early, late = (
        wheel_angle_at(ticks, k, unknowns[AT_LATENCY]),
        wheel_angle_at(ticks, nxt, unknowns[AT_LATENCY]),
    )
    wheel = (0.5 * (early + late) - unknowns[AT_WHEEL_ZERO]) * scale
    gravity_t = GRAVITY * math.sin(0.5 * (ticks[k, ROLL] + ticks[nxt, ROLL]))
    gravity_i = GRAVITY * math.sin(0.5 * (ticks[k, ROLL + 1] + ticks[nxt, ROLL + 1]))
    u = 0.5 * (ticks[k, U] + ticks[nxt, U])
    return DriveInputs(u, wheel, (late - early) / DT * scale, gravity_t, gravity_i, scale)


@kernel
def empty_transition(n: int, sds: Array, noise: ProcessNoise, q: Array) -> Transition:
    """A Transition for a joint state of n, without its Jacobians. Fills q (16,), the process noise of a
    tick."""
    decay = np.ones(N_TRACKER - X_PUSH)
    for i in range(3):
        push, pair = i, X_PAIR - X_PUSH + i
        decay[push], decay[pair] = math.exp(-DT / noise.push_memory_s), PAIR_DECAY
        q[X_PUSH + i] = (1.0 - decay[push] ** 2) * noise.push[i] ** 2
        if i < 2:
            decay[3 + i] = math.exp(-DT * 4.5 / SLOPE_LENGTH)
            q[X_SLOPE + i] = (1.0 - decay[3 + i] ** 2) * SLOPE_SD**2
            decay[5 + i] = math.exp(-DT * 4.5 / UNEVEN_LENGTH)
            q[X_UNEVEN + i] = (1.0 - decay[5 + i] ** 2) * UNEVEN_SD**2
        q[X_PAIR + i] = (1.0 - PAIR_DECAY**2) * (sds[1 + i] if i < 2 else noise.aside) ** 2
    return Transition(
        np.zeros((X_PUSH, X_PUSH)),
        decay,
        np.zeros(X_PUSH),
        np.zeros((N_TRACKER, n)),
        np.zeros((n, N_TRACKER)),
    )


@kernel
def track_segment(
    segment: SegmentArrays, estimate: JointEstimate, setup: RigSetup, places: Places, considered: Array,
    noise: ProcessNoise, tally: RowTally,
) -> None:  # fmt: skip
    """Run the filter over a segment: updates the estimate and adds to the tally.

    places: (a,), indices of the active ones of unknowns.NAMES. considered: (16 + a,), 1.0 for what may not be
    learned.
    """
    ticks, first, length, rows = segment
    x, unknowns, counts, sums = estimate.x, estimate.unknowns, tally.counts, tally.sums
    na = places.shape[0]
    P = pack_covariance(estimate, places)
    n = P.shape[0]
    active = Active(places, np.zeros((na, 9)))
    point = Point(unknowns, np.zeros(6), geometry_at(setup.geometry, unknowns))
    theta = point.theta
    plant = plant_of(
        theta,
        rig_at(setup.rig, point.geometry, unknowns[AT_ROLLING], unknowns[AT_CURVATURE]),
        roll_at(setup.roll, unknowns),
    )
    geometry_jacobian(setup.geometry, unknowns, point.geometry, active)
    jacobians = RateJacobians(
        np.zeros((X_PUSH, X_POSITION)),
        np.zeros(X_PUSH),
        np.zeros((X_PUSH, na)),
        np.zeros(X_PUSH),
        np.zeros(X_PUSH),
    )
    q = np.zeros(N_TRACKER)
    step = empty_transition(n, setup.sds, noise, q)
    state = JointState(x, np.zeros(N_TRACKER), unknowns, places, considered, P)
    following, x_at, rates = state.following, np.zeros(N_TRACKER), np.zeros(X_PUSH)
    h, H, F_P = np.zeros(n), np.zeros(n), np.zeros((N_TRACKER, n))
    work = UpdateWork(np.zeros(n), np.zeros(n), np.zeros(N_TRACKER))
    row, m = 0, rows.shape[0]
    for k in range(first, first + length):
        for i in range(6):
            theta[i] = math.exp(unknowns[i])
        if (k - first) % EVERY == 0:
            point = Point(unknowns, theta, geometry_at(setup.geometry, unknowns))
            here = rig_at(setup.rig, point.geometry, unknowns[AT_ROLLING], unknowns[AT_CURVATURE])
            modes = roll_at(setup.roll, unknowns)
            plant = Plant(theta, here, plant.x, plant.w, plant.forces, plant.rates, modes, plant.work)
            state_rates(x, drive_at(ticks, k, unknowns), plant, rates)
            x_at[:] = x
            for i in range(X_PUSH):  # linearise about x in the middle of these ticks, roughly
                x_at[i] += 0.5 * EVERY * DT * rates[i]
            middle = drive_at(ticks, k + EVERY // 2, unknowns)
            rate_jacobians(x_at, middle, point, plant, setup, active, jacobians)
            integrate_exponential(jacobians.x, step.held)
            joint_jacobian(jacobians, active, step)
        drive = drive_at(ticks, k, unknowns)
        state_rates(x, drive, plant, rates)
        propagate_mean(x, drive.u, rates, step, following)
        complete_jacobian(x, following, drive, active, step)
        while row < m and rows[row, TICK] <= k - first:
            obs = observation(ticks, rows[row], k, drive.u)
            for i in range(N_TRACKER):
                x_at[i] = x[i] + obs.share * (following[i] - x[i])
            error = rows[row, VALUE] - predict_joint_measurement(x_at, obs, point, active, setup, h)
            noise_variance = (rows[row, SD] * noise_factor(obs.kind, unknowns)) ** 2
            row += 1
            if not (math.isfinite(error) and math.isfinite(noise_variance)):
                counts[BAD] += 1.0
                continue
            for j in range(n):
                H[j] = (1.0 - obs.share) * h[j] if j < N_TRACKER else h[j]
            for i in range(N_TRACKER):
                if h[i] != 0.0:
                    for j in range(n):
                        H[j] += obs.share * h[i] * step.F[i, j]
            variance = update(error, noise_variance, H, state, step.F_T, work)
            if variance < 0.0:
                counts[GATED] += 1.0
                continue
            counts[USED] += 1.0
            if obs.kind == ROLL_ANGLE:
                continue
            group = 0 if obs.kind == YAW_RATE else (1 if obs.kind == VELOCITY else 2)
            remaining = noise_variance / variance
            residual = remaining * remaining * error * error + (1.0 - remaining) * noise_variance
            sums[group, 0] += residual / rows[row - 1, SD] ** 2
            sums[group, 1] += 1.0
        q[X_ALPHA] = (drive.u / theta[3] * setup.sds[0] * DT) ** 2
        for i in range(3):
            sums[3 + i, 0] += x[X_PUSH + i] ** 2
            sums[3 + i, 1] += noise.push[i] ** 2 - P[X_PUSH + i, X_PUSH + i]
        propagate_joint_covariance(P, step.F, step.F_T, q, x[X_PSI], F_P)
        x[:] = following
    unpack_covariance(P, places, estimate)
