"""What the tractor's ECU says of its speed by its wheels (PGN 65096): the tyres' radius, and their slip.

Slip varies with the way, not with time: draft and soil do. In turns and next to them the implement is lifted
and the tractor runs light.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.simulator import noise
from tilth.simulator.noise import Array, gauss_markov, generator
from tilth.simulator.scenario import WheelBasedSpeed
from tilth.simulator.tractor import Truth

TURNING: Final = 0.1  # rad/s
LIFTED_M: Final = 20.0  # of the way, before and after each turn
GRID_M: Final = 1.0
MOST_SLIP: Final = 0.3


def wheel_speeds(truth: Truth) -> Array:
    """Of a whole run, at each of truth.time, m/s, negative in reverse."""
    return indicated(truth.scenario.wheel_speed, truth.time, truth.tractor.forward_velocity, slip(truth))


def indicated(of: WheelBasedSpeed, time: Array, velocity: Array, slip: Array) -> Array:
    """By the factor of the tyres that it has at `time`, s; all of one shape."""
    new = np.zeros(np.shape(time), bool) if of.new_tyres_s is None else np.asarray(time) >= of.new_tyres_s
    factor = of.factor / np.where(new, of.new_radius, 1.0)
    result: Array = factor * velocity / (1.0 - slip)
    return result


def slip(truth: Truth) -> Array:
    """Of the driven tyres, (n,), nowhere less than when running light."""
    of, time = truth.scenario.wheel_speed, truth.time
    step_s = float(time[1] - time[0]) if len(time) > 1 else 0.0
    way = np.concatenate([[0.0], np.cumsum(np.abs(truth.tractor.forward_velocity[1:]) * step_s)])
    grid = np.arange(0.0, way[-1] + 2.0 * GRID_M, GRID_M)
    rng = generator(truth.seed, noise.WHEEL_SPEED)
    working = of.slip + gauss_markov(rng, of.slip_sd, of.slip_length, GRID_M, len(grid))
    result: Array = np.clip(np.interp(way, grid, working), of.light_slip, MOST_SLIP)
    result[_light(way, truth.tractor.yaw_rate)] = of.light_slip
    return result


def _light(way: Array, yaw_rate: Array) -> NDArray[np.bool_]:
    """Where it turns, or does within LIFTED_M of its way."""
    turns = way[np.abs(yaw_rate) > TURNING]
    if not len(turns):
        return np.zeros(len(way), np.bool_)
    after = np.searchsorted(turns, way)
    nearest = np.minimum(
        np.abs(way - turns[np.maximum(after - 1, 0)]), np.abs(way - turns[np.minimum(after, len(turns) - 1)])
    )
    return np.asarray(nearest < LIFTED_M)
