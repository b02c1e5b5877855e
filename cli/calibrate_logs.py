"""`tilth calibrate LOG…`: shows what a drive tells of a rig, and writes it down after a yes."""

import argparse
import json
import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table as RichTable

from tilth.analysis.calibration.machine_text import unfilled
from tilth.analysis.calibration.page import report_of
from tilth.analysis.calibration.run import Calibrated, calibrate_logs
from tilth.analysis.report.page import page
from tilth.cli import WrongUse, buses_of, say
from tilth.cli.log_errors import log_errors
from tilth.cli.progress_bar import stages
from tilth.estimator.calibration import residuals
from tilth.estimator.calibration.calibrate import CannotCalibrate
from tilth.estimator.calibration.verdict import NOT_IDENTIFIABLE
from tilth.logger.log import whole_file
from tilth.logger.machine_file import read_machine
from tilth.replay.readers.rig import machine_in
from tilth.schemas.machine import MachineError
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.readable import readable, reason_of

_say = partial(say, "calibrate")


WIDTH = 120  # of what goes into a file


def run_logs(args: argparse.Namespace) -> int:
    """1 where the drive tells nothing, or nothing was written that was to be."""
    machine_file = _machine(args)
    buses = buses_of(args, machine_file.machine)
    try:
        with log_errors(), ExitStack() as stack:
            progress = _progress(stack, args.json)
            found = calibrate_logs(args.logs, machine_file, buses, _say, progress, growing=args.live)
    except CannotCalibrate as error:
        return _refused(args, error)
    if not args.json:
        _show(found)
    status = 0
    try:
        if args.report is not None:
            _write_report(args.report, readable(page(report_of(found))))
        written = _write(args, found) if args.out is not None else None
        status = 0 if written is not False else 1
    except OSError as error:
        _say(f"{error.filename or args.out}: {reason_of(error)}")
        status, written = 1, False
    if args.json:
        print(json.dumps({**found.as_json(), "written": str(args.out) if written else None}))
    return status


def _machine(args: argparse.Namespace) -> MachineFile:
    """Raises WrongUse, MachineError, CommandFailed."""
    if args.machine is None:
        with log_errors():
            return machine_in(args.logs)
    try:
        return read_machine(args.machine)
    except MachineError:
        lines = _unfilled_of(args.machine)
        if not lines:
            raise
        keys = ", ".join(f"{key} (line {number})" for number, key in lines)
        raise WrongUse(
            f"{args.machine}: fill in {keys}. Lengths by a tape to 20 cm are good enough, masses by a scale "
            "or the papers; calibrate finds the rest"
        ) from None


def _unfilled_of(path: Path) -> list[tuple[int, str]]:
    """Lines of a draft without a value; none of what cannot be read, which was said already."""
    try:
        return unfilled(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError):
        return []


def _refused(args: argparse.Namespace, error: CannotCalibrate) -> int:
    _say(str(error))
    others = [fault.text for fault in error.faults if fault.text not in str(error)]
    for text in others:
        _say(f"found meanwhile: {text}")
    if args.json:
        faults = [{"kind": fault.kind, "of": fault.of, "text": fault.text} for fault in error.faults]
        print(json.dumps({"refused": str(error), "faults": faults, "written": None}))
    if args.out is not None and args.out.exists():
        _say(f"{args.out} stays as it was")
    return 1


def _write_report(out: Path, text: str) -> None:
    """One of an earlier drive is kept. Raises OSError."""
    if out.exists() and out.read_bytes() != text.encode():
        kept = _backup(out)
        out.replace(kept)
        _say(f"the old report is kept as {kept}")
    whole_file.write(out, text.encode())
    _say(f"report: {out}")


def _write(args: argparse.Namespace, found: Calibrated) -> bool:
    """Whether the file stands as found. A file that exists is changed only with a yes and kept."""
    there = args.out.read_text(encoding="utf-8") if args.out.exists() else None
    change = found.difference((f"{args.machine or 'the machine file of the log'} (before)", str(args.out)))
    if not args.json and change:
        Console().print(change, highlight=False, markup=False, soft_wrap=True)
    if there == found.after:
        _say(f"{args.out} says all that already")
        return True
    if there is not None and not args.yes and not _asked(args.out, there != found.before):
        return False
    if there is not None:
        kept = _backup(args.out)
        whole_file.write(kept, there.encode())
        _say(f"the old file is kept as {kept}")
    real = args.out.resolve()  # a link stays one: what it leads to is what others read
    whole_file.write(real, found.after.encode())
    _say(f"written: {args.out}")
    return True


def _asked(out: Path, other: bool) -> bool:
    what = f"{out} exists" + (" and is not the machine file of this drive" if other else "")
    order = "Put the machine file of this drive in its place, changed" if other else "Change it"
    if not sys.stdin.isatty():
        _say(f"{what}; nothing was written. Give --yes to change it, or another name")
        return False
    sys.stderr.write(f"tilth calibrate: {what}. {order} as shown? The old one is kept. [y/N] ")
    sys.stderr.flush()
    if sys.stdin.readline().strip().lower() in ("y", "yes"):
        return True
    _say("nothing was written")
    return False


def _backup(out: Path) -> Path:
    """A name that is free."""
    number = 1
    while (kept := out.with_name(f"{out.name}.before-{number}")).exists():
        number += 1
    return kept


def _progress(stack: ExitStack, as_json: bool) -> Callable[[str, float], None]:
    if as_json:
        return lambda what, share: None
    if not sys.stderr.isatty():
        return _in_lines()
    return stages(stack)


def _in_lines() -> Callable[[str, float], None]:
    """Where no bar can be drawn: a line for each stage of minutes."""
    told = ""

    def tell(what: str, share: float) -> None:
        nonlocal told
        stage = what.partition(",")[0]
        if stage != told:
            told = stage
            _say(f"{stage} …")

    return tell


def _show(found: Calibrated) -> None:
    console = Console()
    if not console.is_terminal:
        console.width = WIDTH
    for fault in found.faults:
        console.print(f"FOUND {fault.text}", highlight=False, markup=False, soft_wrap=True)
    table = RichTable(title=found.title, title_justify="left")
    for heading in ("", "change ± 95 %", "in the file", "sd assumed", "sd now", "sd wanted", "halves", ""):
        table.add_column(heading, overflow="fold")
    for row in found.rows():
        table.add_row(*row)
    console.print(table)
    told = [*found.sentences(), *(f"{receiver.words}." for receiver in found.receivers)]
    told += [*residuals.sentences(found.found.fit.left), found.steering_words]
    for one in found.verdict.numbers:
        if one.why_not:
            verb = "not identifiable" if one.status == NOT_IDENTIFIABLE else "weakly identified"
            told.append(f"{one.number.words}: {verb}; better by: {one.why_not}")
    for text in told:
        console.print(text, highlight=False, markup=False, soft_wrap=True)
