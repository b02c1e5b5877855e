"""A receiver's roll: lean and cross slope of its body, a little ago, with a zero error of its own."""

from typing import Final

from tilth.estimator.filters.generated.observation_kernels import measured_roll
from tilth.estimator.filters.unknowns import AT_S_ROLL

NOISE: Final = AT_S_ROLL  # logarithm of the factor on the stated sd

predict_roll = measured_roll  # rad
