"""`tilth demo --guidance`: a controller that adapts, on the wires of a real rig, beside one that does not.

virtual tractor ─CAN─► daemon ─Zenoh─► controller ─CAN─► the tractor's steering

Three processes and two kinds of wires. The same field with fixed gains has been driven before, in lockstep;
the implement's error of both is told row by row, as events, and drawn at the end.
"""

import json
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.table import Table

from tilth.adaptive_guidance.plan import STEP, Along, Plan, Work, plan
from tilth.adaptive_guidance.study import (
    PARTS,
    SETTLED_S,
    SPEED,
    DrivenPath,
    draw,
    driven,
    middle,
    rms,
    scenario_of,
)
from tilth.estimator.models.parameters import rig_of
from tilth.logger import compiling
from tilth.logger.child import words_of
from tilth.logger.daemon import run_daemon
from tilth.logger.display import Display
from tilth.logger.job import Job, JobEnded
from tilth.logger.outlets import Events
from tilth.logger.run_summary import RunSummary
from tilth.logger.zenoh.session import free_endpoint
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.notices import in_words
from tilth.simulator.demo import STOP, DemoError, demo_errors, first_fact, on_loopback
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import ORIGIN_DEG, as_json

WORK: Final = Work(rows=6, length=100.0, spacing=54.0, radius=20.0)
FROM_CHANGE: Final = replace(WORK, rows=5, rows_before=1)  # what is to be seen, without what comes before it
FIGURE: Final = "guidance.svg"


@dataclass(frozen=True, slots=True)
class GuidedPaths:
    """The same field with fixed gains and with those that adapt."""

    fixed: DrivenPath
    adapting: DrivenPath
    figure: Path | None


@dataclass(frozen=True, slots=True)
class Guided(GuidedPaths):
    """What the demo gave on the wires of a rig."""

    summary: RunSummary
    commands: dict[str, Any]  # what became of them, as the tractor tells it


def run_lockstep(seed: int, folder: Path, say: Callable[[str], None], work: Work = WORK) -> GuidedPaths:
    """Drive the field twice, both times faster than real time and without wires: no log, no page. The figure
    goes into the folder. Raises DemoError, OSError."""
    paths = {}
    for gains in ("fixed", "adapting"):
        say(f"driving the field with {gains} gains, faster than real time")
        try:
            paths[gains] = driven(packaged_file().machine, seed, gains, work)
        except RuntimeError as error:
            raise DemoError(str(error)) from None
    folder.mkdir(parents=True, exist_ok=True)
    figure = folder / FIGURE
    draw(paths, figure)
    return GuidedPaths(paths["fixed"], paths["adapting"], figure)


def run_guidance(
    seed: int,
    log_folder: Path,
    display: Display | None = None,
    stop: Callable[[], bool] = lambda: False,
    say: Callable[[str], None] = lambda text: None,
    watch: Callable[[str], object] | None = None,
    work: Work = WORK,
    listen: str = "",
) -> Guided:
    """Drive the field in real time. Raises DemoError.

    stop: asked ten times a second. say: told what takes its time. watch: told the Zenoh endpoint. listen:
    that endpoint; the machine file's if not given, or the next that is free.
    """
    logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)  # it warns at each half-read frame
    _compiled(stop, say)
    say("driving the field with nominal gains first, faster than real time")
    fixed = driven(packaged_file().machine, seed, "fixed", work)
    text = packaged_file().text
    with ExitStack() as ends:
        words = words_of("tilth.simulator.real_time_rig")
        rig, first = _started(ends, stop, "the tractor", words, _order(text, seed, work))
        text = on_loopback(text, first["port"])
        endpoint = free_endpoint(listen or parse_machine(text).zenoh.listen[0])
        text = text.replace("[zenoh]\n", f'[zenoh]\nlisten = ["{endpoint}"]\n')
        machine = parse_machine(text)
        if watch is not None:
            watch(endpoint)
        words = words_of("tilth.adaptive_guidance", *_controller_arguments(machine, endpoint, work))
        controller, _ = _started(ends, stop, "the controller", words)
        events = Events()  # the daemon tells them: in its log, on the page, in the terminal
        watching = _Watching(rig, controller, plan(work, rig_of(machine)), middle(work), fixed, events)
        summary = run_daemon(
            MachineFile(machine, text), log_folder=log_folder, simulated="tilth demo --guidance",
            status=display, stop=lambda: watching.over(stop()), events=events,
        )  # fmt: skip
    if not watching.end:
        files = " ".join(str(path) for path in summary.log_files)
        raise DemoError(f"the tractor ended before its run; what came until then is in {files}")
    figure = None
    adapting = watching.driven()
    if len(adapting.time) and summary.log_files:
        figure = summary.log_files[0].with_name(FIGURE)
        draw({"fixed": fixed, "adapting": adapting}, figure)
    return Guided(fixed, adapting, figure, summary, watching.end)


def _compiled(stop: Callable[[], bool], say: Callable[[str], None]) -> None:
    """Make ready what the estimators call: here the controller is to have estimates from the start.
    Raises DemoError."""

    def report_progress(done: compiling.KernelsDone) -> None:
        if stop():
            raise compiling.CompilingStopped
        if not done.functions:
            say(compiling.TEXT)

    try:
        compiling.prepare(packaged_file().machine, report_progress)
    except compiling.CompilingStopped:
        raise DemoError("stopped before it began") from None


def _order(text: str, seed: int, work: Work) -> bytes:
    """What the tractor's process is told first."""
    machine = packaged_file().machine
    line = plan(work, rig_of(machine))
    scenario = replace(scenario_of(machine, work), other_traffic=False)
    order = {
        "machine_text": text, "seed": seed, "seconds": len(line.row) * STEP / SPEED + 3.0,
        "scenario": as_json(scenario), "listeners": 2,
    }  # fmt: skip
    return json.dumps(order).encode()


def _started(
    ends: ExitStack, stop: Callable[[], bool], name: str, words: Sequence[str], *lines: bytes
) -> tuple[Job, Any]:
    """A process that tells lines of JSON, and the first of them. Raises DemoError."""
    with demo_errors(name):
        job = Job(words, lines)
        ends.callback(job.close)
        return job, first_fact(job, stop)


def _facts(job: Job) -> Iterator[dict[str, Any]]:
    """What it has told since the last call."""
    with suppress(JobEnded):
        while (line := job.next(0.0)) is not None:
            yield json.loads(line)


def _controller_arguments(machine: Machine, endpoint: str, work: Work) -> list[str]:
    server = machine.bus[0].options
    origin = [str(degrees) for degrees in ORIGIN_DEG]
    return [
        "--machine", machine.name, "--prefix", machine.zenoh.prefix, "--connect", endpoint, "--replay",
        "--interface", "socketcand", "--host", str(server["host"]), "--port", str(server["port"]),
        "--origin", *origin, "--rows", str(work.rows), "--length", str(work.length),
        "--spacing", str(work.spacing), "--radius", str(work.radius),
    ]  # fmt: skip


@dataclass(slots=True)
class _Watching:
    """Reads what tractor and controller tell, ten times a second, and says how each row went."""

    rig: Job
    controller: Job
    line: Plan
    middle: float
    fixed: DrivenPath
    events: Events
    end: dict[str, Any] = field(default_factory=dict)  # the tractor's last words
    _rows: list[tuple[float, float, int, bool]] = field(default_factory=list)
    _along: Along = field(init=False)
    _stop_sent: bool = False
    _silent: bool = False
    _code: str = ""  # why the controller does not steer

    def __post_init__(self) -> None:
        self._along = Along(self.line)

    def over(self, early: bool) -> bool:
        """Whether the run has ended; early: end it."""
        if self.end or not self.rig.alive:
            return True
        if early and not self._stop_sent:
            self._stop_sent = True
            self.rig.send(STOP)
        for fact in _facts(self.rig):
            if "sent" in fact:
                self.end = fact
            elif "implement" in fact:
                self._take(fact["at_s"], *fact["implement"])
        self._hear_controller()
        return False  # once more round: what was sent last is still to be read

    def driven(self) -> DrivenPath:
        columns = list(zip(*self._rows, strict=True)) or [(), (), (), ()]
        time, error, row, after = columns
        return DrivenPath(np.array(time), np.array(error), np.array(row, np.int64), np.array(after, bool), [])

    def _take(self, at_s: float, x: float, y: float) -> None:
        error, sample = self._along.error(x, y)
        row = int(self.line.row[sample])
        if self._rows and row != self._rows[-1][2]:
            self._say_how(self._rows[-1][2])
        self._rows.append((at_s, error, row, y > self.middle))

    def _say_how(self, row: int) -> None:
        ours = [error for at, error, of, _ in self._rows if of == row and at > SETTLED_S]
        theirs = self.fixed.error[(self.fixed.row == row) & (self.fixed.time > SETTLED_S)]
        if ours and len(theirs):
            where = f"row {row + 1}" if row >= 0 else f"turn after row {-row}"
            mine, other = (100 * math.sqrt(np.mean(np.square(values))) for values in (ours, theirs))
            self._event(f"{where}: implement off by {mine:.1f} cm RMS, {other:.1f} cm with fixed gains")

    def _hear_controller(self) -> None:
        if not self.controller.alive and not self._silent and not self.end:
            self._silent = True
            self._event("the controller has ended: the wheels stay, the driver brakes")
        for fact in _facts(self.controller):
            before, self._code = self._code, fact["code"]
            if before != self._code:  # not each second of a silence
                why = f"does not steer: {fact['reason']}" if self._code else "steers"
                self._event(f"the controller {why}")

    def _event(self, text: str) -> None:
        self.events.append(("guidance", in_words(text)))


def table(guided: GuidedPaths) -> Table:
    """Both controllers' errors, for a terminal."""
    errors_table = Table(title="Implement off its line, RMS, cm", title_justify="left")
    errors_table.add_column("gains")
    for after, turn in PARTS:
        where = f"{'turns' if turn else 'rows'}, {'soft soil' if after else 'as planned'}"
        errors_table.add_column(where, justify="right")
    for name, one in (("fixed", guided.fixed), ("adapting", guided.adapting)):
        errors = [rms([one], *part) for part in PARTS]
        errors_table.add_row(name, *("" if math.isnan(error) else f"{100 * error:.1f}" for error in errors))
    return errors_table
