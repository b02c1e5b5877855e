"""How much later than the machine file says does each receiver report?

Receivers on one rigid body have a fixed distance, and both bodies meet at the hitch. At speed u a timing
error τ shifts a point by −u τ along its path. So measured distances show the *differences* of latency to a
few milliseconds once the rig moves. A latency that all four share cannot be observed here; it stays as
uncertain as the machine file says.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.rig.residuals import CRUISE

Array = NDArray[np.float64]

CORRELATED_POSES = 25.0  # poses (5 s) whose position errors count as one, since multipath is not white
DRIFT_RATE = 0.5e-3  # s per sqrt(s)
SURVEY_SD = 0.02  # m: error of a surveyed distance, never averaged away
GATE = 5.0  # sd
PRIOR_CORRELATION = 0.5  # of two receivers' latencies in the machine file: often all come from one guess


@dataclass(slots=True)
class Latency:
    """Latencies beyond those of the machine file, in the order of flow.Mount."""

    tau: Array = field(default_factory=lambda: np.zeros(4))  # [4] s
    covariance: Array = field(default_factory=lambda: np.zeros((4, 4)))  # [4, 4] s^2

    def excess_ns(self, receiver: int) -> int:
        return round(float(self.tau[receiver]) * 1e9)

    def drift(self, seconds: float) -> None:
        """Random walk of the differences; not of the common latency, which could not be learned again."""
        self.covariance += (np.eye(4) - 0.25) * (DRIFT_RATE**2 * min(seconds, 10.0))

    def update(self, row: Array, ahead: float, sd: float, speed: float) -> None:
        """Scalar Kalman update of τ with the measurement `row` · τ = −ahead / speed.

        row: (4,). ahead: how far the points of positive weight are ahead of their place by the geometry, m.
        sd: of one such distance, m. speed: along the path, m/s, negative in reverse.
        """
        if abs(speed) < CRUISE:
            return
        innovation = -ahead / speed
        cross = self.covariance @ row
        variance = float(row @ cross) + (CORRELATED_POSES * sd**2 + SURVEY_SD**2) / speed**2
        if innovation**2 > GATE**2 * variance:
            return
        self.tau += cross * (innovation / variance)
        self.covariance -= np.outer(cross, cross) / variance

    def sd_difference(self, one: int, other: int, speed: float) -> float:
        """Sd of τ_one − τ_other, s, including the error of the survey."""
        p = self.covariance
        variance = float(p[one, one] + p[other, other] - 2 * p[one, other])
        return math.sqrt(max(variance, 0.0) + (SURVEY_SD / max(abs(speed), CRUISE)) ** 2)

    def sd_mean(self, receivers: list[int]) -> float:
        """Sd of the mean τ of these receivers, s."""
        return math.sqrt(max(float(np.mean(self.covariance[np.ix_(receivers, receivers)])), 0.0))


def prior(sds: list[float]) -> Latency:
    """The machine file's latencies, before any motion. sds: (4,), s."""
    correlation = PRIOR_CORRELATION + (1 - PRIOR_CORRELATION) * np.eye(4)
    return Latency(covariance=correlation * np.outer(sds, sds))
