"""Bars for work that takes long, on a terminal."""

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack

from rich.console import Console
from rich.progress import Progress, TaskID

Steps = Callable[[str, float, float], None]  # what, done, of all
LINE_S = 10.0  # from one line to the next
EACH_S = 0.1  # from one drawing to the next


def bars(stack: ExitStack) -> Steps:
    """One bar for each thing that is told of, until the stack ends; lines where stderr is no terminal. They
    go to stderr, so JSON on stdout stays alone."""
    if not sys.stderr.isatty():
        said = _Lines()
        return lambda what, done, of: said.take(what, done / of if of else 1.0)
    bar, draw = _bar(stack)
    tasks: dict[str, TaskID] = {}

    def show(what: str, done: float, of: float) -> None:
        if what not in tasks:
            tasks[what] = bar.add_task(what, total=of)
        bar.update(tasks[what], completed=done, total=of)
        draw()

    return show


def stages(stack: ExitStack) -> Callable[[str, float], None]:
    """One bar whose words are what is done now, with its share, until the stack ends; as `bars`."""
    if not sys.stderr.isatty():
        return _Lines().take
    bar, draw = _bar(stack)
    task = bar.add_task("", total=1.0)

    def show(what: str, share: float) -> None:
        bar.update(task, description=what, completed=share)
        draw()

    return show


class _Lines:
    """For a file or a pipe: a line now and then while the work takes long."""

    def __init__(self) -> None:
        self._said_s = time.monotonic()

    def take(self, what: str, share: float) -> None:
        now_s = time.monotonic()
        if now_s - self._said_s >= LINE_S:
            self._said_s = now_s
            print(f"{what}: {100 * share:.0f} %", file=sys.stderr, flush=True)


def _bar(stack: ExitStack) -> tuple[Progress, Callable[[], None]]:
    """Drawn by who tells of a step, not by a thread: a process that is forked for a fit would inherit its
    locks."""
    bar = stack.enter_context(Progress(console=Console(stderr=True), transient=True, auto_refresh=False))
    drawn_s = 0.0

    def draw() -> None:
        nonlocal drawn_s
        if time.monotonic() - drawn_s > EACH_S:
            drawn_s = time.monotonic()
            bar.refresh()

    return bar, draw
