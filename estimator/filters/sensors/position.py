"""A receiver's position, north or east: the tractor's CG, the way from there to the antenna over the hitch,
and the slow errors of receivers."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.generated.observation_kernels import east_i, east_t, north_i, north_t
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.sensors.observation import Observation
from tilth.estimator.filters.unknowns import AT_S_POSITION
from tilth.estimator.record.record import NORTH

Array = NDArray[np.float64]

NOISE: Final = AT_S_POSITION  # logarithm of the factor on the stated sd


@inner_kernel
def predict_position(
    x: Array, unknowns: Array, body: int, obs: Observation, setup: RigSetup, slopes: Array
) -> float:
    """m; fills the slopes."""
    if obs.kind == NORTH:
        if body == 0:
            return float(north_t(x, unknowns, body, obs, setup, slopes))
        return float(north_i(x, unknowns, body, obs, setup, slopes))
    if body == 0:
        return float(east_t(x, unknowns, body, obs, setup, slopes))
    return float(east_i(x, unknowns, body, obs, setup, slopes))
