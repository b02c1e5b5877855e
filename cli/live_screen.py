"""A command that goes on in a terminal: a panel that is drawn anew, and keys; where there is none, lines."""

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from rich.console import Console
from rich.live import Live
from rich.panel import Panel

State = TypeVar("State")


class Screen(Generic[State]):
    """A live panel and keys where there is a terminal; else lines for what is new."""

    def __init__(
        self, panel: Callable[[State], Panel], line: Callable[[State], str], keys: Mapping[str, str],
        told_by: Callable[[str], str] = lambda line: line,
    ) -> None:  # fmt: skip
        """keys: the order that each stands for. told_by: what of a line makes it a new one."""
        self.asks = sys.stdin.isatty() and sys.stdout.isatty()
        self._panel, self._line, self._keys, self._told_by = panel, line, dict(keys), told_by
        self._live: Live | None = None
        self._before: Any = None
        self._told: str = ""

    def __enter__(self) -> Self:
        if self.asks:
            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
            self._live = Live(console=Console(), auto_refresh=False, screen=False)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()
            with contextlib.suppress(termios.error):
                termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def show(self, state: State) -> str:
        """Draw it; the order whose key was pressed, or ""."""
        if self._live is None:
            line = self._line(state)
            if (told := self._told_by(line)) != self._told:
                self._told = told
                print(line, flush=True)
            return ""
        self._live.update(self._panel(state), refresh=True)
        if not select.select([sys.stdin], [], [], 0.0)[0]:
            return ""
        pressed = os.read(sys.stdin.fileno(), 64).decode(errors="replace")
        return next((self._keys[key] for key in pressed if key in self._keys), "")
