"""How much later than the machine file says does each receiver report?

Receivers on one rigid body have a fixed distance, and both bodies meet at the hitch. At speed u a timing
error τ shifts a point by −u τ along its path. So measured distances show the *differences* of latency to a
few milliseconds once the rig moves. A latency that all four share cannot be observed here; it stays as
uncertain as the machine file says.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.driving import DRIVING
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LatencyTuning:
    """How receivers' latencies are learned from the distances between them."""

    correlated_poses: float = tuned(25.0, "poses", "with one position error (5 s): multipath is not white")
    drift_rate: float = tuned(0.5e-3, "s/s^0.5", "random walk of a latency")
    survey_sd: float = tuned(0.02, "m", "error of a surveyed distance, never averaged away")
    gate: float = tuned(5.0, "sd", "a larger innovation is an outlier")
    prior_correlation: float = tuned(0.5, "1", "of two latencies in the machine file: often one guess")


LATENCY: Final = LatencyTuning()
_DIFFERENCES: Final = np.eye(4) - 0.25  # of four from their mean


@dataclass(slots=True)
class Latency:
    """Latencies beyond those of the machine file, in the order of flow.Mount."""

    tau: Array = field(default_factory=lambda: np.zeros(4))  # [4] s
    covariance: Array = field(default_factory=lambda: np.zeros((4, 4)))  # [4, 4] s^2

    def excess_ns(self, receiver: int) -> int:
        return round(float(self.tau[receiver]) * 1e9)

    def drift(self, seconds: float) -> None:
        """Random walk of the differences; not of the common latency, which could not be learned again."""
        self.covariance += _DIFFERENCES * (LATENCY.drift_rate**2 * min(seconds, 10.0))

    def update(self, row: Array, ahead: float, sd: float, speed: float) -> None:
        """Scalar Kalman update of τ with the measurement `row` · τ = −ahead / speed.

        row: (4,). ahead: how far the points of positive weight are ahead of their place by the geometry, m.
        sd: of one such distance, m. speed: along the path, m/s, negative in reverse.
        """
        if abs(speed) < DRIVING.cruise:
            return
        innovation = -ahead / speed
        cross = self.covariance @ row
        variance = float(row @ cross) + (LATENCY.correlated_poses * sd**2 + LATENCY.survey_sd**2) / speed**2
        if innovation**2 > LATENCY.gate**2 * variance:
            return
        self.tau += cross * (innovation / variance)
        self.covariance -= cross[:, None] * cross / variance

    def sd_difference(self, one: int, other: int, speed: float) -> float:
        """Sd of τ_one − τ_other, s, including the error of the survey."""
        p = self.covariance
        variance = float(p[one, one] + p[other, other] - 2 * p[one, other])
        return math.sqrt(max(variance, 0.0) + (LATENCY.survey_sd / max(abs(speed), DRIVING.cruise)) ** 2)

    def sd_mean(self, receivers: list[int]) -> float:
        """Sd of the mean τ of these receivers, s."""
        every = self.covariance.take([4 * one + other for one in receivers for other in receivers])
        return math.sqrt(max(float(np.add.reduce(every)) / len(every), 0.0))


def prior(sds: list[float]) -> Latency:
    """The machine file's latencies, before any motion. sds: (4,), s."""
    correlation = LATENCY.prior_correlation + (1 - LATENCY.prior_correlation) * np.eye(4)
    return Latency(covariance=correlation * np.outer(sds, sds))
