"""Soil differs from place to place: what was learned of it is forgotten over distance.

Log-parameters drift as an Ornstein-Uhlenbeck process in distance travelled. Its stationary law is the prior.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Places = NDArray[np.int64]

DRIFT_M: Final = 50_000.0  # distance over which the soil forgets itself


def kept_over(metres: float) -> float:
    """Share of what was known of the soil that is left after so many metres."""
    return math.exp(-metres / DRIFT_M)


def added_covariance(kept: float, prior_sd: Array) -> Array:
    """What the drift adds to a covariance of which that share is left, (k, k). prior_sd: (k,)."""
    return np.asarray((1.0 - kept**2) * np.diag(prior_sd**2))


def drift(covariance: Array, places: Places, kept: float, prior_sd: Array) -> None:
    """Drift these unknowns of a covariance (n, n), in place. prior_sd: (n,)."""
    covariance[places, :] *= kept
    covariance[:, places] *= kept
    covariance[np.ix_(places, places)] += added_covariance(kept, prior_sd[places])
