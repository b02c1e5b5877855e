"""A receiver's velocity across its body: that of its antenna, which the body's roll sways."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.propagation import Active
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.sensors.antenna import (
    AntennaSlopes,
    drawbar_height,
    lever_ahead,
    set_antenna_jacobian,
)
from tilth.estimator.filters.sensors.observation import Observation, body_of
from tilth.estimator.filters.sensors.roll import roll_rate_of
from tilth.estimator.filters.states import X_BANK_RATE, X_PSI, X_R, X_ROLL, X_SPEED, X_V, Point
from tilth.estimator.filters.unknowns import AT_ROLL_COMPENSATION, AT_S_VELOCITY
from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]

NOISE: Final = AT_S_VELOCITY  # logarithm of the factor on the stated sd
GATE: Final = 5.0  # sds of the innovation; a larger one is an outlier


@inner_kernel
def predict_velocity(
    x: Array, obs: Observation, point: Point, active: Active, setup: RigSetup, h: Array
) -> float:
    """To the right of psi_ref, m/s; fills h."""
    place, body = obs.place, body_of(obs.kind, obs.place)
    u, c, d = obs.u + x[X_SPEED], point.geometry[2], point.geometry[3]
    corrected = setup.corrected[place]
    height = setup.heights[place] + point.unknowns[AT_ROLL_COMPENSATION] * corrected
    lever, drawbar = lever_ahead(place, body, point, setup), drawbar_height(point, setup)
    angle = x[X_PSI] - obs.psi_ref
    sine, cosine = math.sin(angle), math.cos(angle)
    rate_t, rate_i = roll_rate_of(x, 0), roll_rate_of(x, 1)
    up, ahead = (height, lever) if body == 0 else (drawbar, -c)
    across = x[X_V] + ahead * x[X_R] + up * rate_t
    value = u * sine + across * cosine
    h[X_V], h[X_SPEED], h[X_PSI] = cosine, sine, u * cosine - across * sine
    h[X_R], h[X_ROLL + 2], h[X_BANK_RATE] = ahead * cosine, up * cosine, up * cosine / GRAVITY
    by = AntennaSlopes(x[X_R] * cosine, 0.0, 0.0, 0.0, rate_t * corrected * cosine)
    if body == 1:
        h[X_R + 1], h[X_ROLL + 3] = lever - d, height - drawbar
        h[X_BANK_RATE + 1] = (height - drawbar) / GRAVITY
        value += (lever - d) * x[X_R + 1] + (height - drawbar) * rate_i
        by = AntennaSlopes(x[X_R + 1], -x[X_R] * cosine, 0.0, rate_t * cosine - rate_i, rate_i * corrected)
    set_antenna_jacobian(by, place, body, setup, active, h)
    return float(value)
