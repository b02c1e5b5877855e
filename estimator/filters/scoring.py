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

Array = NDArray[np.float64]

MOST_ITERATIONS: Final = 25
SMALL_STEP: Final = 0.03  # of a posterior sd: a step this small ends the search
SLACK: Final = 0.2  # nats by which a step may raise the cost: derivatives with held gains are not exact
ROUGH_START: Final = 1.5
"""Added at the start to a disturbance's logarithm whose sd is above 1: a search that begins with rough ground
does not end in a local minimum."""
_DISTURBANCES: Final = slice(AT["push_t"], AT["push_yaw"] + 1)
FLAT_COST: Final = 0.05  # nats: the search ends if the cost changes by less and the next limit holds as well
ROUGHLY_FLAT: Final = 0.2  # the same where `_apart` follows
SETTLED_STEP: Final = 0.1  # of a posterior sd of the six
ARRIVED_STEP: Final = 0.3
"""Of a posterior sd of the six: remaining step with which a search that has stopped counts as converged."""
STEPS_APART: Final = 8  # at most, of `_apart`; the later ones are halved: no cost falls
FURTHEST: Final = 3.0
"""Sds of any of the six by which `_apart` may leave the likelihood's maximum. A relaxation length that has
become short enough has no effect any more: sigma_i came out at a tenth in one of 16 fields."""
LONGEST_STEP: Final = 0.7  # of a logarithm of the six in one iteration
LONGEST_SHARE: Final = 1.5  # the same of all else, in prior sds
EMPTY_PROMISE: Final = 2.0
"""Nats: a search that has ended though its derivatives promise more than this is stuck, since they hold the
gains. On side slopes one of 40 such fits took all steering for rough ground, 100 nats above the maximum."""
TRIES: Final = 4  # of a step, each with MORE damping than the one before
MORE: Final = 30.0
LEAST_DAMPING: Final = 1e-4


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
    point[_DISTURBANCES] += np.where(np.diag(covariance)[_DISTURBANCES] > 1.0, ROUGH_START, 0.0)
    minimum = _minimise(search, evaluate(search, point))
    stuck = minimum.promised > EMPTY_PROMISE
    if stuck or setup.scale != 1.0:
        # What the ground's shaking tells of a roll mode is not in derivatives with gains held: along them no
        # step may lower the cost. Where `_apart` does not follow, the maximum itself is asked for.
        minimum = _minimise(search, minimum.at, exact=True)
    found, converged = minimum.at, minimum.left < ARRIVED_STEP
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
    of_six, damping, limit = search.active < 6, 1e-3, ROUGHLY_FLAT if search.setup.scale == 1.0 else FLAT_COST
    for k in range(1, MOST_ITERATIONS + 1):
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
        damping = max(damping * 0.2, LEAST_DAMPING) if tried == 1 else damping * MORE ** (tried - 1)
        if k == 2 and not exact:  # outliers are chosen once in a fit, at this point
            _leave_out(search, then.e, then.S)
            then = evaluate(search, then.point, then)
        flat, at = abs(then.cost - at.cost) < limit, then
        # Only the six must be settled: a noise level that has no effect may go to and fro.
        settled = flat and bool(np.max(sizes[of_six], initial=0.0) < SETTLED_STEP)
        if k > 2 and (settled or bool(np.max(sizes) < SMALL_STEP)):
            return Minimum(at, k, 0.0, promised)
    return Minimum(at, MOST_ITERATIONS, math.inf, math.inf)


def _descend(
    search: Search, at: Iterate, gradient: Array, information: Array, damping: float
) -> tuple[Array, int, Iterate | None]:
    """(step, tries, what is there after it); None in the third place if no step lowers the cost."""
    limits = _step_limits(search)
    for tried in range(1, TRIES + 1):
        more = damping * MORE ** (tried - 1)
        step = newton_step(gradient, information, damping=more, limits=limits).change
        trial = at.point.copy()
        trial[search.active] += step
        then = evaluate(search, trial, at)
        if np.isfinite(then.cost) and then.cost <= at.cost + SLACK:
            return step, tried, then
    return np.zeros(len(search.active)), TRIES, None


def _apart(search: Search, at: Iterate) -> tuple[Iterate, Array, bool]:
    """(the likelihood's maximum with `apart_from_ground`, the information there, whether it was found). Noise
    levels stay."""
    of_six, limits = search.active < 6, _step_limits(search)
    instruments, renewed, size, moved = response_to_steering(search, at.point), at.point, math.inf, 0.0
    found, information = start = apart_from_ground(search, evaluate(search, at.point, at, instruments))
    for k in range(STEPS_APART):
        gradient, _ = gradient_and_information(search, found, scores_at(search, found))
        newton, sds = newton_step(gradient, information, moving=search.of_motion, limits=limits)
        step = share_of_step(k, STEPS_APART) * newton
        point = found.point.copy()
        point[search.active] += step
        size, since, moved = (
            float(np.max((np.abs(change) / sds)[of_six], initial=0.0))
            for change in (step, (point - renewed)[search.active], (point - at.point)[search.active])
        )
        if since > ARRIVED_STEP:
            instruments, renewed = response_to_steering(search, point), point
        there = evaluate(search, point, at, instruments)
        if not math.isfinite(there.cost):
            return *start, False
        found, information = apart_from_ground(search, there)
        if size < SETTLED_STEP:
            break
    if size < ARRIVED_STEP and moved < FURTHEST:
        return found, information, True
    return *start, False  # nothing better than the likelihood's maximum is known


def with_gain(found: Posterior, gain: float) -> Posterior:
    """The same posterior with another `gain`."""
    return replace(found, gain=gain)


def _step_limits(search: Search) -> Array:
    """How far one step may go, (a,)."""
    limits: Array = np.where(search.active < 6, LONGEST_STEP, LONGEST_SHARE * search.prior_sd)
    return limits
