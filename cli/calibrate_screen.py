"""A live calibration in a terminal: what to do next, the stages, the numbers."""

import re
from typing import Any, Final

from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from tilth.schemas.proto import tilth_pb2 as pb

KEYS: Final = {"c": "compute", "f": "finish", "q": "quit", "\x03": "quit"}
HELP: Final = "c: compute now   f: finish   q: stop here, and go on later"
BAR: Final = 20  # characters
NARROW: Final = 100  # columns: less has a shorter bar
SHORT_BAR: Final = 6
LEAST: Final = 6  # rows of numbers, before there is room for notes
COUNTS: Final = "This "  # begins what an instant counts for, which changes with each bend
SECONDS: Final = re.compile(r"\d+(\.\d+)? s\b")
SIGNS: Final = {"told": "✔", "rough": "~", "not told": "✘"}


def line(state: pb.CalibrationState) -> str:
    """What is new, for who reads lines: it changes with each step, not with each second."""
    steps = [f"[{'x' if one.complete else ' '}] {one.title}" for one in state.stages]
    told = [" ".join(steps), _next(state)]
    if state.happening and not state.happening.startswith(COUNTS):
        told.append(state.happening)
    told += [f"FOUND {text}" for text in state.found]
    if state.numbers:
        told.append(_good(state))
    told += state.told[:1] if not state.numbers else ()
    told += _beside(state)
    told += [state.computed] if state.computed else []
    return "\n  ".join([*told, *state.notes])


def _beside(state: pb.CalibrationState) -> list[str]:
    """What the last estimate says beyond the numbers."""
    more = [f"What is left of {one.words}: {one.text}." for one in state.left if one.more]
    return more + [one.told for one in state.stages if one.told]


def without_seconds(line: str) -> str:
    """Of a line, what makes it a new one."""
    return SECONDS.sub("s", line)


def _good(state: pb.CalibrationState) -> str:
    good = sum(one.status == "told" for one in state.numbers)
    return f"{good} of {len(state.numbers)} numbers are known as well as is wanted"


def _next(state: pb.CalibrationState) -> str:
    """What to do, without how much of it is missing: that changes all the time."""
    for one in state.stages:
        if not one.complete:
            return f"next: {one.title}: {one.what}"
    return state.text


def panel(state: pb.CalibrationState) -> Panel:
    """All that a driver needs to see, as far as the terminal has room."""
    return Panel(_FittedPanel(state), title=f"calibrating {state.machine}", title_align="left")


class _FittedPanel:
    """As high as the terminal at most: what a driver can do without is left out, keys never are."""

    def __init__(self, state: pb.CalibrationState) -> None:
        self._state = state

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        state = self._state

        def rows(*parts: Any) -> int:
            return len(console.render_lines(Group(*parts), options, pad=False))

        above = [Text(state.text, style="bold"), Text(state.happening)]
        above += [Text(f"FOUND {text}", style="yellow") for text in state.found]
        width = SHORT_BAR if options.max_width < NARROW else BAR
        stages = _stages(state, width)
        told = [] if state.numbers else [Text(text, style="yellow") for text in state.told]
        below = [
            Text(state.computed),
            *map(Text, _beside(state)),
            *(Text(note, style="dim") for note in state.notes),
        ]
        keys = Text(HELP, style="dim")
        height = options.size.height - 2  # of the frame
        if rows(*above, stages, keys) > height - bool(state.numbers):
            stages = _stages(state, width, wraps=False)
        room = height - rows(*above, stages, keys) - (LEAST if state.numbers else 0)
        kept = list[Any]()
        for part in (*below, *told):
            if (room := room - rows(part)) < 0:
                break
            kept.append(part)
        yield Group(*above, stages)
        if state.numbers:
            room = height - rows(*above, stages, *kept, keys)
            whole = _numbers(state)
            yield whole if rows(whole) <= room else _open_numbers(state, room)
        yield Group(*kept[len(below) :], *kept[: len(below)], keys)


def _stages(state: pb.CalibrationState, width: int, *, wraps: bool = True) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    for least in (1, None, width, None):
        table.add_column(min_width=least, no_wrap=not wraps, overflow="fold" if wraps else "ellipsis")
    for one in state.stages:
        full = round(width * one.share)
        bar = f"{'█' * full}{'·' * (width - full)}"
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


def _open_numbers(state: pb.CalibrationState, rows: int) -> Group:
    """In so many rows: how many are known, and those that are not yet."""
    open_ones = [one for one in state.numbers if one.status != "told"]
    shown = max(rows - 1, 0)
    more = len(open_ones) - shown
    last = f", {more} more have no room here" if more > 0 else ""
    table = Table(box=None, padding=(0, 1, 0, 0), show_header=False)
    for least in (1, None, None, None):
        table.add_column(min_width=least, no_wrap=True, overflow="ellipsis")
    for one in open_ones[:shown]:
        table.add_row(SIGNS.get(one.status, "?"), one.words, one.change, f"wanted {one.wanted}")
    return Group(Text(_good(state) + last, no_wrap=True, overflow="ellipsis"), *([table] if shown else []))
