"""A receiver's position, north or east: the tractor's CG, the way from there to the antenna over the hitch,
and the slow errors of receivers."""

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
    from_middle,
    lever_ahead,
    set_antenna_jacobian,
)
from tilth.estimator.filters.sensors.observation import Observation, body_of
from tilth.estimator.filters.sensors.roll import roll_of
from tilth.estimator.filters.states import X_BANK, X_LATERAL_OFFSET, X_PAIR, X_POSITION, X_PSI, X_ROLL, Point
from tilth.estimator.filters.unknowns import AT_LATERAL_OFFSET, AT_PAIR, AT_S_POSITION
from tilth.estimator.record.record import NORTH
from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]

NOISE: Final = AT_S_POSITION  # logarithm of the factor on the stated sd
GATE: Final = 5.0  # sds of the innovation; a larger one is an outlier


@inner_kernel
def axis(kind: int, psi: float) -> tuple[float, float]:
    """(north or east) of a metre forward and of a metre to the right at heading psi, rad."""
    if kind == NORTH:
        return math.cos(psi), -math.sin(psi)
    return math.sin(psi), math.cos(psi)


@inner_kernel
def predict_position(
    x: Array, obs: Observation, point: Point, active: Active, setup: RigSetup, h: Array
) -> float:
    """m; fills h."""
    place, body, axis_of = obs.place, body_of(obs.kind, obs.place), obs.kind - NORTH
    c, d, height = point.geometry[2], point.geometry[3], setup.heights[place]
    ahead, drawbar = lever_ahead(place, body, point, setup), drawbar_height(point, setup)
    arm, pair = from_middle(place, body, setup), X_PAIR + 2 * body + axis_of
    lateral_offset = setup.levers[place, 1] + point.unknowns[AT_PAIR + body] * arm
    roll_t, roll_i = roll_of(x, 0), roll_of(x, 1)
    forward, right = axis(obs.kind, x[X_PSI])
    ahead_t, side_t, up_t = (ahead, lateral_offset + height * roll_t, height) if body == 0 else (
        -c, drawbar * roll_t, drawbar
    )  # fmt: skip
    value = x[X_POSITION + axis_of] + forward * ahead_t + right * side_t
    h[X_POSITION + axis_of], h[pair] = 1.0, arm
    h[X_PSI] = right * ahead_t - forward * side_t
    h[X_ROLL], h[X_BANK] = right * up_t, right * up_t / GRAVITY
    by = AntennaSlopes(forward, 0.0, right, 0.0, 0.0)
    if body == 1:
        forward_i, right_i = axis(obs.kind, x[X_PSI + 1])
        side_i = lateral_offset + point.unknowns[AT_LATERAL_OFFSET] + (height - drawbar) * roll_i
        value += forward_i * (ahead - d) + right_i * side_i
        h[X_PSI + 1] = right_i * (ahead - d) - forward_i * side_i
        h[X_ROLL + 1] = right_i * (height - drawbar)
        h[X_BANK + 1] = h[X_ROLL + 1] / GRAVITY
        h[X_LATERAL_OFFSET + axis_of] = 1.0
        value += x[X_LATERAL_OFFSET + axis_of]
        by = AntennaSlopes(forward_i, -forward, right_i, right * roll_t - right_i * roll_i, 0.0)
    set_antenna_jacobian(by, place, body, setup, active, h)
    return float(value + arm * x[pair])
