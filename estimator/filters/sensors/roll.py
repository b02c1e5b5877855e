"""A receiver's roll: lean and cross slope of its body, a little ago, with a zero error of its own."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.propagation import Active
from tilth.estimator.filters.sensors.observation import Observation, body_of
from tilth.estimator.filters.states import N_STATES, X_BANK, X_BANK_RATE, X_ROLL, Point
from tilth.estimator.filters.unknowns import AT_ROLL_DELAY, AT_ROLL_ZERO, AT_S_ROLL
from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]

NOISE: Final = AT_S_ROLL  # logarithm of the factor on the stated sd
GATE: Final = 5.0  # sds of the innovation; a larger one is an outlier


@inner_kernel
def roll_of(x: Array, body: int) -> float:
    """Of a body, against the horizontal, rad: its lean on its tyres and the ground's slope."""
    return float(x[X_ROLL + body] + x[X_BANK + body] / GRAVITY)


@inner_kernel
def roll_rate_of(x: Array, body: int) -> float:
    """rad/s."""
    return float(x[X_ROLL + 2 + body] + x[X_BANK_RATE + body] / GRAVITY)


@inner_kernel
def predict_roll(x: Array, obs: Observation, point: Point, active: Active, h: Array) -> float:
    """rad; fills h."""
    body = body_of(obs.kind, obs.place)
    delay, rate = point.unknowns[AT_ROLL_DELAY + body], roll_rate_of(x, body)
    h[X_ROLL + body], h[X_ROLL + 2 + body] = 1.0, -delay
    h[X_BANK + body], h[X_BANK_RATE + body] = 1.0 / GRAVITY, -delay / GRAVITY
    for j in range(active.places.shape[0]):
        if active.places[j] == AT_ROLL_ZERO + obs.place:
            h[N_STATES + j] = 1.0
        elif active.places[j] == AT_ROLL_DELAY + body:
            h[N_STATES + j] = -rate
    return float(roll_of(x, body) - delay * rate + point.unknowns[AT_ROLL_ZERO + obs.place])
