"""Do runs tell what their plan expects, and is a proposed plan quicker than steps?

    python bench/experiments.py [--seeds N] [--plant planar|spatial]

A driver with 0.5 s of lag and 1° of error, who looks away, is prompted through a proposed plan and through
held steps, on virtual tractors with drawn rigs. What the runs between the marks then tell, by the code of
`tilth fit`, stands beside what was predicted: from the machine file alone, and `--from` a minute of random
steering on the same ground.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from prompted_run import Prompted, placed

from tilth.analysis.experiment.predict import (
    BETWEEN_M,
    Known,
    from_log,
    from_machine,
    predicted,
    sds,
    worst_of,
)
from tilth.analysis.experiment.propose import NUMBERS, WantedPlan, largest, propose
from tilth.analysis.fit.fitting import Fitted
from tilth.analysis.fit.joint import Linearised, join, linearise
from tilth.analysis.fit.segment_fit import SegmentFit, fit_segment
from tilth.analysis.runs.driven import Driven
from tilth.client.experiment.prompter import course_of
from tilth.estimator import fold
from tilth.estimator.filters.unknowns import SIX
from tilth.estimator.methods import pem
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.record import record_builder
from tilth.schemas.experiment import AnyRun, DrivingLimits, ExperimentPlan, Rectangle, StepRun
from tilth.schemas.flow import PARAMETERS, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.sentences import notice_sentence
from tilth.simulator.drive import drive
from tilth.simulator.packaged import packaged_file
from tilth.simulator.prompted_driver import Person
from tilth.simulator.scenario import DrivenManoeuvre, Ground, Scenario, Soil, Spatial
from tilth.simulator.tractor import Truth
from tilth.simulator.traffic import host_clock, traffic

Array = NDArray[np.float64]

SPEED: Final = 4.5
FIELD: Final = Rectangle(length=1000, width=120)
PLANTS: Final = {
    "planar": Scenario(
        speed=SPEED, other_traffic=False, soil=Soil(grip=0.7, rolling=0.06),
        ground=Ground(roll_sd_deg=0.7, force_sd=0.015),
    ),
    "spatial": Scenario(
        speed=SPEED, other_traffic=False, plant="spatial", ground=Ground(rms=0.01), spatial=Spatial(draw=True)
    ),
}  # fmt: skip
PERSON: Final = Person(looks_away=0.01)
LOG_S: Final = 64.0  # of random steering before
WITHIN: Final = 0.15


@dataclass(frozen=True, slots=True)
class DrivenPlan:
    """What was driven of a plan."""

    fits: tuple[SegmentFit, ...]  # of the runs, in their order
    seconds: tuple[float, ...]  # of steering, of each
    attempts: int
    reasons: tuple[str, ...]  # of those that were not done


def plan_of(
    machine: Machine, kinds: Sequence[str], known: Known | None = None, count: int = 3
) -> ExperimentPlan:
    """The proposal for the bench's field."""
    wanted = WantedPlan(
        "bench", SPEED, 20.0, 3, 1, FIELD, DrivingLimits(), tuple(kinds), min(count, len(kinds))
    )
    return propose(known or from_machine(machine), wanted).plan


def driven_between(machine: Machine, truth: Truth, cuts: Sequence[tuple[float, float]]) -> list[list[Driven]]:
    """What the estimators are given of stretches of a run. cuts: (start, end), s of the truth, in order."""
    clock = host_clock(truth)
    edges = [(clock(start), clock(end)) for start, end in cuts]
    state, recording = fold.initial(machine), record_builder.initial(machine)
    state.ready = False
    found: list[list[Driven]] = [[] for _ in cuts]
    for frame in traffic(machine, truth):
        for publication in fold.step(state, frame):
            if not isinstance(publication.value, Pose):
                continue
            pose = publication.value
            segment = record_builder.observe(recording, state.aligner, pose)
            for k, (start, end) in enumerate(edges):
                if start <= pose.t_ns <= end:
                    found[k].append(Driven(pose, segment))
        if frame.t_ns > edges[-1][1] + 2_000_000_000:
            break
    return found


def drive_plan(machine: Machine, plan: ExperimentPlan, scenario: Scenario, seed: int) -> DrivenPlan:
    """Prompted, faster than real time. Raises RuntimeError where the driver does not get done."""
    course = course_of(plan, rig_of(machine))
    one = Prompted(course, rig_of(machine), PERSON, seed)
    one.prompt = placed(one.prompt, plan)
    seconds = 50.0 * len(course.drives) + 200.0
    truth = drive(machine, seed, seconds, scenario, driven_by=lambda setting: one)
    if not one.finished:
        raise RuntimeError(f"only {one.prompt.at} runs were driven in {seconds:.0f} s")
    starts = {text.removesuffix(" start"): at for at, text in one.marks if text.endswith(" start")}
    cuts = [(starts[text.removesuffix(" end")], at) for at, text in one.marks if text.endswith(" end")]
    fits = [fit_segment(machine, part, (pem.METHOD,)) for part in driven_between(machine, truth, cuts)]
    reasons = tuple(
        notice_sentence(attempt.why) for attempt in one.prompt.attempts if attempt.why is not None
    )
    steering = tuple(drive.scheduled.run.seconds for drive in course.drives)
    return DrivenPlan(tuple(fits), steering, len(one.prompt.attempts), reasons)


def log_before(machine: Machine, scenario: Scenario, seed: int) -> Fitted:
    """A minute of random steering on the same ground by the same rig, fitted."""
    steering = DrivenManoeuvre("random", 6.0)
    random = replace(scenario, steering=steering, rig_seed=seed)
    truth = drive(machine, seed + 1000, LOG_S, random)
    fits = [
        fit_segment(machine, part, (pem.METHOD,)) for part in driven_between(machine, truth, [(2.0, LOG_S)])
    ]
    return Fitted((), tuple(fits), tuple(range(len(fits))), linearised(machine, fits), None)


def linearised(machine: Machine, fits: Sequence[SegmentFit]) -> Linearised:
    told = [fit for fit in fits if fit.windows]
    return linearise(machine, told, [BETWEEN_M] * (len(told) - 1))


def found_sd(machine: Machine, every: Linearised, count: int | None = None) -> Array:
    """Sds of the six logarithms, (6,), as `tilth fit` publishes them of the first runs, of all if None."""
    joint = join(machine, every, None if count is None else list(range(count)))
    return np.asarray(np.sqrt(np.diag(joint.covariance)[SIX]), np.float64)


def compare(plant: str, seeds: Sequence[int]) -> None:
    rig, scenario = packaged_file().machine, PLANTS[plant]
    known = from_machine(rig)
    plan = plan_of(rig, [kind for kind in NUMBERS if kind != "step"])
    print(f"{plant}: {', '.join(_words(run) for run in plan.run)}", flush=True)
    ratios: dict[str, list[Array]] = {"machine file": [], "log": []}
    speedups: list[float] = []
    for seed in seeds:
        began = time.monotonic()
        made = drive_plan(rig, plan, scenario, seed)
        whole = linearised(rig, made.fits)
        ratios["machine file"].append(found_sd(rig, whole) / predicted(known, plan))
        before = log_before(rig, scenario, seed)
        both = found_sd(rig, linearised(rig, [*before.fits, *made.fits]))
        ratios["log"].append(both / predicted(from_log(rig, before), plan))
        print(
            f"  seed {seed}: {made.attempts} tries, {'; '.join(made.reasons) or 'all done at once'}; "
            f"published/predicted {np.round(ratios['log'][-1], 2)} from the log, "
            f"{np.round(ratios['machine file'][-1], 2)} from the file", flush=True,
        )  # fmt: skip
        steps = drive_plan(rig, held_steps(plan), scenario, seed)
        speedups.append(speedup(rig, known, made, whole, steps))
        print(
            f"    {speedups[-1]:.1f} times as long with held steps ({time.monotonic() - began:.0f} s)",
            flush=True,
        )
    for name, rows in ratios.items():
        every = np.array(rows)
        near = np.mean(np.abs(every - 1.0) <= WITHIN)
        print(f"  {plant}, from the {name}: published over predicted sd, medians of {len(rows)} runs")
        print(
            "    "
            + ", ".join(f"{n} {v:.2f}" for n, v in zip(PARAMETERS, np.median(every, axis=0), strict=True))
        )
        print(f"    within 15 %: {near:.0%}")
    print(
        f"  {plant}: held steps take {np.median(speedups):.1f} times as long ({np.round(speedups, 1)})",
        flush=True,
    )


def held_steps(plan: ExperimentPlan) -> ExperimentPlan:
    """As many runs of held steps, of the same length, as far as the limits let them be."""
    limit = _largest_step(plan)
    run = StepRun(kind="step", speed=SPEED, amplitude_deg=limit, seconds=20.0, replicates=9)
    return plan.model_copy(update={"run": (run,), "name": "steps"})


def _largest_step(plan: ExperimentPlan) -> float:
    wanted = WantedPlan("steps", SPEED, 20.0, 3, 1, FIELD, plan.limits, ("step",))
    return float(largest(from_machine(packaged_file().machine), wanted, "step", {}).amplitude_deg)


def speedup(rig: Machine, known: Known, made: DrivenPlan, whole: Linearised, steps: DrivenPlan) -> float:
    """Seconds of all held steps over those of the plan's first runs that leave as small a worst sd; between
    runs it is interpolated."""
    worst = worst_of(known, found_sd(rig, linearised(rig, steps.fits)))
    kept = [seconds for seconds, fit in zip(made.seconds, made.fits, strict=True) if fit.windows]
    before, spent = worst_of(known, sds(known, ())), 0.0
    for count, seconds in enumerate(kept, 1):
        after = worst_of(known, found_sd(rig, whole, count))
        if after <= worst:
            share = (np.log(before) - np.log(worst)) / (np.log(before) - np.log(after))
            return float(sum(steps.seconds) / (spent + share * seconds))
        before, spent = after, spent + seconds
    return float(
        sum(steps.seconds) / spent * (worst / before) ** 2
    )  # the plan is no better: as far as it got


def _words(run: AnyRun) -> str:
    fields = run.model_dump(exclude={"predicted", "replicates", "side", "speed"})
    return " ".join(f"{key} {value}" if key != "kind" else str(value) for key, value in fields.items())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4, metavar="N", help="runs of each plant (4)")
    parser.add_argument("--plant", choices=tuple(PLANTS), action="append", help="only this one")
    options = parser.parse_args()
    for plant in options.plant or PLANTS:
        compare(plant, range(1, options.seeds + 1))


if __name__ == "__main__":
    main()
