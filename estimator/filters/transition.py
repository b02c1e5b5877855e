"""The linearised transition of the filters' state over one tick, and what it does to a covariance.

Of the 30 states of states.py, 14 move with all others: those before X_DISTURBANCE and the position. They are
coupled. The others are processes of their own: each decays, and the cross slopes go together. So of
the Jacobian F only the coupled rows are full, and a covariance is propagated by these and by the decays.
Filters that differ in their noise only share all but decay and q: `c` counts them.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inline_kernel, inner_kernel, kernel
from tilth.estimator.filters.states import (
    ACROSS,
    ALONG,
    BANK_STATES,
    DT,
    N_STATES,
    X_DISTURBANCE,
    X_POSITION,
    X_PSI,
    X_R,
    X_ROLL,
    X_SPEED,
    X_V,
)
from tilth.estimator.filters.unknowns import N_UNKNOWNS

Array = NDArray[np.float64]

D_POSITION: Final = X_DISTURBANCE  # of the position among the coupled states; those before keep their index
N_COUPLED: Final = D_POSITION + 2
POSITION_LATER: Final = X_POSITION - D_POSITION  # by how much the position's index is larger among all


class Transition(NamedTuple):
    """Transition of x over one tick, linearised, and work arrays."""

    rates_x: Array  # (12, 22), rates of the states before X_DISTURBANCE over those before X_POSITION
    rates_wheel: Array  # (12,), over the true wheel angle
    rates_unknowns: Array  # (12, a), over the active unknowns
    rates: Array  # (12,), the rates themselves
    held: Array  # (12, 12), change of the states before X_DISTURBANCE per rate that is held over the tick
    wheel: Array  # (12,), change of the states before X_DISTURBANCE per rad of true wheel angle
    wheel_unknowns: Array  # (n,), derivatives of the true wheel angle by all unknowns
    decay: Array  # (c, 30), factors on the states from X_DISTURBANCE on; they differ in the first three only
    q: Array  # (c, 30), variances of the process noise, without that of the position
    bank: Array  # (4, 4), of the states BANK_STATES
    bank_noise: Array  # (4, 4), covariance of their process noise
    F: Array  # (30, 30), Jacobian of x one tick later over x
    F_unknowns: Array  # (14, a), of the coupled states one tick later over the active unknowns
    F_coupled: Array  # (14, n), of the coupled states one tick later over the joint state of the covariance
    F_coupled_T: Array  # (n, 14), the same transposed
    F_P: Array  # (14, n), overwritten
    F_P_F: Array  # (14, 14), overwritten
    square: Array  # (3, 12, 12), overwritten
    change: Array  # (12, 22), overwritten
    middle: Array  # (30,), overwritten


def empty_transition(na: int, rows: int, count: int) -> Transition:
    """A Transition of `count` filters for `na` active unknowns, of which `rows` are in the covariance,
    without its Jacobians."""
    n = N_STATES + rows
    rates_x = np.zeros((X_DISTURBANCE, X_POSITION))
    for body in range(2):
        rates_x[X_ROLL + body, X_ROLL + 2 + body] = rates_x[X_PSI + body, X_R + body] = 1.0
    rates_x[X_R, X_DISTURBANCE + 2] = 1.0
    F = np.zeros((N_STATES, N_STATES))
    F[X_POSITION, X_POSITION] = F[X_POSITION + 1, X_POSITION + 1] = 1.0
    return Transition(
        rates_x, np.zeros(X_DISTURBANCE), np.zeros((X_DISTURBANCE, na)), np.zeros(X_DISTURBANCE),
        np.zeros((X_DISTURBANCE, X_DISTURBANCE)),
        np.zeros(X_DISTURBANCE), np.zeros(N_UNKNOWNS),
        np.ones((count, N_STATES)), np.zeros((count, N_STATES)),
        np.zeros((4, 4)), np.zeros((4, 4)), F, np.zeros((N_COUPLED, na)), np.zeros((N_COUPLED, n)),
        np.zeros((n, N_COUPLED)), np.zeros((N_COUPLED, n)), np.zeros((N_COUPLED, N_COUPLED)),
        np.zeros((3, X_DISTURBANCE, X_DISTURBANCE)), np.zeros((X_DISTURBANCE, X_POSITION)),
        np.zeros(N_STATES),
    )  # fmt: skip


@kernel
def multiply(A: Array, B: Array, out: Array) -> None:
    """Fill out with A B. It is no inner kernel, since numba's product counts references."""
    np.dot(A, B, out)


@inline_kernel
def integrate_exponential(step: Transition) -> None:
    """Fill step.held: the integral over DT of the matrix exponential of the rates' Jacobian, by a power
    series."""
    A, B, power, held = step.square[0], step.square[1], step.square[2], step.held
    for i in range(X_DISTURBANCE):
        for j in range(X_DISTURBANCE):
            A[i, j] = B[i, j] = DT * step.rates_x[i, j]
            held[i, j] = 0.5 * DT * A[i, j]
        held[i, i] += DT
    for order in range(3, 5):
        multiply(A, B, power)
        factor = DT / (order if order == 3 else order * 3) / 2.0
        for i in range(X_DISTURBANCE):
            for j in range(X_DISTURBANCE):
                B[i, j] = power[i, j]
                held[i, j] += factor * power[i, j]


@inline_kernel
def joint_jacobian(step: Transition) -> None:
    """Fill the Jacobians from the rates' ones, except for the position's rows and the columns of the wheel
    angle's unknowns."""
    held, F = step.held, step.F
    multiply(held, step.rates_x, step.change)
    for i in range(X_DISTURBANCE):
        step.wheel[i] = 0.0
        for j in range(X_DISTURBANCE):
            step.wheel[i] += held[i, j] * step.rates_wheel[j]
    for i in range(X_DISTURBANCE):
        for j in range(X_POSITION):
            F[i, j] = step.change[i, j]
        F[i, i] += 1.0
    unknowns_jacobian(step)
    for i in range(X_DISTURBANCE, N_STATES):
        F[i, i] = step.decay[0, i]
    for i in range(4):
        for j in range(4):
            F[BANK_STATES[i], BANK_STATES[j]] = step.bank[i, j]
    set_coupled(step, 0, X_DISTURBANCE)


@inner_kernel
def unknowns_jacobian(step: Transition) -> None:
    """Fill F_unknowns from the rates' slopes, except for the position's rows and the columns of the wheel
    angle's unknowns."""
    if step.F_unknowns.shape[1] > 0:
        multiply(step.held, step.rates_unknowns, step.F_unknowns[:X_DISTURBANCE])


@inner_kernel
def set_coupled(step: Transition, first: int, end: int) -> None:
    """Fill the rows of F_coupled from `first` to before `end`."""
    coupled, n = step.F_coupled, step.F_coupled.shape[1]
    for k in range(first, end):
        i = k if k < D_POSITION else k + POSITION_LATER
        for j in range(N_STATES):
            coupled[k, j] = step.F_coupled_T[j, k] = step.F[i, j]
        for j in range(N_STATES, n):
            coupled[k, j] = step.F_coupled_T[j, k] = step.F_unknowns[k, j - N_STATES]


@inline_kernel
def position_jacobian(u: float, psi: float, v: float, step: Transition) -> None:
    """Fill the position's rows of the Jacobians from the rows of v and psi_t. u: m/s, true speed."""
    sine, cosine = math.sin(psi), math.cos(psi)
    north, east = -u * sine - v * cosine, u * cosine - v * sine
    F, F_unknowns = step.F, step.F_unknowns
    for j in range(X_POSITION):
        half_v = 0.5 * DT * (F[X_V, j] + (1.0 if j == X_V else 0.0))
        half_psi = 0.5 * DT * (F[X_PSI, j] + (1.0 if j == X_PSI else 0.0))
        F[X_POSITION, j] = -sine * half_v + north * half_psi
        F[X_POSITION + 1, j] = cosine * half_v + east * half_psi
    for j in range(F_unknowns.shape[1]):
        half_v, half_psi = 0.5 * DT * F_unknowns[X_V, j], 0.5 * DT * F_unknowns[X_PSI, j]
        F_unknowns[D_POSITION, j] = -sine * half_v + north * half_psi
        F_unknowns[D_POSITION + 1, j] = cosine * half_v + east * half_psi
    F[X_POSITION, X_SPEED] += DT * cosine
    F[X_POSITION + 1, X_SPEED] += DT * sine
    set_coupled(step, D_POSITION, N_COUPLED)


# Covariances.


@inline_kernel
def add_process_noise(P: Array, q: Array, bank_noise: Array, psi: float) -> None:
    """Add the process noise of one tick to a covariance (n, n); that of the position is along and across the
    heading psi, rad."""
    for i in range(N_STATES):
        P[i, i] += q[i]
    for i in range(4):
        for j in range(4):
            P[BANK_STATES[i], BANK_STATES[j]] += bank_noise[i, j]
    sine, cosine = math.sin(psi), math.cos(psi)
    along, across = ALONG * ALONG * DT, ACROSS * ACROSS * DT
    P[X_POSITION, X_POSITION] += along * cosine * cosine + across * sine * sine
    P[X_POSITION + 1, X_POSITION + 1] += along * sine * sine + across * cosine * cosine
    cross = (along - across) * sine * cosine
    P[X_POSITION, X_POSITION + 1] += cross
    P[X_POSITION + 1, X_POSITION] += cross


@inner_kernel
def decay_columns(rows: Array, first: int, decay: Array, bank: Array) -> None:
    """Multiply rows of a covariance, (k, n), from row `first` on, from the right by the part of F' that is
    not of the coupled states."""
    one, two, three, four = BANK_STATES
    for i in range(first, min(rows.shape[0], N_STATES)):
        before = (rows[i, one], rows[i, two], rows[i, three], rows[i, four])
        for k in range(4):
            total = 0.0
            for j in range(4):
                total += bank[k, j] * before[j]
            rows[i, BANK_STATES[k]] = total
        for j in range(X_DISTURBANCE, N_STATES):
            rows[i, j] *= decay[j]


@inner_kernel
def decay_rows(A: Array, first: int, decay: Array, bank: Array) -> None:
    """Multiply columns of A (30 or more, n), from column `first` on, from the left by the part of F that is
    not of the coupled states."""
    n = A.shape[1]
    for i in range(X_DISTURBANCE, N_STATES):
        if decay[i] != 1.0:
            for j in range(first, n):
                A[i, j] *= decay[i]
    one, two, three, four = BANK_STATES
    for j in range(first, n):
        before = (A[one, j], A[two, j], A[three, j], A[four, j])
        for k in range(4):
            total = 0.0
            for i in range(4):
                total += bank[k, i] * before[i]
            A[BANK_STATES[k], j] = total


@inline_kernel
def propagate_covariance(P: Array, c: int, step: Transition, psi: float) -> None:
    """Propagate P (n, n), of x or of the joint state of filter c of step, over one tick, in place; it stays
    symmetric. psi: heading, rad."""
    F_P, F_P_F, decay, n = step.F_P, step.F_P_F, step.decay[c], P.shape[0]
    multiply(step.F_coupled, P, F_P)
    multiply(F_P, step.F_coupled_T, F_P_F)
    decay_columns(F_P, 0, decay, step.bank)
    decay_rows(P, X_DISTURBANCE, decay, step.bank)
    decay_columns(P, X_DISTURBANCE, decay, step.bank)
    for i in range(X_DISTURBANCE, N_STATES):
        for j in range(N_STATES, n):
            P[j, i] = P[i, j]
    for k in range(N_COUPLED):
        i = k if k < D_POSITION else k + POSITION_LATER
        for j in range(X_DISTURBANCE, n):
            P[i, j] = P[j, i] = F_P[k, j]
    for k in range(N_COUPLED):
        i = k if k < D_POSITION else k + POSITION_LATER
        for other in range(N_COUPLED):
            j = other if other < D_POSITION else other + POSITION_LATER
            P[i, j] = 0.5 * (F_P_F[k, other] + F_P_F[other, k])
    add_process_noise(P, step.q[c], step.bank_noise, psi)
