"""Bars for work that takes long, on a terminal."""

import sys
from collections.abc import Callable
from contextlib import ExitStack

from rich.console import Console
from rich.progress import Progress, TaskID

Steps = Callable[[str, float, float], None]  # what, done, of all


def bars(stack: ExitStack) -> Steps:
    """One bar for each thing that is told of, until the stack ends; none where nobody looks at one. They go
    to stderr, so JSON on stdout stays alone."""
    if not sys.stderr.isatty():
        return lambda what, done, of: None
    bar = stack.enter_context(Progress(console=Console(stderr=True), transient=True))
    tasks: dict[str, TaskID] = {}

    def show(what: str, done: float, of: float) -> None:
        if what not in tasks:
            tasks[what] = bar.add_task(what, total=of)
        bar.update(tasks[what], completed=done, total=of)

    return show


def stages(stack: ExitStack) -> Callable[[str, float], None]:
    """One bar whose words are what is done now, with its share, until the stack ends; as `bars`."""
    if not sys.stderr.isatty():
        return lambda what, share: None
    bar = stack.enter_context(Progress(console=Console(stderr=True), transient=True))
    task = bar.add_task("", total=1.0)
    return lambda what, share: bar.update(task, description=what, completed=share)
