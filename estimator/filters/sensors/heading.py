"""The heading of a body, where a receiver measures it itself."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.sensors.observation import Observation
from tilth.estimator.filters.states import X_PSI
from tilth.estimator.filters.unknowns import AT_S_POSITION

Array = NDArray[np.float64]

NOISE: Final = AT_S_POSITION  # logarithm of the factor on the stated sd
GATE: Final = 5.0  # sds of the innovation; a larger one is an outlier


@inner_kernel
def predict_heading(x: Array, obs: Observation, h: Array) -> float:
    """rad; fills h. No unknown has a part in it."""
    h[X_PSI + obs.place] = 1.0
    return float(x[X_PSI + obs.place])
