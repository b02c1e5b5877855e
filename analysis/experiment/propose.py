"""Proposes a plan of experiments: what to steer, so that the least known of the six is known best.

Each kind of run has a few numbers: frequencies, how long angles are held, the amplitude. They are searched
for the smallest worst sd that its replicates leave, under the limits and with room in the field; then kinds
are chosen that are best together.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.random import default_rng
from numpy.typing import NDArray
from pydantic import TypeAdapter

from tilth.analysis.experiment.predict import Known, predicted, sds, told_by, without_log, worst_of
from tilth.analysis.fit.window_terms import SegmentTerms
from tilth.estimator.models.parameters import Rig, rig_of
from tilth.estimator.models.planned_run import Scheduled, Way, check, drives, needed, way, wheel_angle
from tilth.schemas.experiment import (
    AnyRun,
    DrivingLimits,
    ExperimentPlan,
    PlanError,
    Rectangle,
    Run,
    steered,
)
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]

TRIES: Final = 14  # evaluations of one kind
TURN_SPEED: Final = 2.0  # m/s: headland turns are driven no faster
SHORTEST_S: Final = 8.0  # of a proposed run
MOST_REPLICATES: Final = 40  # of the steps that a plan is compared with
LEAST_AMPLITUDE: Final = 1.0  # degrees
TOLD_ALREADY: Final = 0.95  # of the worst sd: a plan that leaves more of it tells nearly nothing
DRIFT: Final = 0.85  # of the field's width, of a proposed run: a driver comes off its course
_RUN: Final[TypeAdapter[AnyRun]] = TypeAdapter(Run)
SAFE: Final = 0.8  # of the acceleration at which a run is broken off: tyres may hold better than expected


class Number(NamedTuple):
    """One of the few numbers of a kind, searched on a logarithmic scale."""

    key: str
    low: float
    start: float
    high: float


NUMBERS: Final[dict[str, tuple[Number, ...]]] = {
    "step": (),
    "steps": (Number("hold_s", 1.0, 2.5, 6.0),),
    "chirp": (Number("low_hz", 0.04, 0.08, 0.2), Number("high_hz", 0.2, 0.5, 0.6)),
    "random": (Number("shortest_s", 0.5, 0.7, 2.0), Number("longest_s", 1.0, 2.0, 5.0)),
    "multisine": (Number("low_hz", 0.04, 0.08, 0.2), Number("high_hz", 0.2, 0.5, 0.6)),
    "turn": (),
}
"""Of each kind, beside its amplitude, which is the largest allowed: what is steered further tells more, until
the tyre curves count (fit_covariance.TIGHT), which is beyond the limits' default. Nothing is quicker than a
person can follow a bar."""


@dataclass(frozen=True, slots=True)
class WantedPlan:
    """What a person asks for."""

    name: str
    speed: float  # m/s
    seconds: float  # of a run
    replicates: int
    seed: int
    field: Rectangle
    limits: DrivingLimits
    kinds: tuple[str, ...]
    count: int = 3  # kinds in the plan


class BestRun(NamedTuple):
    """The best run of a kind."""

    run: AnyRun
    told: tuple[SegmentTerms, ...]  # by its replicates
    sd: Array  # (6,), after them


@dataclass(frozen=True, slots=True)
class Proposal:
    """A plan, and what it is worth."""

    plan: ExperimentPlan
    seconds: float  # of steering
    sd: Array  # (6,) of the logarithms, after the plan and what was known before
    before: Array  # (6,) where the last run will be, without the plan
    told_already: bool  # by the log, nearly all that the plan could tell
    held: "Compared | None"  # with steps that are held
    swung: "Compared | None"  # with steps to either side, three seconds each, as in MANOEUVRES


class Compared(NamedTuple):
    """What another way to drive takes for the same worst sd."""

    seconds: float  # of steering
    reached: bool  # whether it gets there at all, by MOST_REPLICATES


Progress = Callable[[str, int, int], None]  # what is done now, steps that are over, of all


def propose(known: Known, wanted: WantedPlan, progress: Progress = lambda text, done, of: None) -> Proposal:
    """Raises PlanError where the field or the limits leave no run of any use."""
    best: list[BestRun] = []
    refusals: list[str] = []
    steps = len(wanted.kinds) + 2
    for k, kind in enumerate(wanted.kinds):
        progress(f"searching the best {kind}", k, steps)
        try:
            best.append(_best(known, wanted, kind))
        except PlanError as error:
            refusals.append(str(error))
    if not best:
        raise PlanError(refusals[0])
    progress("choosing what is best together", steps - 2, steps)
    chosen = _together(known, best, wanted.count)
    alone = without_log(known)
    runs = [
        one.run.model_copy(update={"predicted": _named(sds(alone, one.told))})
        for one in sorted(chosen, key=lambda one: worst_of(known, one.sd))
    ]
    plan = ExperimentPlan(
        name=wanted.name, machine=known.machine.name, seed=wanted.seed, field=wanted.field,
        limits=wanted.limits, run=tuple(runs),
    )  # fmt: skip
    check(plan, rig_of(known.machine), drives(plan, default_rng))
    sd, count = predicted(known, plan), sum(run.replicates for run in plan.run)
    with_log = known.before is not None
    plan = plan.model_copy(
        update={
            "predicted": _named(predicted(alone, plan)),
            "predicted_with_log": _named(sd) if with_log else {},
            "predicted_for": steered(plan),
        }
    )
    seconds = sum(run.seconds * run.replicates for run in plan.run)
    progress("comparing it with held steps", steps - 1, steps)
    worst = worst_of(known, sd)
    held = compared(known, wanted, worst, count, "step", {})
    swung = compared(known, wanted, worst, count, "steps", {"hold_s": 3.0})
    before = sds(known, (), count)
    told_already = with_log and worst > TOLD_ALREADY * worst_of(known, before)
    return Proposal(plan, seconds, sd, before, told_already, held, swung)


def _named(sd: Array) -> dict[str, float]:
    return {name: round(float(value), 3) for name, value in zip(PARAMETERS, sd, strict=True)}


def _best(known: Known, wanted: WantedPlan, kind: str) -> BestRun:
    """Raises PlanError where it has no room."""
    from scipy.optimize import minimize  # not before the first word

    numbers = NUMBERS[kind]

    def made(logs: Array) -> AnyRun:
        values = {
            number.key: _rounded(float(np.clip(np.exp(log), number.low, number.high)))
            for number, log in zip(numbers, logs, strict=True)
        }
        for low, high in (("low_hz", "high_hz"), ("shortest_s", "longest_s")):
            if low in values:
                values[high] = max(values[high], values[low])
        return largest(known, wanted, kind, values)

    def worst(logs: Array) -> float:
        try:
            return float(np.log(worst_of(known, _after(known, wanted, made(logs), alone=True).sd)))
        except PlanError:
            return 1.0  # no room

    start: Array = np.log([number.start for number in numbers])
    found = start
    if numbers:
        simplex = np.vstack([start, start + 0.4 * np.eye(len(numbers))])
        options: dict[str, object] = {
            "maxfev": TRIES,
            "initial_simplex": simplex,
            "xatol": 0.1,
            "fatol": 0.005,
        }
        found = np.asarray(minimize(worst, start, method="Nelder-Mead", options=options).x)
    return _after(known, wanted, made(found), alone=False)


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")


def _after(known: Known, wanted: WantedPlan, run: AnyRun, alone: bool) -> BestRun:
    """alone: the first replicate stands for all, which takes less time."""
    replicates = range(1, run.replicates + 1)
    told = tuple(
        told_by(known, Scheduled(1, 1 if alone else k, run), wanted.limits, wanted.seed) for k in replicates
    )
    return BestRun(run, told, sds(known, told))


def largest(known: Known, wanted: WantedPlan, kind: str, values: dict[str, float]) -> AnyRun:
    """The run with the largest amplitude that the limits allow, as long as the field lets it be. Raises
    PlanError."""
    limits, field, rig = wanted.limits, wanted.field, rig_of(known.machine)
    speed = min(wanted.speed, TURN_SPEED) if kind == "turn" else wanted.speed
    seconds, refusal = wanted.seconds, ""
    while seconds >= SHORTEST_S:
        run = _run(kind, values, speed, limits.wheel_angle_deg, seconds, wanted.replicates)
        hardest = max(float(np.max(np.abs(one.lateral_acceleration))) for one in _ways(rig, run, wanted))
        share = min(1.0, SAFE * limits.lateral_acceleration / hardest)
        amplitude = np.floor(10.0 * run.amplitude_deg * share) / 10.0
        if amplitude < LEAST_AMPLITUDE:
            raise PlanError(f"{kind} at {speed:g} m/s: the limits leave less than {LEAST_AMPLITUDE:g}°")
        run = run.model_copy(update={"amplitude_deg": float(amplitude)})
        long, wide = np.max([needed(run, one) for one in _ways(rig, run, wanted)], axis=0)
        usable = field.length - (0.0 if kind == "turn" else 2 * field.headland)
        if long <= usable and wide <= DRIFT * field.width:
            return run
        refusal = (
            f"the field is too small for {kind} runs at {speed:g} m/s: {seconds:g} s take {long:.0f} m by "
            f"{wide:.0f} m, it has {usable:.0f} m between its headlands by {field.width:.0f} m; give a "
            "larger --field, or a lower --speed"
        )
        seconds = float(np.floor(min(0.85 * seconds, seconds - 1.0)))
    raise PlanError(refusal or f"runs of less than {SHORTEST_S:g} s tell too little: give more --seconds")


def _ways(rig: Rig, run: AnyRun, wanted: WantedPlan) -> list[Way]:
    """Where its replicates go."""
    replicates = range(1, run.replicates + 1) if run.kind == "random" else (1,)
    found = []
    for k in replicates:
        one = Scheduled(1, k, run)
        angles = wheel_angle(one, wanted.limits, default_rng((wanted.seed, *one.key)))
        found.append(way(rig, run.speed, angles))
    return found


def _run(
    kind: str, values: dict[str, float], speed: float, amplitude: float, seconds: float, replicates: int
) -> AnyRun:
    fields = {"kind": kind, "speed": speed, "amplitude_deg": amplitude, "seconds": seconds}
    return _RUN.validate_python({**fields, "replicates": replicates, **values})


def _together(known: Known, best: Sequence[BestRun], count: int) -> tuple[BestRun, ...]:
    """So many kinds that leave the smallest worst sd: of several, since kinds that disagree tell what a model
    lacks."""
    choices = itertools.combinations(best, min(count, len(best)))
    return min(choices, key=lambda some: worst_of(known, sds(known, [t for one in some for t in one.told])))


def compared(
    known: Known, wanted: WantedPlan, worst: float, count: int, kind: str, values: dict[str, float]
) -> Compared | None:
    """Runs of one kind, to either side in turn, of the largest amplitude allowed, until the worst sd is as
    small as that of a plan of so many runs, no nearer to the log than its last one; between whole runs it is
    interpolated. None where they have no room."""
    try:
        run = largest(known, wanted, kind, values)
    except PlanError:
        return None
    both = [told_by(known, Scheduled(1, k, run), wanted.limits, wanted.seed) for k in (1, 2)]
    before = worst_of(known, sds(known, (), count))
    low, high = 0, 1
    while high <= MOST_REPLICATES:
        told = [both[k % 2] for k in range(high)]
        after = worst_of(known, sds(known, told, max(count - high, 0)))
        if after <= worst:
            share = (np.log(before) - np.log(worst)) / max(np.log(before) - np.log(after), 1e-9)
            return Compared((low + float(np.clip(share, 0.0, 1.0)) * (high - low)) * run.seconds, True)
        low, before = high, after
        high += max(1, high // 4)
    return Compared(low * run.seconds, False)
