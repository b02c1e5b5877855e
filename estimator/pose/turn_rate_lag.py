"""By how much does a receiver's turn rate lag behind the heading of its body?

A turn rate r_s that is smoothed with the time constant tau lags: tau r_s' + r_s = r. Integrated over an
interval this is (heading change) − ∫ r_s dt = tau (change of r_s) + bias · time. It is linear, so tau and its
sd come from a regression. For a moving mean over a time T the result is about T/2. The heading is that of the
body's two antennas, or the one that the receiver reports.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BIAS_SD: Final = 0.01  # rad/s, of a turn rate
LEAST_HEADING_SD: Final = 0.003  # rad, of a heading change, even if the residuals are smaller
INTERVALS_FOR_RESIDUALS: Final = 12  # intervals needed to take the noise from the residuals
SHARED_ENDS: Final = 1.5
"""Where an interval ends the next one begins: errors of heading and of rate there are in both, with the other
sign, so that the sum of their products varies by so much more than if intervals were independent."""
SMOOTHED_S: Final = 0.25  # s: a larger lag is smoothing, not latency
DELAYED_S: Final = 0.1  # s: so much delay is usual, and learned (unknowns.NAMES, rate_late)
SURE: Final = 4.5  # sds, beyond it


@dataclass(slots=True)
class Lag:
    """One receiver's turn rate: sums of the regression of heading changes on (change of rate, time)."""

    information: Array = field(default_factory=lambda: np.zeros((2, 2)))
    vector: Array = field(default_factory=lambda: np.zeros(2))
    squares: float = 0.0  # of the heading changes minus the integrals, rad^2
    stated_variance: float = 0.0  # sum of their variances by the machine file, rad^2
    intervals: int = 0
    integral: float = 0.0  # of the rate since the interval began, rad
    rate: float = 0.0  # at the last pose, rad/s
    first_rate: float = 0.0  # where the interval began
    poses: int = -1  # since the interval began; -1: none has begun
    smoothed: bool = False


def regress(lag: Lag, change: float, seconds: float, sd_heading: float) -> None:
    """Add one interval of so many seconds. change: of the heading, rad. sd_heading: of one heading, rad."""
    excess = change - lag.integral
    row = np.array([lag.rate - lag.first_rate, seconds])
    if not (math.isfinite(excess) and np.all(np.isfinite(row))):
        return
    lag.information += np.outer(row, row)
    lag.vector += row * excess
    lag.squares += excess**2
    lag.stated_variance += 2 * sd_heading**2
    lag.intervals += 1


def time_constant(lag: Lag) -> tuple[float, float]:
    """(tau, its sd), s, of a turn rate."""
    weights = np.array([0.0, _variance(lag, None) / BIAS_SD**2])
    information = lag.information + np.diag(weights) + 1e-9 * np.eye(2)
    found: Array = np.asarray(np.linalg.solve(information, lag.vector), np.float64)
    variance = SHARED_ENDS * _variance(lag, found)
    return float(found[0]), math.sqrt(variance * np.linalg.inv(information)[0, 0])


def _variance(lag: Lag, found: Array | None) -> float:
    """Variance of one heading change, rad^2: by the machine file, or by the residuals once there are enough.

    found: (tau, bias), or None before the regression.
    """
    stated_variance = max(lag.stated_variance / max(lag.intervals, 1), LEAST_HEADING_SD**2)
    if found is None or lag.intervals < INTERVALS_FOR_RESIDUALS:
        return stated_variance
    residual_squares = lag.squares - 2 * found @ lag.vector + found @ lag.information @ found
    return max(float(residual_squares) / (lag.intervals - 2), LEAST_HEADING_SD**2)


def update_verdict(lag: Lag) -> None:
    """Set `smoothed` once the lag is certain; reset it once there clearly is none."""
    if lag.intervals:
        tau, sd = time_constant(lag)
        found = tau > SMOOTHED_S and tau > DELAYED_S + SURE * sd
        lag.smoothed = found or (lag.smoothed and tau > SMOOTHED_S / 2)


def settled(lag: Lag) -> bool:
    """Whether it is decided: there is a lag, or none that matters."""
    tau, sd = time_constant(lag)
    return lag.smoothed or tau + 2.0 * sd < 2.0 * SMOOTHED_S
