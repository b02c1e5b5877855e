"""Detects a recent change of soil: compares a filter's posterior of the six with checkpoints of the last
seconds.

Without a change, the mean moves by a normal variable with covariance P0 - P1, where P0 is the covariance at
the checkpoint and P1 the present one. A change c along a direction d moves it by c (P0 - P1) P0^-1 d in
addition. The statistic is the likelihood ratio of the best c against c = 0, a chi-square with one degree of
freedom.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.priors import PRIOR
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]

DIRECTIONS: Final = np.array(
    [[1, 1, 1, 0, 0, 0], [1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0]], float
)
"""Directions of a change in the six logarithms: all stiffnesses together, or one of them."""


@dataclass(frozen=True, slots=True)
class SoilChangeTuning:
    """What counts as a change of soil."""

    changed: float = tuned(32.0, "chi^2", "of the likelihood ratio, above which the soil has changed")
    """In 1.6 h of steering over uneven ground without a change the largest was 21."""
    rough_share: float = tuned(4.0, "1", "by which the limit rises on rough ground, times (uneven / rough)^4")
    """The side forces wander with the loads of the wheels, by shares that go with the square of it. On ground
    of 3 cm rms the largest ratio without a change was 60, on 1 cm 28."""
    least_change: float = tuned(0.15, "1", "of a logarithm: the drift follows smaller changes")
    most_change: float = tuned(1.6, "1", "of a logarithm: no soil changes by more than five times")
    known_sd: float = tuned(0.2, "1", "largest sd of a logarithm before, for its change to be detected")
    most_checkpoints: int = tuned(10, "checkpoints", "that are stored, 4 s")
    soil_sd: float = tuned(0.4, "1", "of a stiffness' logarithm, by which other soil changes it")
    common: float = tuned(0.8, "1", "share of that variance that all axles have in common")
    couples: float = tuned(0.05, "1", "of a logarithm, by which another mass moves what it should not")
    rounding: float = tuned(1e-3, "1", "of a logarithm: less cannot be told apart")
    sure: float = tuned(math.log(20.0), "nat", "likelier by which the one change is told from the other")
    loaded: float = tuned(math.log(40.0), "nat", "likelier than no change, from which another load is told")
    checkpoint_segments: int = tuned(2, "segments", "between two of them")


SOIL_CHANGE: Final = SoilChangeTuning()

LARGEST_VARIANCES: Final = np.square(SOIL_CHANGE.known_sd * DIRECTIONS.sum(axis=1))


@dataclass(slots=True)
class Checkpoint:
    """The posterior of the six logarithms at an earlier time, drifted since then."""

    mean: Array  # [6]
    covariance: Array  # [6, 6]


@dataclass(frozen=True, slots=True)
class Change:
    """The likeliest change of the six logarithms."""

    ratio: float  # twice the logarithm of its likelihood ratio
    logs: Array  # [6]
    since: Checkpoint


def limit(uneven: float) -> float:
    """The ratio above which the soil has changed. uneven: sd of how far the ground turns wheels, rad."""
    return SOIL_CHANGE.changed * (1.0 + SOIL_CHANGE.rough_share * (uneven / PRIOR.rough) ** 4)


def likeliest_change(checkpoints: list[Checkpoint], mean: Array, covariance: Array) -> Change | None:
    """The likeliest change since any of the checkpoints; None if no change is large enough.

    mean (6,), covariance (6, 6): the present ones.
    """
    if not checkpoints:
        return None
    before = np.array([checkpoint.covariance for checkpoint in checkpoints])
    known = ((DIRECTIONS @ before) * DIRECTIONS).sum(axis=2) < LARGEST_VARIANCES  # [k, d]
    if not known.any():
        return None
    weights = np.linalg.solve(before, DIRECTIONS.T[None])  # [k, 6, d]
    change = mean - np.array([checkpoint.mean for checkpoint in checkpoints])
    score = (weights * change[:, :, None]).sum(axis=1)
    information = (weights * (DIRECTIONS.T - covariance @ weights)).sum(axis=1)
    valid = known & (np.abs(score) > SOIL_CHANGE.least_change * information) & (information > 0.0)
    if not valid.any():
        return None
    likeliest = score / np.where(valid, information, 1.0)
    likeliest = np.minimum(np.maximum(likeliest, -SOIL_CHANGE.most_change), SOIL_CHANGE.most_change)
    ratio = np.where(valid, likeliest * (2.0 * score - likeliest * information), 0.0)
    k, d = np.unravel_index(np.argmax(ratio), ratio.shape)
    return Change(float(ratio[k, d]), likeliest[k, d] * DIRECTIONS[d], checkpoints[k])


class Odds(NamedTuple):
    """Logarithms of how much likelier a change makes it than none, that a posterior's mean has moved so."""

    load: float  # of the implement's load
    soil: float  # which changes all stiffnesses together, and each axle's a little besides

    @property
    def of_load(self) -> float:
        """The one against the other."""
        return self.load - self.soil


def odds(before: tuple[Array, Array], after: tuple[Array, Array], by_load: Array, without: Array) -> Odds:
    """before, after: mean, (6,), and covariance, (6, 6). by_load: (6, 6), covariance of the six by another
    load;
    without: (6, 6), of what moves besides without any change."""
    answer = np.eye(6) - np.linalg.solve(before[1], after[1]).T
    by_chance = (answer @ before[1] + (answer @ before[1]).T) / 2.0
    values, vectors = np.linalg.eigh(by_chance)
    by_chance = (vectors * np.maximum(values, SOIL_CHANGE.rounding**2)) @ vectors.T + without
    soil, share = np.zeros((6, 6)), SOIL_CHANGE.common
    soil[:3, :3] = SOIL_CHANGE.soil_sd**2 * (share + (1.0 - share) * np.eye(3))
    couples = np.diag([SOIL_CHANGE.couples**2] * 6)
    likelihoods = []
    for change in (np.zeros((6, 6)), by_load + couples, soil + couples):
        total = by_chance + answer @ change @ answer.T
        moved = after[0] - before[0]
        determinant = float(np.linalg.slogdet(total)[1])
        likelihoods.append(-0.5 * (float(moved @ np.linalg.solve(total, moved)) + determinant))
    return Odds(likelihoods[1] - likelihoods[0], likelihoods[2] - likelihoods[0])
