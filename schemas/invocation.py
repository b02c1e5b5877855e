"""How this program was started, so that a command that it prints runs as it is printed.

The command line says it once, before anything else; whoever is imported by another program is `tilth`.
"""

import shlex

_started = ["tilth"]


def started_as(words: list[str]) -> None:
    """Such as ["uv", "run", "tilth"]."""
    _started[:] = words


def command(*words: str) -> str:
    """A command of tilth for a shell: command("check", "my rig.toml") is tilth check 'my rig.toml'."""
    return shlex.join([*_started, *words])


def installing(extra: str) -> str:
    """The command that installs what an extra of this package needs."""
    if _started[0] == "uv":
        return f"uv sync --inexact --extra {extra}"
    return f"pip install 'tilth[{extra}]'"
