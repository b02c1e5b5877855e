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
        information, pull = _data_of(fit, kept, start, sd)
        mean, covariance = _add(mean, covariance, information, pull + information @ start)
    agreement = agree(machine, fits, between_m)
    model = np.max([fit.model_sd for fit in fits], axis=0)
    covariance[SIX, SIX] = agreement.widening * covariance[SIX, SIX] + np.diag(model**2)
    whole_mean, whole = prior_mean.copy(), np.zeros((len(NAMES), len(NAMES)))
    whole_mean[kept], whole[np.ix_(kept, kept)] = mean, (covariance + covariance.T) / 2
    return Joint(whole_mean, whole, prior_sd, agreement, sum(fit.seconds for fit in fits))


def agree(machine: Machine, fits: Sequence[SegmentFit], between_m: Sequence[float]) -> Agreement:
    """Test whether segments agree on the six: arguments as of `join`.

    With D = V V' each segment says V' p = V^+ (D y) with white noise of sd 1, y its estimate without the
    prior. What is the machine's is the same in all. The chi-square is what it costs that the six of a
    segment are those of the one before, too, up to the drift.
    """
    prior_mean, prior_sd = unknowns.prior(machine)
    kept = np.flatnonzero((prior_sd > 0.0) & ~_is_noise())
    start, sd = prior_mean[kept], prior_sd[kept]
    told = [_rows_of(*_data_of(fit, kept, start, sd), sd) for fit in fits]
    values = np.concatenate([value for _, value in told])
    count, own = len(fits), len(kept) - 6
    free = np.zeros((len(values) + own, 6 * count + own))
    free[len(values) :, 6 * count :] = np.eye(own)  # the machine's unknowns, by the prior
    row = 0
    for k, (rows, _) in enumerate(told):
        at = slice(row, row + len(rows))
        free[at, 6 * k : 6 * k + 6], free[at, 6 * count :] = rows[:, :6], rows[:, 6:]
        row += len(rows)
    links = np.zeros((6 * (count - 1), free.shape[1]))
    for k, metres in enumerate(between_m):
        share = retained_share(metres)
        step = np.eye(6) / max(math.sqrt(1.0 - share**2), LEAST_DRIFT)
        links[6 * k : 6 * k + 6, 6 * k : 6 * k + 12] = np.hstack([-share * step, step])
    observed = np.concatenate([values, np.zeros(own)])
    alone, rank = _left(free, observed)
    linked, linked_rank = _left(np.vstack([free, links]), np.concatenate([observed, np.zeros(len(links))]))
    dof = len(links) + rank - linked_rank
    if dof < 1:
        return Agreement(0.0, 0, 1.0, _TOO_FEW)
    found = max(linked - alone, 0.0)
    p = float(chi2.sf(found, dof))
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


def _data_of(fit: SegmentFit, kept: NDArray[np.intp], start: Array, sd: Array) -> tuple[Array, Array]:
    """(D, D (y - p0)) of a segment's data over the unknowns kept, without errors of the model."""
    covariance = fit.covariance[np.ix_(kept, kept)].copy()
    covariance[SIX, SIX] -= _shrunk(covariance[SIX, SIX], fit.model_sd)
    information = information_of(covariance, sd)
    change = fit.mean[kept] - start
    return information, information @ change + change / sd**2


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


def _rows_of(information: Array, pull: Array, prior_sd: Array) -> tuple[Array, Array]:
    """(V', V^+ D (y - p0)) in prior sds: what a segment says of the directions of which it tells enough.

    information: D, (n, n). pull: D (y - p0) as `_data_of` gives it.
    """
    values, vectors = np.linalg.eigh(information * np.outer(prior_sd, prior_sd))
    told = values > LEAST_SHARE
    roots = np.sqrt(values[told])
    return roots[:, None] * vectors[:, told].T, vectors[:, told].T @ (pull * prior_sd) / roots


def _is_noise() -> NDArray[np.bool_]:
    chosen = np.zeros(len(NAMES), np.bool_)
    chosen[NOISE] = True
    return chosen
