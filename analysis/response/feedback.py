"""Whether whoever steered reacted to the rig: then a measured response is biased.

Under feedback, what the ground does to the rig comes back in the wheel angle, and the estimated response is
pulled towards minus one over the controller's. The test: do residuals, measured less simulated, of the past
second help to predict the wheel angle beyond what its own past says? Wheel angles planned beforehand cannot
follow residuals.

Source: Granger's test of causality, from outputs to input; F test of a regression. The own past is longer
than that of the residuals by what a rig remembers, so that an error of the model raises no alarm.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

Array = NDArray[np.float64]

BLOCK_S: Final = 0.2  # means over this time: a steering valve answers no faster
RESIDUAL_LAGS: Final = 5  # blocks: 1 s
INPUT_LAGS: Final = 20  # blocks: 4 s
ALARM: Final = 0.001  # a false alarm in a thousand drives
SHARE: Final = 0.03  # of the wheel angle's news that residuals must predict: a wheel sensor's noise shows too


@dataclass(frozen=True, slots=True)
class LoopCheck:
    """What is known of feedback from the rig's motion to the wheel angle."""

    closed: bool
    p_value: float | None  # of the F test; None where it was not done
    share: float | None  # of the variance of the wheel angle's news that past residuals predict
    sentence: str


def check_loop(
    wheel_angle: Array, residuals: Array, dt: float, *, automatic: bool | None = None
) -> LoopCheck:
    """Test for feedback.

    wheel_angle: (n,), rad. residuals: (n, p), measured less simulated outputs, any units. NaN is a gap.
    dt: s. automatic: whether a guidance system steered, where that is known; True needs no test.
    """
    if automatic:
        return LoopCheck(
            True, None, None,
            "A guidance system steered: it reacts to the rig, so the measured response is biased. Steer "
            "by plan, or judge the models by simulation only.",
        )  # fmt: skip
    found = predicted_by(_block_means(wheel_angle[:, None], dt), _block_means(residuals, dt))
    if found is None:
        return LoopCheck(
            False, None, None, "The drive is too short to tell whether the steering reacted to the rig."
        )
    p_value, share = found
    closed = p_value < ALARM and share > SHARE
    if closed:
        sentence = (
            f"The wheels followed the rig's motion of the second before (past residuals predict "
            f"{100 * share:.0f} % of what is new in the wheel angle, p = {p_value:.1g}): somebody or "
            "something steered by what the rig did, and the measured response is biased."
        )
    else:
        sentence = "Nothing says that the steering reacted to the rig."
    return LoopCheck(closed, p_value, share, sentence)


def predicted_by(u: Array, e: Array) -> tuple[float, float] | None:
    """(probability of the F test, share of the one-step prediction error of u that past e takes away).

    u: (n, 1), e: (n, p), on one clock, NaN in gaps. The share is adjusted for the number of regressors. None
    where there are not three times as many rows as regressors, or nothing varies.
    """
    own, other = _lagged(u, INPUT_LAGS), _lagged(e, RESIDUAL_LAGS)
    target = u[INPUT_LAGS:, 0]
    rows = np.isfinite(target) & np.isfinite(own).all(axis=1) & np.isfinite(other).all(axis=1)
    regressors = 1 + own.shape[1] + other.shape[1]
    if int(rows.sum()) < 3 * regressors:
        return None
    own = np.hstack([np.ones((int(rows.sum()), 1)), _scaled(own[rows])])
    without, rank = _unexplained(own, target[rows])
    within, more = _unexplained(np.hstack([own, _scaled(other[rows])]), target[rows])
    left = len(own) - more
    if more == rank or without <= 0.0 or within <= 0.0:
        return None
    ratio = (without - within) / (more - rank) / (within / left)
    share = 1.0 - within / left / (without / (len(own) - rank))
    return float(fdtrc(more - rank, left, ratio)), share


def _lagged(values: Array, lags: int) -> Array:
    """What was 1 … lags samples before samples INPUT_LAGS … n-1, shape (n - INPUT_LAGS, lags c)."""
    n = len(values)
    return np.hstack([values[INPUT_LAGS - lag : max(n - lag, 0)] for lag in range(1, lags + 1)])


def _scaled(columns: Array) -> Array:
    centred = columns - columns.mean(axis=0)
    size = np.sqrt(np.mean(centred**2, axis=0))
    return np.asarray(centred / np.where(size > 0.0, size, 1.0))


def _unexplained(regressors: Array, target: Array) -> tuple[float, int]:
    """(sum of squares that a regression leaves, rank of the regressors)."""
    solution, _, rank, _ = np.linalg.lstsq(regressors, target, rcond=1e-9)
    return float(np.sum((target - regressors @ solution) ** 2)), int(rank)


def _block_means(values: Array, dt: float) -> Array:
    """Means over BLOCK_S, shape (blocks, c); NaN where a sample is missing. values: (n, c)."""
    size = max(1, round(BLOCK_S / dt))
    whole = len(values) // size * size
    return np.asarray(values[:whole].reshape(-1, size, values.shape[1]).mean(axis=1))
