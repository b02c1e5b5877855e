"""Perturbed filters beside a run: the same filter with other noise levels.

What noise levels do to the prediction errors, by way of the gains, has no closed form. Such a filter has the
covariance of another noise level and shares all Jacobians with the run. Its state is kept as the deviation
from the run's, which moves by these Jacobians: it needs no motion model of its own. The time constant of
the disturbances counts among the noise levels. The run itself is the first of the filters, and deviates by
nothing.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inline_kernel, kernel
from tilth.estimator.filters.joint_update import UpdateWork
from tilth.estimator.filters.measurement_model import noise_factor
from tilth.estimator.filters.propagation import (
    first_covariance,
    ground_at,
    set_bank,
    set_processes,
)
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.states import N_STATES, X_DISTURBANCE
from tilth.estimator.filters.transition import Transition, multiply

Array = NDArray[np.float64]


class Filters(NamedTuple):
    """The run's filter and those beside it, c in all."""

    points: Array  # (c, n), of the unknowns
    deviation: Array  # (30, c), of the state from the run's
    following: Array  # (30, c), one tick later, overwritten
    errors: Array  # (c,), innovations
    variances: Array  # (c,), theirs


def filters(point: Array, nearby: Array) -> Filters:
    """At the first tick of a run at a point, (n,), with others at the points nearby, (c - 1, n)."""
    count = 1 + nearby.shape[0]
    points = np.empty((count, point.shape[0]))
    points[0], points[1:] = point, nearby
    zeros = np.zeros((N_STATES, count))
    return Filters(points, zeros, zeros.copy(), np.zeros(count), np.zeros(count))


def first_covariances(u: float, run: Filters, setup: RigSetup) -> Array:
    """Covariances of the first state at speed u, m/s, shape (c, 30, 30)."""
    count = run.points.shape[0]
    P = np.zeros((count, N_STATES, N_STATES))
    for c in range(count):
        P[c] = first_covariance(u, ground_at(run.points[c]), setup)
    return P


@kernel
def set_all_noise(u: float, run: Filters, setup: RigSetup, step: Transition) -> None:
    """Renew the processes and their noise, at speed u, m/s."""
    set_bank(u, setup, step)
    for c in range(run.points.shape[0]):
        set_processes(u, ground_at(run.points[c]), setup, step, c)


@inline_kernel
def set_innovations(error: float, sd: float, kind: int, H: Array, run: Filters) -> None:
    """Fill errors, and variances with those of the measurement's noise.

    error: the run's innovation. sd: stated one of the measurement. H: (30,), its Jacobian at the tick.
    """
    errors = run.errors
    errors[:] = error
    for i in range(N_STATES):
        if H[i] != 0.0:
            for c in range(errors.shape[0]):
                errors[c] -= H[i] * run.deviation[i, c]
    for c in range(errors.shape[0]):
        run.variances[c] = (sd * noise_factor(kind, run.points[c])) ** 2


@inline_kernel
def deviate(run: Filters, work: UpdateWork) -> None:
    """Add to the deviations what an update has moved the perturbed filters by more than the run."""
    for i in range(N_STATES):
        for c in range(1, run.errors.shape[0]):
            run.deviation[i, c] += work.gain[c, i] * run.errors[c] - work.moved[i]


@inline_kernel
def advance(run: Filters, x: Array, step: Transition) -> None:
    """Propagate the deviations over a tick. x: (30,), the run's state before it."""
    deviation, following = run.deviation, run.following
    if deviation.shape[1] == 1:
        return  # the run deviates by nothing
    multiply(step.F, deviation, following)
    for i in range(X_DISTURBANCE, X_DISTURBANCE + 3):
        for c in range(1, deviation.shape[1]):
            following[i, c] += (step.decay[c, i] - step.decay[0, i]) * (x[i] + deviation[i, c])
    for i in range(N_STATES):
        for c in range(deviation.shape[1]):
            deviation[i, c] = following[i, c]
