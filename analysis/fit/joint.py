"""Several segments as one: their information added up, the prior counted once; and whether they agree.

Each segment has been fitted from the same prior N(p0, S0), with posterior N(p, C). So its data alone have the
information D = C^-1 - S0^-1 about all unknowns that are no noise levels. Soil differs from place to place:
the six drift over the distance between segments (filters/drift.py), as live; what is the machine's does not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from tilth.analysis.fit.segment_fit import SegmentFit
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.drift import drift, retained_share
from tilth.estimator.filters.unknowns import NAMES, NOISE, SIX
from tilth.estimator.results.advice import information_of
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

LEAST_SHARE: Final = 0.2
"""Of the prior's information: directions of which a segment tells less are left out of the test whether
segments agree, since there only the prior's shape would be tested."""
DISAGREE: Final = 0.01  # a smaller p says that the segments do not agree
INFORMED: Final = 1e-6  # relative change of a variance: what a segment has learned of at all


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
    """The posterior of all segments, at the place of the last one; of unknowns.NAMES without noise levels."""

    mean: Array  # [n]
    covariance: Array  # [n, n]
    prior_sd: Array  # [n]
    agreement: Agreement
    seconds: float  # of driving


def join(machine: Machine, fits: Sequence[SegmentFit], between_m: Sequence[float]) -> Joint:
    """fits: in the order of driving, of which pem has fitted something. between_m: distance from each to the
    one after it, m, one fewer. Raises ValueError without fits."""
    if not fits:
        raise ValueError("no segment to join")
    prior_mean, prior_sd = unknowns.prior(machine)
    kept = np.flatnonzero((prior_sd > 0.0) & ~_is_noise())
    start, sd = prior_mean[kept], prior_sd[kept]
    mean, covariance = start.copy(), np.diag(sd**2)
    for k, fit in enumerate(fits):
        if k:
            share = retained_share(between_m[k - 1])
            mean[SIX] = start[SIX] + share * (mean[SIX] - start[SIX])
            drift(covariance, np.arange(6), share, sd)
        mean, covariance = _add(mean, covariance, *_data_of(fit, kept, start, sd))
    agreement = agree(machine, fits, between_m)
    model = np.max([fit.model_sd for fit in fits], axis=0)
    covariance[SIX, SIX] = agreement.widening * covariance[SIX, SIX] + np.diag(model**2)
    whole_mean, whole = prior_mean.copy(), np.zeros((len(NAMES), len(NAMES)))
    whole_mean[kept], whole[np.ix_(kept, kept)] = mean, (covariance + covariance.T) / 2
    return Joint(whole_mean, whole, prior_sd, agreement, sum(fit.seconds for fit in fits))


def agree(machine: Machine, fits: Sequence[SegmentFit], between_m: Sequence[float]) -> Agreement:
    """Test whether segments agree on the six: arguments as of `join`.

    With D = V V', each segment says V^+ (D y) = V' p + white noise of sd 1, y its estimate without the prior;
    the chi-square is what the best common p leaves of all these rows.
    """
    prior_mean, prior_sd = (row[SIX] for row in unknowns.prior(machine))
    rows, values = [], []
    places = np.concatenate([[0.0], np.cumsum(between_m)])
    for fit, place in zip(fits, places, strict=True):
        away = abs(place - float(np.median(places)))
        covariance = fit.covariance[SIX, SIX].copy()
        drift(covariance, np.arange(6), retained_share(away), prior_sd)
        root, value = _rows_of(information_of(covariance, prior_sd), fit.mean[SIX], prior_mean, prior_sd)
        rows.append(root)
        values.append(value)
    design, observed = np.vstack(rows), np.concatenate(values)
    dof = len(observed) - int(np.linalg.matrix_rank(design)) if len(observed) else 0
    if dof < 1:
        return Agreement(0.0, 0, 1.0, _TOO_FEW)
    best = np.linalg.lstsq(design, observed, rcond=None)[0]
    found = float(np.sum((observed - design @ best) ** 2))
    p = float(chi2.sf(found, dof))
    return Agreement(found, dof, p, _sentence(len(fits), found, dof, p))


_TOO_FEW: Final = "Nothing was told twice, so nothing can be said of whether the segments agree."


def _sentence(count: int, found: float, dof: int, p: float) -> str:
    spread = f"chi-square {found:.1f} with {dof} degrees of freedom, p = {p:.2g}"
    if p >= DISAGREE:
        return f"The {count} segments agree within their intervals ({spread})."
    return (
        f"The {count} segments do not agree ({spread}): soil, load or the machine were not the same, or the "
        f"intervals are too narrow here. The joint intervals are widened by {math.sqrt(found / dof):.1f}."
    )


def _data_of(fit: SegmentFit, kept: NDArray[np.intp], start: Array, sd: Array) -> tuple[Array, Array]:
    """(D, D y) of a segment's data over the unknowns kept, without errors of the model."""
    covariance = fit.covariance[np.ix_(kept, kept)].copy()
    covariance[SIX, SIX] -= _shrunk(covariance[SIX, SIX], fit.model_sd)
    information = information_of(covariance, sd)
    return information, information @ fit.mean[kept] + (fit.mean[kept] - start) / sd**2


def _shrunk(covariance: Array, model_sd: Array) -> Array:
    """The part of the six's covariance that errors of the model are, kept small enough to be taken off."""
    part = np.diag(model_sd**2)
    smallest = float(np.linalg.eigvalsh(_scaled(covariance, part))[0])
    return part * min(1.0, 0.9 * smallest)


def _scaled(covariance: Array, part: Array) -> Array:
    root = 1.0 / np.sqrt(np.diag(part))
    return covariance * np.outer(root, root)


def _add(mean: Array, covariance: Array, information: Array, pull: Array) -> tuple[Array, Array]:
    """Posterior after data with D = information and D y = pull."""
    before = np.asarray(np.linalg.inv(covariance), np.float64)
    after = np.asarray(np.linalg.inv(before + information), np.float64)
    return after @ (before @ mean + pull), after


def _rows_of(information: Array, mean: Array, prior_mean: Array, prior_sd: Array) -> tuple[Array, Array]:
    """(V', values): what a segment says of the directions of which it tells enough."""
    scale = np.outer(prior_sd, prior_sd)
    values, vectors = np.linalg.eigh(information * scale)
    told = values > LEAST_SHARE
    root = np.sqrt(values[told])[:, None] * vectors[:, told].T / prior_sd
    pull = information @ mean + (mean - prior_mean) / prior_sd**2  # D y
    along = (vectors[:, told].T @ (pull * prior_sd)) / np.sqrt(values[told])
    return root, along


def _is_noise() -> NDArray[np.bool_]:
    chosen = np.zeros(len(NAMES), np.bool_)
    chosen[NOISE] = True
    return chosen
