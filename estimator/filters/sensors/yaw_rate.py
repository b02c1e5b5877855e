"""A receiver's yaw rate: that of its body, a little ago."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.generated.observation_kernels import yaw_rate
from tilth.estimator.filters.sensors.observation import Observation
from tilth.estimator.filters.states import DT, X_R
from tilth.estimator.filters.unknowns import AT_S_YAW_RATE, AT_YAW_RATE_DELAY

Array = NDArray[np.float64]

NOISE: Final = AT_S_YAW_RATE  # logarithm of the factor on the stated sd


@inner_kernel
def observe_yaw_rate(obs: Observation, x: Array, following: Array, unknowns: Array) -> Observation:
    """The same with how late it is. x, following: (30,), the state at the ticks before and after."""
    kind, place, share, u, psi_ref, _ = obs
    faster = (following[X_R + place] - x[X_R + place]) / DT
    return Observation(kind, place, share - unknowns[AT_YAW_RATE_DELAY + place] / DT, u, psi_ref, faster)


predict_yaw_rate = yaw_rate  # rad/s
