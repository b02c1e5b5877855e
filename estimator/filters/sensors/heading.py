"""The heading of a body, where a receiver measures it itself."""

from typing import Final

from tilth.estimator.filters.generated.observation_kernels import heading
from tilth.estimator.filters.unknowns import AT_S_POSITION

NOISE: Final = AT_S_POSITION  # logarithm of the factor on the stated sd

predict_heading = heading  # rad
