"""Estimate of the unknowns over one record: maximum a posteriori by Fisher scoring with damped steps, then
with room for what the model of the ground has wrong.
"""

from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.contrast import Contrast, contrast_of
from tilth.estimator.filters.fit_covariance import published, whiteness
from tilth.estimator.filters.gates import outliers
from tilth.estimator.filters.likelihood import (
    Iterate,
    Search,
    apart_from_ground,
    evaluate,
    gradient,
    gradient_and_information,
    innovations,
    inverse,
    likelihood_at,
    negative_log_likelihood,
    once_for_a_search,
    posterior_cost,
    scores_at,
    search_of,
    with_gains,
)
from tilth.estimator.filters.newton import (
    End,
    Minimum,
    Rule,
    are_two,
    beside,
    flattest,
    minimise,
    newton_step,
)
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.soil_within import Pieces, pieces_of
from tilth.estimator.filters.unknowns import AT, NOISES
from tilth.estimator.record.record import Record
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SearchTuning:
    """When the search for the maximum goes on, and when it ends."""

    most_iterations: int = tuned(25, "iterations", "of a search")
    small_step: float = tuned(0.03, "sd", "of the posterior: a step this small ends the search")
    slack: float = tuned(0.2, "nat", "by which a step may raise the cost: derivatives are not exact")
    far_slack: float = tuned(
        10.0, "nat", "the same of `_apart`, whose equations are not quite the cost's slopes"
    )
    """So it only keeps a step from running away: held to 0.2, a search ended where its steps were refused."""
    rough_start: float = tuned(1.5, "1", "added at first to a disturbance's logarithm whose sd is above 1")
    """A search that begins with rough ground does not end in a local minimum."""
    flat_cost: float = tuned(
        0.05, "nat", "the search ends if the cost changes by less and `settled_step` holds"
    )
    roughly_flat: float = tuned(0.2, "nat", "the same of noise levels and roll modes before `_apart`")
    soon_flat: float = tuned(1.0, "nat", "the same of a search that only begins for these two")
    spared: float = tuned(
        0.5, "nat", "that a step is to promise, or to take the six further than `settled_step`"
    )
    settled_step: float = tuned(0.1, "sd", "of the posterior of the six")
    arrived_step: float = tuned(0.3, "sd", "of the six: remaining step of a stopped search that converged")
    steps_on_ground: int = tuned(
        1, "steps", "at most, of noise levels and roll modes: each is 7 runs and more"
    )
    steps_apart: int = tuned(8, "steps", "at most, of `_apart`")
    furthest: float = tuned(3.0, "sd", "of any of the six, by which `_apart` may leave the best likelihood")
    """A relaxation length that has become short enough has no effect any more: sigma_i came out at a tenth in
    one of 16 fields."""
    longest_step: float = tuned(0.7, "1", "of a logarithm of the six in one iteration")
    longest_share: float = tuned(1.5, "sd", "of the prior: the same of all else")
    empty_promise: float = tuned(
        5.0, "nat", "a search that ended though its derivatives promise more is stuck"
    )
    """They hold the gains. On side slopes one of 40 such fits took all steering for rough ground, 100 nats
    above the maximum."""
    tries: int = tuned(4, "tries", "of a step, each with more damping than the one before")
    least_damping: float = tuned(1e-4, "1", "with which the first try is damped")


SEARCH: Final = SearchTuning()

_DISTURBANCES: Final = slice(AT["push_t"], AT["push_yaw"] + 1)
_SCALES: Final = [AT[name] for name in NOISES if name != "memory"]  # logarithms of sds


@dataclass(frozen=True, slots=True)
class Posterior:
    """Result of a fit: the posterior of one record and a prior."""

    mean: Array  # [n] of unknowns.NAMES
    covariance: Array  # [n, n]
    likeliest: Array  # [n], where the search has ended: `mean` as if noise were white
    information: Array  # [n, n] of the record without the prior
    cost: float  # minimum, per row
    gain: float  # log-likelihood of the record at the prior's mean minus that at `reference`, nats
    iterations: int
    rows: int
    outliers: int
    whiteness: float  # autocorrelation of the normalised innovations at lag one, mean over the kinds
    converged: bool
    contrast: Contrast | None = None
    """With the estimate that needs no model of the ground, where it is asked for."""
    pieces: Pieces | None = None  # of its way, where `contrast` is
    two_places: bool = False  # whether another place, more than a sd away, is about as likely


def maximise_posterior(
    record: Record,
    setup: RigSetup,
    mean: Array,
    covariance: Array,
    reference: Array | None = None,
    start: Array | None = None,
    *,
    contrast: bool = False,
) -> Posterior:
    """The fit. mean [n], covariance [n, n]: the prior over unknowns.NAMES; one with zero variance stays
    fixed.

    reference: [n], a point to compare with the prior's mean on this record, which was used for neither
    (`gain`). start: [n], where the search begins, the prior's mean if None: it should end in the same place.
    contrast: whether that is asked for, and the pieces of its way.
    """
    search = search_of(record, setup, mean, covariance)
    point = (mean if start is None else start).copy()
    point[_DISTURBANCES] += np.where(np.diag(covariance)[_DISTURBANCES] > 1.0, SEARCH.rough_start, 0.0)
    first = evaluate(search, point, levels=True)
    gain = 0.0 if reference is None else _gain(search, reference, mean, first)
    ended, two_places = _in_one_place(search, _ended(search, first))
    found, information, counted, converged = ended.at, ended.information, ended.counted, ended.converged
    autocorrelation = whiteness(record.rows, search.scored, found.e, found.S)
    scores = scores_at(search, found)
    record_information = np.zeros_like(covariance)
    record_information[np.ix_(search.active, search.active)] = information - search.prior_information
    beside_it = contrast and converged and setup.scale == 1.0
    known = published(search, found.point, scores, inverse(counted), autocorrelation)
    return Posterior(
        *known, found.point, record_information,
        found.cost / max(len(record.rows), 1), gain, ended.steps, len(record.rows),
        int(np.sum(search.used == 0.0)), autocorrelation, converged,
        contrast_of(search, found, counted) if beside_it else None,
        pieces_of(search, found) if beside_it else None,
        two_places,
    )  # fmt: skip


class _Ended(NamedTuple):
    """Where the whole search has ended."""

    at: Iterate  # as apart_from_ground
    information: Array  # (a, a), of the record and the prior
    counted: Array  # (a, a), what apart_from_ground leaves of it
    cost: float  # without it
    steps: int
    converged: bool


def _ended(search: Search, first: Iterate) -> _Ended:
    """first: where the search begins."""
    found, steps, converged = _likeliest(search, first)
    _, information = gradient_and_information(search, found, scores_at(search, found))
    if search.setup.scale != 1.0:
        return _Ended(found, information, information, found.cost, steps, converged)
    there, settled = _apart(search, found)
    left, here = there.at.left, there.at.here
    steps += there.steps
    return _Ended(left, information, there.at.information, here.cost, steps, converged or settled)


def _in_one_place(search: Search, ended: _Ended) -> tuple[_Ended, bool]:
    """(the better one of two places, if there is a sign of another; whether either may be)."""
    if search.setup.scale != 1.0 or not np.any(search.active < 6):
        return ended, False
    covariance, six, point = inverse(ended.counted), search.active < 6, ended.at.point
    change = beside(
        lambda change: posterior_cost(search, _moved(search, point, change)) - ended.cost,
        flattest(covariance, search.prior_sd, six),
    )
    if change is None:
        return ended, False
    search.outliers_chosen = True  # costs over other rows could not be compared
    search.steering = None
    other = _ended(search, evaluate(search, _moved(search, point, change), levels=True))
    away = (other.at.point - point)[search.active] / np.sqrt(np.diag(covariance))
    two = other.converged and are_two(away[six], abs(other.at.cost - ended.at.cost))
    better = other if other.converged and other.at.cost < ended.at.cost else ended
    return better._replace(steps=ended.steps + other.steps), two


def _likeliest(search: Search, first: Iterate) -> tuple[Iterate, int, bool]:
    """(the likelihood's maximum, steps to it, whether it was found). first: where the search begins."""
    minimum = _maximum(_Likelihood(search), first)
    minimum = minimum._replace(at=_chosen(search, minimum.at))
    steps, linear = minimum.steps, search.setup.scale != 1.0
    stuck = minimum.end is End.OUT_OF_STEPS or minimum.promised > SEARCH.empty_promise
    if stuck or linear:
        # Along derivatives with gains held no step may lower the cost. Where `_apart` does not follow, the
        # maximum itself is asked for.
        minimum = _maximum(_Likelihood(search, Gains.ALL), minimum.at)
        steps += minimum.steps
    settled = minimum.end is End.SETTLED
    converged = settled or _arrived(minimum)
    if linear or (stuck and settled and minimum.promised < SEARCH.soon_flat):
        return minimum.at, steps, converged
    ground = _Likelihood(search, Gains.OF_ROLL, ~search.of_motion | search.of_roll, apart_next=True)
    settled_ground = _maximum(ground, minimum.at, SEARCH.steps_on_ground)
    return settled_ground.at, steps + settled_ground.steps, converged


def _gain(search: Search, reference: Array, mean: Array, first: Iterate) -> float:
    """By how many nats the record is likelier at the prior's mean than at a reference, (n,) each. first: a
    point that is known."""
    if np.array_equal(reference, mean):
        return 0.0
    known = np.array_equal(first.point, mean)
    at_mean = negative_log_likelihood(search, first.e, first.S) if known else likelihood_at(search, mean)
    return likelihood_at(search, reference) - at_mean


def leave_out_outliers(search: Search, point: Array) -> None:
    """Rows that are outliers at a point, (n,), count no more."""
    made = innovations(search.record, search.setup, search.start, point, used=search.used)
    _leave_out(search, made.e, made.S)


def _leave_out(search: Search, e: Array, S: Array) -> None:
    search.used = np.where(outliers(search.record.rows, e, S), 0.0, search.used)


class Gains(Enum):
    """Whose derivatives have in them what a change of the filter's gains does."""

    HELD = "held"  # none
    OF_ROLL = "of roll"  # those of the roll modes
    ALL = "all"  # those of the six, too


class _Likelihood(NamedTuple):
    """A search for the likelihood's maximum, as newton.Problem."""

    search: Search
    gains: Gains = Gains.HELD
    moving: NDArray[np.bool_] | None = None  # (a,), what is searched for, all if None
    apart_next: bool = False  # whether `_apart` goes on from where it ends

    def terms(self, at: Iterate) -> tuple[Iterate, Array, Array]:
        if self.gains is not Gains.HELD:
            at = with_gains(self.search, at, six=self.gains is Gains.ALL)
        return at, *gradient_and_information(self.search, at, scores_at(self.search, at))

    def after(self, at: Iterate, change: Array) -> Iterate | None:
        point = _moved(self.search, at.point, change)
        if self.apart_next:
            then = evaluate(self.search, point, at, once_for_a_search(self.search, point))
        else:
            then = evaluate(self.search, point, at, levels=True)
        return then if np.isfinite(then.cost) and then.cost <= at.cost + SEARCH.slack else None

    def taken(self, step: int, at: Iterate) -> Iterate:
        return _chosen(self.search, at) if step == 2 and self.gains is Gains.HELD else at

    def is_spared(self, promised: float, sizes: Array) -> bool:
        """Whether a next step, of so many nats and posterior sds, is left to those that follow."""
        six = float(np.max(sizes[self.search.active < 6], initial=0.0))
        return promised < SEARCH.spared and six < SEARCH.settled_step

    def settled(self, step: int, before: Iterate, at: Iterate, sizes: Array) -> bool:
        """Only the six must be settled: a noise level that has no effect may go to and fro."""
        change, six = abs(at.cost - before.cost), float(np.max(sizes[self.search.active < 6], initial=0.0))
        if self.moving is not None:
            return change < SEARCH.roughly_flat
        if self.search.setup.scale == 1.0:  # `_apart` follows
            return step > 1 and change < SEARCH.soon_flat and six < SEARCH.arrived_step
        flat = change < SEARCH.flat_cost and six < SEARCH.settled_step
        return step > 2 and (flat or float(np.max(sizes)) < SEARCH.small_step)


class _Place(NamedTuple):
    """A point of the search of `_Apart`."""

    here: Iterate
    left: Iterate  # as apart_from_ground
    information: Array  # (a, a), left too

    def along(self, search: Search, change: Array) -> "_Place":
        """After a small change, (a,), by the slopes."""
        cost = float(gradient(search, self.left, scores_at(search, self.left)) @ change) / 2.0
        here, left = (
            replace(
                one, point=_moved(search, one.point, change), e=one.e + change @ one.de,
                S=one.S + change @ one.dS, cost=one.cost + cost,
            )
            for one in (self.here, self.left)
        )  # fmt: skip
        return self._replace(here=here, left=left)


class _Apart(NamedTuple):
    """The search for the maximum with `apart_from_ground`, as newton.Problem, over what `moving` names."""

    search: Search
    moving: NDArray[np.bool_]

    def place(self, point: Array, before: Iterate) -> _Place:
        here = evaluate(self.search, point, before, once_for_a_search(self.search, point))
        return _Place(here, *apart_from_ground(self.search, here))

    def terms(self, at: _Place) -> tuple[_Place, Array, Array]:
        return at, gradient(self.search, at.left, scores_at(self.search, at.left)), at.information

    def after(self, at: _Place, change: Array) -> _Place | None:
        """A change that ends the search is taken along the slopes."""
        if self._ends(np.abs(change) / np.sqrt(np.diag(inverse(at.information)))):
            return at.along(self.search, change)
        then = self.place(_moved(self.search, at.here.point, change), at.here)
        good = np.isfinite(then.here.cost) and then.left.cost <= at.left.cost + SEARCH.far_slack
        return then if good else None

    def taken(self, step: int, at: _Place) -> _Place:
        return at

    def settled(self, step: int, before: _Place, at: _Place, sizes: Array) -> bool:
        return self._ends(sizes)

    def _ends(self, sizes: Array) -> bool:
        return float(np.max(sizes[self.search.active < 6], initial=0.0)) < SEARCH.settled_step


def _moved(search: Search, point: Array, change: Array) -> Array:
    there = point.copy()
    there[search.active] += change
    return there


def _rule(search: Search, moving: NDArray[np.bool_] | None) -> Rule:
    limits = _step_limits(search)
    return Rule(
        limits, False, 0.2, SEARCH.least_damping, tries=SEARCH.tries, at_once=True, moving=moving,
        secant=True, scales=np.where(np.isin(search.active, _SCALES), search.prior_sd, 0.0),
    )  # fmt: skip


def _maximum(problem: _Likelihood, at: Iterate, most: int = SEARCH.most_iterations) -> Minimum[Iterate]:
    """The likelihood's maximum, from a starting point."""
    rule = _rule(problem.search, problem.moving)
    if problem.search.setup.scale == 1.0 and problem.gains is Gains.HELD:  # steps on the ground follow
        rule = rule._replace(is_spared=problem.is_spared)
    return minimise(problem, at, rule, most)


def _arrived(minimum: Minimum[Iterate]) -> bool:
    """Whether no more than a small step remains of a search that no step takes further."""
    return minimum.end is End.STUCK and bool(np.max(minimum.sizes) < SEARCH.arrived_step)


def _apart(search: Search, at: Iterate) -> tuple[Minimum[_Place], bool]:
    """(the likelihood's maximum with `apart_from_ground`, whether it was found). Noise levels and roll modes
    stay."""
    problem = _Apart(search, search.of_motion & ~search.of_roll)
    answered = len(at.instrument_response) > 0
    start = _Place(at, *apart_from_ground(search, at)) if answered else problem.place(at.point, at)
    found = minimise(problem, start, _rule(search, problem.moving), SEARCH.steps_apart)
    six, (_, sds) = search.active < 6, newton_step(np.zeros(len(search.active)), found.at.information)
    moved = np.abs(found.at.here.point - at.point)[search.active] / sds
    near = bool(np.max(found.sizes[six], initial=0.0) < SEARCH.arrived_step)
    if near and np.max(moved[six], initial=0.0) < SEARCH.furthest:
        return found, True
    return found._replace(at=start), False  # nothing better than the likelihood's maximum is known


def with_gain(found: Posterior, gain: float) -> Posterior:
    """The same posterior with another `gain`."""
    return replace(found, gain=gain)


def _chosen(search: Search, at: Iterate) -> Iterate:
    """The point without outliers, which are chosen once in a fit, at the first point that this is asked."""
    if search.outliers_chosen:
        return at
    before, search.outliers_chosen = search.used, True
    _leave_out(search, at.e, at.S)
    return at if np.array_equal(before, search.used) else evaluate(search, at.point, at)


def _step_limits(search: Search) -> Array:
    """How far one step may go, (a,)."""
    limits: Array = np.where(search.active < 6, SEARCH.longest_step, SEARCH.longest_share * search.prior_sd)
    return limits
