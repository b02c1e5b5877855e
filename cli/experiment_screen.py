"""The prompter in a terminal: what to do, a bar to follow, keys to arm, stop and skip."""

import math
from typing import Any, Final

from rich.console import Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from tilth.client.experiment.prompter import COUNTDOWN, FINISHED, RUNNING
from tilth.schemas.proto import tilth_pb2 as pb

KEYS: Final = {" ": "arm", "\n": "arm", "\r": "arm", "s": "stop", "k": "skip", "q": "quit"}
WIDTH: Final = 61  # of the bar, odd: straight is in the middle
HELP: Final = "Space: arm   s: stop   k: skip this run   q: quit"
SHOWN: Final = 6  # attempts


def line(state: pb.ExperimentState) -> str:
    """What is new, for who reads lines."""
    told = [f"{state.done} of {state.of}", state.drive, state.text, *state.learned, *state.commands]
    return "\n  ".join(text for text in told if text)


def panel(state: pb.ExperimentState) -> Panel:
    """All that a driver needs to see."""
    parts: list[Any] = [Text(state.text, style="bold")]
    if state.drive:
        parts.append(Text(state.drive))
    if state.phase == COUNTDOWN:
        parts.append(Text(f"  {math.ceil(state.count_s)}  ", style="bold reverse"))
    if state.phase == RUNNING:
        parts.append(Text(f"{state.at_s:.0f} of {state.length_s:.0f} s"))
    if state.phase != FINISHED:
        parts += bar(state)
    for one in state.conditions:
        parts.append(Text(f"{'✔' if one.met else '✘'} {one.text}", style="green" if one.met else "yellow"))
    if state.attempts:
        parts.append(_attempts(state))
    parts += [Text(line) for line in (*state.learned, *state.commands)]
    parts.append(Text("q: quit" if state.phase == FINISHED else HELP, style="dim"))
    return Panel(Group(*parts), title=title(state), title_align="left")


def title(state: pb.ExperimentState) -> str:
    """How far the plan is."""
    skipped = f", {state.skipped} of them skipped" if state.skipped else ""
    return f"{state.plan}: {state.done} of {state.of} runs{skipped}"


def bar(state: pb.ExperimentState) -> list[Text]:
    """What is wanted above what is measured, left to right; the wheels straight in the middle."""
    largest = max(1.3 * state.largest, math.radians(2.0))
    rows = [("wanted", state.wanted if state.HasField("wanted") else None, "▼")]
    soon = state.ahead[10] if len(state.ahead) > 10 else None
    rows += [("in 1 s", soon, "▽"), ("wheels", state.measured if state.HasField("measured") else None, "▲")]
    return [_row(name, angle, sign, largest) for name, angle, sign in rows]


def _row(name: str, angle: float | None, sign: str, largest: float) -> Text:
    cells = ["·"] * WIDTH
    cells[WIDTH // 2] = "│"
    if angle is None:
        return Text(f"{name:>7} {''.join(cells)}")
    place = round((WIDTH // 2) * (1.0 + min(max(angle / largest, -1.0), 1.0)))
    cells[place] = sign
    return Text(f"{name:>7} {''.join(cells)} {math.degrees(angle):+5.1f}°")


def _attempts(state: pb.ExperimentState) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    for one in state.attempts[-SHOWN:]:
        table.add_row(one.outcome, one.name.removeprefix(f"experiment {state.plan} "), one.reason)
    return table
