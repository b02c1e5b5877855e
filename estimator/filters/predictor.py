"""One-step prediction errors of a record at given unknowns: the likelihood that pem maximises.

It is a Kalman filter over the states of states.py; propagation.py propagates them. Between two ticks the
state is taken as linear in time. Measurements are scalar and are processed one by one, so the log-likelihood
is log L = -1/2 sum (e^2 / S + log S), with innovation e and its variance S.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.filters.measurement_model import noise_factor, observation, predict_measurement
from tilth.estimator.filters.propagation import (
    RelaxationModel,
    discretise,
    nonlinear_correction,
    plant_of,
    propagate_change,
    propagate_covariance,
    propagate_state,
    rig_at,
    roll_at,
    transition_jacobian,
)
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.states import (
    DT,
    N_PUSH,
    N_STATES,
    PAIR_DECAY,
    SLOPE_LENGTH,
    SLOPE_SD,
    START,
    START_PLACE,
    UNEVEN_LENGTH,
    UNEVEN_SD,
    X_PAIR,
    X_POSITION,
    X_PSI,
    X_PUSH,
    Point,
)
from tilth.estimator.filters.unknowns import (
    AT_CURVATURE,
    AT_LATENCY,
    AT_MEMORY,
    AT_PUSH,
    AT_ROLLING,
    AT_UNEVEN,
    AT_WHEEL_GAIN,
    AT_WHEEL_ZERO,
)
from tilth.estimator.record.record import SD, TICK, WHEEL_ANGLE, U

Array = NDArray[np.float64]

SAME_SPEED: Final = 0.03  # m/s: speeds within this use one transition matrix

COMPUTE_GAINS, STORE_GAINS, REUSE_GAINS = 0, 1, 2
"""How a filter run gets its gains: it computes them; computes and stores them; uses the stored ones."""


class Measured(NamedTuple):
    """The data of a filter run."""

    ticks: Array  # [n, 8], as record.Record
    rows: Array  # [m, 6], as record.Record; the values in it are not used
    readings: Array  # (m,), the values; in `innovations` (q, m), one set for each point
    used: Array  # (m,), 0.0 for a row that is left out


class Innovations(NamedTuple):
    """Result of a filter run, (m,), or of runs at q points, (q, m)."""

    e: Array  # innovations (prediction errors)
    S: Array  # their variances


@kernel
def wheel_angle_at(ticks: Array, k: int, behind: float) -> float:
    """The wheel's reading `behind` seconds before tick k (linear between ticks, held at the ends)."""
    n = ticks.shape[0]
    at = k - behind / DT
    if at <= 0.0:
        return float(ticks[0, WHEEL_ANGLE])
    if at >= n - 1:
        return float(ticks[n - 1, WHEEL_ANGLE])
    low = int(at)
    share = at - low
    return float(ticks[low, WHEEL_ANGLE] * (1.0 - share) + ticks[low + 1, WHEEL_ANGLE] * share)


@kernel
def run_filter(
    measured: Measured, x: Array, point: Point, setup: RigSetup, mode: int, gains: Array, out: Innovations
) -> None:
    """Fill out, (m,): innovation and its variance of each row, at one point of the unknowns.

    x: (15,), the first state, overwritten with the last. mode: COMPUTE_GAINS, STORE_GAINS or REUSE_GAINS.
    gains: (m, 30), Kalman gains of the state at the tick and of the state one tick later.
    """
    ticks, rows, readings, used = measured
    e, S = out
    n = ticks.shape[0]
    model = RelaxationModel(
        np.zeros((X_PUSH, X_PUSH)),
        np.zeros((X_PUSH, 5)),
        np.zeros((X_PUSH, X_PUSH)),
        np.zeros((X_PUSH, 5)),
        np.zeros((X_PUSH, N_PUSH)),
    )
    shape = (N_STATES, N_STATES)
    F, F_T, P, F_P = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape)
    following, x_at = np.zeros(N_STATES), np.zeros(N_STATES)
    inputs, correction = np.zeros(3), np.zeros(X_PSI)
    h, H = (
        np.zeros(N_STATES),
        np.zeros(N_STATES),
    )  # slope over the state at the instant, over that at the tick
    P_H, gain, gain_after = np.zeros(N_STATES), np.zeros(N_STATES), np.zeros(N_STATES)
    q = np.zeros(10)
    for i in range(X_PUSH):
        P[i, i] = START[i] * START[i]
    push_decay = np.full(N_PUSH, math.exp(-DT / math.exp(point.unknowns[AT_MEMORY])))
    push_decay[3:5] = math.exp(-DT * max(ticks[0, U], 1.0) / SLOPE_LENGTH)
    push_decay[5:] = math.exp(-DT * max(ticks[0, U], 1.0) / UNEVEN_LENGTH)
    for i in range(3):
        variance = math.exp(2.0 * point.unknowns[AT_PUSH + i])
        P[X_PUSH + i, X_PUSH + i] = variance
        q[1 + i] = (1.0 - push_decay[i] * push_decay[i]) * variance
    for i in range(3, N_PUSH):
        variance = SLOPE_SD**2 if i < 5 else UNEVEN_SD**2 * math.exp(2.0 * point.unknowns[AT_UNEVEN])
        P[X_PUSH + i, X_PUSH + i] = variance
        q[1 + i] = (1.0 - push_decay[i] * push_decay[i]) * variance
    for i in range(2):
        pair_sd = setup.sds[1 + i]
        P[X_POSITION + i, X_POSITION + i] = START_PLACE * START_PLACE
        P[X_PAIR + i, X_PAIR + i] = pair_sd * pair_sd
        q[8 + i] = (1.0 - PAIR_DECAY * PAIR_DECAY) * pair_sd * pair_sd
    rolling, curvature = point.unknowns[AT_ROLLING], point.unknowns[AT_CURVATURE]
    plant = plant_of(
        point.theta,
        rig_at(setup.rig, point.geometry, rolling, curvature),
        roll_at(setup.roll, point.unknowns),
    )
    latency, zero = point.unknowns[AT_LATENCY], point.unknowns[AT_WHEEL_ZERO]
    scale = math.exp(-point.unknowns[AT_WHEEL_GAIN])
    model_u = -1e9
    m, row = rows.shape[0], 0
    for k in range(n):
        last = k == n - 1
        nxt = k if last else k + 1
        u = 0.5 * (ticks[k, U] + ticks[nxt, U])
        if abs(u - model_u) > SAME_SPEED:
            discretise(u, point, setup.rig, model, plant)
            model_u = u
            q[0] = (u / point.theta[3] * setup.sds[0] * DT) ** 2
        reading = 0.5 * (wheel_angle_at(ticks, k, latency) + wheel_angle_at(ticks, nxt, latency))
        inputs[0] = (reading - zero) * scale
        propagate_state(x, u, inputs, model, correction, push_decay, following)
        if setup.planar and k % 2 == 0:
            nonlinear_correction(following, u, inputs, model, plant, correction)
            propagate_state(x, u, inputs, model, correction, push_decay, following)
        if mode != REUSE_GAINS:
            transition_jacobian(x, u, model, push_decay, F, F_T)
        while row < m and rows[row, TICK] <= k:
            if used[row] == 0.0:
                e[row], S[row] = 0.0, 1.0
                row += 1
                continue
            obs = observation(ticks, rows[row], k, u)
            share = obs.share
            for j in range(N_STATES):
                x_at[j] = x[j] + share * (following[j] - x[j])
            error = readings[row] - predict_measurement(x_at, obs, point, setup, h)
            if mode != REUSE_GAINS:
                for j in range(N_STATES):
                    H[j] = (1.0 - share) * h[j]
                for i in range(N_STATES):
                    if h[i] != 0.0:
                        for j in range(N_STATES):
                            H[j] += share * h[i] * F[i, j]
                P_H[:] = 0.0
                for j in range(N_STATES):
                    part = H[j]
                    if part != 0.0:
                        for i in range(N_STATES):
                            P_H[i] += part * P[j, i]
                variance = (rows[row, SD] * noise_factor(obs.kind, point.unknowns)) ** 2
                for i in range(N_STATES):
                    variance += H[i] * P_H[i]
                for i in range(N_STATES):
                    gain[i] = P_H[i] / variance
                    part = gain[i]
                    for j in range(N_STATES):
                        P[i, j] -= part * P_H[j]
                propagate_change(gain, F_T, gain_after)
                S[row] = variance
                if mode == STORE_GAINS:
                    gains[row, :N_STATES] = gain
                    gains[row, N_STATES:] = gain_after
            else:
                gain = gains[row, :N_STATES]
                gain_after = gains[row, N_STATES:]
            for i in range(N_STATES):
                x[i] += gain[i] * error
                following[i] += gain_after[i] * error
            e[row] = error
            row += 1
        if not last:
            if mode != REUSE_GAINS:
                propagate_covariance(P, F, F_T, q, x[X_PSI], F_P)
            x[:] = following
    while row < m:
        e[row], S[row] = 0.0, 1.0
        row += 1


@kernel
def innovations(
    measured: Measured, start: Array, points: Point, modes: Array, setup: RigSetup, out: Innovations
) -> None:
    """Fill out, (q, m), at each of the points, whose arrays are (q, n of unknowns.NAMES), (q, 6) and (q, 9).

    modes: (q,), COMPUTE_GAINS, STORE_GAINS or REUSE_GAINS as float. A run with REUSE_GAINS has the variances
    of the first point. If no gains were stored before it, they are zero: the open loop.
    """
    ticks, rows, readings, used = measured
    gains = np.zeros((rows.shape[0], 2 * N_STATES))
    for i in range(points.unknowns.shape[0]):
        x = start.copy()
        mode = int(modes[i])
        if mode == REUSE_GAINS:
            out.S[i] = out.S[0]
        point = Point(points.unknowns[i], points.theta[i], points.geometry[i])
        measured_here = Measured(ticks, rows, readings[i], used)
        run_filter(measured_here, x, point, setup, mode, gains, Innovations(out.e[i], out.S[i]))
