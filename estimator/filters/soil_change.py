"""Has the soil changed lately? What a recursive filter knew of the six a while ago, and what it knows now.

While nothing changes, a filter's mean moves by a normal variable of covariance P0 - P1, those of then and
now; a change c along a direction d moves it by c (P0 - P1) P0^-1 d as well. The statistic is the likelihood
ratio of the best c against none, a chi-square of one degree of freedom.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DIRECTIONS: Final = np.array(
    [[1, 1, 1, 0, 0, 0], [1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0]], float
)
"""Of the six logarithms: all stiffnesses together, or one."""
CHANGED: Final = 32.0
"""Twice the logarithm of the likelihood ratio: in 1.6 h of steering over uneven ground
without a change the largest was 21."""
LEAST_CHANGE: Final = 0.15  # of a logarithm: a smaller one is left to the drift
KNOWN: Final = 0.2  # sd of a direction's logarithm before which nothing was known that could change
MARKS: Final = 10  # kept, one in EVERY stretches: 4 s
EVERY: Final = 2


@dataclass(slots=True)
class Mark:
    """What was known of the six at a time, and has drifted since."""

    mean: Array  # [6]
    covariance: Array  # [6, 6]


@dataclass(frozen=True, slots=True)
class Change:
    """The likeliest change of the six logarithms, and its likelihood ratio."""

    ratio: float
    logs: Array  # [6]


def likeliest(marks: list[Mark], mean: Array, covariance: Array) -> Change | None:
    """The likeliest change since one of the marks; None where there is none to speak of."""
    if not marks:
        return None
    before = np.array([mark.covariance for mark in marks])
    known = np.sqrt(np.einsum("di,kij,dj->kd", DIRECTIONS, before, DIRECTIONS))
    weights = np.linalg.solve(before, DIRECTIONS.T[None])  # [k, 6, d]
    change = mean - np.array([mark.mean for mark in marks])
    score = np.einsum("kid,ki->kd", weights, change)
    information = np.einsum("kid,di->kd", weights, DIRECTIONS)
    information -= np.einsum("kid,ij,kjd->kd", weights, covariance, weights)
    sound = (known < KNOWN * DIRECTIONS.sum(axis=1)) & (np.abs(score) > LEAST_CHANGE * information)
    sound &= information > 0.0
    if not sound.any():
        return None
    ratio = np.where(sound, score**2 / np.where(sound, information, 1.0), 0.0)
    k, d = np.unravel_index(np.argmax(ratio), ratio.shape)
    return Change(float(ratio[k, d]), score[k, d] / information[k, d] * DIRECTIONS[d])
