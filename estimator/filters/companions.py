"""Companions of a filter run: the same filter with other noise levels.

What noise levels do to the prediction errors, by way of the gains, has no closed form. A companion has the
covariance of another noise level and shares all Jacobians with the run. Its state is kept as the deviation
from the run's, which moves by these Jacobians: it needs no motion model of its own. So the memory of the
pushes, which changes the Jacobians, is no noise level here.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.filters.joint_update import JointState, UpdateWork, update
from tilth.estimator.filters.measurement_model import Observation, noise_factor
from tilth.estimator.filters.propagation import (
    GroundNoise,
    Transition,
    first_covariance,
    ground_at,
    set_processes,
    set_wheel_noise,
)
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.states import N_STATES, Places, Point

Array = NDArray[np.float64]

UNLIMITED: Final = 1e30  # sds: no innovation is an outlier here


class Companion(NamedTuple):
    """The filter with other noise levels."""

    ground: GroundNoise
    step: Transition  # Jacobians are those of the run, process noise is its own
    state: JointState  # x and following are deviations from those of the run


@kernel
def companion(unknowns: Array, u: float, setup: RigSetup, nothing: Places, run: Transition) -> Companion:
    """At the first tick of a run. unknowns: (n,), of which noise levels differ from the run's. u: m/s."""
    ground, zeros, square = ground_at(unknowns), np.zeros(N_STATES), np.zeros((N_STATES, N_STATES))
    step = Transition(
        run.rates_x, run.rates_wheel, run.rates_unknowns, run.rates, run.held, run.wheel,
        np.ones(N_STATES), np.zeros(N_STATES), np.zeros((2, 3)),
        run.F, run.F_unknowns, run.F_T, square.copy(), square.copy(), run.square,
        run.change,
    )  # fmt: skip
    P = first_covariance(u, ground, setup)
    return Companion(ground, step, JointState(zeros.copy(), zeros.copy(), unknowns, nothing, zeros, P))


@kernel
def set_noise(near: Companion, u: float, point: Point, setup: RigSetup) -> None:
    """Renew its process noise, at speed u, m/s."""
    set_processes(u, near.ground, setup, near.step)
    set_wheel_noise(u, point.theta[3], setup.sds, near.step)


@kernel
def advance(near: Companion) -> None:
    """Propagate the deviation over a tick."""
    np.dot(near.step.F, near.state.x, near.state.following)


@kernel
def take(
    near: Companion,
    error: float,
    sd: float,
    obs: Observation,
    h: Array,
    H: Array,
    moved: Array,
    work: UpdateWork,
) -> tuple[float, float]:
    """Update with one measurement; (innovation, its variance).

    error: the run's innovation. sd: stated one of the measurement. h, H: (27,), its Jacobians at its instant
    and at the tick. moved: (2, 27), what the run's state and its following one have moved by.
    """
    x, following = near.state.x, near.state.following
    for i in range(N_STATES):
        if h[i] != 0.0:
            error -= h[i] * (x[i] + obs.share * (following[i] - x[i]))
    variance = (sd * noise_factor(obs.kind, near.state.unknowns)) ** 2
    S = float(update(error, variance, H, near.state, near.step.F_T, UNLIMITED, work))
    for i in range(N_STATES):
        x[i] -= moved[0, i]
        following[i] -= moved[1, i]
    return error, S
