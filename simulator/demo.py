"""The demo: the virtual tractor on a CAN bus over loopback, the real daemon at its other end, a comparison.

A second process plays the traffic; this one runs the same daemon as `tilth run`. Where the daemon has to
compile first, the tractor drives meanwhile, and its time counts from when the estimators are ready.
"""

import json
import logging
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from rich.table import Table

from tilth.logger import compiling
from tilth.logger.child import words_of
from tilth.logger.daemon import run_daemon
from tilth.logger.display import Display, NoDisplay
from tilth.logger.job import Job, JobEnded
from tilth.logger.run_summary import RunSummary
from tilth.logger.zenoh.session import free_endpoint
from tilth.replay.estimates_json import estimates_and_nuisances
from tilth.schemas.flow import PARAMETERS, Estimate, Event, ParameterEstimate
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.sentences import sentence
from tilth.schemas.spread import interval, scale_of, unit_of
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import Ground, RollSensor, Scenario, Soil, as_json
from tilth.simulator.tractor import draw

SPATIAL: Final = Scenario(
    plant="spatial", ground=Ground(rms=0.01), soil=Soil(grip=0.7), roll_sensor=RollSensor(draw=True)
)
"""Of `tilth demo --spatial`: the same drive over ground of 1 cm rms, with roll as real receivers tell it."""
COMPILING_S: Final = 900.0  # longest drive while the daemon compiles; longer than that it ends with it
STARTING_S: Final = 180.0  # longest wait for the second process, which may have to compile its model
SOON_S: Final = 4.0  # of that without a word
IN_FLIGHT_S: Final = 5.0  # longest wait for what it sent last
TICK_S: Final = 0.1
STOP: Final = b'{"stop": true}'


class DemoError(Exception):
    """The demo cannot run; one sentence says why."""


@dataclass(frozen=True, slots=True)
class Demo:
    """What a demo gave."""

    seed: int
    truth: Mapping[str, float]  # PARAMETERS, N/rad and m
    summary: RunSummary
    frames_sent: int

    @property
    def frames_lost(self) -> int:
        return self.frames_sent - self.summary.recorded


@dataclass(frozen=True, slots=True)
class TruthAndEstimate:
    """One parameter: truth beside estimate."""

    name: str
    truth: float
    estimate: ParameterEstimate | None
    interval: tuple[float, float] | None  # 95 %

    @property
    def holds(self) -> bool | None:
        """Whether the interval holds the truth; None where there is no estimate."""
        return None if self.interval is None else self.interval[0] <= self.truth <= self.interval[1]


def run_demo(
    seconds: float,
    seed: int,
    log_folder: Path,
    display: Display | None = None,
    stop: Callable[[], bool] = lambda: False,
    say: Callable[[str], None] = lambda text: None,
    watch: Callable[[str], object] | None = None,
    scenario: Scenario | None = None,
) -> Demo:
    """Drive the packaged machine for so long, in real time. Raises DemoError and MachineError.

    stop: asked ten times a second; the log is finished in any case. say: told what takes its time. watch:
    told the Zenoh endpoint before it begins.
    """
    logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)  # it warns at each half-read frame
    packaged = packaged_file()
    timed = _Timed(display or NoDisplay(), seconds)
    kept = compiling.load(packaged.machine)  # then the daemon estimates from its first frame on
    endpoint = free_endpoint(packaged.machine.zenoh.listen[0])
    if watch is not None:
        watch(endpoint)
    scenario = scenario or Scenario()
    lasting = seconds if kept else seconds + COMPILING_S
    order = {"machine_text": packaged.text, "seed": seed, "seconds": lasting, "scenario": as_json(scenario)}
    with closing(Player(order, stop, say)) as player:
        text = on_loopback(packaged.text, player.port)
        text = text.replace("[zenoh]\n", f'[zenoh]\nlisten = ["{endpoint}"]\n')
        machine = parse_machine(text)
        summary = run_daemon(
            MachineFile(machine, text),
            log_folder=log_folder,
            simulated="tilth demo",
            status=timed,
            stop=lambda: player.finished(stop() or (timed.over and not kept), timed.frames),
        )
    if player.sent is None:
        files = " ".join(str(path) for path in summary.log_files)
        raise DemoError(f"the simulator died before its end; what came until then is in {files}")
    return Demo(seed, draw(machine, seed, scenario), summary, player.sent)


class _Timed(Display):
    """Shows what is to be shown, and knows when the estimators have been ready for so many seconds."""

    def __init__(self, display: Display, seconds: float) -> None:
        self.over = False
        self.frames = 0  # taken by the daemon, by its last status
        self._display = display
        self._seconds = seconds
        self._ready_ns = 0

    def show(self, status: pb.Status, estimate: Estimate | None) -> None:
        self.frames = status.frames
        if status.t_ns and not status.preparing:
            self._ready_ns = self._ready_ns or status.t_ns
            self.over = status.t_ns - self._ready_ns >= self._seconds * 1e9
        self._display.show(status, estimate)

    def event(self, event: Event) -> None:
        self._display.event(event)


def on_loopback(machine_text: str, port: int) -> str:
    """The machine file with its one bus replaced by a socketcand server on this computer."""
    bus = f"""[[bus]]
name = "can0"
interface = "socketcand"
channel = "can0"
bitrate = 250000
options = {{ host = "127.0.0.1", port = {port} }}

"""
    return re.sub(r"\[\[bus\]\]\n[^\[]*", bus, machine_text, count=1)


class Player:
    """The second process: see socketcand_server.main."""

    def __init__(self, order: dict[str, Any], stop: Callable[[], bool], say: Callable[[str], None]) -> None:
        """Returns once it has driven and is ready to play. Raises DemoError where it does not start."""
        self.sent: int | None = None  # frames, as soon as it says so
        self._ended_s: float | None = None
        self._told_to_stop = False
        with demo_errors("the simulator"):
            self._job = Job(words_of("tilth.simulator.socketcand_server"), [json.dumps(order).encode()])
            try:
                self.port = int(first_fact(self._job, stop, say)["port"])
            except BaseException:
                self.close()
                raise

    def finished(self, early: bool, taken: int) -> bool:
        """True when all is played and so many frames have been taken; early: play no further."""
        if early and not self._told_to_stop:
            self._told_to_stop = True
            self._job.send(STOP)
        if self._ended_s is None:
            try:
                line = self._job.next(0.0)
                self.sent = None if line is None else json.loads(line)["sent"]
                over = line is not None
            except JobEnded:
                over = True
            self._ended_s = time.monotonic() if over else None
            return False
        # What was sent last may still be on its way, on a busy computer for a second or two.
        return taken >= (self.sent or 0) or time.monotonic() > self._ended_s + IN_FLIGHT_S

    def close(self) -> None:
        self._job.close()


@contextmanager
def demo_errors(name: str) -> Iterator[None]:
    """DemoError where a process of that name does not start."""
    try:
        yield
    except JobEnded as why:
        raise DemoError(f"{name} did not start: {why}") from None


def first_fact(job: Job, stop: Callable[[], bool], say: Callable[[str], None] = lambda text: None) -> Any:
    """What a process says first, as JSON. Raises DemoError, JobEnded."""
    for tick in range(round(STARTING_S / TICK_S)):
        if (line := job.next(TICK_S)) is not None:
            return json.loads(line)
        if stop():
            raise DemoError("stopped before it began")
        if tick == round(SOON_S / TICK_S):
            say("preparing the tractor's model")
    raise JobEnded(f"it said nothing for {STARTING_S:.0f} s")


def compare(truth: Mapping[str, float], estimate: Estimate | None) -> list[TruthAndEstimate]:
    """One row for each of PARAMETERS."""
    rows = []
    for i, name in enumerate(PARAMETERS):
        parameter = estimate.parameters[i] if estimate is not None else None
        rows.append(TruthAndEstimate(name, truth[name], parameter, _interval(estimate, i)))
    return rows


def _interval(estimate: Estimate | None, i: int) -> tuple[float, float] | None:
    """95 %, log-normal."""
    if estimate is None:
        return None
    value, sd = estimate.parameters[i].value, estimate.parameters[i].sd
    if value is None or sd is None:
        return None
    n = len(PARAMETERS)
    log_sd = math.sqrt(estimate.log_covariance[i * n + i]) if estimate.log_covariance else sd / value
    return interval(value, log_sd)


def result(demo: Demo) -> dict[str, object]:
    """What `tilth demo --json` says: that of a replay, with truth and the fate of the frames."""
    summary = demo.summary
    first, last = summary.first_frame_ns, summary.last_frame_ns
    return {
        "frames": summary.recorded,
        "measurements": summary.measurements,
        "rejected": summary.rejected,
        "poses": summary.poses,
        "duration_s": 0.0 if first is None or last is None else (last - first) * 1e-9,
        "truncated": False,
        "simulated": True,
        **estimates_and_nuisances(summary.estimates),
        "truth": dict(demo.truth),
        "log": [str(path) for path in summary.log_files],
        "frames_sent": demo.frames_sent,
        "frames_lost": demo.frames_lost,
    }


def comparison_table(demo: Demo) -> Table:
    """Truth beside the recommended estimate, for a terminal."""
    table = Table(title=f"Truth and estimate, seed {demo.seed}", title_justify="left")
    for heading, justify in _COLUMNS:
        table.add_column(heading, justify=justify)
    for row in compare(demo.truth, demo.summary.estimates.get("recommended")):
        table.add_row(*_cells(row))
    return table


def truth_and_estimate(demo: Demo) -> list[dict[str, object]]:
    """The same for the page: numbers in the units that people read."""
    rows = []
    for row in compare(demo.truth, demo.summary.estimates.get("recommended")):
        scale, value = scale_of(row.name), row.estimate.value if row.estimate is not None else None
        rows.append({
            "name": row.name, "unit": unit_of(row.name), "truth": row.truth * scale, "holds": row.holds,
            "value": None if value is None else value * scale,
            "interval": None if row.interval is None else [end * scale for end in row.interval],
        })  # fmt: skip
    return rows


_COLUMNS: Final[tuple[tuple[str, Literal["left", "right"]], ...]] = (
    ("", "left"),
    ("truth", "right"),
    ("estimate", "right"),
    ("95 % interval", "right"),
    ("holds truth", "left"),
    ("status", "left"),
)


def _cells(row: TruthAndEstimate) -> tuple[str, ...]:
    scale, digits = scale_of(row.name), 0 if row.name.startswith("C_") else 2
    start = (f"{row.name}, {unit_of(row.name)}", f"{row.truth * scale:.{digits}f}")
    status = "unestimated" if row.estimate is None else row.estimate.status.name.lower()
    if row.estimate is None or row.interval is None or row.estimate.value is None:
        return *start, "", "", "", status
    low, high = (f"{end * scale:.{digits}f}" for end in row.interval)
    holds = "[green]yes[/]" if row.holds else "[red]no[/]"
    return *start, f"{row.estimate.value * scale:.{digits}f}", f"{low} … {high}", holds, status


def reasons(demo: Demo) -> list[str]:
    """A line for each reason why there is no estimate, or none that is fresh."""
    names: dict[str, list[str]] = {}
    estimate = demo.summary.estimates.get("recommended")
    for row in compare(demo.truth, estimate):
        reason = "no estimator has spoken" if row.estimate is None else sentence(row.estimate.reason)
        if reason:
            names.setdefault(reason, []).append(row.name)
    return [f"{', '.join(of)}: {reason}" for reason, of in names.items()]
