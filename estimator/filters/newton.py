"""A step of Newton's method towards the maximum of a posterior: what all searches for one have in common."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.likelihood import inverse

Array = NDArray[np.float64]


class NewtonStep(NamedTuple):
    """From where gradient and information are of."""

    change: Array  # (a,), of the unknowns
    sds: Array  # (a,), posterior ones by the information, to see how far that is


def newton_step(
    gradient: Array,
    information: Array,
    *,
    moving: NDArray[np.bool_] | None = None,
    damping: float = 0.0,
    limits: Array | None = None,
) -> NewtonStep:
    """The step to the minimum of a cost in nats, by its gradient (a,) and information (a, a).

    moving: (a,), which unknowns may move, all if None; the others are taken as known. damping: as by
    Levenberg and Marquardt, in shares of the information's diagonal. limits: (a,), how far one step may go; a
    longer one is shortened as a whole and keeps its direction. Raises numpy.linalg.LinAlgError where data and
    prior leave something open.
    """
    free = np.ones(len(gradient), np.bool_) if moving is None else moving
    damped = information[np.ix_(free, free)]
    damped = damped + damping * np.diag(np.diag(damped))
    change = np.zeros(len(gradient))
    change[free] = np.linalg.solve(damped, -gradient[free])
    if limits is not None:
        change /= max(float(np.max(np.abs(change) / limits, initial=0.0)), 1.0)
    return NewtonStep(change, np.sqrt(np.diag(inverse(information))))


def share_of_step(k: int, most: int) -> float:
    """Of Newton's step, that the k-th of at most `most` steps goes where no cost is seen to fall: the later
    ones are halved, so that a search that goes to and fro ends."""
    return 1.0 if k < most // 2 else 0.5
