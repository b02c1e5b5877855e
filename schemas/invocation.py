"""How this program was started, so that a command that it prints runs as it is printed.

The command line says it once, before anything else; whoever is imported by another program is `tilth`, and
starts no command by itself.
"""

import shlex
from collections.abc import Sequence

_started = ["tilth"]
_background: list[str] = []


def started_as(words: list[str], background: Sequence[str] = ()) -> None:
    """words: such as ["uv", "run", "tilth"]. background: program and first arguments of a process that runs a
    command behind all else that the computer does."""
    _started[:] = words
    _background[:] = background


def in_background(*words: str) -> list[str]:
    """Arguments of a process that runs a command of tilth; empty where another program imports this one."""
    return [*_background, *words] if _background else []


def command(*words: str) -> str:
    """A command of tilth for a shell: command("check", "my rig.toml") is tilth check 'my rig.toml'."""
    return shlex.join([*_started, *words])


def installing(extra: str) -> str:
    """The command that installs what an extra of this package needs."""
    if _started[0] == "uv":
        return f"uv sync --inexact --extra {extra}"
    return f"pip install 'tilth[{extra}]'"
