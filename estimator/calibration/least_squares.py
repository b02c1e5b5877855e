"""Robust linear least squares with a prior, and its covariance with errors that last for a while."""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LeastSquaresTuning:
    """Robust least squares."""

    rounds: int = tuned(6, "rounds", "of new weights")
    huber: float = tuned(2.0, "sd", "beyond which a residual counts less (Huber)")
    block: int = tuned(100, "rows", "that may have errors in common: 20 s")


LEAST_SQUARES: Final = LeastSquaresTuning()


class Solved(NamedTuple):
    """Of p unknowns."""

    value: Array  # (p,)
    covariance: Array  # (p, p)
    sd: float  # of one residual, robust

    @property
    def sds(self) -> Array:
        return np.asarray(np.sqrt(np.diag(self.covariance)), np.float64)


def solve(
    design: Array, observed: Array, prior_sd: Array, floor: float, block: int = LEAST_SQUARES.block
) -> Solved:
    """design: (n, p); observed: (n,); prior_sd: (p,), about 0. floor: least sd of a residual.

    `block` rows that follow each other may err together: the covariance is the sandwich over blocks.
    """
    information = np.diag(prior_sd**-2.0)
    if len(observed) == 0:
        return Solved(np.zeros(len(prior_sd)), np.diag(prior_sd**2), floor)
    value: Array = np.zeros(len(prior_sd))
    weights: Array = np.ones(len(observed))
    sd, left = max(float(np.std(observed)), floor), observed
    for _ in range(LEAST_SQUARES.rounds):
        scaled = design.T * (weights / sd**2)
        normal = scaled @ design + information
        value = np.asarray(np.linalg.solve(normal, scaled @ observed), np.float64)
        left = observed - design @ value
        sd = max(1.4826 * float(np.median(np.abs(left))), floor)
        weights = np.minimum(1.0, LEAST_SQUARES.huber * sd / np.maximum(np.abs(left), 1e-300))
    scaled = design.T * (weights / sd**2)
    inverse = np.asarray(np.linalg.inv(scaled @ design + information), np.float64)
    scores = (scaled * left).T  # (n, p)
    starts = np.arange(0, len(observed), block)
    sums = np.add.reduceat(scores, starts, axis=0)
    middle = sums.T @ sums + information
    robust = inverse @ middle @ inverse
    factors = np.sqrt(np.maximum(np.diag(robust) / np.diag(inverse), 1.0))
    return Solved(value, np.asarray(inverse * np.outer(factors, factors), np.float64), sd)
