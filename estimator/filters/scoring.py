"""Estimate of the unknowns over one record: maximum a posteriori by Fisher scoring with damped steps, then
with room for what the model of the ground has wrong.
"""

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.fit_covariance import published, whiteness
from tilth.estimator.filters.gates import outliers
from tilth.estimator.filters.likelihood import (
    Iterate,
    Search,
    apart_from_ground,
    evaluate,
    gradient_and_information,
    innovations,
    inverse,
    likelihood_at,
    response_to_steering,
    scores_at,
    search_of,
    with_gains,
    with_noise_levels,
)
from tilth.estimator.filters.newton import End, Minimum, Rule, minimise, newton_step, share_of_step
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.record.record import Record
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SearchTuning:
    """When the search for the maximum goes on, and when it ends."""

    most_iterations: int = tuned(25, "iterations", "of a search")
    small_step: float = tuned(0.03, "sd", "of the posterior: a step this small ends the search")
    slack: float = tuned(0.2, "nat", "by which a step may raise the cost: derivatives are not exact")
    rough_start: float = tuned(1.5, "1", "added at first to a disturbance's logarithm whose sd is above 1")
    """A search that begins with rough ground does not end in a local minimum."""
    flat_cost: float = tuned(
        0.05, "nat", "the search ends if the cost changes by less and `settled_step` holds"
    )
    roughly_flat: float = tuned(0.2, "nat", "the same where `_apart` follows")
    settled_step: float = tuned(0.1, "sd", "of the posterior of the six")
    arrived_step: float = tuned(0.3, "sd", "of the six: remaining step of a stopped search that converged")
    steps_apart: int = tuned(8, "steps", "at most, of `_apart`; the later ones are halved: no cost falls")
    furthest: float = tuned(3.0, "sd", "of any of the six, by which `_apart` may leave the best likelihood")
    """A relaxation length that has become short enough has no effect any more: sigma_i came out at a tenth in
    one of 16 fields."""
    longest_step: float = tuned(0.7, "1", "of a logarithm of the six in one iteration")
    longest_share: float = tuned(1.5, "sd", "of the prior: the same of all else")
    empty_promise: float = tuned(
        2.0, "nat", "a search that ended though its derivatives promise more is stuck"
    )
    """They hold the gains. On side slopes one of 40 such fits took all steering for rough ground, 100 nats
    above the maximum."""
    tries: int = tuned(4, "tries", "of a step, each with more damping than the one before")
    least_damping: float = tuned(1e-4, "1", "with which the first try is damped")


SEARCH: Final = SearchTuning()

_DISTURBANCES: Final = slice(AT["push_t"], AT["push_yaw"] + 1)


@dataclass(frozen=True, slots=True)
class Posterior:
    """Result of a fit: the posterior of one record and a prior."""

    mean: Array  # [n] of unknowns.NAMES
    covariance: Array  # [n, n]
    information: Array  # [n, n] of the record without the prior
    cost: float  # minimum, per row
    gain: float  # log-likelihood of the record at the prior's mean minus that at `reference`, nats
    iterations: int
    rows: int
    outliers: int
    whiteness: float  # autocorrelation of the normalised innovations at lag one, mean over the kinds
    converged: bool


def maximise_posterior(
    record: Record, setup: RigSetup, mean: Array, covariance: Array, reference: Array | None = None
) -> Posterior:
    """The fit. mean [n], covariance [n, n]: the prior over unknowns.NAMES; one with zero variance stays
    fixed.

    reference: [n], a point to compare with the prior's mean on this record, which was used for neither
    (`gain`).
    """
    search = search_of(record, setup, mean, covariance)
    gain = 0.0 if reference is None else likelihood_at(search, reference) - likelihood_at(search, mean)
    point = mean.copy()
    point[_DISTURBANCES] += np.where(np.diag(covariance)[_DISTURBANCES] > 1.0, SEARCH.rough_start, 0.0)
    minimum = _minimise(search, evaluate(search, point))
    stuck = minimum.end is End.OUT_OF_STEPS or minimum.promised > SEARCH.empty_promise
    if stuck or setup.scale != 1.0:
        # What the ground's shaking tells of a roll mode is not in derivatives with gains held: along them no
        # step may lower the cost. Where `_apart` does not follow, the maximum itself is asked for.
        minimum = _minimise(search, minimum.at, exact=True)
    found, converged = minimum.at, minimum.end is End.SETTLED
    converged |= minimum.end is End.STUCK and bool(np.max(minimum.sizes) < SEARCH.arrived_step)
    _, information = gradient_and_information(search, found, scores_at(search, found))
    counted = information
    if setup.scale == 1.0:
        found, counted, settled = _apart(search, found)
        converged |= settled
    autocorrelation = whiteness(record.rows, search.scored, found.e, found.S)
    scores = scores_at(search, found)
    record_information = np.zeros_like(covariance)
    record_information[np.ix_(search.active, search.active)] = information - search.prior_information
    return Posterior(
        found.point, published(search, found.point, scores, inverse(counted), autocorrelation),
        record_information,
        found.cost / max(len(record.rows), 1), gain, minimum.steps, len(record.rows),
        int(np.sum(search.used == 0.0)), autocorrelation, converged,
    )  # fmt: skip


def leave_out_outliers(search: Search, point: Array) -> None:
    """Rows that are outliers at a point, (n,), count no more."""
    made = innovations(search.record, search.setup, search.start, point, used=search.used)
    _leave_out(search, made.e, made.S)


def _leave_out(search: Search, e: Array, S: Array) -> None:
    search.used = np.where(outliers(search.record.rows, e, S), 0.0, search.used)


class _Likelihood(NamedTuple):
    """A search as newton.Problem. exact: derivatives have in them what the gains do."""

    search: Search
    exact: bool

    def terms(self, at: Iterate) -> tuple[Iterate, Array, Array]:
        at = with_noise_levels(self.search, at)
        if self.exact:
            at = with_gains(self.search, at)
        return at, *gradient_and_information(self.search, at, scores_at(self.search, at))

    def after(self, at: Iterate, change: Array) -> Iterate | None:
        trial = at.point.copy()
        trial[self.search.active] += change
        then = evaluate(self.search, trial, at)
        return then if np.isfinite(then.cost) and then.cost <= at.cost + SEARCH.slack else None

    def taken(self, step: int, at: Iterate) -> Iterate:
        if step != 2 or self.exact:
            return at
        _leave_out(self.search, at.e, at.S)  # outliers are chosen once in a fit, at this point
        return evaluate(self.search, at.point, at)

    def settled(self, step: int, before: Iterate, at: Iterate, sizes: Array) -> bool:
        """Only the six must be settled: a noise level that has no effect may go to and fro."""
        limit = SEARCH.roughly_flat if self.search.setup.scale == 1.0 else SEARCH.flat_cost
        six = float(np.max(sizes[self.search.active < 6], initial=0.0))
        flat = abs(at.cost - before.cost) < limit
        return step > 2 and ((flat and six < SEARCH.settled_step) or float(np.max(sizes)) < SEARCH.small_step)


def _minimise(search: Search, at: Iterate, exact: bool = False) -> Minimum[Iterate]:
    """The minimum of the cost, from a starting point."""
    rule = Rule(_step_limits(search), False, 0.2, SEARCH.least_damping, tries=SEARCH.tries, at_once=True)
    return minimise(_Likelihood(search, exact), at, rule, SEARCH.most_iterations)


def _apart(search: Search, at: Iterate) -> tuple[Iterate, Array, bool]:
    """(the likelihood's maximum with `apart_from_ground`, the information there, whether it was found). Noise
    levels stay."""
    of_six, limits = search.active < 6, _step_limits(search)
    instruments, renewed, size, moved = response_to_steering(search, at.point), at.point, math.inf, 0.0
    found, information = start = apart_from_ground(search, evaluate(search, at.point, at, instruments))
    for k in range(SEARCH.steps_apart):
        gradient, _ = gradient_and_information(search, found, scores_at(search, found))
        newton, sds = newton_step(gradient, information, moving=search.of_motion, limits=limits)
        step = share_of_step(k, SEARCH.steps_apart) * newton
        point = found.point.copy()
        point[search.active] += step
        size, since, moved = (
            float(np.max((np.abs(change) / sds)[of_six], initial=0.0))
            for change in (step, (point - renewed)[search.active], (point - at.point)[search.active])
        )
        if since > SEARCH.arrived_step:
            instruments, renewed = response_to_steering(search, point), point
        there = evaluate(search, point, at, instruments)
        if not math.isfinite(there.cost):
            return *start, False
        found, information = apart_from_ground(search, there)
        if size < SEARCH.settled_step:
            break
    if size < SEARCH.arrived_step and moved < SEARCH.furthest:
        return found, information, True
    return *start, False  # nothing better than the likelihood's maximum is known


def with_gain(found: Posterior, gain: float) -> Posterior:
    """The same posterior with another `gain`."""
    return replace(found, gain=gain)


def _step_limits(search: Search) -> Array:
    """How far one step may go, (a,)."""
    limits: Array = np.where(search.active < 6, SEARCH.longest_step, SEARCH.longest_share * search.prior_sd)
    return limits
