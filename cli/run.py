"""`tilth run`: log the buses of a machine, estimate, publish."""

import argparse
import contextlib
import os
import signal
import sys
from collections import deque
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from tilth.cli import WrongUse, duration
from tilth.logger.machine_file import implement_of, read_machine, read_rigs

if TYPE_CHECKING:  # with the estimators: what is wrong with the machine file is said before they are there
    from tilth.logger.outlets import Events
    from tilth.logger.run_summary import RunSummary


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "run",
        help="log the buses of a machine, estimate, publish",
        description="Log the buses of a machine, estimate, publish; until Ctrl-C or SIGTERM.",
    )
    parser.add_argument(
        "machine", type=Path, metavar="MACHINE.toml",
        help="MACHINE.toml+NAME starts with that implement of a tractor with several, instead of the last "
        "one",
    )  # fmt: skip
    parser.add_argument(
        "--log", type=Path, metavar="DIR", help="log folder, instead of the one in the machine file"
    )
    parser.add_argument("--no-zenoh", action="store_true", help="publish nothing")
    parser.add_argument("--plain", action="store_true", help="print plain lines, also in a terminal")
    parser.add_argument("--fresh", action="store_true", help="ignore what earlier runs have learned")
    parser.add_argument("--note", default="", metavar="TEXT", help="a note about the run, kept in the log")
    parser.add_argument("--seconds", type=duration, metavar="N", help="stop after N seconds")


def run(args: argparse.Namespace) -> int:
    """1 where frames were lost, not recorded, or none came at all."""
    rigs = read_rigs(args.machine)
    from tilth.logger.can.bus_opening import check_interfaces

    check_interfaces(next(iter(rigs.values())).machine)
    with contextlib.suppress(OSError):
        print(f"{args.machine}: starting", flush=True)
    from tilth.logger.daemon import run_daemon
    from tilth.logger.hitched import chosen
    from tilth.logger.status_line import PanelDisplay, PlainDisplay
    from tilth.logger.supervisor import of_environment
    from tilth.logger.zenoh.session import refusal

    events: Events = deque()
    folder = args.log or Path(next(iter(rigs.values())).machine.log.folder)
    named = implement_of(args.machine)
    name = named or chosen(rigs, folder, lambda kind, told: events.append((kind, told)))
    machine_file = read_machine(args.machine) if named else rigs[name]
    machine = machine_file.machine
    if refused := "" if args.no_zenoh else refusal(machine):
        raise WrongUse(refused)
    stopping = False

    def stop(signum: int, frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    for signum in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(signum, stop)
    plain = args.plain or not sys.stdout.isatty()
    display = PlainDisplay(sys.stdout) if plain else PanelDisplay(machine.name)
    try:
        summary = run_daemon(
            machine_file,
            rigs=rigs,
            log_folder=args.log,
            zenoh=not args.no_zenoh,
            seconds=args.seconds,
            status=display,
            stop=lambda: stopping,
            keep=True,
            fresh=args.fresh,
            note=args.note,
            supervisor=of_environment(os.environ),
            events=events,
        )
    finally:
        display.close()
    with contextlib.suppress(OSError):  # nobody reads it any more: what happened is told by the status
        print(_last_words(summary))
    return 0 if summary.recorded == summary.frames > 0 and not (summary.lost or summary.faults) else 1


def _last_words(summary: "RunSummary") -> str:
    files = " ".join(str(path) for path in summary.log_files)
    words = [f"{summary.frames} frames, {summary.measurements} measurements, {summary.poses} poses"]
    if summary.lost:
        words.append(f"{summary.lost} frames lost in the kernel: the computer was too busy")
    if summary.not_recorded:
        words.append(f"{summary.not_recorded} frames not recorded")
    if summary.faults:
        words.append(
            f"the estimators failed {summary.faults} times: report it with the log, which is complete"
        )
    words.append(f"Log: {files}" if files else "No log was written.")
    return "\n".join(words)
