"""A fit of straight rows: what the wheel angle does, apart from whatever the ground does.

The filter of predictor.py at the prior's point whitens what a row measured. The response to the wheel angle
is that of the same model about straight driving at the speed that was driven, without measurements. A change
of the unknowns changes the readings by it, and passes through the filter as readings do, gains held. What
is left is regressed on its own past (free_noise.py); the unknowns minimise its cost and the prior's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from studies.rows.free_noise import FreeNoise, gradient_and_information, regress, slopes_left
from tilth.estimator.filters import likelihood
from tilth.estimator.filters.gates import outliers
from tilth.estimator.filters.likelihood import innovations
from tilth.estimator.filters.newton import newton_step
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.states import DT, N_STATES
from tilth.estimator.filters.unknowns import NAMES, NOISES
from tilth.estimator.record.record import (
    EAST,
    HEADING,
    KIND,
    NORTH,
    OFFSET,
    PLACE,
    PSI,
    ROLL,
    TICK,
    VALUE,
    VELOCITY,
    WHEEL_ANGLE,
    YAW_RATE,
    R,
    Record,
)

Array = NDArray[np.float64]

EPOCH_S: Final = 0.2  # for which what an output measured is one value
ORDER: Final = 15  # epochs of the past, 3 s: the last axle meets a rut 7.5 m after the first
SETTLING_S: Final = 10.0  # at the start of a row, in which the filter only finds its state
OUTPUTS: Final = (  # kind, places
    (EAST, (0,)), (EAST, (1,)), (EAST, (2,)), (EAST, (3,)),
    (VELOCITY, (0, 1)), (VELOCITY, (2, 3)), (YAW_RATE, (0,)), (YAW_RATE, (1,)),
)  # fmt: skip
"""In the row's frame, where north is along it: each antenna's position across, each body's velocities and
yaw rates."""
PRESENT: Final = 0.9  # share of the epochs that an output must have, to be used
SCALE: Final = 1e-4  # of the wheel angle, for a response about straight driving
LEAST_TELLING: Final = 1e-3  # information over that of the prior, of an unknown that a row can move
MOST_STEPS: Final = 15
LONGEST_STEP: Final = 0.7  # of any of the six logarithms
SETTLED: Final = 0.1  # of a posterior sd of the six: a step this small ends the search
SHARES: Final = (1.0, 0.6, 0.3, 0.1, 0.02)  # of a step, that are tried


class StraightResponse(NamedTuple):
    """Readings of a row at a point of the unknowns, as steering alone makes them."""

    readings: Array  # (m,)
    slopes: Array  # (m, a), by the active unknowns; (m, 0) if not asked for


@dataclass(frozen=True, slots=True)
class DrivenRow:
    """One row, through the filter at the prior's point."""

    record: Record  # along north
    steered: Record  # the same without motions and readings
    used: Array  # (m,)
    e: Array  # (m,), innovations
    sd: Array  # (m,), theirs
    places: NDArray[np.int64]  # (k,), where in the epochs' outputs each of `chosen` belongs
    chosen: NDArray[np.int64]  # (k,), rows of the record that are outputs
    counts: Array  # (n c,), rows of each output of each epoch
    epochs: int
    wheel_angle: Array  # (n,), at each epoch, rad


@dataclass(frozen=True, slots=True)
class RowPosterior:
    """Result of a fit of rows and a prior."""

    mean: Array  # (n,), of unknowns.NAMES
    covariance: Array  # (n, n)
    steps: int
    converged: bool
    seconds: float  # of driving, settled
    wheel_rms: float  # rad
    own_share: float  # of the wheel angle's variance that the past of what was measured does not explain


def along_north(record: Record) -> Record:
    """The record with its row along north and its first position as the origin."""
    ticks, rows = record.ticks.copy(), record.rows.copy()
    psi = float(np.median(ticks[:, PSI]))
    ticks[:, PSI : PSI + 2] -= psi
    rows[rows[:, KIND] == HEADING, VALUE] -= psi
    north, east = (np.flatnonzero(rows[:, KIND] == kind) for kind in (NORTH, EAST))
    order = [np.lexsort((rows[at, PLACE], rows[at, OFFSET], rows[at, TICK])) for at in (north, east)]
    north, east = north[order[0]], east[order[1]]
    across, along = (rows[at, VALUE] - rows[at[0], VALUE] for at in (east, north))
    rows[north, VALUE] = np.cos(psi) * along + np.sin(psi) * across
    rows[east, VALUE] = np.cos(psi) * across - np.sin(psi) * along
    return Record(record.t_ns, ticks, rows)


def _without_motion(record: Record) -> Record:
    ticks, rows = record.ticks.copy(), record.rows.copy()
    ticks[:, [PSI, PSI + 1, R, R + 1, ROLL, ROLL + 1]] = 0.0
    rows[:, VALUE] = 0.0
    return Record(record.t_ns, ticks, rows)


def row_of(record: Record, setup: RigSetup, point: Array) -> DrivenRow:
    """A row, whose record has no gap, through the filter at a point, (n,), of the unknowns."""
    record = along_north(record)
    start, rows = likelihood.first_state(record, setup), record.rows
    used = np.all(np.isfinite(rows), axis=1).astype(np.float64)
    made = innovations(record, setup, start, point, used=used)
    settled = rows[:, TICK] >= likelihood.LIKELIHOOD.settling_ticks
    used[settled & outliers(rows, made.e, made.S)] = 0.0
    made = innovations(record, setup, start, point, used=used)
    instants = rows[:, TICK] * DT + rows[:, OFFSET]
    phase = float(np.angle(np.mean(np.exp(2j * np.pi * instants / EPOCH_S)))) / (2 * np.pi) * EPOCH_S
    epoch = np.floor((instants - phase) / EPOCH_S + 0.5).astype(np.int64)
    first, epochs = int(epoch.min()), int(epoch.max() - epoch.min()) + 1
    output = np.full(len(rows), -1)
    for k, (kind, places) in enumerate(OUTPUTS):
        output[(rows[:, KIND] == kind) & np.isin(rows[:, PLACE], places)] = k
    chosen = np.flatnonzero((output >= 0) & (used > 0.0))
    at = (epoch[chosen] - first) * len(OUTPUTS) + output[chosen]
    counts = np.bincount(at, minlength=epochs * len(OUTPUTS)).astype(np.float64)
    ticks = np.clip(np.round(((np.arange(epochs) + first) * EPOCH_S + phase) / DT), 0, len(record.ticks) - 1)
    return DrivenRow(
        record, _without_motion(record), used, made.e, np.sqrt(made.S), at, chosen, counts, epochs,
        record.ticks[ticks.astype(np.int64), WHEEL_ANGLE],
    )  # fmt: skip


def by_epoch(row: DrivenRow, values: Array) -> Array:
    """Whitened values of the record's rows, (m, k), as outputs of the epochs, (n, c, k)."""
    scaled = (values / row.sd[:, None])[row.chosen]
    sums = np.stack([np.bincount(row.places, v, minlength=len(row.counts)) for v in scaled.T], axis=1)
    weighted = np.asarray(sums, np.float64) / np.sqrt(np.maximum(row.counts, 1.0))[:, None]
    return np.asarray(weighted.reshape(row.epochs, len(OUTPUTS), values.shape[1]))


class RowFit:
    """The problem of a fit: rows, a prior with its point."""

    def __init__(self, records: Sequence[Record], setup: RigSetup, mean: Array, covariance: Array) -> None:
        """mean: (n,), covariance: (n, n), the prior over unknowns.NAMES."""
        self.setup, self.mean, self.prior_covariance = setup, mean, covariance
        self.rows = [row_of(record, setup, mean) for record in records]
        free = np.diag(covariance) > 0.0
        motion = np.array([name not in NOISES for name in NAMES])
        self.active = np.flatnonzero(free & motion)
        at_rest = [self._open_loop(row, mean, self.active, 0.0).slopes for row in self.rows]
        self.constant = np.any([np.any(slopes != 0.0, axis=0) for slopes in at_rest], axis=0)
        self.offsets = [slopes[:, self.constant] for slopes in at_rest]
        self.first = [self._response(row, mean, likelihood.NOTHING).readings for row in self.rows]
        self.e = [by_epoch(row, row.e[:, None])[self.skip :, :, 0] for row in self.rows]
        present = np.mean(
            [np.mean(row.counts.reshape(row.epochs, -1) > 0, axis=0) for row in self.rows], axis=0
        )
        self.present = present > PRESENT
        self.prior_information = likelihood.inverse(covariance[np.ix_(self.active, self.active)])

    @property
    def skip(self) -> int:
        """Epochs at the start of a row that are not used but as the past of others."""
        return round(SETTLING_S / EPOCH_S) - ORDER

    def _open_loop(
        self, row: DrivenRow, point: Array, places: NDArray[np.int64], scale: float
    ) -> StraightResponse:
        ticks = row.steered.ticks.copy()
        ticks[:, WHEEL_ANGLE] *= scale
        made = innovations(
            Record(row.steered.t_ns, ticks, row.steered.rows), self.setup, np.zeros(N_STATES), point, places,
            closed=False,
        )  # fmt: skip
        return StraightResponse(-made.e, -made.de)

    def _response(self, row: DrivenRow, point: Array, places: NDArray[np.int64]) -> StraightResponse:
        """About straight driving, where it is in proportion to the wheel angle."""
        turned = self._open_loop(row, point, places, SCALE)
        return StraightResponse(turned.readings / SCALE, turned.slopes / SCALE)

    def _filtered(self, row: DrivenRow, readings: Array) -> Array:
        """What changes of the readings, (m, k), make of the innovations of the epochs, (n, c, k)."""
        count = readings.shape[1]
        made = innovations(
            row.record, self.setup, likelihood.first_state(row.record, self.setup), self.mean,
            np.resize(self.active, count), used=row.used, instruments=np.ascontiguousarray(readings),
            responding=np.ones(count, dtype=np.bool_),
        )  # fmt: skip
        return by_epoch(row, made.de)[self.skip :]

    def _split(self, point: Array) -> tuple[Array, Array]:
        """(the point with what is constant at the prior's mean, by how much that is off)."""
        steered, constant = point.copy(), self.active[self.constant]
        steered[constant] = self.mean[constant]
        return steered, (point - self.mean)[constant]

    def at(self, points: Array) -> list[tuple[FreeNoise, float]]:
        """(the regression, the cost with that of the prior) at each point, (k, n)."""
        made = self.innovations_at(points)
        return [self._judged(point, stretches) for point, stretches in zip(points, made, strict=True)]

    def innovations_at(self, points: Array) -> list[list[Array]]:
        """At each point, (k, n): less what steering changes there, (n_i, c) of each row."""
        left: list[list[Array]] = [[] for _ in points]
        for row, e, first, offsets in zip(self.rows, self.e, self.first, self.offsets, strict=True):
            changes = []
            for point in points:
                steered, off = self._split(point)
                readings = self._response(row, steered, likelihood.NOTHING).readings
                changes.append(readings - first + offsets @ off)
            made = self._filtered(row, np.stack(changes, axis=1))
            for k, stretches in enumerate(left):
                stretches.append((e - made[:, :, k])[:, self.present])
        return left

    def _judged(self, point: Array, stretches: list[Array]) -> tuple[FreeNoise, float]:
        deviation = (point - self.mean)[self.active]
        prior = 0.5 * float(deviation @ self.prior_information @ deviation)
        sound = all(bool(np.all(np.isfinite(e))) for e in stretches)  # not after a step that is too long
        noise = regress(stretches if sound else [e[:, self.present] for e in self.e], ORDER)
        return noise, noise.cost + prior if sound else np.inf

    def slopes(self, point: Array) -> list[Array]:
        """Of the innovations by the active unknowns, (n_i, c, a) of each row."""
        steered, _ = self._split(point)
        found = []
        for row, offsets in zip(self.rows, self.offsets, strict=True):
            by_unknown = self._response(row, steered, self.active).slopes
            by_unknown[:, self.constant] = offsets
            found.append(-self._filtered(row, by_unknown)[:, self.present])
        return found

    def maximise(self) -> RowPosterior:
        """The posterior: Gauss and Newton's steps, each as long as lowers the cost."""
        point, converged, steps = self.mean.copy(), False, 0
        [(noise, cost)] = self.at(point[None])
        information = self.prior_information
        for _ in range(MOST_STEPS):
            steps += 1
            gradient, told = gradient_and_information(noise, slopes_left(noise, self.slopes(point)))
            deviation = (point - self.mean)[self.active]
            gradient, information = (
                gradient + self.prior_information @ deviation,
                told + self.prior_information,
            )
            newton, sds = newton_step(gradient, information)
            longest = float(np.max(np.abs(newton[self.active < 6]), initial=0.0))
            most = min(1.0, LONGEST_STEP / max(longest, 1e-9))
            share, noise, cost = self._search(point, newton, most, noise, cost)
            point[self.active] += share * newton
            if (
                float(np.max((np.abs(newton) / sds)[self.active < 6], initial=0.0)) * max(share, 0.1)
                < SETTLED
            ):
                converged = True
                break
            if share == 0.0:
                break
        covariance = self.prior_covariance.copy()
        covariance[np.ix_(self.active, self.active)] = likelihood.inverse(information)
        wheel = np.concatenate([row.wheel_angle[self.skip + ORDER :] for row in self.rows])
        wheel = wheel - wheel.mean()
        unexplained = wheel - noise.explained(wheel)
        share = float(unexplained @ unexplained / noise.freedom / np.mean(wheel**2))
        return RowPosterior(
            point,
            covariance,
            steps,
            converged,
            len(wheel) * EPOCH_S,
            float(np.std(wheel)),
            min(share, 1.0),
        )

    def _search(
        self, point: Array, newton: Array, longest: float, noise: FreeNoise, cost: float
    ) -> tuple[float, FreeNoise, float]:
        """(share of the step that is taken, what is there): of SHARES the one of least cost; 0 if none lowers
        it. They are tried together, since most of the work is the filter's own."""
        shares = np.array(SHARES) * longest
        trials = np.tile(point, (len(shares), 1))
        trials[:, self.active] += np.outer(shares, newton)
        tried = [(float(share), *there) for share, there in zip(shares, self.at(trials), strict=True)]
        best = min(tried, key=lambda each: each[2])
        return best if best[2] < cost else (0.0, noise, cost)
