"""How well a plan will tell the six parameters, before it is driven.

Each run is expected without noise: where the filter's model says that both bodies go, measured as often and
as well as the receivers do. What such records tell is what `tilth fit` finds in them: the same terms, the
same join, with all nuisances and the model's errors. The ground and the receivers are as a log found them, or
as the priors of the estimators have them.

A fit holds at the place of its last run, and soil differs from place to place: what a log told counts a
little less with each run that lies between.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.random import default_rng
from numpy.typing import NDArray

from tilth.analysis.fit.fitting import Fitted
from tilth.analysis.fit.joint import Joint, Linearised, join
from tilth.analysis.fit.segment_fit import FittedWindow
from tilth.analysis.fit.window_terms import SegmentTerms, Terms, terms_at
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.states import DT
from tilth.estimator.filters.unknowns import NOISE, SIX
from tilth.estimator.methods import pem
from tilth.estimator.models.planned_run import Scheduled, drives, wheel_angle
from tilth.estimator.record.record import KIND, PLACE, SD, TICK, Record
from tilth.estimator.record.windows import WINDOWS
from tilth.estimator.results.advice import ADVICE, expected, planned_rows
from tilth.schemas.experiment import DrivingLimits, ExperimentPlan
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

LEAD_S: Final = 1.0  # straight, that a driver's run has before the planned one
WINDOW_TICKS: Final = round(WINDOWS.longest * 0.2 / DT)
SHORTEST_TICKS: Final = round(6.0 / DT)  # of a window that is fitted
BETWEEN_M: Final = 150.0  # from one run to the next: the way round


@dataclass(frozen=True, slots=True)
class Known:
    """What is known before a plan is driven."""

    machine: Machine
    point: Array  # [n] of unknowns.NAMES, where records are expected
    before: Linearised | None = None  # what a log has told, around that point
    rates: tuple[tuple[float, float, float, float], ...] = ()  # kind, place, Hz, sd; () by the machine file
    cache: dict[tuple[object, ...], SegmentTerms] = field(default_factory=dict)


def from_machine(machine: Machine) -> Known:
    """Nothing was driven yet."""
    return Known(machine, unknowns.prior(machine)[0])


def from_log(machine: Machine, fitted: Fitted) -> Known:
    """What the fit of a log has told, on its ground, with its receivers. Raises ValueError where it is
    nothing."""
    if fitted.linearised is None:
        raise ValueError("the log tells nothing of the tyres")
    windows = [window for fit in fitted.fits for window in fit.windows]
    point = fitted.linearised.point.copy()
    point[NOISE] = np.mean([window.noise for window in windows], axis=0)
    rows = np.concatenate([window.record.rows for window in windows])
    seconds = sum(len(window.record.ticks) for window in windows) * DT
    kinds = np.unique(rows[:, [KIND, PLACE]], axis=0)
    rates = []
    for kind, place in kinds.tolist():
        chosen = rows[(rows[:, KIND] == kind) & (rows[:, PLACE] == place)]
        rates.append((kind, place, len(chosen) / seconds, float(np.median(chosen[:, SD]))))
    return Known(machine, point, fitted.linearised, tuple(rates))


def told_by(known: Known, scheduled: Scheduled, limits: DrivingLimits, seed: int) -> SegmentTerms:
    """What a run will tell."""
    run = scheduled.run
    side = scheduled.replicate % 2 if run.side == "both" else 0
    drawn = (seed, *scheduled.key) if run.kind == "random" else ()
    name = (run.model_dump_json(exclude={"replicates", "predicted"}), side, drawn, limits.wheel_rate_degps)
    if name not in known.cache:
        angles = wheel_angle(scheduled, limits, default_rng((seed, *scheduled.key)))
        known.cache[name] = told_of(known, run.speed, angles)
    return known.cache[name]


def told_of(known: Known, speed: float, angles: Array) -> SegmentTerms:
    """What a drive will tell. angles: of the wheels, rad, DT apart, (n,), from straight."""
    angles = np.concatenate([np.zeros(round(LEAD_S / DT)), angles])
    record = expected(known.machine, known.point, speed, angles, _rows(known, len(angles)))
    noise = known.point[NOISE].copy()
    made = (terms_at(known.machine, FittedWindow(part, noise), known.point) for part in _windows(record))
    return tuple(_on_average(known, one) for one in made)


def _on_average(known: Known, terms: Terms) -> Terms:
    """What the terms of a record without noise are on average with it: no gradient, scores that vary as the
    information says, innovations as white as those of the log."""
    whiteness = 0.0
    if known.before is not None:
        whiteness = float(np.mean([one.whiteness for told in known.before.told for one in told]))
    return replace(
        terms, gradient=np.zeros_like(terms.gradient), scores=terms.information, whiteness=whiteness
    )


def _rows(known: Known, count: int) -> Array:
    """What the receivers measure at `count` ticks, (m, 6)."""
    if not known.rates:
        return planned_rows(known.machine, count, (ADVICE.receiver_rate,) * 4)
    made = []
    for kind, place, hertz, sd in known.rates:
        ticks = np.arange(0.0, count - 1.0, 1.0 / max(hertz * DT, 1e-3))
        whole = np.floor(ticks)
        zeros = np.zeros(len(ticks))
        made.append(
            np.column_stack([whole, (ticks - whole) * DT, zeros + kind, zeros + place, zeros, zeros + sd])
        )
    rows = np.concatenate(made)
    return rows[np.argsort(rows[:, TICK] * DT + rows[:, 1], kind="stable")]


def _windows(record: Record) -> list[Record]:
    """As the estimator takes a long drive: in windows of at most WINDOWS.longest."""
    found: list[Record] = []
    for first in range(0, len(record.ticks), WINDOW_TICKS):
        last = min(first + WINDOW_TICKS, len(record.ticks))
        if found and last - first < SHORTEST_TICKS:
            break
        chosen = (record.rows[:, TICK] >= first) & (record.rows[:, TICK] < last)
        rows = record.rows[chosen].copy()
        rows[:, TICK] -= first
        found.append(Record(record.t_ns, record.ticks[first:last], rows))
    return found


def joined(known: Known, told: Sequence[SegmentTerms], runs_on: int = 0) -> Joint:
    """The posterior after what the log has told and after these runs, so many runs further on. Raises
    ValueError without any."""
    before = known.before
    every = [*(() if before is None else before.told), *told]
    if not every:
        raise ValueError("nothing to join")
    gaps = () if before is None else before.between_m
    between = [*gaps, *[BETWEEN_M] * (len(every) - 1 - len(gaps))]
    if runs_on:
        every.append(())  # a place of which nothing is told
        between.append(runs_on * BETWEEN_M)
    return join(known.machine, Linearised(known.point, tuple(every), tuple(between), (0.0,) * len(every)))


def sds(known: Known, told: Sequence[SegmentTerms], runs_on: int = 0) -> Array:
    """Sds of the six logarithms, (6,), as they will be published after these runs, so many further on."""
    if not told and known.before is None:
        return np.asarray(unknowns.prior(known.machine)[1][SIX], np.float64)
    return np.asarray(np.sqrt(np.diag(joined(known, told, runs_on).covariance)[SIX]), np.float64)


def worst_of(known: Known, sd: Array) -> float:
    """The largest of six such sds, without what the machine file does not know of the masses: driving tells
    stiffnesses over masses only, whichever way one drives."""
    masses = np.diag(pem.of_masses(np.diag(unknowns.prior(known.machine)[1] ** 2)))[SIX]
    return float(np.sqrt(np.max(np.square(sd) - masses)))


def predicted(known: Known, plan: ExperimentPlan) -> Array:
    """Sds of the six logarithms after a whole plan, (6,)."""
    planned = drives(plan, default_rng)
    return sds(known, [told_by(known, one, plan.limits, plan.seed) for one, _ in planned])


def without_log(known: Known) -> Known:
    """The same ground and receivers, and nothing told of the tyres yet: as a fit of the runs alone."""
    return replace(known, before=None)
