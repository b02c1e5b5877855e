"""Several segments as one: their windows around one point, the prior counted once; and whether they agree.

Soil differs from place to place: the six drift over the distance between segments (filters/drift.py), as
live; what is the machine's does not. A subset of the segments needs no new search: near the common point what
each window says is linear (window_terms.py).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc  # scipy.stats takes a second to import

from tilth.analysis.fit.segment_fit import SegmentFit
from tilth.analysis.fit.side_by_side import Map
from tilth.analysis.fit.window_terms import MOST_STEPS, SETTLED, Terms, newton, places, terms_at
from tilth.estimator.filters import fit_covariance, unknowns
from tilth.estimator.filters.drift import drift, retained_share
from tilth.estimator.filters.unknowns import NAMES, SIX
from tilth.estimator.methods import pem
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]
Told = tuple[Terms, ...]  # of the windows of one segment

LEAST_SHARE: Final = 0.2
"""Of the prior's information: directions of which a segment tells less are left out of the test whether
segments agree, since there only the prior's shape would be tested."""
LEAST_DRIFT: Final = 0.01
"""Smallest sd, over the prior's, by which the six of two segments may differ."""
DISAGREE: Final = 0.01  # a smaller p says that the segments do not agree


@dataclass(frozen=True, slots=True)
class Agreement:
    """Whether segments give the same six within their covariances."""

    chi2: float
    dof: int
    p: float  # of a larger chi-square by chance; 1 without degrees of freedom
    sentence: str

    @property
    def agrees(self) -> bool:
        return self.p >= DISAGREE

    @property
    def widening(self) -> float:
        """Factor on the variances of the six, by the spread; 1 where the segments agree."""
        return 1.0 if self.agrees else max(self.chi2 / self.dof, 1.0)


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


@dataclass(frozen=True, slots=True)
class Linearised:
    """All segments around their common point."""

    point: Array  # [n]
    told: tuple[Told, ...]  # of each segment
    between_m: tuple[float, ...]  # from each segment to the next
    seconds: tuple[float, ...]  # of driving, of each


def linearise(
    machine: Machine, fits: Sequence[SegmentFit], between_m: Sequence[float], each: Map = map
) -> Linearised:
    """Find the common point. fits: in the order of driving, of which pem has fitted something. between_m:
    distance from each to the one after it, m, one fewer. each: calls a function for several arguments, as
    `map` does. Raises ValueError without fits."""
    windows = [window for fit in fits for window in fit.windows]
    if not windows:
        raise ValueError("no segment to join")
    point = _start(machine, fits)
    terms: list[Terms] = []
    for k in range(MOST_STEPS):
        terms = list(each(terms_at, [machine] * len(windows), windows, [point] * len(windows)))
        moved, size = newton(machine, terms, point, 1.0 if k < MOST_STEPS // 2 else 0.5)
        if size < SETTLED or k == MOST_STEPS - 1:
            break  # the terms are those of the point
        point = moved
    told, first = [], 0
    for fit in fits:
        told.append(tuple(terms[first : first + len(fit.windows)]))
        first += len(fit.windows)
    return Linearised(point, tuple(told), tuple(between_m), tuple(fit.seconds for fit in fits))


def _start(machine: Machine, fits: Sequence[SegmentFit]) -> Array:
    """The fits' means, each unknown weighted by its variance."""
    mean = unknowns.prior(machine)[0].copy()
    shared = places(machine)
    weights = np.array([1.0 / np.diag(fit.covariance)[shared] for fit in fits])
    mean[shared] = np.average([fit.mean[shared] for fit in fits], axis=0, weights=weights)
    return mean


def join(machine: Machine, all_of: Linearised, chosen: Sequence[int] | None = None) -> Joint:
    """The posterior of the chosen segments, of all if None, in their order."""
    rows = list(range(len(all_of.told)) if chosen is None else chosen)
    told = [all_of.told[k] for k in rows]
    between = [sum(all_of.between_m[a:b]) for a, b in pairwise(rows)]
    prior_mean, prior_sd = unknowns.prior(machine)
    shared = places(machine)
    sd, away = prior_sd[shared], (all_of.point - prior_mean)[shared]
    mean = -away  # of the change from the common point
    covariance, errors = np.diag(sd**2), np.zeros(6)
    for k, segment in enumerate(told):
        if k:
            share = retained_share(between[k - 1])
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
    agreement = agree(machine, told, between)
    covariance = _published(covariance, told, sd, agreement, errors)
    whole_mean, whole = prior_mean.copy(), np.zeros((len(NAMES), len(NAMES)))
    whole_mean[shared] = all_of.point[shared] + mean
    whole[np.ix_(shared, shared)] = covariance
    whole += pem.of_masses(np.diag(prior_sd**2))
    seconds = sum(all_of.seconds[k] for k in rows)
    return Joint(whole_mean, whole, prior_mean, prior_sd, agreement, seconds)


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), np.float64)


def _information(windows: Sequence[Terms]) -> Array:
    return np.asarray(sum(one.information for one in windows))


def _published(
    covariance: Array, told: Sequence[Told], sd: Array, agreement: Agreement, model_sd: Array
) -> Array:
    """Widened as a fit's is (fit_covariance.published), and by the spread where segments do not agree.
    model_sd: (6,), of the errors of the model in what was learned."""
    every = [one for segment in told for one in segment]
    prior = np.diag(sd**-2.0)
    still = _inverse(prior + _information(every))  # without drift
    wide = fit_covariance.widened(still, prior + sum(one.scores for one in every))
    by = np.sqrt(np.diag(wide) / np.diag(still))
    out = covariance * np.outer(by, by)
    colour = 1.0 + fit_covariance.COLOUR_FACTOR * max(float(np.mean([one.whiteness for one in every])), 0.0)
    factors = np.ones(len(out))
    factors[SIX] = colour * math.sqrt(agreement.widening)
    out = out * np.outer(factors, factors)
    out[SIX, SIX] += np.diag(model_sd**2)
    return np.asarray((out + out.T) / 2, np.float64)


def agree(machine: Machine, told: Sequence[Told], between_m: Sequence[float]) -> Agreement:
    """Test whether segments agree on the six, around a common point.

    With D = V V' each segment says V' p = V^+ (-g) with white noise of sd 1; D is narrowed by what the scores
    say of coloured noise. What is the machine's is the same in all. The chi-square is what it costs that the
    six of a segment are those of the one before, too, up to the drift.
    """
    sd = unknowns.prior(machine)[1][places(machine)]
    rows = [_rows_of(segment, sd) for segment in told]
    observed = np.concatenate([value for _, value in rows])
    count, own = len(told), len(sd) - 6
    free = np.zeros((len(observed) + own, 6 * count + own))
    free[len(observed) :, 6 * count :] = np.eye(own)  # the machine's unknowns, by the prior
    row = 0
    for k, (design, _) in enumerate(rows):
        at = slice(row, row + len(design))
        free[at, 6 * k : 6 * k + 6], free[at, 6 * count :] = design[:, :6], design[:, 6:]
        row += len(design)
    links = np.zeros((6 * (count - 1), free.shape[1]))
    for k, metres in enumerate(between_m):
        share = retained_share(metres)
        step = np.eye(6) / max(math.sqrt(1.0 - share**2), LEAST_DRIFT)
        links[6 * k : 6 * k + 6, 6 * k : 6 * k + 12] = np.hstack([-step, step])
    observed = np.concatenate([observed, np.zeros(own)])
    alone, rank = _left(free, observed)
    linked, linked_rank = _left(np.vstack([free, links]), np.concatenate([observed, np.zeros(len(links))]))
    dof = len(links) + rank - linked_rank
    if dof < 1:
        return Agreement(0.0, 0, 1.0, _TOO_FEW)
    found = max(linked - alone, 0.0)
    p = float(chdtrc(dof, found))
    return Agreement(found, dof, p, _sentence(count, found, dof, p))


def _left(design: Array, observed: Array) -> tuple[float, int]:
    """Sum of squares that the best unknowns leave, and the rank."""
    best, _, rank, _ = np.linalg.lstsq(design, observed, rcond=1e-9)
    return float(np.sum((observed - design @ best) ** 2)), int(rank)


_TOO_FEW: Final = "Nothing was told twice, so nothing can be said of whether the segments agree."


def _sentence(count: int, found: float, dof: int, p: float) -> str:
    spread = f"chi-square {found:.1f} with {dof} degrees of freedom, p = {p:.2g}"
    if p >= DISAGREE:
        return f"The {count} segments agree within their intervals ({spread})."
    return (
        f"The {count} segments do not agree ({spread}): soil, load or the machine were not the same, or the "
        f"intervals are too narrow here. The joint intervals are widened by {math.sqrt(found / dof):.1f}."
    )


def _rows_of(segment: Told, sd: Array) -> tuple[Array, Array]:
    """(V', -V^+ g) in prior sds: what a segment says of the directions of which it tells enough."""
    scale = np.outer(sd, sd)
    information = _information(segment) * scale
    spread = np.asarray(sum(one.scores for one in segment)) * scale
    pull = -np.asarray(sum(one.gradient for one in segment)) * sd
    values, vectors = np.linalg.eigh(information)
    # Where the scores vary more than white noise lets them, the direction tells as much less.
    along = np.einsum("ij,ik,kj->j", vectors, spread, vectors)
    excess = np.maximum(along / np.maximum(values, 1e-12), 1.0)
    told = values / excess > LEAST_SHARE
    roots = np.sqrt(values[told] / excess[told])
    design = roots[:, None] * vectors[:, told].T
    return design, (vectors[:, told].T @ pull) / (excess[told] * roots)
