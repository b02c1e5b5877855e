"""Several segments as one: the prior counted once, and a variance of the soil between segments.

Soil differs from place to place: the six drift over the distance between segments (filters/drift.py), as
live, and where segments differ by more than that, each has six of its own about their mean (agreement.py);
what is the machine's does not differ. A subset of the segments needs no new search: near the points that were
found what each window says is linear (window_terms.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit  # scipy.stats takes a second to import

from tilth.analysis.fit.agreement import (
    Agreement,
    agree,
    between_sd,
    distances,
    own_change,
    sum_of,
    with_room,
)
from tilth.analysis.fit.segment_fit import SegmentFit
from tilth.analysis.fit.side_by_side import Map
from tilth.analysis.fit.window_terms import SegmentTerms, places, terms_at
from tilth.estimator.filters import fit_covariance, unknowns
from tilth.estimator.filters.drift import drift, retained_share
from tilth.estimator.filters.newton import newton_step, share_of_step
from tilth.estimator.filters.unknowns import NAMES, NOISE, SIX
from tilth.estimator.methods import pem
from tilth.schemas.machine import Machine
from tilth.schemas.spread import WITHIN

Array = NDArray[np.float64]

MOST_STEPS: Final = 10  # of Newton to the points; the later ones are halved
SETTLED: Final = 0.1  # of a sd of the six: a step this small ends it
ALL_SETTLED: Final = 0.5
"""The same of any unknown: `join` takes the step that is left, and one of a sd in the damping of a roll mode
cost 10 nats."""
LONGEST: Final = 1.0  # prior sds, of one step
ONE_SOIL: Final = 0.15
"""Largest sd of a logarithm for the six of a further segment, masses apart, where segments do not agree:
beyond ±30 % (95 %) one number says nothing of any of them."""


@dataclass(frozen=True, slots=True)
class Joint:
    """The posterior of several segments, at the place of the last one; of unknowns.NAMES. Noise levels are
    each window's own: here they stand at the prior's mean, without variance."""

    mean: Array  # [n]
    covariance: Array  # [n, n]
    prior_mean: Array  # [n]
    prior_sd: Array  # [n]
    agreement: Agreement
    seconds: float  # of driving
    between_sd: Array  # (6,), of the logarithms of a segment about the mean
    new_segment_sd: Array  # (6,), of those of a further segment, with what is not known of the mean
    refused: NDArray[np.bool_]  # (6,), whether there is no one number, since the segments do not agree


@dataclass(frozen=True, slots=True)
class Linearised:
    """All segments near the points that were found for them."""

    point: Array  # [n], common
    told: tuple[SegmentTerms, ...]  # of each segment, around that point
    between_m: tuple[float, ...]  # from each segment to the next
    seconds: tuple[float, ...]  # of driving, of each
    alone: tuple[tuple[Array, Array], ...] = ()  # mean [n] and covariance [n, n] of each one's own fit


def linearise(
    machine: Machine, fits: Sequence[SegmentFit], between_m: Sequence[float], each: Map = map
) -> Linearised:
    """Find the points: what is the machine's in common, the six of each segment as far from their mean as
    segments differ. fits: in the order of driving, of which pem has fitted something. between_m: distance
    from each to the one after it, m, one fewer. each: calls a function for several arguments, as `map` does.
    Raises ValueError without fits."""
    windows = [window for fit in fits for window in fit.windows]
    if not windows:
        raise ValueError("no segment to join")
    owner = [k for k, fit in enumerate(fits) for _ in fit.windows]
    shared = places(machine)
    point, points = _start(machine, fits)
    longest = LONGEST * unknowns.prior(machine)[1]
    told, spread = list[SegmentTerms](), np.zeros(6)
    for k in range(MOST_STEPS):
        terms = each(terms_at, [machine] * len(windows), windows, points[owner])
        around: list[SegmentTerms] = [()] * len(fits)
        for at, window, one in zip(owner, windows, terms, strict=True):
            gradient = one.gradient + one.information @ (point - points[at])[shared]
            common = point.copy()
            common[NOISE] = window.noise
            # Errors of the model in proportion are those of the common value, else the smaller ones win.
            errors = np.hypot(fit_covariance.model_sd_of(window.record, common), fits[at].excess)
            around[at] = (*around[at], replace(one, gradient=gradient, model_sd=errors))
        told = around
        if k < MOST_STEPS // 2:
            spread = between_sd(machine, told, agree(machine, told, between_m))
        moved, moved_points, sds = _newton(machine, told, spread, point)
        step = (moved_points - points)[:, shared]
        sizes = np.max(np.abs(step) / np.hypot(sds, np.pad(spread, (0, len(sds) - 6))), axis=0)
        settled = np.max(sizes[SIX]) < SETTLED and np.max(sizes) < ALL_SETTLED
        if settled or k == MOST_STEPS - 1:
            break  # the terms are those of the points
        share = share_of_step(k, MOST_STEPS)
        point += share * np.clip(moved - point, -longest, longest)  # what runs away holds up no other
        points += share * np.clip(moved_points - points, -longest, longest)
    return Linearised(
        point, tuple(told), tuple(between_m), tuple(fit.seconds for fit in fits),
        tuple((fit.mean, fit.covariance) for fit in fits),
    )  # fmt: skip


def _start(machine: Machine, fits: Sequence[SegmentFit]) -> tuple[Array, Array]:
    """The fits' means, each unknown weighted by its variance, [n]; and the same with each one's own six,
    (segments, n)."""
    mean = unknowns.prior(machine)[0].copy()
    shared = places(machine)
    weights = np.array([1.0 / np.diag(fit.covariance)[shared] for fit in fits])
    mean[shared] = np.average([fit.mean[shared] for fit in fits], axis=0, weights=weights)
    points = np.tile(mean, (len(fits), 1))
    points[:, SIX] = [fit.mean[SIX] for fit in fits]
    return mean, points


def _newton(
    machine: Machine, told: Sequence[SegmentTerms], spread: Array, point: Array
) -> tuple[Array, Array, Array]:
    """(common point [n], that of each segment (segments, n), sds of the common unknowns (a,)) by a step of
    Newton. The prior counts once."""
    mean, sd = unknowns.prior(machine)
    shared = places(machine)
    prior = np.diag(sd[shared] ** -2.0)
    terms = [one for segment in told for one in with_room(segment, spread)]
    information = prior + sum(one.information for one in terms)
    gradient = prior @ (point - mean)[shared] + sum(one.gradient for one in terms)
    change, sds = newton_step(gradient, information)
    moved = point.copy()
    moved[shared] += change
    points = np.tile(moved, (len(told), 1))
    if np.any(spread):
        points[:, SIX] += [own_change(segment, spread, change) for segment in told]
    return moved, points, sds


def join(machine: Machine, all_of: Linearised, chosen: Sequence[int] | None = None) -> Joint:
    """The posterior of the chosen segments, of all if None, in their order. One alone gives its own fit."""
    rows = list(range(len(all_of.told)) if chosen is None else chosen)
    told = [all_of.told[k] for k in rows]
    between_m = distances(all_of.between_m, rows)
    prior_mean, prior_sd = unknowns.prior(machine)
    seconds = sum(all_of.seconds[k] for k in rows)
    agreement = agree(machine, told, between_m)
    if len(rows) == 1 and all_of.alone:
        mean, covariance = (one.copy() for one in all_of.alone[rows[0]])
        mean[NOISE] = prior_mean[NOISE]
        covariance[NOISE, :] = covariance[:, NOISE] = 0.0
        none, further = np.zeros(6), np.sqrt(np.diag(covariance)[SIX])
        return Joint(mean, covariance, prior_mean, prior_sd, agreement, seconds, none, further, none > 0.0)
    spread = between_sd(machine, told, agreement)
    change, covariance = _posterior(machine, all_of.point, told, between_m, spread)
    few = np.ones(6) if agreement.agrees else _factor_of_few(machine, told, spread)
    if np.any(few > 1.0):
        without = _posterior(machine, all_of.point, told, between_m, np.zeros(6))[1]
        before, after = np.diag(without)[SIX], np.diag(covariance)[SIX]
        wider = np.ones(len(covariance))
        wider[SIX] = np.sqrt(1.0 + (few**2 - 1.0) * np.maximum(after - before, 0.0) / after)
        covariance = covariance * np.outer(wider, wider)
    shared = places(machine)
    whole_mean, whole = prior_mean.copy(), np.zeros((len(NAMES), len(NAMES)))
    whole_mean[shared] = all_of.point[shared] + change
    whole[np.ix_(shared, shared)] = covariance
    whole += pem.of_masses(np.diag(prior_sd**2))
    further = np.sqrt(np.diag(whole)[SIX] + (few * spread) ** 2)
    low, high = _range(machine, all_of, rows)
    outside = (whole_mean[SIX] < low) | (whole_mean[SIX] > high)
    apart = np.hypot(few * spread, np.sqrt(np.diag(covariance)[SIX])) > ONE_SOIL
    refused = np.full(6, not agreement.agrees) & (outside | apart)
    return Joint(whole_mean, whole, prior_mean, prior_sd, agreement, seconds, spread, further, refused)


def _posterior(
    machine: Machine, point: Array, told: Sequence[SegmentTerms], between_m: Sequence[float], spread: Array
) -> tuple[Array, Array]:
    """(change from the point (a,), covariance (a, a)) at the place of the last segment."""
    told = [with_room(segment, spread) for segment in told]
    prior_mean, prior_sd = unknowns.prior(machine)
    shared = places(machine)
    sd, away = prior_sd[shared], (point - prior_mean)[shared]
    mean = -away
    covariance, errors = np.diag(sd**2), np.zeros(6)
    for k, segment in enumerate(told):
        if k:
            share = retained_share(between_m[k - 1])
            mean[SIX] = share * (mean[SIX] + away[SIX]) - away[SIX]
            drift(covariance, np.arange(6), share, sd)
        for one in segment:
            # As pem: errors of the model that a window does not share count as what it may correct.
            common = np.minimum(errors, one.model_sd)
            covariance[SIX, SIX] += np.diag(errors**2 - common**2)
            before, variances = _inverse(covariance), np.diag(covariance)[SIX].copy()
            covariance = _inverse(before + one.information)
            mean = covariance @ (before @ mean - one.gradient)
            errors = fit_covariance.mixed(common, one.model_sd, variances, np.diag(covariance)[SIX])
    return mean, _published(covariance, told, sd, errors)


def _range(machine: Machine, all_of: Linearised, rows: Sequence[int]) -> tuple[Array, Array]:
    """Smallest and largest of the six that these segments give alone, each (6,): infinite where none tells
    anything."""
    rows = [k for k in rows if all_of.told[k]]
    if not rows:
        return np.full(6, -np.inf), np.full(6, np.inf)
    if all_of.alone:
        alone = [all_of.alone[k][0][SIX] for k in rows]
    else:
        none = np.zeros(6)
        alone = [
            all_of.point[SIX] + _posterior(machine, all_of.point, [all_of.told[k]], [], none)[0][SIX]
            for k in rows
        ]
    return np.min(alone, axis=0), np.max(alone, axis=0)


def _factor_of_few(machine: Machine, told: Sequence[SegmentTerms], spread: Array) -> Array:
    """How much wider than by a normal distribution 95 % of the six are, (6,), where their variance between
    segments is known by so few: Student's t, as by Hartung and Knapp. Segments count by their weights."""
    prior = np.diag(unknowns.prior(machine)[1][places(machine)] ** -2.0)
    own = [np.diag(_inverse(prior + sum_of(segment).information))[SIX] for segment in told if segment]
    weights = 1.0 / (np.array(own) + spread**2)
    count = np.sum(weights, axis=0) ** 2 / np.sum(weights**2, axis=0)
    return np.asarray(stdtrit(np.maximum(count - 1.0, 1.0), 0.975) / WITHIN, np.float64)


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), np.float64)


def _published(covariance: Array, told: Sequence[SegmentTerms], sd: Array, model_sd: Array) -> Array:
    """Widened as a fit's is (fit_covariance.published). model_sd: (6,), of the errors of the model in what
    was learned."""
    every = [one for segment in told for one in segment]
    prior = np.diag(sd**-2.0)
    still = _inverse(prior + sum(one.information for one in every))  # without drift
    wide = fit_covariance.widened(still, prior + sum(one.scores for one in every))
    by = np.sqrt(np.diag(wide) / np.diag(still))
    out = covariance * np.outer(by, by)
    colour = 1.0 + fit_covariance.FIT_COVARIANCE.colour_factor * max(
        float(np.mean([one.whiteness for one in every])), 0.0
    )
    out[SIX, :] *= colour
    out[:, SIX] *= colour
    out[SIX, SIX] += np.diag(model_sd**2)
    return np.asarray((out + out.T) / 2, np.float64)
