"""Compiles what the estimators of a machine call, before anything has to be in time.

`python -m tilth.logger.compiling MACHINE.toml` does it in advance, for whoever runs it: the installer.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

from tilth.estimator.estimators import rows_for
from tilth.logger.machine_file import read_machine
from tilth.schemas.machine import Machine, MachineError

TEXT = "compiling kernels, once per machine: half a minute, a few minutes on a small computer"

Say = Callable[[str], None]


def prepare(machine: Machine, say: Say) -> float:
    """Compile, or load what was kept on disk. Returns the seconds of compiling, 0.0 where all was kept.

    say: is told TEXT as soon as the first kernel has to be compiled.
    """
    try:
        from numba.core import config, event
    except (ImportError, OSError):
        return 0.0  # kernels are interpreted
    if getattr(config, "DISABLE_JIT", 0):  # set at run time
        return 0.0
    began: list[float] = []

    class Compilations(event.Listener):
        """numba's; loading from disk is none."""

        def on_start(self, event: object) -> None:
            if not began:
                began.append(time.monotonic())
                say(TEXT)

        def on_end(self, event: object) -> None:
            return

    listener = Compilations()
    event.register("numba:compile", listener)
    try:
        for row in rows_for(machine):
            row.prepare(machine)
    finally:
        event.unregister("numba:compile", listener)
    return time.monotonic() - began[0] if began else 0.0


def main(words: list[str]) -> int:
    """Of one machine file; 2 where there is none that can be read."""
    try:
        if len(words) != 1:
            raise MachineError("usage: python -m tilth.logger.compiling MACHINE.toml")
        machine, _ = read_machine(Path(words[0]))
    except MachineError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    prepare(machine, _print)
    return 0


def _print(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
