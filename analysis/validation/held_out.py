"""How well parameters of some runs predict others: where both bodies go, as the dissertation's tables 7.4 and
7.6 have it, but for every subset of the runs, and with what was not fitted told apart.

A prediction is the motion model's of the estimators, with wheel angle, speed and rolls as measured and all
else left to the model: nothing corrects it after its start.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, islice
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.fit.side_by_side import Map
from tilth.analysis.runs.driven import Driven
from tilth.estimator.filters import likelihood, unknowns
from tilth.estimator.filters.rig_setup import RigSetup, rig_setup
from tilth.estimator.filters.states import X_POSITION, X_PSI, X_R, X_V
from tilth.estimator.record.record import (
    EAST,
    HEADING,
    KIND,
    NORTH,
    PLACE,
    ROLL_ANGLE,
    SD,
    TICK,
    TICK_NS,
    VALUE,
    VELOCITY,
    YAW_RATE,
    Record,
    concatenate,
)
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

SECONDS: Final = 30.0  # of a prediction, as in the dissertation
START_S: Final = 4.0  # at the beginning, from which the first state is found
MOST_SUBSETS_OF: Final = 6  # runs: of more only each alone, all but each, and all
UNCORRECTED: Final = 1e6  # factor on sds: such a measurement corrects nothing
BLOCK_S: Final = 3.0  # of the intervals: errors within are taken for one
RESAMPLED: Final = 200
HORIZONS_S: Final = (1.0, 5.0)
_STARTS: Final = 6  # of predictions over a horizon
_OUTPUTS: Final = {"yaw_rate": YAW_RATE, "velocity": VELOCITY, "heading": HEADING}
_FREE: Final = (X_POSITION, X_POSITION + 1, X_PSI, X_PSI + 1, X_V, X_R, X_R + 1)
_FREE_SD: Final = np.array([0.5, 0.5, 0.03, 0.03, 0.2, 0.03, 0.03])  # m, m, rad, rad, m/s, rad/s, rad/s


@dataclass(frozen=True, slots=True)
class Predictable:
    """A stretch of a run that can be predicted, and its first state."""

    id: str
    record: Record
    start: Array  # (27,)
    noise: Array  # of unknowns.NOISE, by the run's own fit


@dataclass(frozen=True, slots=True)
class Cell:
    """How parameters predict one run."""

    run: str
    held_out: bool  # whether the parameters are not from this run, too
    tractor_m: float  # root mean square distance over SECONDS
    implement_m: float
    tractor_m_low: float  # 95 %, by blocks of BLOCK_S
    tractor_m_high: float
    implement_m_low: float
    implement_m_high: float
    fit_percent: dict[str, float]  # output -> 100 (1 - |error| / |change|), over SECONDS
    horizon_rms: dict[str, dict[str, float]]  # horizon in s -> output -> rad/s, m/s or rad
    gain: float  # log-likelihood of the run over that with the machine file's parameters, nats


@dataclass(frozen=True, slots=True)
class Subset:
    """Parameters of some runs, and how they predict every run."""

    fitted: tuple[str, ...]  # none: the machine file's
    cells: tuple[Cell, ...]  # none where it is refused
    refused: str = ""  # why there are no parameters of these together


def predictable(machine: Machine, id: str, driven: Sequence[Driven], point: Array) -> Predictable | None:
    """The longest stretch of a segment without a gap, at most SECONDS from its beginning; None where it is
    shorter than twice START_S. point: [n] of unknowns.NAMES, by the run's own fit."""
    pieces: list[list[Any]] = [[]]
    for at in driven:
        segment = at.segment
        if segment is None or segment.reason or not len(segment.record.ticks):
            pieces.append([])
        elif not segment.follows and pieces[-1]:
            pieces.append([segment])
        else:
            pieces[-1].append(segment)
    longest = max(pieces, key=len)
    if len(longest) * 0.2 < 2 * START_S:
        return None
    record = concatenate(longest[: round(SECONDS / 0.2)])
    setup = rig_setup(machine)
    start = likelihood.first_state(record, setup)
    return Predictable(id, record, _first_state(record, setup, start, point), point[unknowns.NOISE].copy())


def table(
    machine: Machine, runs: Sequence[Predictable], estimates: Mapping[tuple[str, ...], Array | str],
    each: Map = map,
) -> tuple[Subset, ...]:  # fmt: skip
    """Each subset's parameters over each run; the machine file's first.

    estimates: ids of the runs that were fitted -> [n] of unknowns.NAMES, or why there is none. each: as
    `map`.
    """
    setup, prior = rig_setup(machine), unknowns.prior(machine)[0]
    rows = [((), prior), *estimates.items()]
    whole = ((), tuple(run.id for run in runs))  # of these also over horizons
    before = {run.id: _likelihood(run, setup, _with_noise(prior, run.noise)) for run in runs}
    asked = [
        (setup, run, point, before[run.id], run.id not in ids, ids in whole)
        for ids, point in rows
        if not isinstance(point, str)
        for run in runs
    ]
    cells = iter(each(_cell, *zip(*asked, strict=True)) if asked else ())
    return tuple(
        Subset(ids, (), point) if isinstance(point, str) else Subset(ids, tuple(islice(cells, len(runs))))
        for ids, point in rows
    )


def way(machine: Machine, run: Predictable, point: Array) -> tuple[Array, Array]:
    """Where tractor and implement went, and where parameters say: each (instants, 5), time in s, north and
    east as measured, north and east as predicted, m, of the middle between the body's receivers.

    point: [n] of unknowns.NAMES.
    """
    setup = rig_setup(machine)
    errors = _open_loop(run.record, setup, run.start, _with_noise(point, run.noise))
    tractor, implement = (_way(run.record.rows, errors, body) for body in (0, 1))
    for one in (tractor, implement):
        one[:, 3:] = one[:, 1:3] - one[:, 3:]
    return tractor, implement


def subsets(ids: Sequence[str]) -> list[tuple[str, ...]]:
    """Every subset of up to MOST_SUBSETS_OF runs, smaller ones first; of more runs each alone, all but each,
    and all."""
    every = range(1, len(ids) + 1)
    sizes = every if len(ids) <= MOST_SUBSETS_OF else sorted({1, len(ids) - 1, len(ids)})
    return [chosen for size in sizes for chosen in combinations(ids, size)]


def _cell(
    setup: RigSetup, run: Predictable, point: Array, before: float, held_out: bool, horizons: bool
) -> Cell:
    """before: log-likelihood of the run with the machine file's parameters."""
    here = _with_noise(point, run.noise)
    rows = run.record.rows
    errors = _open_loop(run.record, setup, run.start, here)
    squares = [_squares(rows, errors, body) for body in (0, 1)]
    chosen = _after(rows, START_S)
    return Cell(
        run.id, held_out, _rms(squares[0]), _rms(squares[1]), *_interval(squares[0]), *_interval(squares[1]),
        fit_percent={name: _fit_percent(rows[chosen], errors[chosen], k) for name, k in _OUTPUTS.items()},
        horizon_rms={f"{s:g}": _horizon(run, setup, here, s) for s in HORIZONS_S if horizons},
        gain=_likelihood(run, setup, here) - before,
    )  # fmt: skip


def _rms(squares: Array) -> float:
    return math.sqrt(float(np.mean(squares[:, 1]))) if len(squares) else math.nan


def _with_noise(point: Array, noise: Array) -> Array:
    """The unknowns with a run's own noise levels."""
    out = point.copy()
    out[unknowns.NOISE] = noise
    return out


def _open_loop(record: Record, setup: RigSetup, start: Array, point: Array, until_s: float = 0.0) -> Array:
    """(m,), measured minus predicted; measurements of the first until_s and all rolls correct the state."""
    rows = record.rows.copy()
    free = (rows[:, KIND] != ROLL_ANGLE) & _after(rows, until_s)
    rows[free, SD] *= UNCORRECTED
    measured = Record(record.t_ns, record.ticks, rows)
    return likelihood.innovations(measured, setup, start, point).e


def _after(rows: Array, seconds: float) -> NDArray[np.bool_]:
    return np.asarray(rows[:, TICK] * TICK_NS * 1e-9 >= seconds)


def _first_state(record: Record, setup: RigSetup, start: Array, point: Array) -> Array:
    """The first state with which the prediction fits the first START_S best, by least squares. The rig drives
    straight there, or nearly, so that tyres hardly matter."""
    early = record.rows[~_after(record.rows, START_S)]
    head = Record(record.t_ns, record.ticks[: round(START_S * 50) + 1], early)
    kept = head.rows[:, KIND] != ROLL_ANGLE
    weight = 1.0 / head.rows[kept, SD]
    errors = _open_loop(head, setup, start, point)[kept]
    slopes = np.empty((len(errors), len(_FREE)))
    for k, (state, sd) in enumerate(zip(_FREE, _FREE_SD, strict=True)):
        moved = start.copy()
        moved[state] += 0.01 * sd
        slopes[:, k] = (_open_loop(head, setup, moved, point)[kept] - errors) / 0.01
    design = np.vstack([slopes * weight[:, None], np.eye(len(_FREE))])
    step = np.linalg.lstsq(design, -np.concatenate([errors * weight, np.zeros(len(_FREE))]), rcond=None)[0]
    found = start.copy()
    found[list(_FREE)] += step * _FREE_SD
    return found


def _squares(rows: Array, errors: Array, body: int) -> Array:
    """(instants, 2): time in s, and squared distance in m^2 of a body, the mean over its receivers."""
    way = _way(rows, errors, body)
    return np.column_stack([way[:, 0], np.sum(way[:, 3:] ** 2, axis=1)])


def _way(rows: Array, errors: Array, body: int) -> Array:
    """(instants, 5): time in s, north and east of a body as measured, m, and both less the predicted ones;
    the mean over its receivers."""
    per_tick: dict[float, list[list[tuple[float, float]]]] = {}
    for kind, row, error in zip(rows[:, KIND], rows, errors, strict=True):
        if kind in (NORTH, EAST) and row[PLACE] // 2 == body:
            both = per_tick.setdefault(float(row[TICK]), [[], []])
            both[int(kind == EAST)].append((float(row[VALUE]), float(error)))
    found = []
    for tick, (north, east) in per_tick.items():
        if north and east:
            (x, x_error), (y, y_error) = np.mean(north, axis=0), np.mean(east, axis=0)
            found.append((tick * TICK_NS * 1e-9, x, y, x_error, y_error))
    return np.array(found).reshape(-1, 5)


def _interval(squares: Array) -> tuple[float, float]:
    """95 % of the root mean square, by drawing blocks of BLOCK_S anew."""
    if not len(squares):
        return math.nan, math.nan
    block = (squares[:, 0] // BLOCK_S).astype(int)
    sums = np.bincount(block, squares[:, 1])
    counts = np.bincount(block)
    rng = np.random.default_rng(1)
    drawn = rng.integers(len(sums), size=(RESAMPLED, len(sums)))
    means = sums[drawn].sum(axis=1) / np.maximum(counts[drawn].sum(axis=1), 1)
    low, high = np.sqrt(np.quantile(means, [0.025, 0.975]))
    return float(low), float(high)


def _fit_percent(rows: Array, errors: Array, kind: int) -> float:
    """100 (1 - |error| / |measured - its mean|), over all places of a kind; that of headings without turns of
    the plane, as they are in the record."""
    left, whole = 0.0, 0.0
    for place in set(rows[rows[:, KIND] == kind, PLACE]):
        chosen = (rows[:, KIND] == kind) & (rows[:, PLACE] == place)
        values = rows[chosen, VALUE]
        left += float(np.sum(errors[chosen] ** 2))
        whole += float(np.sum((values - values.mean()) ** 2))
    return 100.0 * (1.0 - math.sqrt(left / whole)) if whole > 0.0 else math.nan


def _horizon(run: Predictable, setup: RigSetup, point: Array, seconds: float) -> dict[str, float]:
    """Root mean square error of predictions over a horizon, from states that the measurements have corrected
    until then."""
    rows, found = run.record.rows, dict[str, list[Array]]()
    length = len(run.record.ticks) * TICK_NS * 1e-9
    for until_s in np.linspace(START_S, max(length - seconds, START_S), _STARTS):
        errors = _open_loop(run.record, setup, run.start, point, float(until_s))
        within = _after(rows, until_s) & ~_after(rows, until_s + seconds)
        for name, kind in _OUTPUTS.items():
            found.setdefault(name, []).append(errors[within & (rows[:, KIND] == kind)])
    joined = {name: np.concatenate(parts) for name, parts in found.items()}
    return {name: math.sqrt(float(np.mean(e**2))) if e.size else math.nan for name, e in joined.items()}


def _likelihood(run: Predictable, setup: RigSetup, point: Array) -> float:
    """Log-likelihood of a run with the state corrected as in a fit, nats, up to a constant."""
    made = likelihood.innovations(run.record, setup, run.start, point)
    scored = _after(run.record.rows, likelihood.LIKELIHOOD.settling_ticks * TICK_NS * 1e-9)
    return -0.5 * float(np.sum((made.e**2 / made.S + np.log(made.S))[scored]))
