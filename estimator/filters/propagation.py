"""Propagates state and covariance over one tick: the discretised relaxation model plus a nonlinear
correction.

Between two ticks the relaxation model is integrated exactly for the mean of the inputs. The difference of the
nonlinear model from it (large angles, tyre curve, load transfer) is evaluated once for two ticks, in their
middle, and added. The
tracker, whose model is the nonlinear one, uses the functions for the position and for the plant.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.filters.states import (
    ACROSS,
    ALONG,
    DT,
    N_PUSH,
    N_STATES,
    PAIR_DECAY,
    X_ALPHA,
    X_PAIR,
    X_POSITION,
    X_PSI,
    X_PUSH,
    X_R,
    X_V,
    Point,
)
from tilth.estimator.filters.unknowns import AT_ROLL_MODES
from tilth.estimator.models.parameters import Rig
from tilth.estimator.models.rolling import N_ROLLING, RollModes, RollWork, rates_rolling, roll_work

Array = NDArray[np.float64]

NUDGE_LINEAR = 1e-6


class RelaxationModel(NamedTuple):
    """The states before X_PUSH at one speed: x' = A x + B inputs, and its discretisation over a tick."""

    A: Array  # (8, 8)
    B: Array  # (8, 3), of relaxation.INPUTS
    F: Array  # (8, 8), of the state over DT
    G: Array  # (8, 3), of inputs that are held
    G_push: Array  # (12, 5), of the ground's pushes, held


class Plant(NamedTuple):
    """The nonlinear model at one point of the unknowns, and its work arrays."""

    theta: Array  # (6,)
    rig: Rig
    x: Array  # (15,), its state
    w: Array  # (9,), its inputs
    forces: Array  # (6, 3)
    rates: Array  # (15,), x'
    roll: RollModes
    work: RollWork


@kernel
def discretise(u: float, point: Point, rig: Rig, model: RelaxationModel, plant: Plant) -> None:
    """Fill the model at speed u, m/s, about straight driving."""
    A, B, F = model.A, model.B, model.F
    at = np.zeros(N_STATES)
    A[:, :] = 0.0
    for j in range(X_PUSH):
        for side in (-1.0, 1.0):
            at[j] = side * NUDGE_LINEAR
            plant.w[:] = 0.0
            plant_rates(at, u, plant)
            for i in range(X_PSI):
                A[i, j] += side * plant.rates[5 + i] / (2.0 * NUDGE_LINEAR)
        at[j] = 0.0
    A[X_PSI, X_R] = A[X_PSI + 1, X_R + 1] = 1.0
    B[:, :] = 0.0
    for j in range(5):
        place = j if j < 3 else 6 + j
        for side in (-1.0, 1.0):
            plant.w[:] = 0.0
            plant.w[place] = side * NUDGE_LINEAR
            plant_rates(at, u, plant)
            for i in range(X_PSI):
                B[i, j] += side * plant.rates[5 + i] / (2.0 * NUDGE_LINEAR)
    F[:] = np.eye(X_PUSH)
    held = DT * np.eye(X_PUSH)
    power = np.eye(X_PUSH)
    factor = 1.0
    for order in range(1, 6):
        power = power @ A
        factor *= DT / order
        F += factor * power
        held += (factor * DT / (order + 1)) * power
    model.G[:] = held @ B
    model.G_push[:, 0:2] = model.G[:, 1:3]
    model.G_push[:, 2] = held[:, 1]
    model.G_push[:, 3:5] = model.G[:, 1:3]
    model.G_push[:, 5:7] = model.G[:, 3:5]


@kernel
def propagate_position(x: Array, u: float, out: Array) -> None:
    """Fill the position of out, the state one tick after x, whose v and psi_t are filled already."""
    psi, v = 0.5 * (x[X_PSI] + out[X_PSI]), 0.5 * (x[X_V] + out[X_V])
    sine, cosine = math.sin(psi), math.cos(psi)
    out[X_POSITION] = x[X_POSITION] + DT * (u * cosine - v * sine)
    out[X_POSITION + 1] = x[X_POSITION + 1] + DT * (u * sine + v * cosine)


@kernel
def propagate_state(
    x: Array, u: float, inputs: Array, model: RelaxationModel, correction: Array, push_decay: Array,
    out: Array,
) -> None:  # fmt: skip
    """Fill out (15,), the state one tick after x.

    inputs: (3,), as relaxation.INPUTS. correction: (6,), of `nonlinear_correction`. push_decay: factor on the
    ground's pushes over a tick.
    """
    F, G, G_push = model.F, model.G, model.G_push
    for i in range(X_PUSH):
        total = 0.0
        for j in range(3):
            total += G[i, j] * inputs[j]
        for j in range(N_PUSH):
            total += G_push[i, j] * x[X_PUSH + j]
        for j in range(X_PUSH):
            total += F[i, j] * x[j]
        out[i] = total
    for i in range(X_PSI):
        out[i] += DT * correction[i]
    for i in range(2):  # the correction of r' changes the heading within the tick too
        out[X_PSI + i] += 0.5 * DT * DT * correction[X_R + i]
    for i in range(X_PUSH, X_POSITION):
        out[i] = push_decay[i - X_PUSH] * x[i]
    propagate_position(x, u, out)
    for i in range(X_PAIR, N_STATES):
        out[i] = PAIR_DECAY * x[i]


@kernel
def plant_rates(x: Array, u: float, plant: Plant) -> None:
    """Fill plant.rates at state x; plant.w[:3] holds the wheel angle and gravity on both bodies."""
    state = plant.x
    state[2], state[3], state[4] = x[X_PSI], x[X_PSI + 1], u
    for i in range(X_PSI):
        state[5 + i] = x[i]
    plant.w[3] = u
    rates_rolling(state, plant.w, plant.theta, plant.rig, plant.roll, plant.forces, plant.work, plant.rates)


@kernel
def nonlinear_correction(
    x: Array, u: float, inputs: Array, model: RelaxationModel, plant: Plant, out: Array
) -> None:
    """Fill out (6,): rates of the nonlinear model less those of the relaxation model at state x."""
    plant.w[:] = 0.0
    plant.w[0], plant.w[1], plant.w[2] = inputs[0], inputs[1], inputs[2]
    plant_rates(x, u, plant)
    A, B = model.A, model.B
    for i in range(X_PSI):
        linear = 0.0
        for j in range(3):
            linear += B[i, j] * inputs[j]
        for j in range(X_PUSH):
            linear += A[i, j] * x[j]
        out[i] = plant.rates[5 + i] - linear


@kernel
def position_jacobian(u: float, psi: float, v: float, columns: int, F: Array) -> None:
    """Fill the position's rows of F, in its first columns, from its rows of v and psi_t."""
    sine, cosine = math.sin(psi), math.cos(psi)
    north = -u * sine - v * cosine
    east = u * cosine - v * sine
    for j in range(columns):
        half_v = 0.5 * DT * (F[X_V, j] + (1.0 if j == X_V else 0.0))
        half_psi = 0.5 * DT * (F[X_PSI, j] + (1.0 if j == X_PSI else 0.0))
        F[X_POSITION, j] = -sine * half_v + north * half_psi
        F[X_POSITION + 1, j] = cosine * half_v + east * half_psi


@kernel
def transition_jacobian(
    x: Array, u: float, model: RelaxationModel, push_decay: Array, F: Array, F_T: Array
) -> None:
    """Fill F (15, 15), the transition Jacobian over one tick, and its transpose F_T.

    Only those entries are filled that `propagate_covariance` and `propagate_change` read; the others are
    zero.
    """
    for i in range(X_PUSH):
        for j in range(X_PUSH):
            F[i, j] = F_T[j, i] = model.F[i, j]
        for j in range(N_PUSH):
            F[i, X_PUSH + j] = F_T[X_PUSH + j, i] = model.G_push[i, j]
    position_jacobian(u, x[X_PSI], x[X_V], X_PUSH, F)
    for j in range(X_PUSH):
        F_T[j, X_POSITION] = F[X_POSITION, j]
        F_T[j, X_POSITION + 1] = F[X_POSITION + 1, j]
    for i in range(X_PUSH, N_STATES):
        F[i, i] = F_T[i, i] = (
            push_decay[i - X_PUSH] if i < X_POSITION else (1.0 if i < X_PAIR else PAIR_DECAY)
        )


@kernel
def propagate_change(change: Array, F_T: Array, out: Array) -> None:
    """Fill out (15,): F times a small change of the state, (15,)."""
    for j in range(X_PUSH):
        out[j] = 0.0
    for k in range(X_POSITION):
        part = change[k]
        for j in range(X_PUSH):
            out[j] += part * F_T[k, j]
    for j in range(X_PUSH, N_STATES):
        out[j] = change[j] * F_T[j, j]
    for j in range(X_POSITION, X_PAIR):
        for k in range(X_PUSH):
            out[j] += change[k] * F_T[k, j]


@kernel
def add_position_noise(P: Array, psi: float) -> None:
    """Add the position's process noise of one tick to a covariance: along and across the heading psi, rad."""
    sine, cosine = math.sin(psi), math.cos(psi)
    along, across = ALONG * ALONG * DT, ACROSS * ACROSS * DT
    P[X_POSITION, X_POSITION] += along * cosine * cosine + across * sine * sine
    P[X_POSITION + 1, X_POSITION + 1] += along * sine * sine + across * cosine * cosine
    cross = (along - across) * sine * cosine
    P[X_POSITION, X_POSITION + 1] += cross
    P[X_POSITION + 1, X_POSITION] += cross


@kernel
def propagate_covariance(P: Array, F: Array, F_T: Array, q: Array, psi: float, F_P: Array) -> None:
    """Propagate P (15, 15) over one tick: F P F' + Q, in place.

    q: (6,), process noise variances of alpha_f, the pushes and both pairs. Loops add rows to rows and skip
    zeros, which is three times as fast as two matrix products. F_P: (15, 15), work array.
    """
    for i in range(X_PUSH):
        for j in range(N_STATES):
            F_P[i, j] = F[i, 0] * P[0, j]
        for k in range(1, X_POSITION):
            part = F[i, k]
            for j in range(N_STATES):
                F_P[i, j] += part * P[k, j]
    for i in range(X_PUSH, N_STATES):
        part = F[i, i]
        for j in range(N_STATES):
            F_P[i, j] = part * P[i, j]
    for i in range(X_POSITION, X_PAIR):
        for k in range(X_PUSH):
            part = F[i, k]
            for j in range(N_STATES):
                F_P[i, j] += part * P[k, j]
    for i in range(N_STATES):
        propagate_change(F_P[i], F_T, P[i])
    P[X_ALPHA, X_ALPHA] += q[0]
    for i in range(N_PUSH):
        P[X_PUSH + i, X_PUSH + i] += q[1 + i]
    for i in range(2):
        P[X_PAIR + i, X_PAIR + i] += q[8 + i]
    add_position_noise(P, psi)


@kernel
def rig_at(rig: Rig, geometry: Array, rolling: float, curvature: float) -> Rig:
    """The rig with this geometry (9,), rolling resistance and curvature of the tyre curve (1/grip)."""
    grip = 1.0 / max(curvature, 1e-3)
    return Rig(
        geometry[0], geometry[1], geometry[2], geometry[3], geometry[4], geometry[5], geometry[6],
        geometry[7], geometry[8], rig.C_af, rig.C_ar, rig.C_ai, rig.sigma_f, rig.sigma_r, rig.sigma_i,
        rig.h_t, rig.h_i, rig.h_h, rig.w_f, rig.w_r, rig.w_i, rig.roll_share_f, grip, grip, grip,
        rig.load_exponent, rolling, rolling, rolling, rig.front_drive, rig.drive_gain, rig.drive_limit, rig.g,
    )  # fmt: skip


@kernel
def roll_at(roll: RollModes, unknowns: Array) -> RollModes:
    """The roll modes at a point of the unknowns."""
    k = np.exp(unknowns[AT_ROLL_MODES : AT_ROLL_MODES + 6])
    return RollModes(
        roll.stiffness_t * k[0], roll.stiffness_i * k[1], roll.damping_t * k[2], roll.damping_i * k[3],
        roll.inertia_t * k[4], roll.inertia_i * k[5],
        max(roll.pin + unknowns[AT_ROLL_MODES + 6], 0.0), roll.stiffness_f * k[0],
    )  # fmt: skip


@kernel
def plant_of(theta: Array, rig: Rig, roll: RollModes) -> Plant:
    """The nonlinear model with these parameters."""
    return Plant(
        theta,
        rig,
        np.zeros(N_ROLLING),
        np.zeros(11),
        np.zeros((6, 3)),
        np.zeros(N_ROLLING),
        roll,
        roll_work(),
    )
