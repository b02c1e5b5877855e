"""What is wrong with a place of an MCAP file, and what it costs, in words."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

_DAYS_S: Final = 1e6


class FaultKind(StrEnum):
    """What is wrong with a place of a file."""

    HOLE = "hole"  # nothing can be read there
    CHUNK = "chunk"  # its checksum is wrong
    LEFT_OUT = "left_out"  # a recovery could not read what stood there
    HEAD = "head"  # of a chunk whose messages can be read
    DOUBLED = "doubled"
    MOVED = "moved"  # stands where it was not written
    APPENDED = "appended"  # another file begins
    INDEX = "index"
    CHANGED = "changed"  # by the checksum of the whole


@dataclass(frozen=True, slots=True)
class LogFault:
    """`from_s`, `until_s`: between which times, s after its first message, messages are missing."""

    kind: FaultKind
    start: int
    end: int
    costs: bool = False  # messages
    from_s: float | None = None
    until_s: float | None = None
    from_ns: int = 0  # the same as from_s, as log time

    def __str__(self) -> str:
        at = f"at byte {self.start:,}"
        match self.kind:
            case FaultKind.HEAD:
                return f"damaged {at}: the head of a chunk, whose messages are read"
            case FaultKind.DOUBLED:
                return f"a part of it stands there twice, again {at}; it is used once"
            case FaultKind.MOVED:
                return f"a part of it stands in the wrong place, {at}; it is read where it belongs"
            case FaultKind.APPENDED:
                return f"another file begins in it, {at}, which is read as well"
            case FaultKind.INDEX:
                return f"its index is damaged or not its own, {at}; it is read without"
            case FaultKind.CHANGED:
                return "its checksum is wrong: metadata or indexes of messages were changed"
            case FaultKind.LEFT_OUT:
                return f"a part {at} could not be read when it was recovered{self._span()}; all else is read"
        if not self.costs:
            return f"damaged {at}: {self.end - self.start:,} bytes cannot be read; no message was in them"
        size = (
            f"{self.end - self.start:,} bytes cannot be read"
            if self.end > self.start
            else "a part is missing"
        )
        return f"damaged {at}: {size}{self._span()}; all else is read"

    def _span(self) -> str:
        if self.from_s is None:
            return ", before the first message that can" if self.until_s is not None else ""
        if self.until_s is None:
            return f", of what followed {self.from_s:.2f} s after its begin"
        lost_s = self.until_s - self.from_s
        if not 0 <= lost_s < _DAYS_S:  # a head of a chunk was changed, which has no checksum
            return ""
        return f", {lost_s:.2f} s of the log from {self.from_s:.2f} s after its begin on"
