"""The lock by which programs tell each other that a log is being written.

It is a courtesy. Some shares and sticks have none: a log is recorded there without it, and what has changed
lately counts as being written.
"""

import fcntl
import os
import time
from pathlib import Path
from typing import BinaryIO, Final

from tilth.logger.clock import Clock

LATELY_NS: Final = 60_000_000_000  # a recorder writes a status each second, unless its disk stalls
_LOOKS: Final = 25
_BETWEEN_S: Final = 0.1


def lock(descriptor: int, *, wait: bool = False) -> bool:
    """Lock a file for writing; False where its file system has no locks.

    wait: until no other program has it. Else raises BlockingIOError where one has.
    """
    return _flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))


def is_being_written(file: BinaryIO) -> bool:
    """Whether another program holds it for writing, as the recorder does until a file is whole."""
    try:
        if not _flock(file.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB):
            return _changed_lately(file)
    except BlockingIOError:
        return True
    fcntl.flock(file, fcntl.LOCK_UN)
    return False


def grows(file: BinaryIO) -> bool:
    """Whether somebody writes it, seen for some seconds: for where there are no locks, and the clock of a
    share may be another one."""
    seen = _seen(file)
    for _ in range(_LOOKS):
        time.sleep(_BETWEEN_S)
        if _seen(file) != seen:
            return True
    return False


def _flock(descriptor: int, how: int) -> bool:
    try:
        fcntl.flock(descriptor, how)
    except BlockingIOError:
        raise
    except OSError:  # whatever a file system says that has none
        return False
    return True


def _changed_lately(file: BinaryIO) -> bool:
    ago_ns = Clock().t_ns() - os.fstat(file.fileno()).st_mtime_ns
    return abs(ago_ns) < LATELY_NS  # far in the future is no sign: a computer may begin its day in 1970


def _seen(file: BinaryIO) -> tuple[int, int]:
    # Opened anew: what a share's client has kept of an open file may be old.
    found = Path(file.name).stat()
    return found.st_size, found.st_mtime_ns
