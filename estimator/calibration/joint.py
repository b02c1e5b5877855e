"""One estimate over all records of a drive: maximum of the product's own likelihood by Fisher scoring.

All records share one vector of unknowns (unknowns.NAMES), the six and the noise levels among them. The
covariance is that of the likelihood, widened by how the scores vary over time, as in pem. What pem does for
the six beyond that, to count only what known steering explains, is not done: geometry does not hang on the
ground's forces, and over half a minute of tight turns the open loop that it needs may run away.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration.residuals import KindResiduals, residuals, squares_of
from tilth.estimator.filters import fit_covariance, likelihood, scoring, unknowns
from tilth.estimator.filters.likelihood import Iterate, Search
from tilth.estimator.filters.newton import Rule, minimise
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.unknowns import NAMES, NOISE, SIX
from tilth.estimator.record.record import KIND, Record
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]
Progress = Callable[[int, float], None]  # steps done, largest step in sds


@dataclass(frozen=True, slots=True)
class JointTuning:
    """The search of the joint fit."""

    most_steps: int = tuned(10, "steps", "at most, with noise levels held")
    settled: float = tuned(0.15, "sd", "a step this small ends a search")
    longest: float = tuned(1.0, "sd", "of the prior, in one step")
    most_damping: float = tuned(1e6, "1", "with more, no step helps")


JOINT: Final = JointTuning()


@dataclass(frozen=True, slots=True)
class Half:
    """What every other record says alone, near the common point."""

    mean: Array  # [n]
    covariance: Array  # [n, n]


@dataclass(frozen=True, slots=True)
class JointFit:
    """Of n unknowns."""

    mean: Array  # [n]
    covariance: Array  # [n, n]
    prior_mean: Array  # [n]
    prior_sd: Array  # [n]
    halves: tuple[Half, Half] | None  # None of fewer than four records
    seconds: float
    rows: int
    outliers: int
    whiteness: float  # autocorrelation of innovations at lag one
    residual: float  # rms of the innovations over their sds
    left: tuple[KindResiduals, ...]  # the same by kind of measurement, over the stated noise
    steps: int
    settled: bool


class _Sum:
    """Gradient and information of the records at a point, without the prior."""

    def __init__(self, searches: Sequence[Search], point: Array, before: Sequence[Iterate] | None) -> None:
        self.point = point
        with np.errstate(all="ignore"):  # after a step that is too long nothing is finite; it is rejected
            self.at = [
                likelihood.evaluate(search, point, past, levels=True)
                for search, past in zip(searches, before or repeat(None, len(searches)), strict=True)
            ]
            self.each = [
                _without_prior(
                    search,
                    at,
                    *likelihood.gradient_and_information(search, at, likelihood.scores_at(search, at)),
                )
                for search, at in zip(searches, self.at, strict=True)
            ]
            self.cost = _cost(searches, self.at)
        if not all(
            np.isfinite(gradient).all() and np.isfinite(square).all() for gradient, square in self.each
        ):
            self.cost = np.inf


def fit(
    records: Sequence[Record], setup: RigSetup, mean: Array, sd: Array, start: Array, told: Sequence[int],
    progress: Progress = lambda steps, size: None, noise_steps: int = 6, most_steps: int = JOINT.most_steps,
) -> JointFit:  # fmt: skip
    """mean, sd: [n], the prior; an unknown with no sd stays fixed. start: [n]. told: unknowns that must
    settle. Raises ValueError without records or steps.

    Noise levels are sought for noise_steps and then held: where there is nothing to a level, it would go on
    for ever. most_steps: with these held, 0 for a fit that only another one begins at.
    """
    if not records:
        raise ValueError("no record to fit")
    if not noise_steps + most_steps:
        raise ValueError("no step to take")
    point, stages = start.copy(), ((noise_steps, False), (most_steps, True))
    made: JointFit | None = None
    for most, held in [stage for stage in stages if stage[0]]:
        free = sd.copy()
        about = mean.copy()
        if held:
            free[NOISE], about[NOISE] = 0.0, point[NOISE]
        searches = [likelihood.search_of(record, setup, about, np.diag(free**2)) for record in records]
        if held:
            for search in searches:
                scoring.leave_out_outliers(search, point)
        active = searches[0].active
        awaited = np.isin(active, told if held else ())
        problem = _Problem(searches, np.diag(free[active] ** -2.0), about, awaited, progress)
        rule = Rule(JOINT.longest * free[active], True, 0.1, 1e-6, most=JOINT.most_damping)
        ended = minimise(problem, _Sum(searches, point, None), rule, most)
        point, settled = ended.at.point, problem.size(ended.sizes) < JOINT.settled
        made = _result(searches, ended.at, point, about, free, ended.steps, settled)
    assert made is not None
    return made


class _Problem(NamedTuple):
    """All records as newton.Problem."""

    searches: Sequence[Search]
    prior: Array  # (a, a)
    mean: Array  # [n]
    awaited: NDArray[np.bool_]  # (a,), which unknowns must settle
    progress: Progress

    def away(self, point: Array) -> Array:
        """From the prior's mean, (a,)."""
        return np.asarray((point - self.mean)[self.searches[0].active], np.float64)

    def terms(self, at: _Sum) -> tuple[_Sum, Array, Array]:
        return at, *_with_prior(at.each, self.prior, self.away(at.point))

    def after(self, at: _Sum, change: Array) -> _Sum | None:
        moved = at.point.copy()
        moved[self.searches[0].active] += change
        with np.errstate(all="ignore"):  # derivatives cost ten times as much: only of steps that are taken
            cost = sum(likelihood.likelihood_at(search, moved) for search in self.searches)
        here, there = (0.5 * float(by @ self.prior @ by) for by in map(self.away, (at.point, moved)))
        if not (np.isfinite(cost) and cost + there < at.cost + here + 0.2):
            return None
        then = _Sum(self.searches, moved, at.at)
        return then if np.isfinite(then.cost) else None

    def taken(self, step: int, at: _Sum) -> _Sum:
        return at

    def settled(self, step: int, before: _Sum, at: _Sum, sizes: Array) -> bool:
        size = self.size(sizes)
        self.progress(step, size)
        return bool(np.any(self.awaited)) and size < JOINT.settled

    def size(self, sizes: Array) -> float:
        """Of a step, by what must settle."""
        return float(np.max(sizes[self.awaited], initial=0.0))


def _cost(searches: Sequence[Search], at: Iterable[Iterate]) -> float:
    return sum(
        likelihood.negative_log_likelihood(search, one.e, one.S)
        for search, one in zip(searches, at, strict=True)
    )


def _without_prior(search: Search, at: Iterate, gradient: Array, information: Array) -> tuple[Array, Array]:
    away = (at.point - search.prior_mean)[search.active]
    return gradient - search.prior_information @ away, information - search.prior_information


def _with_prior(each: Sequence[tuple[Array, Array]], prior: Array, away: Array) -> tuple[Array, Array]:
    gradient = np.asarray(sum((one for one, _ in each), prior @ away), np.float64)
    return gradient, np.asarray(sum((one for _, one in each), prior), np.float64)


def _result(
    searches: Sequence[Search], now: _Sum, point: Array, mean: Array, sd: Array, steps: int, settled: bool
) -> JointFit:
    prior = np.diag(sd[searches[0].active] ** -2.0)
    known = [
        (information, fit_covariance.scores_covariance(search, likelihood.scores_at(search, at)))
        for search, at, (_, information) in zip(searches, now.at, now.each, strict=True)
    ]
    away = (point - mean)[searches[0].active]
    covariance = _covariance(known, prior)
    halves = None
    if len(searches) >= 4:
        one, other = (
            _half(now.each[k::2], known[k::2], prior, point, searches[0].active, away) for k in range(2)
        )
        halves = one, other
    whole = np.zeros((len(NAMES), len(NAMES)))
    whole[np.ix_(searches[0].active, searches[0].active)] = covariance
    white = float(
        np.mean([
            fit_covariance.whiteness(s.record.rows, s.scored, at.e, at.S)
            for s, at in zip(searches, now.at, strict=True)
        ])
    )  # fmt: skip
    for record in searches:
        whole[SIX, SIX] += np.diag(fit_covariance.model_sd_of(record.record, point) ** 2) / len(searches)
    scored = np.concatenate([s.scored for s in searches]) > 0.0
    z = np.concatenate([at.e / np.sqrt(at.S) for at in now.at])[scored]
    kinds = np.concatenate([s.record.rows[:, KIND] for s in searches])[scored]
    return JointFit(
        point, whole, mean, sd, halves,
        sum(len(s.record.ticks) for s in searches) * 0.02, len(z),
        int(sum(np.sum(s.used == 0.0) for s in searches)), white, float(np.sqrt(np.mean(z**2))),
        residuals(squares_of(kinds, z), point), steps, settled,
    )  # fmt: skip


def _covariance(known: Sequence[tuple[Array, Array]], prior: Array) -> Array:
    information = np.asarray(sum((one for one, _ in known), prior), np.float64)
    scores = np.asarray(sum((one for _, one in known), prior), np.float64)
    return fit_covariance.widened(likelihood.inverse(information), scores)


def _half(
    each: Sequence[tuple[Array, Array]], known: Sequence[tuple[Array, Array]], prior: Array, point: Array,
    active: NDArray[np.int64], away: Array,
) -> Half:  # fmt: skip
    gradient, information = _with_prior(each, prior, away)
    mean = point.copy()
    mean[active] -= np.linalg.solve(information, gradient)
    whole = np.zeros((len(NAMES), len(NAMES)))
    whole[np.ix_(active, active)] = _covariance(known, prior)
    return Half(mean, whole)


assert unknowns.SIX == SIX
