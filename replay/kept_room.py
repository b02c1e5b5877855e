"""Room for a log that a replay writes to be kept: it is not written where the disk is too full."""

from collections.abc import Callable, Sequence
from pathlib import Path

from tilth.logger.log.derived import Derived
from tilth.replay.readers.log import LogError


class NoRoom(LogError):
    """The disk of what is kept is too full."""


def room_for(derived: Derived, logs: Sequence[Path]) -> Callable[[int], int]:
    """Make room for what a replay gives of logs; it is about as long as they are. What is returned takes the
    bytes that are read, gives them back, and raises NoRoom as this does. Raises OSError."""

    def check(done: int) -> int:
        if derived.is_low():
            raise NoRoom(f"{derived.no_room()}; make room, or name another disk by XDG_CACHE_HOME")
        return done

    derived.make_room(sum(path.stat().st_size for path in logs))
    check(0)
    return check
