"""`tilth experiment --propose`: the plan whose runs tell most of what is not known yet."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

from tilth.analysis.experiment.plan_text import text_of, worth
from tilth.analysis.experiment.predict import Known, from_log, from_machine
from tilth.analysis.experiment.propose import SHORTEST_S, Progress, WantedPlan
from tilth.analysis.experiment.propose import propose as best_plan
from tilth.analysis.fit.fitting import CannotFit, choose, fit_all
from tilth.analysis.runs.run import Run, is_mcap, open_runs
from tilth.cli import WrongUse, check_folder, say
from tilth.cli.log_errors import log_errors
from tilth.cli.progress_bar import Steps, bars
from tilth.logger.log import whole_file
from tilth.logger.machine_file import read_machine
from tilth.schemas.experiment import KINDS, DrivingLimits, PlanError, Rectangle
from tilth.schemas.invocation import command
from tilth.schemas.machine import Machine
from tilth.schemas.machine_difference import differing
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.readable import readable, reason_of

_say = partial(say, "experiment")


KINDS_PROPOSED = tuple(kind for kind in KINDS if kind != "step")  # what a proposal is compared with


def propose(args: argparse.Namespace) -> int:
    """1 where the log tells nothing."""
    if args.machine is None or args.out is None:
        raise WrongUse("--propose needs --machine M.toml and --out PLAN.toml")
    for name, low, high in (("replicates", 1, 20), ("runs", 1, len(KINDS)), ("seed", 0, 2**31)):
        value = getattr(args, name)
        if not low <= value <= high:
            raise WrongUse(f"--{name} {value}: give a whole number from {low} to {high}")
    if args.out.exists():
        raise WrongUse(f"{args.out} exists and is not overwritten; give another --out")
    check_folder(args.out.parent)
    machine_file = read_machine(args.machine)
    try:
        wanted = _wanted(args)
        with ExitStack() as stack:
            show = bars(stack)
            with log_errors():
                known = _known(args, machine_file, show)
            found = best_plan(known, wanted, _searching(show))
    except PlanError as error:
        raise WrongUse(str(error)) from None
    except (CannotFit, ValueError) as error:
        _say(str(error))
        return 1
    source = ", ".join(readable(log.name) for log in args.logs)
    try:
        text = readable(text_of(found, str(args.out), source))
        whole_file.write(args.out, text.encode(), replace=False)
    except OSError as error:
        raise WrongUse(f"{args.out}: {reason_of(error)}") from None
    print(worth(found))
    count = sum(run.replicates for run in found.plan.run)
    print(f"{args.out} is written: {'1 run' if count == 1 else f'{count} runs'}.")
    return 0


def _searching(show: Steps) -> Progress:
    """A bar where somebody looks at one, else a line for each step."""
    if sys.stderr.isatty():
        return lambda text, done, of: show("searching a plan", done, of)
    return lambda text, done, of: _say(text)


def _wanted(args: argparse.Namespace) -> WantedPlan:
    """Raises WrongUse, PlanError."""
    field, limits = _field(args.field, args.headland), _limits(args.angle)
    if not 1.5 <= args.speed <= 12:
        raise WrongUse(f"--speed {args.speed:g}: give 1.5 to 12 m/s; slip is too small to learn from below")
    if not SHORTEST_S <= args.seconds <= 60:
        raise WrongUse(
            f"--seconds {args.seconds:g}: give {SHORTEST_S:g} to 60 s for a run; less tells too little"
        )
    kinds = tuple(args.kind) or KINDS_PROPOSED
    return WantedPlan(
        name=_name(args.out), speed=args.speed, seconds=args.seconds, replicates=args.replicates,
        seed=args.seed, field=field, limits=limits, kinds=kinds, count=args.runs,
    )  # fmt: skip


def _field(field: Rectangle, headland: float | None) -> Rectangle:
    """Raises WrongUse."""
    try:
        if headland is None:
            return Rectangle(length=field.length, width=field.width)
        return Rectangle(length=field.length, width=field.width, headland=headland)
    except ValueError:
        raise WrongUse(
            "--headland: give 0 to 200 m (without: 20); two of them must leave some of the field, "
            f"which is {field.length:g} m long"
        ) from None


def _limits(angle_deg: float | None) -> DrivingLimits:
    """Raises WrongUse."""
    try:
        return DrivingLimits() if angle_deg is None else DrivingLimits(wheel_angle_deg=angle_deg)
    except ValueError:
        raise WrongUse(f"--angle {angle_deg:g}: give at most 37 degrees, of the wheels") from None


def _name(out: Path) -> str:
    """Of the plan: its file's, as far as a mark may hold it."""
    kept = "".join(sign if sign.isalnum() and sign.isascii() else "-" for sign in out.stem)[:60].strip("-")
    return kept or "plan"


def _known(args: argparse.Namespace, machine_file: MachineFile, show: Steps) -> Known:
    """Raises LogError, CannotFit, WrongUse."""
    machine = machine_file.machine
    if not args.logs:
        return from_machine(machine)
    for log in args.logs:
        if not log.exists():
            raise WrongUse(f"{log}: there is no such log")
    if not all(
        log.is_file() and is_mcap(log) for log in args.logs
    ):  # of other programs: no machine file in it
        return _learned(args, machine, open_runs(args.logs, machine=machine_file, say=_say), show)
    runs = open_runs(args.logs, say=_say)
    for run in runs:
        if run.machine.name != machine.name:
            raise WrongUse(
                f"{run.sources[0].name} is of {run.machine.name}, {args.machine} is of {machine.name}; give "
                "the log of this rig, or leave out --from"
            )
    if all(_same_rig(run.machine, machine) for run in runs):
        # Texts that differ in buses alone would be of different rigs to a fit.
        return _learned(args, machine, [replace(run, machine_file=machine_file) for run in runs], show)
    own = {source: run.machine for run in runs for source in run.sources}
    return _learned(args, machine, open_runs(args.logs, machine=machine_file, say=_say), show, own)


def _learned(
    args: argparse.Namespace, machine: Machine, runs: Sequence[Run], show: Steps,
    own: Mapping[Path, Machine] | None = None,
) -> Known:  # fmt: skip
    """own: the machine files that the logs hold, where they were replayed with another. Raises CannotFit."""
    for run in runs:
        if not run.poses.rows:
            _say(_no_poses(args, machine, run.sources[0], (own or {}).get(run.sources[0])))
    wanted = choose(runs)
    for run in runs:
        if run.poses.rows and not any(one.run is run for one in wanted):
            _say(f"{run.sources[0]}: no driving with steering is in it; it counts for nothing")
    what = "1 stretch" if len(wanted) == 1 else f"{len(wanted)} stretches"
    _say(f"fitting {what} of driving in the log")
    fitted = fit_all(wanted, progress=lambda done, of: show("fitting", done, of))
    for k, one in enumerate(wanted):
        if k not in fitted.told:
            log, start, end = one.run.sources[0], one.segment.start_s, one.segment.end_s
            why = command("fit", str(log))
            _say(f"{log}: {start:.0f} to {end:.0f} s tell nothing; `{why}` says why")
    return from_log(machine, fitted)


def _no_poses(args: argparse.Namespace, machine: Machine, log: Path, own: Machine | None) -> str:
    """Why a log counts for nothing."""
    differs = "" if own is None else f"; the machine file in it differs in {differing(machine, own)}"
    rejected = command("replay", str(log), "--machine", str(args.machine))
    return f"{log}: no pose comes out of it with {args.machine}{differs}; `{rejected}` says what was rejected"


def _same_rig(one: Machine, other: Machine) -> bool:
    """Whether two machine files differ in buses, network and logging at most."""
    outside = {"bus": other.bus, "zenoh": other.zenoh, "log": other.log}
    return one.model_copy(update=outside) == other
