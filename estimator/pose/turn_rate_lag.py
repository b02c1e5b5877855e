"""By how much a receiver's turn rate lags behind the heading of the body that it stands on.

A turn rate that is smoothed by a time tau lags: tau r_s' + r_s = r. Over an interval that is
(heading change) − ∫ r_s dt = tau (change of r_s) + bias · time, a straight line, so that tau and its sd come
from a regression; of a mean over a time T it finds about T/2. The heading is that of the body's two antennas,
or one that the receiver reports itself.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BIAS_SD: Final = 0.01  # rad/s, of a turn rate
LEAST_HEADING_SD: Final = 0.003  # rad: of a heading change, however well the line fits
FROM_RESIDUALS: Final = 12  # intervals from which on their spread tells the noise
SMOOTHED_S: Final = 0.25  # a lag beyond this is no latency
SURE: Final = 4.5  # sds


@dataclass(slots=True)
class Lag:
    """Of one receiver's turn rate: sums of the regression of heading change on (rate change, time)."""

    information: Array = field(default_factory=lambda: np.zeros((2, 2)))
    vector: Array = field(default_factory=lambda: np.zeros(2))
    squares: float = 0.0  # rad^2
    stated: float = 0.0  # sum of the variances that the file would have, rad^2
    intervals: int = 0
    integral: float = 0.0  # of the rate since the interval began, rad
    rate: float = 0.0  # at the last pose, rad/s
    first_rate: float = 0.0  # where the interval began
    poses: int = -1  # since the interval began; -1: none has begun
    smoothed: bool = False


def regress(lag: Lag, change: float, seconds: float, sd_heading: float) -> None:
    """One interval: by how much the heading changed, rad, in so many s. sd_heading: of a heading, rad."""
    beyond = change - lag.integral
    row = np.array([lag.rate - lag.first_rate, seconds])
    if not (math.isfinite(beyond) and np.all(np.isfinite(row))):
        return
    lag.information += np.outer(row, row)
    lag.vector += row * beyond
    lag.squares += beyond**2
    lag.stated += 2 * sd_heading**2
    lag.intervals += 1


def time_constant(lag: Lag) -> tuple[float, float]:
    """(tau, its sd), s, of a turn rate."""
    weights = np.array([0.0, _variance(lag, None) / BIAS_SD**2])
    information = lag.information + np.diag(weights) + 1e-9 * np.eye(2)
    found: Array = np.asarray(np.linalg.solve(information, lag.vector), np.float64)
    variance = _variance(lag, found)
    return float(found[0]), math.sqrt(variance * np.linalg.inv(information)[0, 0])


def _variance(lag: Lag, found: Array | None) -> float:
    """Of one heading change, rad^2: as the file has it until there are enough to tell by their spread."""
    stated = max(lag.stated / max(lag.intervals, 1), LEAST_HEADING_SD**2)
    if found is None or lag.intervals < FROM_RESIDUALS:
        return stated
    left = lag.squares - 2 * found @ lag.vector + found @ lag.information @ found
    return max(float(left) / (lag.intervals - 2), LEAST_HEADING_SD**2)


def judge(lag: Lag) -> None:
    """A lag is found once it is sure, and stays until it is clearly none."""
    if lag.intervals:
        tau, sd = time_constant(lag)
        found = tau > SMOOTHED_S and tau > SURE * sd
        lag.smoothed = found or (lag.smoothed and tau > SMOOTHED_S / 2)


def settled(lag: Lag) -> bool:
    """Whether it is known that there is a lag, or that there is none worth the name."""
    tau, sd = time_constant(lag)
    return lag.smoothed or tau + 2.0 * sd < 2.0 * SMOOTHED_S
