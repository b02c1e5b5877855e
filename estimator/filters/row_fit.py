"""A fit of straight rows: what the wheel angle does, apart from whatever the ground does.

A filter whitens what the rows measured (row_filter.py). The response to the wheel angle is that of its model
about straight driving (straight_driving.py), with all unknowns of the motion and of the sensors. What is left
is regressed on its own past (free_noise.py). The unknowns minimise the cost of that and of the prior. The
filter stands at the prior's point first, then where the search has ended: where the tyres are far from the
prior's, and the steering answers the ground, the first one leaves more than its past can explain.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import likelihood
from tilth.estimator.filters.free_noise import FreeNoise, gradient_and_information, of_pieces, regress
from tilth.estimator.filters.newton import newton_step
from tilth.estimator.filters.plain_row import OUTPUTS, PLAIN_ROW, PlainRow, plain_row
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.row_filter import (
    AT_PLAY,
    N_ROW_UNKNOWNS,
    ZERO,
    KeptGains,
    Whitened,
    respond,
    set_gains,
)
from tilth.estimator.filters.straight_driving import KEPT, filter_model, straight_model, tabulated
from tilth.estimator.filters.unknowns import NAMES, NOISES
from tilth.estimator.record.record import (
    WHEEL_ANGLE,
    Record,
    U,
)
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]

OF_BODIES: Final = ((0, 1, 4, 6), (2, 3, 5, 7))  # of OUTPUTS
OF_ROWS: Final = np.arange(AT_PLAY, N_ROW_UNKNOWNS)  # unknowns of each fit anew


@dataclass(frozen=True, slots=True)
class RowFitTuning:
    """Numerics of a fit of rows."""

    past_lengths: float = tuned(1.2, "1", "that the past reaches back, over the way from front to last axle")
    least_order: int = tuned(10, "epochs", "of the past")
    most_order: int = tuned(25, "epochs", "of the past")
    settling_s: float = tuned(5.0, "s", "at the start of a row, in which the filter only finds its state")
    """No less than the past. Fifteen rows of 25 s held 24 of 24 with 3, 5 or 10; sds are smallest with 3."""
    present: float = tuned(0.9, "1", "share of the epochs that an output must have, to be used")
    zero_sd: float = tuned(math.radians(1.0), "rad", "of the wheel angle of a row that goes straight on")
    play_sd: float = tuned(math.radians(0.06), "rad", "rms of half the play of wheel sensors")
    """Linkages have 0.05 to 0.2 degrees from flank to flank, worn ones more."""
    rate_scale_sd: float = tuned(0.01, "1", "of the logarithm of turn rates over true ones, of each body")
    least_telling: float = tuned(0.01, "1", "information over the prior's, of an unknown that rows can move")
    most_steps: int = tuned(12, "steps", "of the search")
    longest_step: float = tuned(0.7, "1", "of any of the six logarithms")
    settled: float = tuned(0.3, "sd", "of the posterior of the six: a step this small ends the search")
    """It is taken, and what is left is less by far. With 0.1 five of six rows of two minutes came out within
    0.2 sd, in half as long again."""
    flat_cost: float = tuned(0.1, "nat", "a step that lowers the cost by less ends the search, too")
    renewed: float = tuned(0.3, "sd", "of the six, that a point moves until slopes are renewed")
    beyond: float = tuned(0.8, "1", "a step whose parabola is lowest before this share went too far")
    shares: tuple[float, ...] = tuned((1.0, 0.5, 0.25, 0.1, 0.03), "1", "of a step, tried one by one")
    filters: int = tuned(
        4, "runs", "at most: the first at the prior's point, each other where a search ended"
    )
    same_place: float = tuned(0.3, "sd", "of the six, by which two searches in a row end apart at most")
    piece_m: float = tuned(40.0, "m", "of a row at most, of which it is told apart what it tells")


ROW_FIT: Final = RowFitTuning()


class RowPiece(NamedTuple):
    """What a piece of a row tells of the six at the end of the fit, all but its zero as the fit has found
    it."""

    row: int  # number of its row
    begin_s: float  # since the row began
    end_s: float
    gradient: Array  # (6,), of the log-likelihood
    information: Array  # (6, 6)


class RowPosterior(NamedTuple):
    """Result of a fit of rows and a prior."""

    mean: Array  # (n,), of unknowns.NAMES
    covariance: Array  # (n, n)
    steps: int
    converged: bool
    seconds: float  # of driving, settled
    wheel_rms: float  # rad
    own_share: float  # of the wheel angle's variance that the past of what was measured does not explain
    cost: float  # per epoch
    play: float  # rad, half of that of the wheel sensor
    pieces: tuple[RowPiece, ...]


@dataclass(frozen=True, slots=True)
class WhitenedRow:
    """One row, whitened."""

    whitened: Whitened
    epochs: int
    e: Array  # (n, c), innovations of the epochs
    present: Array  # (c,), share of the epochs that have an output
    wheel_angle: Array  # (n,), rad


@dataclass(slots=True)
class RowPoint:
    """Where a search is."""

    unknowns: Array  # (n,)
    own: Array  # (r + 3,), of this fit: zeros of the wheel angle in each row, rad, then OF_ROWS
    noise: FreeNoise
    cost: float
    slopes: list[Array] = field(default_factory=list)


def _of_row(point: Array, zero: float, of_rows: Array) -> Array:
    """The unknowns of a row, (N_ROW_UNKNOWNS,): a point with another zero of the wheel angle, and OF_ROWS."""
    there = np.concatenate([point, of_rows])
    there[ZERO] = zero
    return there


def whitened_row(row: PlainRow, setup: RigSetup, point: Array) -> WhitenedRow:
    """A row through the filter at a point, (n,), of the unknowns."""
    ticks, rows, m, n = row.ticks, row.rows, len(row.rows), len(KEPT)
    speeds, stops = tabulated(ticks), row.stops
    gains = KeptGains(np.empty(m), np.empty(m), np.zeros((m, n)), np.zeros((m, n)), row.used.copy())
    model, mean_reading = filter_model(speeds, point, setup), np.array([ticks[:, WHEEL_ANGLE].mean()])
    each = Whitened(
        ticks, rows, gains, model, np.arange(m), np.ones(m), mean_reading, row.flanks, stops
    )  # fmt: skip
    response, straight = np.empty((m, 1)), straight_model(speeds, point, setup, likelihood.NOTHING)
    respond(each, straight, _of_row(point, 0.0, np.zeros(len(OF_ROWS))), likelihood.NOTHING, response)
    left = row.across - response[:, 0]
    set_gains(ticks, rows, left, point, model, likelihood.LIKELIHOOD.settling_ticks, stops, gains)
    count = len(row.wheel_angle)
    slots = np.where((row.outputs >= 0) & (gains.used > 0.0), row.epoch * len(OUTPUTS) + row.outputs, -1)
    chosen = slots >= 0
    counts = np.bincount(slots[chosen], minlength=count * len(OUTPUTS))
    scales = np.zeros(m)
    scales[chosen] = 1.0 / np.sqrt(gains.S[chosen] * counts[slots[chosen]])
    e = np.bincount(slots[chosen], scales[chosen] * gains.e[chosen], minlength=count * len(OUTPUTS))
    present = np.mean(np.asarray(counts.reshape(count, -1) > 0, np.float64), axis=0)
    whitened = each._replace(slots=slots.astype(np.int64), scales=scales)
    outputs = np.asarray(e, np.float64).reshape(count, len(OUTPUTS))
    return WhitenedRow(whitened, count, outputs, present, row.wheel_angle)


class RowFit:
    """The problem of a fit: rows, a prior with its point."""

    def __init__(
        self,
        rows: Sequence[PlainRow],
        setup: RigSetup,
        mean: Array,
        covariance: Array,
        begin: tuple[Array, Array] | None = None,
    ) -> None:
        """rows: each longer than `least_seconds`. mean: (n,), covariance: (n, n), the prior over
        unknowns.NAMES. begin: as `end` of another fit, where the search begins; the filter stands at its
        point. None: at the prior's."""
        self.setup, self.mean, self.prior_covariance = setup, mean, covariance
        of_rows = [ROW_FIT.play_sd, ROW_FIT.rate_scale_sd, ROW_FIT.rate_scale_sd]
        self.own_sd = np.array([ROW_FIT.zero_sd] * len(rows) + of_rows)
        self.none = np.zeros(len(self.own_sd))
        self.end = begin or (mean, self.none)
        self.whitened_at = self.end[0]
        self.rows = [whitened_row(row, setup, self.whitened_at) for row in rows]
        self.order = _order(self.rows, setup)
        present = np.mean([row.present for row in self.rows], axis=0)
        self.outputs = np.flatnonzero(present > ROW_FIT.present)
        self.first = [self._respond(k, self.whitened_at, self.none)[0] for k in range(len(self.rows))]
        free = np.diag(covariance) > 0.0
        motion = np.array([name not in NOISES and name != "wheel_zero" for name in NAMES])
        self._choose(np.flatnonzero(free & motion))

    def _choose(self, active: NDArray[np.int64]) -> None:
        self.active = active
        self.prior_information = np.zeros((len(active) + len(self.own_sd),) * 2)
        within = self.prior_covariance[np.ix_(active, active)]
        self.prior_information[: len(active), : len(active)] = likelihood.inverse(within)
        self.prior_information[len(active) :, len(active) :] = np.diag(self.own_sd**-2.0)

    @property
    def measured(self) -> bool:
        """Whether something of each body is."""
        return all(np.isin(self.outputs, of_body).any() for of_body in OF_BODIES)

    @property
    def skip(self) -> int:
        """Epochs at the start of a row that are not used but as the past of others."""
        return round(ROW_FIT.settling_s / PLAIN_ROW.epoch_s) - self.order

    def _respond(
        self, k: int, point: Array, own: Array, places: NDArray[np.int64] = likelihood.NOTHING
    ) -> tuple[Array, Array]:
        """Of row k at a point, (n,) and (r + 3,): (the whitened response (n, c), its slopes (n, c, a) by
        those at places)."""
        row = self.rows[k]
        of_model = places[places < AT_PLAY]
        model = straight_model(tabulated(row.whitened.ticks), point, self.setup, of_model)
        out = np.empty((row.epochs * len(OUTPUTS), 1 + len(places)))
        respond(row.whitened, model, _of_row(point, own[k], own[-len(OF_ROWS) :]), places, out)
        shaped = out.reshape(row.epochs, len(OUTPUTS), -1)[self.skip :, self.outputs]
        return shaped[:, :, 0], shaped[:, :, 1:]

    def at(self, unknowns: Array, own: Array, sloped: bool = False) -> RowPoint | None:
        """A point, and its slopes if asked for; None where the rig that it is of runs away."""
        places = self._places() if sloped else likelihood.NOTHING
        made = [self._respond(k, unknowns, own, places) for k in range(len(self.rows))]
        left = [
            row.e[self.skip :, self.outputs] - response + first
            for row, (response, _), first in zip(self.rows, made, self.first, strict=True)
        ]
        if not all(np.all(np.isfinite(e)) and np.max(np.abs(e)) < 1e6 for e in left):
            return None
        off, noise = self._deviation(unknowns, own), regress(left, self.order)
        cost = noise.cost + 0.5 * float(off @ self.prior_information @ off)
        slopes = [self._of_fit(k, slopes) for k, (_, slopes) in enumerate(made) if sloped]
        return RowPoint(unknowns, own, noise, cost, slopes)

    def _deviation(self, unknowns: Array, own: Array) -> Array:
        return np.concatenate([(unknowns - self.mean)[self.active], own])

    def _places(self) -> NDArray[np.int64]:
        """Of what a row's slopes are by."""
        return np.concatenate([self.active, [ZERO], OF_ROWS])

    def slopes(self, at: RowPoint) -> list[Array]:
        """Of the innovations by the active unknowns and those of this fit, (n_i, c, a + r + 3)."""
        places, rows = self._places(), range(len(self.rows))
        return [self._of_fit(k, self._respond(k, at.unknowns, at.own, places)[1]) for k in rows]

    def _of_fit(self, k: int, slopes: Array) -> Array:
        """The same of row k's response, (n, c, a + 1 + 3), where no other row's zero is among them."""
        active = len(self.active)
        each = np.zeros((*slopes.shape[:2], active + len(self.own_sd)))
        each[:, :, :active] = -slopes[:, :, :active]
        each[:, :, active + k] = -slopes[:, :, active]
        each[:, :, -len(OF_ROWS) :] = -slopes[:, :, -len(OF_ROWS) :]
        return each

    def _terms(self, at: RowPoint) -> tuple[Array, Array]:
        return self._with_prior(at, *gradient_and_information(at.noise, at.slopes))

    def _with_prior(self, at: RowPoint, gradient: Array, told: Array) -> tuple[Array, Array]:
        off = self._deviation(at.unknowns, at.own)
        return gradient + self.prior_information @ off, told + self.prior_information

    def maximise(self) -> RowPosterior:
        """The posterior: Gauss and Newton's steps, each as long as lowers the cost."""
        start = self.at(*self.end, sloped=True)
        if start is None:
            raise ValueError("the response to the wheel angle runs away where the search begins")
        gradient, told = gradient_and_information(start.noise, start.slopes)
        prior = np.diag(self.prior_covariance)[self.active]
        telling = np.diag(told)[: len(self.active)] * prior > ROW_FIT.least_telling
        kept = np.flatnonzero(np.append(telling, np.ones(len(self.none), np.bool_)))
        start.slopes = [np.ascontiguousarray(S[:, :, kept]) for S in start.slopes]
        self._choose(self.active[telling])
        terms = self._with_prior(start, gradient[kept], told[np.ix_(kept, kept)])
        self.first_covariance = self._covariance(terms[1])
        return self._posterior(*self._search(start, terms))

    def _search(self, at: RowPoint, terms: tuple[Array, Array]) -> tuple[RowPoint, int, bool, Array]:
        """(where it ends, steps, whether it settled, the information there with the prior). terms: `_terms`
        of where it begins."""
        six, moved = self.active < 6, 0.0
        for step in range(1, ROW_FIT.most_steps + 1):
            gradient, information = terms
            newton, sds = newton_step(gradient, information)
            longest = float(np.max(np.abs(newton[: len(six)][six]), initial=0.0))
            most = min(1.0, ROW_FIT.longest_step / max(longest, 1e-9))
            then = self._descend(at, most * newton, most * float(gradient @ newton))
            size = float(np.max((np.abs(newton) / sds)[: len(six)][six], initial=0.0))
            if then is None and moved == 0.0:
                return at, step, size < ROW_FIT.settled, information
            if then is None:  # along slopes of another point
                at.slopes, moved = self.slopes(at), 0.0
                terms = self._terms(at)
                continue
            before = self._deviation(at.unknowns, at.own)
            change = np.abs(self._deviation(then.unknowns, then.own) - before) / sds
            moved += float(np.max(change[: len(six)][six], initial=0.0))
            if moved > ROW_FIT.renewed:
                then.slopes, moved = self.slopes(then), 0.0
            else:
                then.slopes = at.slopes
            flat, at = at.cost - then.cost < ROW_FIT.flat_cost, then
            terms = self._terms(at)
            if size < ROW_FIT.settled or (flat and size < 2 * ROW_FIT.settled):
                return at, step, True, terms[1]
        return at, ROW_FIT.most_steps, False, terms[1]

    def _descend(self, at: RowPoint, change: Array, slope: float) -> RowPoint | None:
        """Of the shares of a step the first that lowers the cost, or the lowest point of the parabola through
        it; None without any. slope: of the cost along the step, nats."""
        for share in ROW_FIT.shares:
            then = self._moved(at, share * change)
            if then is None or then.cost >= at.cost:
                continue
            lowest = -slope * share**2 / (2.0 * max(then.cost - at.cost - slope * share, 1e-9))
            between = self._moved(at, lowest * change) if lowest < ROW_FIT.beyond * share else None
            return between if between is not None and between.cost < then.cost else then
        return None

    def _moved(self, at: RowPoint, change: Array) -> RowPoint | None:
        unknowns = at.unknowns.copy()
        unknowns[self.active] += change[: len(self.active)]
        return self.at(unknowns, at.own + change[len(self.active) :])

    def _following(self) -> Array:
        """By what all unknowns follow the active ones, (n, a): what they were correlated with."""
        active, prior = self.active, self.prior_covariance
        return np.asarray(np.linalg.solve(prior[np.ix_(active, active)], prior[active]).T, np.float64)

    def _covariance(self, information: Array) -> Array:
        """Of all unknowns, (n, n). information: (a + r + 3,) * 2, of the active ones and this fit's."""
        active, prior, follows = self.active, self.prior_covariance, self._following()
        found = likelihood.inverse(information)[: len(active), : len(active)]
        covariance = prior + follows @ (found - prior[np.ix_(active, active)]) @ follows.T
        return (covariance + covariance.T) / 2.0

    def _posterior(self, at: RowPoint, steps: int, converged: bool, information: Array) -> RowPosterior:
        self.end = at.unknowns, at.own
        mean = self.mean + self._following() @ (at.unknowns - self.mean)[self.active]
        settled = self.skip + self.order
        wheel = np.concatenate(
            [row.wheel_angle[settled:] - row.wheel_angle[settled:].mean() for row in self.rows]
        )
        return RowPosterior(
            mean, self._covariance(information), steps, converged, len(wheel) * PLAIN_ROW.epoch_s,
            float(np.sqrt(np.mean(wheel**2))), at.noise.share_of_own(wheel),
            at.cost / len(wheel), float(at.own[-len(OF_ROWS)]), self._pieces(at),
        )  # fmt: skip

    def _pieces(self, at: RowPoint) -> tuple[RowPiece, ...]:
        """What pieces of all rows tell, each with a zero of its own."""
        settled, row_ends, found = self.skip + self.order, 0, list[RowPiece]()
        six, a = np.flatnonzero(self.active < 6), len(self.active)
        slopes = [S[:, :, [*six, a + k]] for k, S in enumerate(at.slopes)]
        spans = list[tuple[int, int, slice]]()  # row, its first epoch that is used, epochs of all
        for k, row in enumerate(self.rows):
            begins, row_ends = row_ends, row_ends + row.epochs - settled
            metres = (row_ends - begins) * PLAIN_ROW.epoch_s * float(np.mean(row.whitened.ticks[:, U]))
            count = math.ceil(metres / ROW_FIT.piece_m)
            ends = np.linspace(begins, row_ends, count + 1).round().astype(int).tolist()
            spans += [(k, begins, slice(*two)) for two in pairwise(ends)]
        gradients, told = of_pieces(at.noise, slopes, [span for _, _, span in spans])
        for (k, begins, span), gradient, each in zip(spans, gradients, told, strict=True):
            by_zero = each[:-1, -1] / (each[-1, -1] + ROW_FIT.zero_sd**-2.0)
            score, information = np.zeros(6), np.zeros((6, 6))
            score[self.active[six]] = by_zero * gradient[-1] - gradient[:-1]
            at_six = np.ix_(self.active[six], self.active[six])
            information[at_six] = each[:-1, :-1] - np.outer(by_zero, each[-1, :-1])
            begin_s, end_s = (PLAIN_ROW.epoch_s * (settled + e - begins) for e in (span.start, span.stop))
            found.append(RowPiece(k, begin_s, end_s, score, information))
        return tuple(found)


def fitted(records: Sequence[Record], setup: RigSetup, mean: Array, covariance: Array) -> RowPosterior | None:
    """The posterior of rows and a prior, (n,) and (n, n); None where too little is measured.

    It is as wide as it depends on where the filter stands, and each of the six at least as wide as the same
    rows tell it at the prior's point. Errors lead the search to where slopes are large, above all to soft
    implement tyres and long lengths, and there they make it sure: an sd of 5 % was 150 % off, where the row
    tells 50 %.
    """
    rows = [plain_row(record) for record in records]
    problem = RowFit(rows, setup, mean, covariance)
    if not problem.measured:
        return None
    found, apart, steps = problem.maximise(), np.zeros(len(mean)), 0
    at_first = np.diag(problem.first_covariance)[:6]
    for _ in range(ROW_FIT.filters - 1):
        steps, before = steps + found.steps, found.mean
        problem = RowFit(rows, setup, mean, covariance, (before, problem.end[1]))
        found = problem.maximise()
        apart = found.mean - before
        if np.all(np.abs(apart[:6]) < ROW_FIT.same_place * np.sqrt(np.diag(found.covariance)[:6])):
            break
    wider = np.ones(len(mean))
    wider[:6] = np.sqrt(np.maximum(at_first / np.diag(found.covariance)[:6], 1.0))
    wide = np.outer(wider, wider) * found.covariance + np.outer(apart, apart)
    return found._replace(covariance=wide, steps=steps + found.steps)


def _order(rows: Sequence[WhitenedRow], setup: RigSetup) -> int:
    """Epochs of the past: until the last axle has come to where the first one was."""
    return order_at(float(np.mean(np.concatenate([row.whitened.ticks[:, U] for row in rows]))), setup)


def order_at(speed: float, setup: RigSetup) -> int:
    """Epochs of the past at a speed, m/s: until the last axle has come to where the first one was."""
    a, _, c, d, e = setup.geometry[:5]
    wanted = ROW_FIT.past_lengths * (a + c + d + e) / speed / PLAIN_ROW.epoch_s
    return int(np.clip(math.ceil(wanted), ROW_FIT.least_order, ROW_FIT.most_order))
