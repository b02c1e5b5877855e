"""`tilth demo`: a simulated tractor through the whole chain."""

import argparse
import contextlib
import json
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Final

from tilth.cli import WrongUse, check_folder, duration, say
from tilth.cli.zenoh_options import add_host
from tilth.logger.child import words_of
from tilth.logger.job import Job, JobEnded
from tilth.monitor.addresses import listening_socket
from tilth.schemas.invocation import command
from tilth.schemas.readable import reason_of

if TYPE_CHECKING:  # with the estimators: what is wrong, and what is done, is said before they are there
    from rich.console import Console

    from tilth.logger.display import Display
    from tilth.simulator.demo import Demo

_say = partial(say, "demo")

WHAT: Final = (
    "a simulated tractor pulls an implement over a field; its sensors are recorded as on a real one",
    "from this drive Tilth learns how firmly the soil holds the tyres; first numbers after about 15 s",
)

STAYING_S: Final = 0.2  # between two looks whether the page is to stay


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "demo",
        help="run everything on a simulated tractor",
        description="A simulated tractor sends on a CAN bus over loopback. The real daemon logs it, "
        "estimates and publishes. At the end each estimate is shown next to the true value. Needs no "
        "hardware and no privileges.",
    )
    parser.add_argument(
        "--seconds", type=duration, default=None, metavar="N", help="seconds to drive, in real time (90)"
    )
    parser.add_argument(
        "--guidance",
        action="store_true",
        help="let a controller use the live estimates to keep the implement on its line, over soil that "
        "gets softer half-way, compared with fixed gains (4 minutes of driving, half a minute of "
        "preparation)",
    )
    parser.add_argument(
        "--fast",
        action="store_true",
        help="with --guidance: both drives in one process, faster than real time, without CAN, Zenoh, log "
        "and page, for a small computer",
    )
    parser.add_argument(
        "--from-change",
        action="store_true",
        help="with --guidance: begin one row before the soil changes (3 minutes)",
    )
    parser.add_argument(
        "--spatial",
        action="store_true",
        help="use a three-dimensional tractor that rolls on its tyres over uneven ground, with other "
        "physics than the estimators' (needs the extra 'spatial')",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="choose another rig and drive (1)")
    parser.add_argument("--log", type=Path, default=Path("logs"), metavar="DIR", help="log folder (logs)")
    parser.add_argument("--no-page", action="store_true", help="do not serve the live page")
    add_host(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, the rest on stderr")


def run(args: argparse.Namespace) -> int:
    """1 where frames were lost."""
    if args.seed < 0:
        raise WrongUse(f"--seed {args.seed}: give a whole number from 0 up")
    if args.guidance and (args.seconds is not None or args.json):
        raise WrongUse("--guidance drives a whole field: leave out --seconds and --json")
    if not args.guidance and (args.fast or args.from_change):
        raise WrongUse("--fast and --from-change go with --guidance")
    if args.spatial:
        _check_spatial(args.guidance)
    if args.log.exists():
        check_folder(args.log)
    if args.fast:
        return _fast(args)
    if not args.no_page:
        _check_host(args.host)
    for sentence in WHAT:
        _say(sentence)
    from tilth.logger.status_line import LineDisplay, PlainDisplay, soil_line
    from tilth.simulator.demo import DemoError

    stopping = False

    def stop(signum: int, frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, stop)
    plain = args.json or not sys.stdout.isatty()
    display = PlainDisplay(sys.stderr, soil_line) if plain else LineDisplay()
    with contextlib.closing(_Page(args.host)) as page:
        watch = None if args.no_page else page.open
        drive = _guidance if args.guidance else _demo
        try:
            tell = drive(args, display, lambda: stopping, watch)
        except DemoError as error:
            _say(str(error))
            return 1
        finally:
            display.close()
        status, over = tell()
        if not plain and not stopping:
            page.stay(over, lambda: stopping)
    return status


def _check_spatial(guidance: bool) -> None:
    """Raises WrongUse."""
    if guidance:
        raise WrongUse("--guidance drives the planar tractor: leave out --spatial")
    from tilth.simulator.spatial.engine import NotInstalled, check_installed

    try:
        check_installed()
    except NotInstalled as error:
        raise WrongUse(f"--spatial: {error}") from None


def _check_host(host: str) -> None:
    """Before a drive that nobody can watch. Raises WrongUse."""
    try:
        listening_socket(host, 0).close()
    except OSError as error:
        raise WrongUse(
            f"--host {host}: {reason_of(error)}; give an address of this computer, or 0.0.0.0"
        ) from None


Stop = Callable[[], bool]
Watch = Callable[[str], object] | None
Tell = Callable[[], tuple[int, dict[str, object]]]
"""Says how it was, once the display is closed; the exit status, and what the page says."""


def _demo(args: argparse.Namespace, display: "Display", stop: Stop, watch: Watch) -> Tell:
    from tilth.simulator.demo import SPATIAL, result, run_demo, truth_and_estimate

    scenario = SPATIAL if args.spatial else None
    demo = run_demo(args.seconds or 90.0, args.seed, args.log, display, stop, _say, watch, scenario)

    def tell() -> tuple[int, dict[str, object]]:
        if args.json:
            print(json.dumps(result(demo)))
        else:
            _tell(demo)
        over = {"rows": truth_and_estimate(demo), **_next(demo.summary.log_files)}
        return (1 if demo.frames_lost or demo.summary.faults else 0), over

    return tell


def _fast(args: argparse.Namespace) -> int:
    """Both drives of the guidance demo without wires. 1 where that fails or is interrupted."""
    from tilth.adaptive_guidance.demo import FROM_CHANGE, WORK, run_lockstep, table
    from tilth.simulator.demo import DemoError

    try:
        guided = run_lockstep(args.seed, args.log, _say, FROM_CHANGE if args.from_change else WORK)
    except KeyboardInterrupt:
        _say("stopped before both drives were over; there is nothing to show")
        return 1
    except DemoError as error:
        _say(str(error))
        return 1
    except OSError as error:
        raise WrongUse(f"--log {args.log}: {reason_of(error)}") from None
    console = _console()
    console.print(table(guided))
    console.print(f"Figure: {guided.figure}", soft_wrap=True, highlight=False)
    return 0


def _guidance(args: argparse.Namespace, display: "Display", stop: Stop, watch: Watch) -> Tell:
    """1 also where the steering refused commands."""
    # with matplotlib: only who asks pays for it
    from tilth.adaptive_guidance.demo import FROM_CHANGE, WORK, run_guidance, table

    work = FROM_CHANGE if args.from_change else WORK
    guided = run_guidance(args.seed, args.log, display, stop, _say, watch, work)

    def tell() -> tuple[int, dict[str, object]]:
        console = _console()
        console.print(table(guided))
        refused = guided.commands["refused"]
        for reason, count in refused.items():
            console.print(f"{count} commands refused: {reason}", highlight=False)
        if guided.commands["late"]:
            console.print(
                "This computer was too busy for real time: commands came late, which made the errors larger."
            )
        if guided.figure is not None:
            console.print(f"Figure: {guided.figure}", soft_wrap=True, highlight=False)
        files = " ".join(str(path) for path in guided.summary.log_files)
        console.print(f"Log:    {files}", soft_wrap=True, highlight=False)
        over = {"rows": [], **_next(guided.summary.log_files)}
        return (1 if refused or guided.summary.faults else 0), over

    return tell


class _Page:
    """The live page, a process of its own."""

    def __init__(self, host: str) -> None:
        self._host = host
        self._job: Job | None = None
        self._address = ""

    def open(self, endpoint: str) -> None:
        """Start it, and say where it is and what is to be seen there."""
        self._job = Job(words_of("tilth.cli.demo_page", endpoint, self._host), [], aloud=True)
        try:
            self._address = (self._job.next() or b"").decode().strip()
        except JobEnded:
            _say("the page could not be started; the drive goes on")
            return
        _say(f"watch it at {self._address}")
        _say("it shows the field from above, the five sensors, and what is learned about soil and tyres")

    def stay(self, over: dict[str, object], stop: Stop) -> None:
        """It says what the demo gave, and stays until then."""
        if self._job is None or not self._job.alive:
            return
        self._job.send(json.dumps(over).encode())
        _say(f"done; the page stays at {self._address} until Ctrl-C")
        with contextlib.suppress(JobEnded):
            while not stop():
                if line := self._job.next(STAYING_S):
                    _say(line.decode())

    def close(self) -> None:
        if self._job is not None:
            self._job.close()


def _next(log_files: Sequence[Path]) -> dict[str, object]:
    """What to do with the logs."""
    files = [str(path) for path in log_files]
    steps = [
        ("the report of this drive", command("report", *files, "--out", "demo.html")),
        ("play this drive again", command("monitor", *files)),
        ("compute it again and compare each byte", command("replay", *files, "--verify")),
        ("draft a machine file for your own rig", command("discover", "--bus", "socketcan:can0")),
    ]
    return {"files": files, "next": steps if files else steps[-1:]}


def _console() -> "Console":
    from rich.console import Console

    return Console()


def _tell(demo: "Demo") -> None:
    from tilth.simulator.demo import comparison_table, reasons

    console = _console()
    console.print(comparison_table(demo))
    for reason in reasons(demo):
        console.print(reason, highlight=False)
    lost = f", [bold red]{demo.frames_lost} lost[/]" if demo.frames_lost else ", none lost"
    console.print(f"{demo.frames_sent} frames sent, {demo.summary.recorded} logged{lost}.")
    files = demo.summary.log_files
    if not files:
        console.print("No log was written.")
        return
    console.print(f"Log:    {' '.join(map(str, files))}", soft_wrap=True, highlight=False)
    console.print(f"Replay: {command('replay', *map(str, files))}", soft_wrap=True, highlight=False)
