"""A live calibration in a terminal: what to do next, the stages, the numbers."""

from typing import Any, Final

from rich.console import Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from tilth.schemas.proto import tilth_pb2 as pb

KEYS: Final = {"c": "compute", "f": "finish", "q": "quit", "\x03": "quit"}
HELP: Final = "c: compute now   f: finish   q: stop here, and go on later"
BAR: Final = 20  # characters
SIGNS: Final = {"told": "✔", "rough": "~", "not told": "✘"}


def line(state: pb.CalibrationState) -> str:
    """What is new, for who reads lines: it changes with each step, not with each second."""
    steps = [f"[{'x' if one.complete else ' '}] {one.title}" for one in state.stages]
    told = [" ".join(steps), _next(state), *(f"FOUND {text}" for text in state.found)]
    if state.numbers:
        good = sum(one.status == "told" for one in state.numbers)
        told.append(f"{good} of {len(state.numbers)} numbers are known as well as is wanted")
    told += state.told[:1] if not state.numbers else ()
    return "\n  ".join([*told, *state.notes])


def _next(state: pb.CalibrationState) -> str:
    """What to do, without how much of it is missing: that changes all the time."""
    for one in state.stages:
        if not one.complete:
            return f"next: {one.title}: {one.what}"
    return state.text


def panel(state: pb.CalibrationState) -> Panel:
    """All that a driver needs to see."""
    parts: list[Any] = [Text(state.text, style="bold"), Text(state.happening)]
    parts += [Text(f"FOUND {text}", style="yellow") for text in state.found]
    parts.append(_stages(state))
    if state.numbers:
        parts.append(_numbers(state))
    else:
        parts += [Text(text, style="yellow") for text in state.told]
    parts.append(Text(state.computed))
    parts += [Text(note, style="dim") for note in state.notes]
    parts.append(Text(HELP, style="dim"))
    return Panel(Group(*parts), title=f"calibrating {state.machine}", title_align="left")


def _stages(state: pb.CalibrationState) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    for one in state.stages:
        full = round(BAR * one.share)
        bar = f"{'█' * full}{'·' * (BAR - full)}"
        table.add_row("✔" if one.complete else " ", one.title, bar, one.done)
    return table


def _numbers(state: pb.CalibrationState) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("", "(each ± is 95 %)", "change of the file", "before", "now", "wanted", ""):
        table.add_column(heading, overflow="fold")
    for one in state.numbers:
        sign = SIGNS.get(one.status, "?")
        table.add_row(sign, one.words, one.change, one.before, one.now, one.wanted, one.tell)
    return table
