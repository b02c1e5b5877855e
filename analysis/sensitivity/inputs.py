"""Inputs of a sensitivity analysis: what each may be, and how they go together."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tilth.analysis.sensitivity.designs import ParameterBox

Array = NDArray[np.float64]
Outputs = Callable[[Array], Array]
"""Of points (n, k): (n, m), NaN in rows that have no answer."""


class Inputs(NamedTuple):
    """Marginals, and how the normal scores of inputs are correlated (None: they are not).

    Either a box, uniform between its ends, or medians with sds of logarithms.
    """

    names: tuple[str, ...]
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    median: tuple[float, ...] = ()
    log_sd: tuple[float, ...] = ()
    correlation: tuple[tuple[float, ...], ...] | None = None

    def of_scores(self, scores: Array) -> Array:
        """Points, (n, k), of normal scores."""
        if self.median:
            return np.asarray(np.array(self.median) * np.exp(scores * np.array(self.log_sd)))
        low, high = np.array(self.low), np.array(self.high)
        return np.asarray(low + (high - low) * ndtr(scores))


def of_box(box: ParameterBox) -> Inputs:
    """Independent and uniform."""
    return Inputs(box.names, box.low, box.high)


def of_covariance(names: Sequence[str], median: Sequence[float], log_covariance: Array) -> Inputs:
    """Log-normal. Raises ValueError where the covariance is not positive definite."""
    covariance = np.asarray(log_covariance, dtype=np.float64)
    if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance)[0] <= 0:
        raise ValueError("the covariance is not positive definite; give one that is")
    sds = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sds, sds)
    apart = np.abs(correlation - np.eye(len(sds))).max() < 1e-12
    rows = None if apart else tuple(map(tuple, correlation.tolist()))
    return Inputs(tuple(names), median=tuple(median), log_sd=tuple(sds.tolist()), correlation=rows)
