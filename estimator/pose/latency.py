"""How much later than the machine file says does each receiver report?

Receivers on one rigid body keep their distance, and both bodies meet at the hitch. At speed u a timing
error of δ moves a point by −u δ along its path, so the measured distance tells the *differences* of latency
to a few milliseconds once the rig moves. What all four share cannot be seen here and stays as uncertain as
the machine file says.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLOWEST = 1.5  # m/s: below, distances say too little of time
CORRELATED = 25.0  # poses (5 s) whose position errors count as one: multipath is not white
DRIFT = 0.5e-3  # s per sqrt(s)
SURVEY = 0.02  # m: error of a surveyed distance, never averaged away
GATE = 5.0  # sd
SHARED = 0.5  # correlation of what the machine file says of two receivers: often one guess for all


@dataclass(slots=True)
class Latency:
    """Excess latency over the machine file's, s, in the order of flow.Mount."""

    tau: Array = field(default_factory=lambda: np.zeros(4))  # [4] s
    covariance: Array = field(default_factory=lambda: np.zeros((4, 4)))  # [4, 4] s^2

    def excess_ns(self, receiver: int) -> int:
        return round(float(self.tau[receiver]) * 1e9)

    def drift(self, seconds: float) -> None:
        """Let the differences wander; what all share could not be learned again."""
        self.covariance += (np.eye(4) - 0.25) * (DRIFT**2 * min(seconds, 10.0))

    def observe(self, row: Array, ahead: float, sd: float, speed: float) -> None:
        """Distances say that `row` · τ is off by −ahead / speed.

        row: [4]; ahead: how far the points of positive weight are ahead of where the geometry puts them, m;
        sd of one such observation, m; speed along the path, m/s, negative in reverse.
        """
        if abs(speed) < SLOWEST:
            return
        innovation = -ahead / speed
        cross = self.covariance @ row
        variance = float(row @ cross) + (CORRELATED * sd**2 + SURVEY**2) / speed**2
        if innovation**2 > GATE**2 * variance:
            return
        self.tau += cross * (innovation / variance)
        self.covariance -= np.outer(cross, cross) / variance

    def sd_difference(self, one: int, other: int, speed: float) -> float:
        """Sd of τ_one − τ_other, s, with the survey's share."""
        p = self.covariance
        variance = float(p[one, one] + p[other, other] - 2 * p[one, other])
        return math.sqrt(max(variance, 0.0) + (SURVEY / max(abs(speed), SLOWEST)) ** 2)

    def sd_mean(self, receivers: list[int]) -> float:
        """Sd of the mean τ of these receivers, s."""
        return math.sqrt(max(float(np.mean(self.covariance[np.ix_(receivers, receivers)])), 0.0))


def prior(sds: list[float]) -> Latency:
    """Before any motion: as the machine file says. sds: [4], s."""
    correlation = SHARED + (1 - SHARED) * np.eye(4)
    return Latency(covariance=correlation * np.outer(sds, sds))
