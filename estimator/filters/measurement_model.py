"""What the filters expect of a measurement: each sensor's own model, by the kind of the measurement.

A sensor's file in sensors/ has its prediction with slopes by states and unknowns, its noise and its gate. The
wheel angle, which is an input, has such a file too. Predictions and slopes are generated from symbols
(deploy/observation_equations.py).
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.sensors import heading, position, roll, velocity, yaw_rate
from tilth.estimator.filters.sensors.heading import predict_heading
from tilth.estimator.filters.sensors.observation import Observation, body_of
from tilth.estimator.filters.sensors.position import predict_position
from tilth.estimator.filters.sensors.roll import predict_roll
from tilth.estimator.filters.sensors.velocity import predict_velocity
from tilth.estimator.filters.sensors.yaw_rate import observe_yaw_rate, predict_yaw_rate
from tilth.estimator.filters.states import DT
from tilth.estimator.record.record import HEADING, KIND, OFFSET, PLACE, PSI, ROLL_ANGLE, VELOCITY, YAW_RATE

Array = NDArray[np.float64]

_BY_KIND: Final = (yaw_rate, velocity, position, position, heading, roll)  # record.YAW_RATE to ROLL_ANGLE
NOISE_LEVELS: Final = tuple(sensor.NOISE for sensor in _BY_KIND)
GATES: Final = tuple(sensor.SENSOR.gate for sensor in _BY_KIND)


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
def noise_factor(kind: int, unknowns: Array) -> float:
    """Factor on the stated sd of a measurement. unknowns: (n,)."""
    return math.exp(unknowns[NOISE_LEVELS[kind]])


def outliers(rows: Array, e: Array, S: Array) -> NDArray[np.bool_]:
    """(m,), which of the innovations e, with variances S, of a record's rows are beyond their gates."""
    gates = np.array(GATES)[rows[:, KIND].astype(np.intp)]
    return np.asarray(np.abs(e) > gates * np.sqrt(S))
