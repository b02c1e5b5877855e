"""Soil differs from place to place, so what was learned of it is forgotten over distance.

Log-parameters drift as an Ornstein-Uhlenbeck process over the distance driven. Its stationary distribution is
the prior.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]
Places = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class DriftTuning:
    """How soil differs from place to place."""

    length_m: float = tuned(50_000.0, "m", "correlation length of the soil")


DRIFT: Final = DriftTuning()


def retained_share(metres: float) -> float:
    """Correlation of the soil's log-parameters over so many metres."""
    return math.exp(-metres / DRIFT.length_m)


def added_covariance(share: float, prior_sd: Array) -> Array:
    """Process noise of the drift, (k, k). share: as `retained_share`. prior_sd: (k,)."""
    return np.diag((1.0 - share**2) * prior_sd**2)


def drift(covariance: Array, places: Places | slice, share: float, prior_sd: Array) -> None:
    """Propagate a covariance (n, n) over the drift of the unknowns at these places, in place.

    share: as `retained_share`. prior_sd: (n,).
    """
    factors, variances = np.ones(len(covariance)), np.einsum("ii->i", covariance)
    factors[places] = share
    covariance *= factors[:, None]
    covariance *= factors
    variances[places] += (1.0 - share**2) * prior_sd[places] ** 2
