"""Options of the commands that read logs of any kind at a desk, and the runs that they name."""

import argparse
from collections.abc import Callable
from pathlib import Path

from tilth.analysis.report.given import GivenTimes, given_times
from tilth.analysis.runs.run import Run, open_runs
from tilth.cli import buses_of
from tilth.logger.machine_file import read_machine
from tilth.replay.readers.rig import machine_in
from tilth.schemas.machine_toml import MachineFile


def add_machine(
    parser: argparse.ArgumentParser, what: str = "machine file, instead of the one in the logs"
) -> None:
    """The option of another machine file."""
    parser.add_argument("--machine", type=Path, metavar="M.toml", help=what)


def add_segments(parser: argparse.ArgumentParser, what: str) -> None:
    """The options of stretches of driving by their times, and by their marks."""
    parser.add_argument(
        "--segment", action="append", default=[], type=_times, metavar="[N:]A:B",
        help=f"{what}; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--mark", action="append", default=[], metavar="NAME",
        help='fit only what is between marks "NAME start" and "NAME end"; * stands for anything; may be '
        "repeated",
    )  # fmt: skip


def _times(text: str) -> GivenTimes:
    try:
        return given_times(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def given_machine(args: argparse.Namespace) -> MachineFile | None:
    """That of --machine. Raises MachineError."""
    return read_machine(args.machine) if args.machine else None


def runs_of(
    args: argparse.Namespace,
    machine: MachineFile | None,
    say: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> tuple[Run, ...]:
    """Those in args.logs. progress: takes (done, all). Raises WrongUse, LogError, MachineError, OSError."""
    buses: dict[str, str] = {}
    if args.bus:
        buses = buses_of(args, (machine or machine_in(args.logs)).machine)
    return open_runs(args.logs, machine=machine, buses=buses, progress=progress, say=say)
