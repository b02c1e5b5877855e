"""A process that ends when its parent does. Its other end is logger/job.py.

`python -P -m tilth.logger.child PARENT MODULE WORD…` runs a module as `python -m MODULE WORD…` does.
"""

import base64
import contextlib
import os
import pickle
import signal
import sys
from typing import Any, Final

_PR_SET_PDEATHSIG: Final = 1  # of Linux's prctl(2)


def words_of(module: str, *words: str) -> list[str]:
    """Arguments of a process that runs the module, as a child of this one."""
    return [sys.executable, "-P", "-m", __name__, str(os.getpid()), module, *words]


def end_with(parent: int) -> None:
    """Let the system end this process with the thread that started it, in the process of that id; at once,
    if that has ended already. Elsewhere than on Linux only the latter."""
    import ctypes  # not for who only wants words

    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def packed(value: Any) -> bytes:
    """As a line, between parent and child only."""
    return base64.b64encode(pickle.dumps(value, pickle.HIGHEST_PROTOCOL))


def unpacked(line: bytes) -> Any:
    """Of such a line, with its end or without. Raises ValueError where it is none."""
    try:
        return pickle.loads(base64.b64decode(line.removesuffix(b"\n"), validate=True))
    except Exception as error:  # pickle says so in many ways
        raise ValueError(f"it said what is no answer ({line[:40]!r})") from error


def _main() -> None:
    import runpy

    parent, module, *words = sys.argv[1:]
    end_with(int(parent))
    sys.argv = [module, *words]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    _main()
