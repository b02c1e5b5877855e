"""Estimate of the unknowns over one record: maximum a posteriori by Fisher scoring with damped steps, then
with room for what the model of the ground has wrong.
"""

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.fit_covariance import published, whiteness
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
from tilth.estimator.filters.measurement_model import outliers
from tilth.estimator.filters.newton import newton_step, share_of_step
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
    more_damping: float = tuned(30.0, "1", "factor of the damping from try to try")
    least_damping: float = tuned(1e-4, "1", "with which the first try is damped")


SEARCH: Final = SearchTuning()

_DISTURBANCES: Final = slice(AT["push_t"], AT["push_yaw"] + 1)


class Minimum(NamedTuple):
    """Where a search has ended."""

    at: Iterate
    iterations: int
    left: float  # posterior sds of any unknown that Newton's next step would go; 0 where all has settled
    promised: float  # nats by which Newton's last step should have lowered the cost


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
    stuck = minimum.promised > SEARCH.empty_promise
    if stuck or setup.scale != 1.0:
        # What the ground's shaking tells of a roll mode is not in derivatives with gains held: along them no
        # step may lower the cost. Where `_apart` does not follow, the maximum itself is asked for.
        minimum = _minimise(search, minimum.at, exact=True)
    found, converged = minimum.at, minimum.left < SEARCH.arrived_step
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
        found.cost / max(len(record.rows), 1), gain, minimum.iterations, len(record.rows),
        int(np.sum(search.used == 0.0)), autocorrelation, converged,
    )  # fmt: skip


def leave_out_outliers(search: Search, point: Array) -> None:
    """Rows that are outliers at a point, (n,), count no more."""
    made = innovations(search.record, search.setup, search.start, point, used=search.used)
    _leave_out(search, made.e, made.S)


def _leave_out(search: Search, e: Array, S: Array) -> None:
    search.used = np.where(outliers(search.record.rows, e, S), 0.0, search.used)


def _minimise(search: Search, at: Iterate, exact: bool = False) -> Minimum:
    """The minimum of the cost, from a starting point. exact: derivatives have in them what the gains do."""
    of_six, damping, limit = (
        search.active < 6,
        1e-3,
        SEARCH.roughly_flat if search.setup.scale == 1.0 else SEARCH.flat_cost,
    )
    for k in range(1, SEARCH.most_iterations + 1):
        at = with_noise_levels(search, at)
        if exact:
            at = with_gains(search, at)
        gradient, information = gradient_and_information(search, at, scores_at(search, at))
        newton, sds = newton_step(gradient, information)
        promised = -float(gradient @ newton) / 2.0
        step, tried, then = _descend(search, at, gradient, information, damping)
        sizes = np.abs(step) / sds
        if then is None:
            return Minimum(at, k, float(np.max(np.abs(newton) / sds)), promised)
        damping = (
            max(damping * 0.2, SEARCH.least_damping)
            if tried == 1
            else damping * SEARCH.more_damping ** (tried - 1)
        )
        if k == 2 and not exact:  # outliers are chosen once in a fit, at this point
            _leave_out(search, then.e, then.S)
            then = evaluate(search, then.point, then)
        flat, at = abs(then.cost - at.cost) < limit, then
        # Only the six must be settled: a noise level that has no effect may go to and fro.
        settled = flat and bool(np.max(sizes[of_six], initial=0.0) < SEARCH.settled_step)
        if k > 2 and (settled or bool(np.max(sizes) < SEARCH.small_step)):
            return Minimum(at, k, 0.0, promised)
    return Minimum(at, SEARCH.most_iterations, math.inf, math.inf)


def _descend(
    search: Search, at: Iterate, gradient: Array, information: Array, damping: float
) -> tuple[Array, int, Iterate | None]:
    """(step, tries, what is there after it); None in the third place if no step lowers the cost."""
    limits = _step_limits(search)
    for tried in range(1, SEARCH.tries + 1):
        more = damping * SEARCH.more_damping ** (tried - 1)
        step = newton_step(gradient, information, damping=more, limits=limits).change
        trial = at.point.copy()
        trial[search.active] += step
        then = evaluate(search, trial, at)
        if np.isfinite(then.cost) and then.cost <= at.cost + SEARCH.slack:
            return step, tried, then
    return np.zeros(len(search.active)), SEARCH.tries, None


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
