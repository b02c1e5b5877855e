"""One-step prediction errors of a record at given unknowns, and their derivatives: the likelihood that pem
maximises.

It is a Kalman filter over the states of states.py; propagation.py propagates them. Between two ticks the
state is taken as linear in time. Measurements are scalar and are processed one by one, so the log-likelihood
is log L = -1/2 sum (e^2 / S + log S), with innovation e and its variance S. The derivatives of e over the
unknowns, with the gains held, are propagated beside the state by the same Jacobians, and so are companions
with other noise levels (companions.py).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.filters.companions import (
    UNLIMITED,
    advance,
    companion,
    set_noise,
    take,
)
from tilth.estimator.filters.joint_update import JointState, UpdateWork, between, update
from tilth.estimator.filters.measurement_model import (
    noise_factor,
    observation,
    predict_joint_measurement,
)
from tilth.estimator.filters.propagation import (
    EVERY,
    Active,
    drive_at,
    empty_plant,
    empty_transition,
    first_covariance,
    ground_at,
    linearise,
    propagate,
    propagate_covariance,
    set_geometry_slopes,
    set_plant,
    set_processes,
    set_wheel_noise,
)
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.states import N_STATES, X_PSI, Places, Point
from tilth.estimator.record.record import SD, TICK, U

Array = NDArray[np.float64]


class Measured(NamedTuple):
    """The data of a filter run."""

    ticks: Array  # [n, 8], as record.Record
    rows: Array  # [m, 6], as record.Record; the values in it are not used
    readings: Array  # (m,), the values
    used: Array  # (m,), 0.0 for a row that is left out
    closed: bool  # whether measurements update the state; False: the open loop


class Innovations(NamedTuple):
    """Result of a filter run."""

    e: Array  # (m,), innovations (prediction errors)
    S: Array  # (m,), their variances
    de: Array  # (m, a), derivatives of e over the active unknowns, with the gains held
    e_nearby: Array  # (m, q), innovations with other noise levels
    S_nearby: Array  # (m, q), their variances


class Carried(NamedTuple):
    """Derivatives of the state over the active unknowns, (27, a), with the gains held."""

    D: Array  # at the tick
    following: Array  # one tick later


@kernel
def row_slopes(h: Array, share: float, carried: Carried, own: Array, sign: float, d: Array) -> None:
    """Fill d (a,), derivatives of an innovation. h: (27 + a,), of its prediction; own: (a,), of what else
    changes with the unknowns, times sign; share: of the tick."""
    for j in range(d.shape[0]):
        d[j] = sign * own[j]
    for i in range(N_STATES):
        if h[i] != 0.0:
            for j in range(d.shape[0]):
                now = carried.D[i, j]
                d[j] -= h[i] * (now + share * (carried.following[i, j] - now))


@kernel
def carry_update(work: UpdateWork, error: float, d: Array, carried: Carried, moved: Array) -> None:
    """Add a measurement's part to the derivatives; fill moved (2, 27), the changes of the state."""
    for i in range(N_STATES):
        moved[0, i], moved[1, i] = work.gain[i] * error, work.gain_after[i] * error
        for j in range(d.shape[0]):
            carried.D[i, j] += work.gain[i] * d[j]
            carried.following[i, j] += work.gain_after[i] * d[j]


@kernel
def run_filter(
    measured: Measured, x: Array, point: Point, setup: RigSetup, places: Places, driven: Array,
    nearby: Array, out: Innovations,
) -> None:  # fmt: skip
    """Fill out: innovation, its variance and its derivatives, of each row, at one point of the unknowns.

    x: (27,), the first state, overwritten with the last. places: (a,), the unknowns to differentiate by.
    driven: (m, a), changes of the readings, whose response of the innovations is then `de`; or (0, 0).
    nearby: (q, n), points that differ in noise levels, which are tried beside; or (0, n).
    """
    ticks, rows, readings, used, closed = measured
    na, nothing = places.shape[0], places[:0]
    response = driven.shape[0] > 0
    active, step = Active(places, np.zeros((na, 9))), empty_transition(na, 0)
    ground, plant = ground_at(point.unknowns), empty_plant(setup, na)
    set_geometry_slopes(point, active)
    set_plant(plant, point, setup, active)
    P = first_covariance(ticks[0, U], ground, setup)
    state = JointState(x, np.zeros(N_STATES), point.unknowns, nothing, np.zeros(N_STATES), P)
    companions = [companion(point.unknowns, ticks[0, U], setup, nothing, step)]
    companions.clear()  # numba has its type now
    for q in range(nearby.shape[0]):
        companions.append(companion(nearby[q], ticks[0, U], setup, nothing, step))
    following, x_at = state.following, np.zeros(N_STATES)
    carried = Carried(np.zeros((N_STATES, na)), np.zeros((N_STATES, na)))
    h, H, d = np.zeros(N_STATES + na), np.zeros(N_STATES), np.zeros(na)
    work = UpdateWork(np.zeros(N_STATES), np.zeros(N_STATES), np.zeros(N_STATES))
    moved = np.zeros((2, N_STATES))
    n, m, row = ticks.shape[0], rows.shape[0], 0
    out.e[:], out.S[:], out.de[:], out.e_nearby[:], out.S_nearby[:] = 0.0, 1.0, 0.0, 0.0, 1.0
    for k in range(n):
        drive = drive_at(ticks, k, point.unknowns)
        if k % EVERY == 0:
            set_processes(drive.u, ground, setup, step)
            set_wheel_noise(drive.u, point.theta[3], setup.sds, step)
            linearise(x, ticks, k, point, plant, active, step)
            for near in companions:
                set_noise(near, drive.u, point, setup)
        propagate(x, drive, plant, active, step, following)
        for near in companions:
            advance(near)
        if response:
            step.F_unknowns[:] = 0.0
        np.dot(step.F, carried.D, carried.following)
        carried.following[:] += step.F_unknowns
        while row < m and rows[row, TICK] <= k:
            if used[row] == 0.0:
                row += 1
                continue
            obs = observation(ticks, rows[row], k, drive.u)
            for i in range(N_STATES):
                x_at[i] = x[i] + obs.share * (following[i] - x[i])
            error = readings[row] - predict_joint_measurement(x_at, obs, point, active, setup, h)
            if response:
                row_slopes(h, obs.share, carried, driven[row], 1.0, d)
            else:
                row_slopes(h, obs.share, carried, h[N_STATES:], -1.0, d)
            out.e[row], out.de[row, :] = error, d
            if closed:
                between(obs.share, h, step, H)
                noise_variance = (rows[row, SD] * noise_factor(obs.kind, point.unknowns)) ** 2
                out.S[row] = update(error, noise_variance, H, state, step.F_T, UNLIMITED, work)
                carry_update(work, error, d, carried, moved)
                for q in range(len(companions)):
                    out.e_nearby[row, q], out.S_nearby[row, q] = take(
                        companions[q], error, rows[row, SD], obs, h, H, moved, work
                    )
            row += 1
        if closed:
            propagate_covariance(P, step, x[X_PSI])
            for near in companions:
                propagate_covariance(near.state.P, near.step, x[X_PSI])
                near.state.x[:] = near.state.following
        x[:] = following
        carried.D[:] = carried.following
