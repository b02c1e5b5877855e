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
from tilth.estimator.filters.unknowns import AT_ROLLING
from tilth.estimator.models.nonlinear import rates
from tilth.estimator.models.parameters import Rig
from tilth.estimator.models.relaxation import input_matrix, system_matrix

Array = NDArray[np.float64]


class RelaxationModel(NamedTuple):
    """The states before X_PUSH at one speed: x' = A x + B inputs, and its discretisation over a tick."""

    A: Array  # (8, 8)
    B: Array  # (8, 3), of relaxation.INPUTS
    F: Array  # (8, 8), transition matrix over DT
    G: Array  # (8, 3), input matrix over DT, inputs held
    G_push: Array  # (8, 3), the same for the ground's pushes


class Plant(NamedTuple):
    """The nonlinear model at one point of the unknowns, and its work arrays."""

    theta: Array  # (6,)
    rig: Rig
    x: Array  # (13,), its state
    w: Array  # (9,), its inputs
    forces: Array  # (6, 3)
    rates: Array  # (13,), x'


@kernel
def discretise(u: float, point: Point, rig: Rig, model: RelaxationModel) -> None:
    """Fill the model at speed u, m/s: matrix exponential as a power series up to the fifth order."""
    A, B, F = model.A, model.B, model.F
    rolling, heights = point.unknowns[AT_ROLLING], (rig.h_t, rig.h_i)
    system = system_matrix(u, point.geometry, point.theta, rolling, heights)
    inputs = input_matrix(u, point.geometry, point.theta, rolling, heights)
    for i in range(X_PUSH):
        row = i if i < X_PSI else i + 1
        for j in range(X_PUSH):
            A[i, j] = system[row, j if j < X_PSI else j + 1]
        for j in range(3):
            B[i, j] = inputs[row, j]
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
    model.G_push[:, :2] = model.G[:, 1:]
    model.G_push[:, 2] = held[:, 1]


@kernel
def propagate_position(x: Array, u: float, out: Array) -> None:
    """Fill the position of out, the state one tick after x, whose v and psi_t are filled already."""
    psi, v = 0.5 * (x[X_PSI] + out[X_PSI]), 0.5 * (x[X_V] + out[X_V])
    sine, cosine = math.sin(psi), math.cos(psi)
    out[X_POSITION] = x[X_POSITION] + DT * (u * cosine - v * sine)
    out[X_POSITION + 1] = x[X_POSITION + 1] + DT * (u * sine + v * cosine)


@kernel
def propagate_state(
    x: Array, u: float, inputs: Array, model: RelaxationModel, correction: Array, push_decay: float,
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
            total += G[i, j] * inputs[j] + G_push[i, j] * x[X_PUSH + j]
        for j in range(X_PUSH):
            total += F[i, j] * x[j]
        out[i] = total
    for i in range(X_PSI):
        out[i] += DT * correction[i]
    for i in range(2):  # the correction of r' changes the heading within the tick too
        out[X_PSI + i] += 0.5 * DT * DT * correction[X_R + i]
    for i in range(X_PUSH, X_POSITION):
        out[i] = push_decay * x[i]
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
    rates(state, plant.w, plant.theta, plant.rig, (0.0, 0.0), plant.forces, plant.rates)


@kernel
def nonlinear_correction(
    x: Array, u: float, inputs: Array, model: RelaxationModel, plant: Plant, out: Array
) -> None:
    """Fill out (6,): rates of the nonlinear model minus those of the relaxation model at state x, (15,)."""
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
    x: Array, u: float, model: RelaxationModel, push_decay: float, F: Array, F_T: Array
) -> None:
    """Fill F (15, 15), the transition Jacobian over one tick, and its transpose F_T.

    Only those entries are filled that `propagate_covariance` and `propagate_change` read; the others are
    zero.
    """
    for i in range(X_PUSH):
        for j in range(X_PUSH):
            F[i, j] = F_T[j, i] = model.F[i, j]
        for j in range(3):
            F[i, X_PUSH + j] = F_T[X_PUSH + j, i] = model.G_push[i, j]
    position_jacobian(u, x[X_PSI], x[X_V], X_PUSH, F)
    for j in range(X_PUSH):
        F_T[j, X_POSITION] = F[X_POSITION, j]
        F_T[j, X_POSITION + 1] = F[X_POSITION + 1, j]
    for i in range(X_PUSH, N_STATES):
        F[i, i] = F_T[i, i] = push_decay if i < X_POSITION else (1.0 if i < X_PAIR else PAIR_DECAY)


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
    for i in range(3):
        P[X_PUSH + i, X_PUSH + i] += q[1 + i]
    for i in range(2):
        P[X_PAIR + i, X_PAIR + i] += q[4 + i]
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
def plant_of(theta: Array, rig: Rig) -> Plant:
    """The nonlinear model with theta, (6,), and new work arrays."""
    return Plant(theta, rig, np.zeros(13), np.zeros(9), np.zeros((6, 3)), np.zeros(13))
