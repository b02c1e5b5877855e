"""A receiver's velocity across its body: that of its antenna, which the body's roll sways."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.generated.observation_kernels import velocity_i, velocity_t
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.sensors.observation import Observation
from tilth.estimator.filters.unknowns import AT_S_VELOCITY

Array = NDArray[np.float64]

NOISE: Final = AT_S_VELOCITY  # logarithm of the factor on the stated sd


@inner_kernel
def predict_velocity(
    x: Array, unknowns: Array, body: int, obs: Observation, setup: RigSetup, slopes: Array
) -> float:
    """To the right of psi_ref, m/s; fills the slopes."""
    if body == 0:
        return float(velocity_t(x, unknowns, body, obs, setup, slopes))
    return float(velocity_i(x, unknowns, body, obs, setup, slopes))
