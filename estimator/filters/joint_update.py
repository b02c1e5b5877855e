"""The update of the filters with one measurement, and the Jacobian of a measurement between two ticks."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.filters.propagation import Transition
from tilth.estimator.filters.states import N_STATES, Places

Array = NDArray[np.float64]


class JointState(NamedTuple):
    """The joint state during a run."""

    x: Array  # (27,)
    following: Array  # (27,), x one tick later
    unknowns: Array  # (n,), in the order of unknowns.NAMES
    places: Places  # (a,), of the active ones among them
    considered: Array  # (27 + a,), 1.0 for what may not be learned
    P: Array  # (27 + a, 27 + a)


class UpdateWork(NamedTuple):
    """Work arrays of an update."""

    P_H: Array  # (27 + a,)
    gain: Array  # (27 + a,)
    gain_after: Array  # (27,), of the state one tick later


@kernel
def between(share: float, h: Array, step: Transition, H: Array) -> None:
    """Fill H (n,), the Jacobian over the joint state at the tick, from h (n,), that at an instant a share of
    a tick later, between which the state is linear."""
    n = H.shape[0]
    for j in range(n):
        H[j] = (1.0 - share) * h[j] if j < N_STATES else h[j]
    for i in range(N_STATES):
        if h[i] != 0.0 and share != 0.0:
            for j in range(N_STATES):
                H[j] += share * h[i] * step.F[i, j]
            for j in range(N_STATES, n):
                H[j] += share * h[i] * step.F_unknowns[i, j - N_STATES]


@kernel
def update(
    error: float, variance: float, H: Array, state: JointState, F_T: Array, gate: float, work: UpdateWork
) -> float:
    """Schmidt-Kalman update of the joint state with one measurement; considered unknowns stay as they are.

    error: the innovation. variance: of the measurement's noise. H: (27 + a,), Jacobian over the joint state
    at the tick. Returns the variance of the innovation; negative if the error is beyond
    `gate` sds of it and nothing was updated.
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
    if error * error > gate * gate * variance:
        return -variance
    inverse = 1.0 / variance
    gain_after[:] = 0.0
    for i in range(n):
        gain[i] = P_H[i] * inverse
        if considered[i] == 0.0:
            for j in range(n):
                P[i, j] -= gain[i] * P_H[j]
            for j in range(N_STATES):
                gain_after[j] += gain[i] * F_T[i, j]
        else:  # considered: its variance stays, its covariance with updated states changes
            for j in range(n):
                P[i, j] -= (1.0 - considered[j]) * gain[i] * P_H[j]
            gain[i] = 0.0
    for i in range(N_STATES):
        state.x[i] += gain[i] * error
        state.following[i] += gain_after[i] * error
    for j in range(state.places.shape[0]):
        state.unknowns[state.places[j]] += gain[N_STATES + j] * error
    return variance
