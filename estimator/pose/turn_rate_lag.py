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

from tilth.estimator.state_json import NOT_STORED
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TurnRateLagTuning:
    """Whether a receiver's turn rate is smoothed, or only late."""

    bias_sd: float = tuned(0.01, "rad/s", "sd of the constant error of a turn rate")
    least_heading_sd: float = tuned(0.003, "rad", "of a heading change, even if the residuals are smaller")
    intervals_for_residuals: int = tuned(12, "intervals", "needed to take the noise from the residuals")
    shared_ends: float = tuned(1.5, "1", "by which the variance is larger than of independent intervals")
    """Where an interval ends the next one begins: errors of heading and of rate there are in both, with the
    other sign, so that the sum of their products varies by so much more than if intervals were
    independent."""
    smoothed_s: float = tuned(0.25, "s", "a larger lag is smoothing, not latency")
    delayed_s: float = tuned(0.1, "s", "so much delay is usual, and learned as an unknown of the filters")
    sure: float = tuned(4.5, "sd", "beyond it")


TURN_RATE_LAG: Final = TurnRateLagTuning()


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
    found: tuple[float, float] | None = field(default=None, metadata=NOT_STORED)
    """(tau, its sd), s, of the present sums, where it has been asked for."""


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
    lag.found = None


def time_constant(lag: Lag) -> tuple[float, float]:
    """(tau, its sd), s, of a turn rate: asked at each pose, it changes with each interval."""
    if lag.found is None:
        lag.found = _time_constant(lag)
    return lag.found


def _time_constant(lag: Lag) -> tuple[float, float]:
    weights = np.array([0.0, _variance(lag, None) / TURN_RATE_LAG.bias_sd**2])
    information = lag.information + np.diag(weights) + 1e-9 * np.eye(2)
    found: Array = np.asarray(np.linalg.solve(information, lag.vector), np.float64)
    variance = TURN_RATE_LAG.shared_ends * _variance(lag, found)
    return float(found[0]), math.sqrt(variance * np.linalg.inv(information)[0, 0])


def _variance(lag: Lag, found: Array | None) -> float:
    """Variance of one heading change, rad^2: by the machine file, or by the residuals once there are enough.

    found: (tau, bias), or None before the regression.
    """
    stated_variance = max(lag.stated_variance / max(lag.intervals, 1), TURN_RATE_LAG.least_heading_sd**2)
    if found is None or lag.intervals < TURN_RATE_LAG.intervals_for_residuals:
        return stated_variance
    residual_squares = lag.squares - 2 * found @ lag.vector + found @ lag.information @ found
    return max(float(residual_squares) / (lag.intervals - 2), TURN_RATE_LAG.least_heading_sd**2)


def update_verdict(lag: Lag) -> None:
    """Set `smoothed` once the lag is certain; reset it once there clearly is none."""
    if lag.intervals:
        tau, sd = time_constant(lag)
        found = tau > TURN_RATE_LAG.smoothed_s and tau > TURN_RATE_LAG.delayed_s + TURN_RATE_LAG.sure * sd
        lag.smoothed = found or (lag.smoothed and tau > TURN_RATE_LAG.smoothed_s / 2)


def settled(lag: Lag) -> bool:
    """Whether it is decided: there is a lag, or none that matters."""
    tau, sd = time_constant(lag)
    return lag.smoothed or tau + 2.0 * sd < 2.0 * TURN_RATE_LAG.smoothed_s
