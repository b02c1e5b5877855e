"""Where a person looks: a panel in a terminal, plain lines where there is none.

The daemon's loop draws it, so nothing here may take long or wait.
"""

from collections import deque
from collections.abc import Callable, Mapping
from typing import TextIO

from rich.columns import Columns
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from tilth.logger.can.live_bus import BusState
from tilth.logger.clock import utc_text
from tilth.schemas.flow import Estimate, Event, ParameterEstimate, Status
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.sentences import event_sentence
from tilth.schemas.spread import of_logarithm
from tilth.schemas.states import DeviceState

PLAIN_NS = 5_000_000_000
MOST_EVENTS = 4
MOST_PROBLEMS = 6
STIFFNESSES = ("front", "rear", "implement")  # the first three of PARAMETERS
_COLOUR: Mapping[str, str] = {
    BusState.OPEN: "green", DeviceState.ALIVE: "green", DeviceState.WAITING: "yellow",
    BusState.SILENT: "red", BusState.FAILED: "red", DeviceState.NO_DATA: "red", DeviceState.LOST: "red",
}  # fmt: skip

Line = Callable[[pb.Status, Estimate | None], str]


class PlainDisplay:
    """A line at each event, and one each five seconds."""

    def __init__(self, stream: TextIO, line: Line | None = None) -> None:
        """line: of the state of the run (plain_line)."""
        self._stream = stream
        self._line = line or plain_line
        self._next_ns = 0

    def show(self, status: pb.Status, estimate: Estimate | None) -> None:
        if status.t_ns >= self._next_ns and status.t_ns:
            self._next_ns = status.t_ns + PLAIN_NS
            self._write(status.t_ns, self._line(status, estimate))

    def event(self, event: Event) -> None:
        self._write(event.t_ns, f"{event.kind}: {event_sentence(event)}")

    def close(self) -> None:
        return

    def _write(self, t_ns: int, text: str) -> None:
        self._stream.write(f"{utc_text(t_ns, '%H:%M:%SZ')} {text}\n")
        self._stream.flush()


class LineDisplay:
    """One line that is written anew."""

    def __init__(self, console: Console | None = None) -> None:
        self._live = Live(console=console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)

    def show(self, status: pb.Status, estimate: Estimate | None) -> None:
        self._live.start()  # only the first time does anything
        self._live.update(Text(soil_line(status, estimate), no_wrap=True, overflow="ellipsis"), refresh=True)

    def event(self, event: Event) -> None:
        return

    def close(self) -> None:
        """Leave the last line standing and give the terminal back."""
        self._live.stop()


class PanelDisplay:
    """One panel that stays in place; events pass through it."""

    def __init__(self, machine: str, console: Console | None = None) -> None:
        self._machine = machine
        self._events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self._live = Live(console=console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)

    def show(self, status: pb.Status, estimate: Estimate | None) -> None:
        self._live.start()  # only the first time does anything
        self._live.update(panel(self._machine, status, estimate, tuple(self._events)), refresh=True)

    def event(self, event: Event) -> None:
        self._events.append(event)

    def close(self) -> None:
        """Leave the last panel standing and give the terminal back."""
        self._live.stop()


def plain_line(status: pb.Status, estimate: Estimate | None) -> str:
    """The state of the run in one line."""
    alive = sum(receiver.state == "alive" for receiver in status.receivers)
    rate = sum(bus.frames_per_s for bus in status.buses)
    parts = [
        "ready, ignition is off" if status.resting else "recording" if status.recording else "NOT RECORDING",
        f"{status.log_bytes / 1e6:.1f} MB",
        f"{status.frames} frames ({rate:.0f}/s)",
        f"receivers {alive}/{len(status.receivers)}",
        f"wheel angle {status.wheel_angle.state}",
        *(f"{bus.name} failed {_times(bus.failures)}" for bus in status.buses if bus.failures),
        *([preparing_text(status)] if status.preparing else []),
        *(f"{name} {stiffness_text(one)}" for name, one in _stiffnesses(estimate)),
    ]
    if status.problems:
        parts.append(
            f"PROBLEM {status.problems[0]}"
            + (f" (and {len(status.problems) - 1} more)" * (len(status.problems) > 1))
        )
    return ", ".join(parts)


def soil_line(status: pb.Status, estimate: Estimate | None) -> str:
    """What is learned, in one line, kN/rad; what is made ready, before anything is."""
    if status.preparing:
        return f"… {preparing_text(status)}"
    minutes, seconds = divmod(int(status.uptime_s), 60)
    stiffnesses = _stiffnesses(estimate)
    soil = "driving; nothing known about the tyres yet"
    if any(one.value is not None for _, one in stiffnesses):
        known = ", ".join(f"{name} {stiffness_text(one, bare=True)}" for name, one in stiffnesses)
        soil = f"tyres, kN/rad (95 %): {known}"
    return f"{minutes}:{seconds:02d}  {soil}" + (f"  {status.problems[0]}" if status.problems else "")


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def preparing_text(status: pb.Status) -> str:
    """What is still being made ready, and about how long that takes."""
    # A forecast that has come down to nothing was too short: how long the last ones take is not known.
    is_foretold = status.HasField("ready_in_s") and status.ready_in_s >= 1.0
    remaining = f", about {status.ready_in_s:.0f} s left" if is_foretold else ""
    return f"{status.preparing}{remaining}"


def stiffness_text(one: ParameterEstimate, bare: bool = False) -> str:
    """Value with its 95 % range, or what keeps it from being known. bare: of a table whose head says it."""
    if one.value is None or one.sd is None:
        return f"{one.status.name.lower()}"
    stale = "" if one.status is Status.ESTIMATED else f", {one.status.name.lower()}"
    return of_logarithm(one.value / 1e3, one.sd / 1e3, "" if bare else "kN/rad", bare) + stale


def panel(
    machine: str, status: pb.Status, estimate: Estimate | None, events: tuple[Event, ...]
) -> RenderableType:
    """Buses, sensors, soil, log and problems: all at a glance."""
    healthy = status.recording and not status.problems
    return Panel(
        Group(
            _headline(status),
            Columns((_buses(status), _sensors(status), _soil(estimate)), padding=(0, 3)),
            _log_line(status),
            *([Text(f"… {preparing_text(status)}", style="yellow")] if status.preparing else []),
            *(Text(f"✘ {problem}", style="bold red") for problem in status.problems[:MOST_PROBLEMS]),
            *(
                Text(
                    f"{utc_text(e.t_ns, '%H:%M:%SZ')} {event_sentence(e)}",
                    style="dim",
                    overflow="ellipsis",
                    no_wrap=True,
                )
                for e in events
            ),
        ),
        title=f"Tilth  {machine}{status.implement and ' + '}{status.implement}",
        border_style="green" if healthy else "red",
    )


def _headline(status: pb.Status) -> Text:
    minutes, seconds = divmod(int(status.uptime_s), 60)
    clock = f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"
    if status.resting:
        return Text.assemble(("○ READY", "bold green"), f"  {clock}  ignition is off: no frame on any bus")
    if status.recording:
        return Text.assemble(
            ("● RECORDING", "bold green"), f"  {clock}  {status.frames} frames, {status.poses} poses"
        )
    return Text.assemble((" NOT RECORDING ", "bold white on red"), f"  {clock}  {status.frames} frames")


def _table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for column in columns:
        table.add_column(column, no_wrap=True, justify="right" if column.endswith("/s") else "left")
    return table


def _state(state: str) -> Text:
    mark = "✔" if state in (BusState.OPEN, DeviceState.ALIVE) else "✘" if _COLOUR.get(state) == "red" else "…"
    return Text(f"{mark} {state.replace('_', ' ')}", style=_COLOUR.get(state, ""))


def _buses(status: pb.Status) -> Table:
    failed = any(bus.failures for bus in status.buses)  # also where all of them work again
    table = _table("bus", "", "frames/s", "bad", *(["failed"] if failed else []))
    for bus in status.buses:
        counts = [bus.error_frames + bus.lost_frames, *([bus.failures] if failed else [])]
        cells = [Text(f"{count or ''}", "red") for count in counts]
        table.add_row(bus.name, _state(bus.state), f"{bus.frames_per_s:.0f}", *cells)
    return table


def _sensors(status: pb.Status) -> Table:
    table = _table("sensor", "", "fix", "age")
    for receiver in status.receivers:
        table.add_row(
            receiver.mount.replace("_", " "),
            _state(receiver.state),
            receiver.fix.replace("_", " "),
            _age(receiver),
        )
    table.add_row("wheel angle", _state(status.wheel_angle.state), "", _age(status.wheel_angle))
    return table


def _age(receiver: pb.ReceiverStatus) -> str:
    return f"{receiver.age_s:.1f} s" if receiver.HasField("age_s") else ""


def _soil(estimate: Estimate | None) -> Table:
    table = _table("tyres", "kN/rad (95 %)")  # once: cells have to fit into 80 columns
    for name, one in _stiffnesses(estimate):
        style = {Status.ESTIMATED: "bold", Status.STALE: "yellow", Status.INVALID: "red"}.get(
            one.status, "dim"
        )
        table.add_row(name, Text(stiffness_text(one, bare=True), style=style))
    return table


def _stiffnesses(estimate: Estimate | None) -> list[tuple[str, ParameterEstimate]]:
    none = ParameterEstimate(None, None, Status.UNESTIMATED, None)
    rows = estimate.parameters[:3] if estimate is not None else (none,) * 3
    return list(zip(STIFFNESSES, rows, strict=True))


def _log_line(status: pb.Status) -> Text:
    if not status.HasField("disk_free_bytes"):
        return Text(status.log_file)
    hours = status.hours_left
    room = f"{status.disk_free_bytes / 1e9:.1f} GB free, {'over 99' if hours > 99 else f'{hours:.0f}'} h"
    return Text(
        f"{status.log_file or 'no log file'}  {status.log_bytes / 1e6:.1f} MB  ({room})", overflow="fold"
    )
