"""What the filters expect of a measurement: each sensor's own model, by the kind of the measurement.

A sensor's file in sensors/ has its prediction with slopes by states and unknowns, and its noise; gates are in
gates.py. The wheel angle, which is an input, has such a file too. Predictions and slopes are generated from
symbols (deploy/observation_equations.py).
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.joint_update import JointState
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.sensors import heading, position, roll, velocity, yaw_rate
from tilth.estimator.filters.sensors.heading import predict_heading
from tilth.estimator.filters.sensors.observation import Observation, body_of
from tilth.estimator.filters.sensors.position import predict_position
from tilth.estimator.filters.sensors.roll import predict_roll
from tilth.estimator.filters.sensors.velocity import predict_velocity
from tilth.estimator.filters.sensors.yaw_rate import observe_yaw_rate, predict_yaw_rate
from tilth.estimator.filters.states import DT, N_STATES, Places
from tilth.estimator.filters.transition import D_POSITION, N_COUPLED, POSITION_LATER, Transition
from tilth.estimator.record.record import HEADING, KIND, OFFSET, PLACE, PSI, ROLL_ANGLE, VELOCITY, YAW_RATE

Array = NDArray[np.float64]

_BY_KIND: Final = (yaw_rate, velocity, position, position, heading, roll)  # record.YAW_RATE to ROLL_ANGLE
NOISE_LEVELS: Final = tuple(sensor.NOISE for sensor in _BY_KIND)


@inner_kernel
def observation(
    ticks: Array, row: Array, k: int, u: float, x: Array, following: Array, unknowns: Array
) -> Observation:
    """The observation of a row of the record, at or after tick k and before the next. u: m/s. x, following:
    (30,), the state at both. unknowns: (n,)."""
    after = min(k + 1, ticks.shape[0] - 1)
    kind, place, share = int(row[KIND]), int(row[PLACE]), row[OFFSET] / DT
    psi = PSI + body_of(kind, place)
    psi_ref = ticks[k, psi] + share * (ticks[after, psi] - ticks[k, psi])
    obs = Observation(kind, place, share, u, psi_ref, 0.0)
    return observe_yaw_rate(obs, x, following, unknowns) if kind == YAW_RATE else obs


@inner_kernel
def predict_measurement(x: Array, obs: Observation, unknowns: Array, setup: RigSetup, slopes: Array) -> float:
    """Predicted measurement at state x, (30,), and a point of the unknowns, (n,); fills slopes, (30 + n,),
    with its derivatives by both."""
    slopes[:] = 0.0
    body = body_of(obs.kind, obs.place)
    if obs.kind == YAW_RATE:
        return float(predict_yaw_rate(x, unknowns, body, obs, setup, slopes))
    if obs.kind == HEADING:
        return float(predict_heading(x, unknowns, body, obs, setup, slopes))
    if obs.kind == ROLL_ANGLE:
        return float(predict_roll(x, unknowns, body, obs, setup, slopes))
    if obs.kind == VELOCITY:
        return float(predict_velocity(x, unknowns, body, obs, setup, slopes))
    return float(predict_position(x, unknowns, body, obs, setup, slopes))


@inner_kernel
def between(share: float, h: Array, F: Array, H: Array) -> None:
    """Fill H, the Jacobian over the n states at the tick, from h, that at an instant a share of a tick later,
    between which the state is linear. F: (n, n), over the tick. Of longer H and h the first n are meant."""
    n = F.shape[0]
    for j in range(n):
        H[j] = (1.0 - share) * h[j]
    for i in range(n):
        if h[i] != 0.0 and share != 0.0:
            for j in range(n):
                H[j] += share * h[i] * F[i, j]


@inner_kernel
def unknowns_between(share: float, h: Array, places: Places, step: Transition, out: Array) -> None:
    """Fill out (a,), as `between`, over the active unknowns, at `places`."""
    na = out.shape[0]
    for j in range(na):
        out[j] = h[N_STATES + places[j]]
    for k in range(N_COUPLED):
        i = k if k < D_POSITION else k + POSITION_LATER
        if h[i] != 0.0 and share != 0.0:
            for j in range(na):
                out[j] += share * h[i] * step.F_unknowns[k, j]


class Expected(NamedTuple):
    """Work arrays of an innovation."""

    x: Array  # (30,), state at the measurement
    h: Array  # (30 + n,), derivatives of the prediction by it and all unknowns
    H: Array  # (30 or more,), the same by the state at the tick
    H_unknowns: Array  # (a,), and by the active unknowns


@inner_kernel
def innovation(
    reading: float, obs: Observation, state: JointState, places: Places, setup: RigSetup, step: Transition,
    at: Expected,
) -> float:  # fmt: skip
    """What a reading is more than predicted; fills the arrays. The state is linear in time over the tick."""
    x, following = state.x, state.following
    for i in range(N_STATES):
        at.x[i] = x[i] + obs.share * (following[i] - x[i])
    error = reading - predict_measurement(at.x, obs, state.unknowns, setup, at.h)
    between(obs.share, at.h, step.F, at.H)
    unknowns_between(obs.share, at.h, places, step, at.H_unknowns)
    return float(error)


@inner_kernel
def noise_factor(kind: int, unknowns: Array) -> float:
    """Factor on the stated sd of a measurement. unknowns: (n,)."""
    return math.exp(unknowns[NOISE_LEVELS[kind]])
