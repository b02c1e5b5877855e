"""A run of a plan of experiments: which angles the wheels take, where the tractor goes, whether it has room.

Where it goes is what the linear model with relaxation says at the machine file's values.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tilth.estimator.models import manoeuvres
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import simulate, system
from tilth.estimator.models.manoeuvres import MANOEUVRE, manoeuvre_named, rate_limited
from tilth.estimator.models.parameters import Rig
from tilth.estimator.tuning import tuned
from tilth.schemas.experiment import (
    KINDS,
    AnyRun,
    ChirpRun,
    DrivingLimits,
    ExperimentPlan,
    MultisineRun,
    PlanError,
    RandomRun,
    Rectangle,
    StepsRun,
)

Array = NDArray[np.float64]

DT: Final = 0.02  # s, between samples of a planned run


@dataclass(frozen=True, slots=True)
class PlannedRunTuning:
    """Of planned runs."""

    beside_m: float = tuned(5.0, "m", "kept free at the sides: half the rig, and what a driver is off")
    run_up_s: float = tuned(4.0, "s", "straight and at speed before a run: steady, and the countdown")


PLANNED_RUN: Final = PlannedRunTuning()


class Scheduled(NamedTuple):
    """One drive of a plan. number: of [[run]], from 1. replicate: from 1."""

    number: int
    replicate: int
    run: AnyRun

    @property
    def key(self) -> tuple[int, int]:
        """What its draws depend on, beside the plan's seed."""
        return KINDS.index(self.run.kind), self.replicate

    @property
    def name(self) -> str:
        """For people."""
        return f"run {self.number}, {self.run.kind}, replicate {self.replicate} of {self.run.replicates}"


class Way(NamedTuple):
    """Where a tractor goes from where a run begins, at each sample, (n,)."""

    ahead: Array  # m
    lateral_offset: Array  # m, to the right
    lateral_acceleration: Array  # m/s^2


def schedule(plan: ExperimentPlan, rng: Generator) -> tuple[Scheduled, ...]:
    """All drives in randomised blocks: the first replicates of all runs, shuffled, then the second ones."""
    order: list[Scheduled] = []
    for replicate in range(1, max(run.replicates for run in plan.run) + 1):
        block = [
            Scheduled(number, replicate, run)
            for number, run in enumerate(plan.run, 1)
            if replicate <= run.replicates
        ]
        order += [block[k] for k in rng.permutation(len(block)).tolist()]
    return tuple(order)


def wheel_angle(scheduled: Scheduled, limits: DrivingLimits, rng: Generator) -> Array:
    """Wheel angles to follow, rad, DT apart, (n,): straight at first (MANOEUVRE.start_s), then the run's
    steering, as fast as the limits let it be. rng: for random levels."""
    return rate_limited(_wanted(scheduled, rng), math.radians(limits.wheel_rate_degps) * DT)


def share_followed(scheduled: Scheduled, limits: DrivingLimits, rng: Generator) -> float:
    """Of the steering of a run, how much the limit of the wheel's rate leaves: one deviation over the
    other."""
    wanted = _wanted(scheduled, rng)
    return float(np.std(rate_limited(wanted, math.radians(limits.wheel_rate_degps) * DT)) / np.std(wanted))


def _wanted(scheduled: Scheduled, rng: Generator) -> Array:
    """rad, (n,), as if the wheels could be turned at once."""
    run = scheduled.run
    time: Array = np.arange(round((MANOEUVRE.start_s + run.seconds) / DT) + 1, dtype=np.float64) * DT
    left = run.side == "left" or (run.side == "both" and scheduled.replicate % 2 == 0)
    wanted = _steering(run, time, math.radians(run.amplitude_deg), rng)
    return -wanted if left else wanted


def drives(
    plan: ExperimentPlan, draws: Callable[[tuple[int, ...]], Generator]
) -> tuple[tuple[Scheduled, Array], ...]:
    """All runs of a plan with their wheel angles, in the order in which they are driven. draws: makes a
    generator of a seed, as numpy's default_rng; so who plans, prompts and simulates has the same runs."""
    return tuple(
        (one, wheel_angle(one, plan.limits, draws((plan.seed, *one.key))))
        for one in schedule(plan, draws((plan.seed,)))
    )


def _steering(run: AnyRun, time: Array, amplitude: float, rng: Generator) -> Array:
    match run:
        case StepsRun():
            return manoeuvres.steps(time, amplitude, rng, run.hold_s)
        case ChirpRun():
            return manoeuvres.chirp(time, amplitude, rng, run.low_hz, run.high_hz)
        case MultisineRun():
            return manoeuvres.multisine(time, amplitude, rng, run.low_hz, run.high_hz)
        case RandomRun():
            return manoeuvres.random_levels(time, amplitude, rng, run.shortest_s, run.longest_s)
        case _:
            return manoeuvre_named(run.kind).wheel_angle(time, amplitude, rng)


def way(rig: Rig, speed: float, angles: Array) -> Way:
    """Of wheel angles DT apart, rad, (n,), from straight running."""
    model = model_named("relaxation")
    whole = system(model, rig, speed)
    inputs = np.zeros((len(angles), len(whole.inputs)))
    inputs[:, 0] = angles
    states = simulate(model, rig, speed, inputs, np.zeros(len(whole.states)), DT, linear=True)
    v, r, psi = (states[:, whole.states.index(name)] for name in ("v", "r_t", "psi_t"))
    ahead = np.cumsum(speed * np.cos(psi) - v * np.sin(psi)) * DT
    lateral_offset = np.cumsum(speed * np.sin(psi) + v * np.cos(psi)) * DT
    return Way(ahead, lateral_offset, speed * r)


def room(field: Rectangle, along: Array, across: Array, turning: bool) -> float:
    """How far the places stay inside of the field, m, negative outside. along, across: m from its corner,
    (n,). turning: headlands may be driven on, too."""
    end = 0.0 if turning else field.headland
    inside = (
        along - end,
        field.length - end - along,
        across - PLANNED_RUN.beside_m,
        field.width - PLANNED_RUN.beside_m - across,
    )
    return float(min(np.min(one) for one in inside))


def check(plan: ExperimentPlan, rig: Rig, planned: Iterable[tuple[Scheduled, Array]]) -> None:
    """Raises PlanError where a run is too hard for the limits or has no room in the field. planned: as
    `drives`."""
    for scheduled, angles in planned:
        run, found = scheduled.run, way(rig, scheduled.run.speed, angles)
        hardest = float(np.max(np.abs(found.lateral_acceleration)))
        most = plan.limits.lateral_acceleration
        if hardest > most:
            raise PlanError(
                f"run[{scheduled.number}], {run.kind}: {run.amplitude_deg:g}° at {run.speed:g} m/s give "
                f"{hardest:.1f} m/s^2 to the side, limits.lateral_acceleration allows {most:g}; take at most "
                f"{run.amplitude_deg * most / hardest:.1f}°, or drive more slowly"
            )
        need_long, need_wide = needed(run, found)
        field = plan.field
        usable = field.length - (0.0 if run.kind == "turn" else 2 * field.headland)
        for what, need, has in (("length", need_long, usable), ("width", need_wide, field.width)):
            if need > has:
                raise PlanError(
                    f"run[{scheduled.number}], {run.kind}: {run.seconds:g} s at {run.speed:g} m/s need "
                    f"{need:.0f} m of {what}, the field has {has:.0f} m"
                    f"{' between its headlands' if what == 'length' and run.kind != 'turn' else ''}; make "
                    "the run shorter or slower, or the field larger"
                )


def needed(run: AnyRun, found: Way) -> tuple[float, float]:
    """Length and width of the ground that a run takes with its run-up, m."""
    behind = min(float(np.min(found.ahead)), -PLANNED_RUN.run_up_s * run.speed)
    sides = float(np.max(found.lateral_offset) - np.min(found.lateral_offset))
    return float(np.max(found.ahead)) - behind, sides + 2 * PLANNED_RUN.beside_m
