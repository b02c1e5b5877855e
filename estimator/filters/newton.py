"""Newton's method towards the maximum of a posterior: what all searches for one have in common."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Final, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.likelihood import inverse
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]
At = TypeVar("At")


@dataclass(frozen=True, slots=True)
class NewtonTuning:
    """How a step that does not lower the cost is damped."""

    first_damping: float = tuned(1e-3, "1", "of the information's diagonal, at the beginning")
    more: float = tuned(30.0, "1", "factor on the damping of a step that does not lower the cost")
    most_shrunk: float = tuned(-0.45, "1", "of a logarithm of an sd, that Newton's step is taken for at most")
    beside: float = tuned(3.0, "sd", "from where a search has ended, to look for another place")
    least_rise: float = tuned(0.3, "1", "of the cost there, by the curvature: less, and there may be one")
    """Of 21 windows of five rigs of the fleet the least was 0.56."""
    same_place: float = tuned(1.0, "sd", "that two searches for one place end apart at most")
    as_likely: float = tuned(3.0, "nat", "that the cost differs between two places of which either may be")


NEWTON: Final = NewtonTuning()


class NewtonStep(NamedTuple):
    """From where gradient and information are of."""

    change: Array  # (a,), of the unknowns
    sds: Array  # (a,), posterior ones by the information, to see how far that is


class StepTaken(NamedTuple):
    """The step before."""

    newton: Array  # (a,), as Newton had it
    taken: Array  # (a,), as it was taken


class End(Enum):
    """How a search has ended."""

    SETTLED = "settled"  # by the rule of its problem
    STUCK = "stuck"  # no step lowers the cost
    OUT_OF_STEPS = "out of steps"


class Minimum(NamedTuple, Generic[At]):
    """Where a search has ended."""

    at: At
    steps: int
    end: End
    sizes: Array  # (a,), of its last step in posterior sds; if stuck, of the step that Newton would take
    promised: float  # nats by which Newton's last step should have lowered the cost


class Problem(Protocol[At]):
    """A cost in nats over a unknowns, as a search sees it. At: a point with all that is known there."""

    def terms(self, at: At) -> tuple[At, Array, Array]:
        """(the point with its derivatives, gradient (a,), information (a, a))."""
        ...

    def after(self, at: At, change: Array) -> At | None:
        """Where a change (a,) leads; None if the cost is not lower there."""
        ...

    def taken(self, step: int, at: At) -> At:
        """The point after so many steps, as the search goes on from it."""
        ...

    def settled(self, step: int, before: At, at: At, sizes: Array) -> bool:
        """Whether it may end there. sizes: (a,), of the last step, in posterior sds."""
        ...


class Rule(NamedTuple):
    """How a search changes its damping, and how far one step may go."""

    limits: Array  # (a,)
    each: bool  # whether each unknown is limited by itself, so that what runs away holds up no other
    less: float  # factor on the damping after a step that lowers the cost
    least: float
    most: float = math.inf  # so much is not tried
    tries: int = 100  # of a step, each with `more` damping than the one before
    at_once: bool = False  # lessen it only if the first try does
    moving: NDArray[np.bool_] | None = None  # (a,), which unknowns may move, all if None
    secant: bool = False  # whether a step back is shorter, as `not_back` says
    scales: Array | None = (
        None  # (a,), prior sds of those that are logarithms of sds, as `of_scales`; 0 of others
    )
    is_spared: Callable[[float, Array], bool] | None = None
    """Whether the search ends, after its first step, before one that promises so many nats and goes so far,
    (a,), posterior sds."""


def newton_step(
    gradient: Array,
    information: Array,
    *,
    moving: NDArray[np.bool_] | None = None,
    damping: float = 0.0,
    limits: Array | None = None,
    each: bool = False,
) -> NewtonStep:
    """The step to the minimum of a cost in nats, by its gradient (a,) and information (a, a).

    moving: (a,), which unknowns may move, all if None; the others are taken as known. damping: as by
    Levenberg and Marquardt, in shares of the information's diagonal. limits: (a,), how far one step may go; a
    longer one is shortened as a whole and keeps its direction, or each unknown by itself. Raises
    numpy.linalg.LinAlgError where data and prior leave something open.
    """
    free = np.ones(len(gradient), np.bool_) if moving is None else moving
    damped = information[np.ix_(free, free)]
    damped = damped + damping * np.diag(np.diag(damped))
    change = np.zeros(len(gradient))
    change[free] = np.linalg.solve(damped, -gradient[free])
    if limits is not None and each:
        change = np.clip(change, -limits, limits)
    elif limits is not None:
        change /= max(float(np.max(np.abs(change) / limits, initial=0.0)), 1.0)
    return NewtonStep(change, np.sqrt(np.diag(inverse(information))))


def flattest(covariance: Array, prior_sd: Array, told: NDArray[np.bool_]) -> Array:
    """A change of all unknowns, (a,), one posterior sd long, along which data have told least.

    covariance: (a, a), posterior. prior_sd: (a,). told: (a,), which unknowns are asked for; it is the least
    determined direction of these, with the others following.
    """
    within, sd = covariance[np.ix_(told, told)], prior_sd[told]
    direction = np.linalg.eigh(within / np.outer(sd, sd))[1][:, -1] * sd
    along = np.linalg.solve(within, direction)
    return np.asarray(covariance[:, told] @ along / math.sqrt(direction @ along), np.float64)


def beside(cost: Callable[[Array], float], direction: Array) -> Array | None:
    """A change, (a,), to where the cost, nats, has not risen as it should: another minimum may be near. None:
    there is no such sign. cost: by a change (a,), 0 without one. direction: as `flattest`."""
    tried = [(cost(step), step) for step in (-NEWTON.beside * direction, NEWTON.beside * direction)]
    rise, change = min(tried, key=lambda one: one[0] if math.isfinite(one[0]) else math.inf)
    return change if rise < NEWTON.least_rise * NEWTON.beside**2 / 2.0 else None


def are_two(sizes: Array, worse: float) -> bool:
    """Whether two searches have ended in two places of which either may be. sizes: how far they are apart,
    posterior sds. worse: nats between them."""
    return bool(np.max(np.abs(sizes)) > NEWTON.same_place) and worse < NEWTON.as_likely


def share_of_step(k: int, most: int) -> float:
    """Of Newton's step, that the k-th of at most `most` steps goes where no cost is seen to fall: the later
    ones are halved, so that a search that goes to and fro ends."""
    return 1.0 if k < most // 2 else 0.5


def minimise(problem: Problem[At], at: At, rule: Rule, most: int) -> Minimum[At]:
    """The minimum of a problem's cost from a point on, by at most so many damped steps, one or more."""
    damping, sizes, promised = NEWTON.first_damping, np.zeros(0), math.inf
    last: StepTaken | None = None
    for step in range(1, most + 1):
        at, gradient, information = problem.terms(at)
        newton, sds = newton_step(gradient, information, moving=rule.moving)
        promised = -float(gradient @ newton) / 2.0
        if step > 1 and rule.is_spared is not None and rule.is_spared(promised, np.abs(newton) / sds):
            return Minimum(at, step - 1, End.SETTLED, np.abs(newton) / sds, promised)
        descent = _descend(problem, at, gradient, information, rule, damping, last)
        change, then, damping = descent
        if then is None:
            return Minimum(at, step, End.STUCK, np.abs(newton) / sds, promised)
        last = StepTaken(newton, change) if rule.secant else None
        before, at, sizes = at, problem.taken(step, then), np.abs(change) / sds
        if problem.settled(step, before, at, sizes):
            return Minimum(at, step, End.SETTLED, sizes, promised)
    return Minimum(at, most, End.OUT_OF_STEPS, sizes, promised)


def _descend(
    problem: Problem[At], at: At, gradient: Array, information: Array, rule: Rule, damping: float,
    last: StepTaken | None,
) -> tuple[Array, At | None, float]:  # fmt: skip
    """(step, what is there after it, damping of the next one); None in the second place if no step lowers the
    cost."""
    for tried in range(rule.tries):
        more = damping * NEWTON.more**tried
        if more >= rule.most:
            break
        change, sds = newton_step(
            gradient, information, moving=rule.moving, damping=more, limits=rule.limits, each=rule.each
        )
        change = change if rule.scales is None else of_scales(change, sds, rule.scales)
        change = change if last is None else not_back(change, last, information)
        then = problem.after(at, change)
        if then is not None:
            kept = rule.at_once and tried > 0
            return change, then, more if kept else max(more * rule.less, rule.least)
    return np.zeros(len(gradient)), None, damping


def of_scales(change: Array, sds: Array, prior_sds: Array) -> Array:
    """Steps, (a,), for Newton's, where unknowns are logarithms of sds. By the information that is expected,
    such a step is half of what the variance would have to change by, in shares of itself; its logarithm is
    taken, as far as data tell of it. sds: posterior ones. prior_sds: 0 of other unknowns."""
    share = np.zeros(len(change))
    np.divide(sds, prior_sds, out=share, where=prior_sds > 0.0)
    share = np.where(prior_sds > 0.0, np.maximum(1.0 - share**2, 0.0), 0.0)
    logarithm = np.log1p(2.0 * np.maximum(change, NEWTON.most_shrunk)) / 2.0
    return np.asarray(change + share * (logarithm - change), np.float64)


def not_back(change: Array, last: StepTaken, information: Array) -> Array:
    """A step, (a,), that does not go to and fro.

    By the slopes, a share 1 - s of Newton's step is left after a share s of it was taken. Where a step goes
    back instead, the curvature along the one before is larger by a factor, and it is shorter there by that
    (a secant).
    """
    square = float(last.newton @ information @ last.newton)
    left, share = (float(one @ information @ last.newton) / square for one in (change, last.taken))
    if left >= 0.0 or share <= 0.0:
        return change
    factor = max((1.0 - left) / share, 1.0)
    return change + left * (1.0 / factor - 1.0) * last.newton
