"""`tilth export`: what logs hold, as files for other programs."""

import argparse
import json
import math
import re
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from tilth.analysis.export.export import SPREADSHEET_ROWS, Exported, ExportPlan, check, export, folders_of
from tilth.analysis.export.files import FORMATS, ExportError, check_installed
from tilth.analysis.export.naming import NAMES, UnknownChannel, choose
from tilth.analysis.runs.run import Run
from tilth.cli import WrongUse, add_bus_names, log_path, say, say_unusual
from tilth.cli.log_errors import log_errors
from tilth.cli.log_options import add_machine, given_machine, runs_of
from tilth.cli.progress_bar import bars

_say = partial(say, "export")


Shown = Callable[[int, int], None]
_PERIOD = re.compile(r"(\d+(?:\.\d+)?)(us|ms|s)")
_NS = {"us": 1e3, "ms": 1e6, "s": 1e9}


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "export",
        help="write the contents of logs to Parquet, CSV or MAT files",
        description="Write the contents of logs to files for other programs. DIR/RUN/ gets a file for each "
        "channel, or one for all on a common clock, and export.json, which describes them. Logs of "
        "other programs are replayed first.",
        epilog=f"channels: {', '.join(NAMES)}",
    )
    parser.add_argument(
        "logs", nargs="+", type=log_path, metavar="LOG", help="logs; the parts of a run are combined"
    )
    parser.add_argument("--to", required=True, choices=tuple(FORMATS), help="format of the files")
    parser.add_argument(
        "--out", required=True, type=Path, metavar="DIR", help="folder that gets a folder per run"
    )
    parser.add_argument(
        "--clock",
        type=_period,
        metavar="20ms",
        help="all channels in one file, at this interval (each at its own times)",
    )
    parser.add_argument(
        "--channels",
        type=lambda text: tuple(filter(None, text.split(","))),
        default=(),
        metavar="pose,…",
        help="only these channels; * stands for anything (all)",
    )
    parser.add_argument(
        "--from", type=_seconds, default=0.0, dest="from_s", metavar="S", help="start, in seconds of the run"
    )
    parser.add_argument(
        "--until",
        type=_seconds,
        default=math.inf,
        dest="until_s",
        metavar="S",
        help="end, in seconds of the run",
    )
    add_machine(
        parser, "machine file; required if tilth did not write the log; otherwise the log is replayed with it"
    )
    add_bus_names(parser)
    parser.add_argument("--json", action="store_true", help="the summary as one JSON object")


def _seconds(text: str) -> float:
    """argparse type: s since the run began."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"{text}: give seconds since the run began, from 0 up")
    return value


def _period(text: str) -> int:
    """argparse type: a duration with its unit, ns."""
    found = _PERIOD.fullmatch(text)
    if found is None or float(found[1]) * _NS[found[2]] < 1e3:
        raise argparse.ArgumentTypeError(f"{text}: give a time with its unit, such as 20ms or 1s")
    return round(float(found[1]) * _NS[found[2]])


def run(args: argparse.Namespace) -> int:
    """1 where not all of a log could be read, or written."""
    try:
        plan = _plan(args)
        check_installed(args.to)
        if args.out.exists() and not args.out.is_dir():
            raise ExportError(f"--out {args.out}: no folder; give one, or a new name")
        with log_errors(args.out, "nothing is left of it"), ExitStack() as stack:
            steps = bars(stack)
            runs = _runs(args, partial(steps, "replay"))
            folders = folders_of(runs, args.out)
            for one in runs:
                check(one, plan)
            done = [
                export(one, plan, folder, partial(steps, one.id))
                for one, folder in zip(runs, folders, strict=True)
            ]
    except ExportError as error:
        raise WrongUse(str(error)) from None
    _tell(done, args)
    return 1 if any(one.skipped for one in done) else 0


def _plan(args: argparse.Namespace) -> ExportPlan:
    """Raises WrongUse."""
    if args.from_s >= args.until_s:
        raise WrongUse(f"--from {args.from_s:g} is not before --until {args.until_s:g}")
    try:
        channels = choose(args.channels, args.clock is not None)
    except UnknownChannel as error:
        raise WrongUse(f"--channels {error}") from None
    return ExportPlan(args.to, channels, args.clock, args.from_s, args.until_s)


def _runs(args: argparse.Namespace, progress: Shown) -> tuple[Run, ...]:
    """Raises LogError, MachineError, WrongUse, OSError."""
    machine = given_machine(args)
    if machine is not None:
        say_unusual("export", machine[0])
    return runs_of(args, machine, _say, progress)


def _tell(done: list[Exported], args: argparse.Namespace) -> None:
    for one in done:
        for what, count in sorted(one.skipped.items()):
            words = "file cut off" if what == "cut" else what.replace("_", " ")
            _say(f"{one.run}: {count} {words}; the rest is exported")
        if one.late:
            _say(f"{one.run}: {one.late} rows came more than 2 s late and are not on the clock")
        long = [name for name, rows in one.rows.items() if args.to == "csv" and rows >= SPREADSHEET_ROWS]
        if long:
            names = ", ".join(long)
            _say(f"{names}: a spreadsheet shows {SPREADSHEET_ROWS - 1} rows of it; see --from and --until")
    if args.json:
        print(json.dumps({"runs": [_as_json(one) for one in done]}))
        return
    for one in done:
        print(f"{one.folder}: " + ", ".join(f"{name} ({rows} rows)" for name, rows in one.rows.items()))


def _as_json(one: Exported) -> dict[str, object]:
    return {
        "run": one.run, "folder": str(one.folder), "rows": one.rows, "skipped": dict(one.skipped),
        "late": one.late,
    }  # fmt: skip
