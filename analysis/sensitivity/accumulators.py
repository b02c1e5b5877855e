"""What is kept of many values: count, mean, spread and quantiles, of constant size whatever their number.

Quantiles come from a histogram with fixed bins of the logarithm. Its counts add up exactly, in any order;
the sums are added in the order of the batches, so that results are the same whoever computed them.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PER_DECADE: Final = 200  # bins: a quantile is right to 0.6 %
LOWEST, HIGHEST = -8, 6  # powers of ten; what lies beyond counts in the bins at the ends
BINS: Final = (HIGHEST - LOWEST) * PER_DECADE


class Kept(NamedTuple):
    """Of k quantities. Values that are no number are in `lost` and nowhere else."""

    counted: NDArray[np.int64]  # (k,)
    lost: NDArray[np.int64]  # (k,)
    total: Array  # (k,)
    squares: Array  # (k,)
    bins: NDArray[np.int64]  # (k, BINS)


def nothing(k: int) -> Kept:
    """Of k quantities, no value yet."""
    none = np.zeros(k, np.int64)
    return Kept(none, none, np.zeros(k), np.zeros(k), np.zeros((k, BINS), np.int64))


def of(values: Array) -> Kept:
    """values: (n, k), not negative."""
    n, k = values.shape
    kept = Kept(np.zeros(k, np.int64), np.zeros(k, np.int64), np.zeros(k), np.zeros(k),
                np.zeros((k, BINS), np.int64))  # fmt: skip
    for column in range(k):  # one after the other, for memory
        good = values[np.isfinite(values[:, column]), column]
        at = np.floor((np.log10(np.maximum(good, 1e-300)) - LOWEST) * PER_DECADE).astype(np.int64)
        kept.bins[column] = np.bincount(np.clip(at, 0, BINS - 1), minlength=BINS)
        kept.counted[column], kept.lost[column] = len(good), n - len(good)
        with np.errstate(over="ignore"):  # an answer that grew without end: its mean is infinite, its rank is
            kept.total[column], kept.squares[column] = good.sum(), (good**2).sum()  # not lost
    return kept


def merged(a: Kept, b: Kept) -> Kept:
    """Of the values of both."""
    return Kept(
        a.counted + b.counted,
        a.lost + b.lost,
        a.total + b.total,
        a.squares + b.squares,
        a.bins + b.bins,
    )


def mean(kept: Kept) -> Array:
    """(k,); NaN where there is none."""
    with np.errstate(invalid="ignore"):
        return np.asarray(kept.total / kept.counted)


def spread(kept: Kept) -> Array:
    """Standard deviation, (k,)."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(np.sqrt(np.maximum(kept.squares / kept.counted - mean(kept) ** 2, 0.0)))


def quantile(kept: Kept, share: float) -> Array:
    """(k,), the geometric middle of the bin that holds it, zero in the lowest; NaN if there is no value."""
    found = np.full(len(kept.counted), np.nan)
    for k, bins in enumerate(kept.bins):
        if kept.counted[k]:
            at = int(np.searchsorted(np.cumsum(bins), share * kept.counted[k]))
            found[k] = 10 ** (LOWEST + (min(at, BINS - 1) + 0.5) / PER_DECADE) if at else 0.0
    return found
