"""Where an antenna is on its body, and what the unknowns of that place do to what it measures."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.propagation import Active
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.states import N_STATES, Point
from tilth.estimator.filters.unknowns import (
    AT_CG,
    AT_HITCH,
    AT_LATERAL_OFFSET,
    AT_LEVER,
    AT_PAIR,
    AT_ROLL_COMPENSATION,
)

Array = NDArray[np.float64]


class AntennaSlopes(NamedTuple):
    """Derivatives of what an antenna measures, per metre, and by the sway."""

    ahead: float  # by its position forward
    back: float  # by the distance of the hitch behind the tractor's CG
    lateral_offset: float  # by its position to the right
    drawbar: float  # by the height of the drawbar
    roll_compensation: float


@inner_kernel
def drawbar_height(point: Point, setup: RigSetup) -> float:
    """Of the hitch above the ground, m."""
    return setup.rig.h_h + (point.unknowns[AT_HITCH] if setup.scale == 1.0 else 0.0)


@inner_kernel
def lever_ahead(place: int, body: int, point: Point, setup: RigSetup) -> float:
    """How far an antenna is ahead of its body's CG, m."""
    return float(setup.levers[place, 0] + point.unknowns[AT_LEVER + body] - point.unknowns[AT_CG + body])


@inner_kernel
def from_middle(place: int, body: int, setup: RigSetup) -> float:
    """How far an antenna is ahead of the middle of its body's antennas, m."""
    return float(setup.levers[place, 0] - setup.middles[body, 0])


@inner_kernel
def set_antenna_jacobian(
    by: AntennaSlopes, place: int, body: int, setup: RigSetup, active: Active, h: Array
) -> None:
    """Fill what of h, (30 + a,), is over the unknowns. place: of the antenna, on a body."""
    for j in range(active.places.shape[0]):
        unknown, derivative = active.places[j], 0.0
        if unknown == AT_LEVER + body:
            derivative = by.ahead
        elif unknown == AT_CG and body == 0:
            derivative = -by.ahead
        elif unknown == AT_PAIR + body:
            derivative = by.lateral_offset * from_middle(place, body, setup)
        elif unknown == AT_ROLL_COMPENSATION:
            derivative = by.roll_compensation
        elif unknown == AT_LATERAL_OFFSET and body == 1:
            derivative = by.lateral_offset
        elif unknown == AT_HITCH and body == 1 and setup.scale == 1.0:
            derivative = by.drawbar
        elif body == 1 and unknown != AT_CG + 1:  # this one shifts hitch and antennas alike: no effect
            derivative = by.back * active.geometry[j, 2] - by.ahead * active.geometry[j, 3]
        h[N_STATES + j] = derivative
