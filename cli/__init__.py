"""The command line: `tilth COMMAND`. Commands parse arguments, call a function of another layer and print.

Exit status: 0 done, 1 ran but found a fault, 2 wrong use or configuration with one line that says what to do.
With --json the answer goes to stdout and everything else to stderr.
"""

import argparse
import atexit
import importlib
import io
import math
import os
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, suppress
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

from tilth.logger.can.lean_can import import_can
from tilth.logger.child import words_of
from tilth.schemas.invocation import command, started_as
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.plausible import unusual
from tilth.schemas.readable import reason_of

# One row per command: module tilth.cli.<name> has `add(subparsers)`, which adds the parser of that name, and
# `run(args) -> int`, the exit status. Only the module asked for is imported: `tilth check` needs no scipy.
COMMANDS: tuple[tuple[str, str], ...] = (
    ("run", "log the buses of a machine, estimate, publish"),
    ("status", "show the state of the running daemon"),
    ("mark", "note an event in the log of the daemon that runs"),
    ("accept", "accept the present position of what the running daemon has found moved"),
    ("implement", "tell the daemon which implement is hitched, or what it carries"),
    ("logs", "list the runs in a log folder, mark those to be kept, add notes"),
    ("offload", "copy finished runs to a USB stick or another folder, and verify the copies"),
    ("verify", "read logs completely, and report what is missing or damaged"),
    ("recover", "finish log files that a power cut left unfinished"),
    ("check", "check configuration, buses, disk and clock before a run"),
    ("decode", "print the messages of a log, one JSON object per line"),
    ("replay", "feed logs through the estimators again"),
    ("fit", "estimate the parameters of each manoeuvre in logs, and of all together"),
    ("compare", "show what differs beyond chance between two logs or fits"),
    ("import", "make a log from a table of positions and wheel angles"),
    ("export", "write the contents of logs to Parquet, CSV or MAT files"),
    ("season", "identify many days of logs and combine them"),
    ("map", "draw a map of the fields of a season"),
    ("report", "report what was driven and found, in one HTML file"),
    ("demo", "run everything with a simulated tractor"),
    ("simulate", "drive a scenario and write its log and the true values"),
    ("experiment", "propose a plan of experiments, or prompt a driver through one"),
    ("discover", "listen to a bus and draft a machine file"),
    ("setup", "make a machine file on a web page, from a phone"),
    ("calibrate", "find what a drive reveals about a rig, and write it into its machine file"),
    ("keys", "manage who may listen to a machine on a shared network, and who may mark"),
    ("mavlink", "send the parameters to a MAVLink autopilot"),
    ("model", "show how a rig moves, and what a drive can reveal about its tyres"),
    ("sensitivity", "show how much each output of a rig depends on each parameter"),
    ("uncertainty", "show how well the outputs of a rig are known, and what limits that"),
    ("monitor", "show a running daemon in a browser"),
    ("foxglove", "show a running daemon in Foxglove or Lichtblick"),
)


class WrongUse(Exception):
    """Raised by a command that cannot start: one sentence that says what to do. Exit status 2."""


class CommandFailed(Exception):
    """Raised by a command that cannot go on: one sentence, and the exit status."""

    def __init__(self, text: str, status: int) -> None:
        super().__init__(text)
        self.status = status


REPORT_SUFFIXES = (".html", ".htm")
RECORDERS = ("run", "check", "demo")  # they hold a bus open for long, and read no MF4


def log_path(text: str) -> Path:
    """The type of an argument that names a log. One on storage elsewhere, as s3://bucket/day.mcap, is copied
    here for as long as the command runs."""
    from tilth.replay.readers.log import ForeignLog
    from tilth.replay.readers.remote import at_hand, is_remote

    if not is_remote(text):
        return Path(text)
    copies = ExitStack()
    try:
        path = copies.enter_context(at_hand(text))
    except ForeignLog as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    atexit.register(copies.close)
    return path


def duration(text: str) -> float:
    """argparse type: a duration, s, positive and finite."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"{text}: give a number above zero")
    return value


def whole(least: int) -> Callable[[str], int]:
    """argparse type: a whole number from `least` up."""

    def number(text: str) -> int:
        if not text.isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text}: give a whole number from {least} up")
        return int(text)

    return number


def check_folder(folder: Path) -> None:
    """Before a drive, or a computation of minutes, is lost to a name. Raises WrongUse."""
    if not folder.is_dir():
        raise WrongUse(f"{folder}: there is no such folder; make it, or give another")
    if not os.access(folder, os.W_OK):
        raise WrongUse(f"{folder}: you may not write there; give another folder, or ask for access")


def check_out(out: Path | None, beside: Sequence[str] = (".json",)) -> None:
    """Before anything is computed. beside: endings of its other files. Raises WrongUse."""
    if out is None:
        return
    if out.suffix.lower() not in REPORT_SUFFIXES:
        raise WrongUse(f"--out {out}: give a name that ends in .html")
    for path in (out, *(out.with_suffix(ending) for ending in beside)):
        if path.exists():
            raise exists(path)
    check_folder(out.parent)


def exists(path: object) -> WrongUse:
    """What to say of a report that is there."""
    return WrongUse(f"{path}: exists; a report is never overwritten, give another name")


def as_given(args: argparse.Namespace, *names: str) -> list[str]:
    """Options as they would be typed again, without those that were not given. names: of options, such as
    "speed"; "from=log" where the attribute has another name."""
    words: list[str] = []
    for name in names:
        option, _, attribute = name.partition("=")
        value = getattr(args, attribute or option)
        if value is True:
            words.append(f"--{option}")
            continue
        for one in value if isinstance(value, list) else [] if value is None or value is False else [value]:
            words += [f"--{option}", f"{one:g}" if isinstance(one, float) else str(one)]
    return words


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(2, f"tilth{self.prog.removeprefix(command())}: {message}; see {self.prog} --help\n")


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        print(f"tilth {version('tilth')}")  # a search of the disk: for who asks only
        parser.exit()


def add_bus_names(parser: argparse.ArgumentParser) -> None:
    """The option of the commands that read logs of others."""
    parser.add_argument(
        "--bus",
        action="append",
        default=[],
        metavar="LOG=MACHINE",
        help="name of a log's bus in the machine file; LOG= leaves that bus out",
    )


def buses_of(args: argparse.Namespace, machine: Machine | None) -> dict[str, str]:
    """{name in the logs: name in the machine file} of --bus. Raises WrongUse."""
    from tilth.replay.readers.rig import bus_names  # with all readers of logs

    try:
        return bus_names(args.bus, machine)
    except ValueError as error:
        raise WrongUse(str(error)) from None


def at_least(low: int, what: str = "whole number") -> Callable[[str], int]:
    """A type for argparse: such a number from low up."""

    def number(text: str) -> int:
        if not text.isdecimal() or int(text) < low:
            raise argparse.ArgumentTypeError(f"{text}: give a {what}, from {low} up")
        return int(text)

    return number


def add_processes(parser: argparse.ArgumentParser, option: str) -> None:
    """The option of how many there are to be."""
    processes = at_least(1, "number of processes")
    parser.add_argument(option, type=processes, metavar="N", help="number of processes (one per core)")


def say(of: str, text: str) -> None:
    """To stderr, after the name of a command."""
    print(f"tilth {of}: {text}", file=sys.stderr, flush=True)


def say_unusual(of: str, machine: Machine) -> None:
    """What is rare in a machine file."""
    for text in unusual(machine):
        say(of, f"machine file: {text}")


def _started(program: str, environment: Mapping[str, str]) -> list[str]:
    """What a person typed before the name of a command."""
    if "UV_RUN_RECURSION_DEPTH" in environment:  # `uv run` says so to what it starts
        return ["uv", "run", "tilth"]
    if Path(program).name != "tilth":  # part of another program
        return ["tilth"]
    found = shutil.which("tilth", path=environment.get("PATH"))
    if found and Path(program).exists() and Path(program).samefile(found):
        return ["tilth"]
    return [program]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command in argv (without the program's name; sys.argv where None). Returns the exit status."""
    # Matrices are small here: threads that share one wait for each other, and processes stand side by side.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is there
    words = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names of files are bytes: some are in no encoding
            stream.reconfigure(errors="backslashreplace")
    started_as(_started(sys.argv[0], os.environ), words_of("tilth.cli.background"))
    parser = _Parser(
        prog=command(),
        description="Records a tractor's CAN buses and estimates how the soil holds the tyres.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    wanted = next((word for word in words if not word.startswith("-")), None)
    if wanted is not None and wanted not in dict(COMMANDS):
        parser.exit(2, f"tilth: {_no_command(wanted)}\n")
    if wanted in RECORDERS:
        import_can()
    for name, summary in COMMANDS:
        if name == wanted:
            importlib.import_module(f"tilth.cli.{name}").add(subparsers)
        else:
            subparsers.add_parser(name, help=summary)
    args = parser.parse_args(words)
    try:
        status: int = importlib.import_module(f"tilth.cli.{args.command}").run(args)
        sys.stdout.flush()
    except BrokenPipeError:  # `tilth decode … | head`: the reader has had enough
        _drop_output()
        return 0
    except (MachineError, WrongUse, CommandFailed, KeyboardInterrupt, BrokenExecutor, OSError) as error:
        text, status = _in_words(error)
        say(args.command, text)
        if isinstance(error, OSError) and not isinstance(error, PermissionError):
            with suppress(OSError):
                _drop_output()
    return status


def _no_command(word: str) -> str:
    import difflib  # for a slip only

    near = difflib.get_close_matches(word, dict(COMMANDS), n=2, cutoff=0.6)
    meant = f"; did you mean {' or '.join(near)}?" if near else "."
    return f"there is no command {word}{meant} {command('--help')} lists all"


def _drop_output() -> None:
    """What has not been written yet goes nowhere."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _in_words(error: BaseException) -> tuple[str, int]:
    """How a command ended, and its exit status."""
    match error:
        case CommandFailed():
            return str(error), error.status
        case MachineError() | WrongUse():
            return str(error), 2
        case PermissionError():
            who = "you may not; ask for access, or do it as who may (sudo -u tilth)"
            return f"{error.filename}: {who}", 2
        case OSError():  # `tilth fit --json >FILE` on a full disk
            return f"{error.filename or 'standard output'}: {reason_of(error)}", 1
        case BrokenExecutor():
            killed = "one of its processes was killed, most likely since memory ran out"
            return f"{killed}; give fewer logs, or use another computer", 1
        case _:
            return "stopped", 1
