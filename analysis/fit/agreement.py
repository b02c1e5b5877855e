"""Whether segments give the same six, by how much those of one differ from those of another beyond what each
tells of itself, and which of them go together.

Soil differs from place to place, the machine does not. Where several segments must share six that are not
the same, what is left over goes into what they share besides: of soils a factor of two apart, levers were
moved by 12 sds of their survey, and the joint stiffness came out below that of every segment. So between
segments the six have a variance of their own, estimated from all of what they say (random effects by
restricted maximum likelihood). It is zero where they agree.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq
from scipy.special import chdtrc  # scipy.stats takes a second to import

from tilth.analysis.fit.window_terms import SegmentTerms, Terms, places
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.drift import retained_share
from tilth.estimator.filters.unknowns import SIX
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

LEAST_SHARE: Final = 0.2
"""Of the prior's information: directions of which a segment tells less are left out of the test whether
segments agree, since there only the prior's shape would be tested."""
LEAST_DRIFT: Final = 0.01
"""Smallest sd, over the prior's, by which the six of two segments may differ."""
DISAGREE: Final = 0.01  # a smaller p says that the segments do not agree
SPREAD: Final = 0.05
"""With a smaller p segments have a variance between them. Estimated from the few that there are, it is a
matter of chance where they agree: it would widen intervals up to threefold."""
SMALLEST: Final = 0.01  # over the prior's sd: a smaller sd between segments is none
LARGEST: Final = 3.0
_STARTS: Final = (0.03, 0.5)  # of the search for it


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
    def spread(self) -> bool:
        """Whether the six are taken to differ from segment to segment."""
        return self.p < SPREAD


def agree(machine: Machine, told: Sequence[SegmentTerms], between_m: Sequence[float]) -> Agreement:
    """Test whether segments agree on the six, around a common point.

    With D = V V' each segment says V' p = V^+ (-g) with white noise of sd 1; D is narrowed by what the scores
    say of coloured noise. What is the machine's is the same in all. The chi-square is what it costs that the
    six of a segment are those of the one before, too, up to the drift.
    """
    return _agree(_rows(machine, told), between_m)


def _agree(rows: Sequence[tuple[Array, Array]], between_m: Sequence[float]) -> Agreement:
    """rows: of each segment, as `_rows_of`."""
    observed = np.concatenate([value for _, value in rows])
    count, own = len(rows), rows[0][0].shape[1] - 6
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
    found: Any = lstsq(design, observed, cond=1e-9, lapack_driver="gelsy")
    best, _, rank, _ = found
    return float(np.sum((observed - design @ best) ** 2)), int(rank)


_TOO_FEW: Final = "Nothing was told twice, so nothing can be said of whether the segments agree."


def _sentence(count: int, found: float, dof: int, p: float) -> str:
    spread = f"chi-square {found:.1f} with {dof} degrees of freedom, p = {p:.2g}"
    if p >= DISAGREE:
        return f"The {count} segments agree within their intervals ({spread})."
    return (
        f"The {count} segments do not agree ({spread}): soil, load or the machine were not the same, or the "
        "intervals are too narrow here."
    )


def _rows(machine: Machine, told: Sequence[SegmentTerms]) -> list[tuple[Array, Array]]:
    sd = unknowns.prior(machine)[1][places(machine)]
    return [_rows_of(segment, sd) for segment in told]


def _rows_of(segment: SegmentTerms, sd: Array) -> tuple[Array, Array]:
    """(V', -V^+ g) in prior sds: what a segment says of the directions of which it tells enough."""
    scale = np.outer(sd, sd)
    information = np.asarray(sum(one.information for one in segment)) * scale
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


def between_sd(machine: Machine, told: Sequence[SegmentTerms], agreement: Agreement) -> Array:
    """Sds of the six logarithms, (6,), from segment to segment; 0 where they agree.

    By restricted maximum likelihood: the mean of the six has a flat prior, what is the machine's its own.
    What each segment tells is narrowed as in `agree`.
    """
    from scipy.optimize import minimize  # a third of a second, not before the first word

    sd = unknowns.prior(machine)[1][places(machine)]
    if not agreement.spread or len(told) < 2:
        return np.zeros(6)
    rows = _rows(machine, told)
    told_twice = np.array([design.T @ design for design, _ in rows])
    pulls = np.array([design.T @ value for design, value in rows])
    prior = np.diag([0.0] * 6 + [1.0] * (len(sd) - 6)) + 1e-6 * np.eye(len(sd))

    def cost(logs: Array) -> float:
        """-2 log of the restricted likelihood. logs: of the variances, over the prior's."""
        information, pull, size, gained = _with_room(told_twice, pulls, np.exp(logs))
        whole, sum_of = prior + information.sum(axis=0), pull.sum(axis=0)
        root = np.linalg.cholesky(whole)
        best = np.linalg.solve(root, sum_of)
        return float(size.sum() - gained.sum() + 2.0 * np.sum(np.log(np.diag(root))) - best @ best)

    limits = [(2.0 * math.log(SMALLEST / 3.0), 2.0 * math.log(LARGEST))] * 6
    found = [
        minimize(cost, np.full(6, 2.0 * math.log(start)), method="L-BFGS-B", bounds=limits)
        for start in _STARTS
    ]
    sds = np.exp(np.asarray(min(found, key=lambda one: float(one.fun)).x) / 2.0)
    return np.asarray(np.where(sds < SMALLEST, 0.0, sds) * sd[SIX])


def _with_room(information: Array, pull: Array, variances: Array) -> tuple[Array, Array, Array, Array]:
    """What is left of it where the six of each segment are their mean and a change of their own with such
    variances: (information (k, a, a), pull (k, a), log-determinants (k,) and sums of squares (k,) of the
    likelihood). information: (k, a, a), pull: (k, a), variances: (6,)."""
    root = np.sqrt(variances)
    rows = information[:, SIX, :] * root[:, None]
    inside = np.eye(6) + information[:, SIX, SIX] * np.outer(root, root)
    pulled = pull[:, SIX] * root
    solved = np.linalg.solve(inside, np.concatenate([rows, pulled[:, :, None]], axis=2))
    taken = np.einsum("kij,kil->kjl", rows, solved)
    return (
        information - taken[:, :, :-1], pull - taken[:, :, -1], np.linalg.slogdet(inside)[1],
        np.einsum("ki,ki->k", pulled, solved[:, :, -1]),
    )  # fmt: skip


def sum_of(segment: SegmentTerms) -> Terms:
    """The windows of a segment as one; errors of the model weighted by what each tells."""
    weights = np.array([np.diag(one.information)[SIX] for one in segment]) + 1e-12
    return Terms(
        np.asarray(sum(one.gradient for one in segment)),
        np.asarray(sum(one.information for one in segment)),
        np.asarray(sum(one.scores for one in segment)),
        float(np.mean([one.whiteness for one in segment])),
        np.average([one.model_sd for one in segment], axis=0, weights=weights),
    )


def with_room(segment: SegmentTerms, sds: Array) -> SegmentTerms:
    """What a segment says of the mean of the six, where its own differ from that by such sds, (6,)."""
    if not segment or not np.any(sds):
        return segment
    one, root = sum_of(segment), sds
    inside = np.eye(6) + one.information[SIX, SIX] * np.outer(root, root)
    left = np.eye(len(one.gradient))
    left[:, SIX] -= one.information[:, SIX] * root @ np.linalg.inv(inside) * root
    information = left @ one.information
    spread = information + left @ (one.scores - one.information) @ left.T
    return (
        replace(
            one, gradient=left @ one.gradient, information=(information + information.T) / 2, scores=spread
        ),
    )


def own_change(segment: SegmentTerms, sds: Array, change: Array) -> Array:
    """By how much the six of a segment differ from their mean, (6,), where all else changes by `change`,
    (a,)."""
    one, root = sum_of(segment), sds
    inside = np.eye(6) + one.information[SIX, SIX] * np.outer(root, root)
    pull = (one.gradient + one.information @ change)[SIX]
    return np.asarray(-root * np.linalg.solve(inside, root * pull))


def groups(
    machine: Machine, told: Sequence[SegmentTerms], between_m: Sequence[float]
) -> tuple[tuple[int, ...], ...]:
    """Segments that agree among themselves, in order. Neighbours on the way are joined first, the most alike
    before others; then soils that were met again."""
    rows = _rows(machine, told)
    found: list[tuple[int, ...]] = [(k,) for k in range(len(told))]
    for pairs in (_neighbours, _all_pairs):
        known: dict[tuple[int, ...], float] = {}
        while True:
            tried = []
            for a, b in pairs(len(found)):
                both = tuple(sorted(found[a] + found[b]))
                if both not in known:
                    known[both] = _agree([rows[k] for k in both], distances(between_m, both)).p
                tried.append((known[both], a, b))
            p, a, b = max(tried, default=(0.0, 0, 0))
            if p < DISAGREE:
                break
            merged = tuple(sorted(found[a] + found[b]))
            found = sorted([one for k, one in enumerate(found) if k not in (a, b)] + [merged])
    return tuple(found)


def _neighbours(count: int) -> Iterator[tuple[int, int]]:
    return pairwise(range(count))


def _all_pairs(count: int) -> Iterator[tuple[int, int]]:
    return combinations(range(count), 2)


def distances(between_m: Sequence[float], rows: Sequence[int]) -> list[float]:
    """m from each of these segments to the next one of them."""
    return [sum(between_m[a:b]) for a, b in pairwise(rows)]
