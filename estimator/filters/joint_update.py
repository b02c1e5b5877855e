"""What the filters share of their steps: covariances from tick to tick, and the update with one
measurement."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inline_kernel, inner_kernel
from tilth.estimator.filters.states import (
    BANK_STATES,
    N_STATES,
    X_DISTURBANCE,
    X_PAIR,
    X_POSITION,
    X_PSI,
    Places,
)
from tilth.estimator.filters.transition import (
    D_POSITION,
    N_COUPLED,
    POSITION_LATER,
    Transition,
    propagate_covariance,
)

Array = NDArray[np.float64]


class JointState(NamedTuple):
    """The joint state during a run; row_filter.py has fewer states. Beside it there may be perturbed filters
    (perturbed_filters.py): `c` filters in all, of which the first is the run's."""

    x: Array  # (30,)
    following: Array  # (30,), x one tick later
    unknowns: Array  # (n,), in the order of unknowns.NAMES
    places: Places  # (a,), of the active ones among them
    considered: Array  # (30 + a,), 1.0 for what may not be learned
    P: Array  # (c, 30 + a, 30 + a)


class UpdateWork(NamedTuple):
    """Work arrays of an update."""

    P_H: Array  # (c, 30 + a)
    gain: Array  # (c, 30 + a)
    moved: Array  # (30 + a,), how far the first filter's joint state has moved
    coupled: Array  # (14,), and its coupled states one tick later


def empty_work(count: int, n: int) -> UpdateWork:
    """Work arrays for `count` filters of n states and unknowns."""
    return UpdateWork(np.zeros((count, n)), np.zeros((count, n)), np.zeros(n), np.zeros(N_COUPLED))


@inner_kernel
def propagate_covariances(state: JointState, step: Transition) -> None:
    """Of all filters, by a tick."""
    for c in range(state.P.shape[0]):
        propagate_covariance(state.P[c], c, step, state.x[X_PSI])


@inline_kernel
def update(
    errors: Array, variances: Array, H: Array, state: JointState, step: Transition, gate: float,
    work: UpdateWork,
) -> bool:  # fmt: skip
    """Schmidt-Kalman update of the joint state with one measurement, as `correct`; considered unknowns stay
    as they are. H: (30 + a,), Jacobian over the joint state at the tick."""
    used = correct(errors, variances, H, state, gate, work)
    if used:
        move(errors[0], state, step, work)
    return used


@inner_kernel
def correct(
    errors: Array, variances: Array, H: Array, state: JointState, gate: float, work: UpdateWork
) -> bool:
    """Update the covariances and fill work's gains.

    errors: (c,), innovations. variances: (c,), of the measurement's noise; then of the innovations. H: (n,).
    False if the first error is beyond `gate` sds of it and nothing was updated.
    """
    P, considered, P_H, gain = state.P, state.considered, work.P_H, work.gain
    count, n = P.shape[0], P.shape[1]
    P_H[:] = 0.0
    for c in range(count):
        for k in range(n):
            if H[k] != 0.0:
                for i in range(n):
                    P_H[c, i] += H[k] * P[c, k, i]
        for i in range(n):
            variances[c] += H[i] * P_H[c, i]
    if errors[0] * errors[0] > gate * gate * variances[0]:
        return False
    for c in range(count):
        inverse = 1.0 / variances[c]
        for i in range(n):
            gain[c, i] = P_H[c, i] * inverse
        for i in range(n):
            if considered[i] == 0.0:
                for j in range(n):
                    P[c, i, j] -= gain[c, i] * P_H[c, j]
            else:  # considered: its variance stays, its covariance with updated states changes
                for j in range(n):
                    P[c, i, j] -= (1.0 - considered[j]) * gain[c, i] * P_H[c, j]
                gain[c, i] = 0.0
    return True


@inner_kernel
def move(error: float, state: JointState, step: Transition, work: UpdateWork) -> None:
    """Move the state, the one after it and the unknowns by the first filter's gain times its innovation."""
    moved, coupled, x, following, F = work.moved, work.coupled, state.x, state.following, step.F
    for i in range(moved.shape[0]):
        moved[i] = work.gain[0, i] * error
    for j in range(state.places.shape[0]):
        state.unknowns[state.places[j]] += moved[N_STATES + j]
    coupled[:] = 0.0
    for i in range(moved.shape[0]):
        for k in range(N_COUPLED):
            coupled[k] += step.F_coupled_T[i, k] * moved[i]
    for i in range(N_STATES):
        x[i] += moved[i]
        if X_DISTURBANCE <= i < X_POSITION or i >= X_PAIR:
            following[i] += F[i, i] * moved[i]
    for i in BANK_STATES:
        for j in BANK_STATES:
            if i != j:
                following[i] += F[i, j] * moved[j]
    for k in range(N_COUPLED):
        following[k if k < D_POSITION else k + POSITION_LATER] += coupled[k]
