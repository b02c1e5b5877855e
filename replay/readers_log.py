"""What is common to every log reader: the log itself, its records, the errors."""

from collections.abc import Container, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from tilth.schemas.flow import Frame
from tilth.schemas.proto.tilth_pb2 import Snapshot

READABLE = (
    "tilth reads its own .mcap logs, candump -l, ASC, BLF, TRC, MF4, the CSV and SQLite files of python-can "
    "and canboat's plain text"
)


class LogError(Exception):
    """A log cannot be read; one sentence that says why. `status` is the exit status of a command."""

    status = 1


class EmptyLog(LogError):
    """There is no frame in it."""


class ForeignLog(LogError):
    """It is no log of CAN frames, or of a kind that nobody here can read."""

    status = 2


@dataclass(frozen=True, slots=True)
class Logged:
    """A result as it was logged live."""

    topic: str
    t_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Place:
    """Which run a log belongs to and the place it has there; nothing is known of logs that others wrote."""

    run: tuple[str, str] = ("", "")  # id, start
    part: int = 0  # from 1

    def told_after(self, last: "Place") -> str:
        """What a person should know of this log after that one, as the end of a sentence; "": nothing."""
        if self.run != last.run:
            return "another run begins here; counts are of all runs, estimates of the last one alone"
        if self.part > last.part + 1:
            return f"part {self.part} of its run follows part {last.part}; what is between is missing"
        if 0 < self.part <= last.part:
            return f"part {self.part} after part {last.part} of the same run; give each once and in order"
        return ""

    def goes_on_from(self, last: "Place") -> bool:
        """Whether what was learned before this log is of its own past."""
        return self.run == last.run and (self.part > last.part or not self.part)


Record = Frame | Snapshot | Logged


@dataclass(slots=True)
class Log:
    """A log opened for reading; `truncated` and `skipped` are complete once `records` is used up.

    Records come in the order of the file, which is the order in which they were processed, and are never
    sorted, whatever their stamps say.
    """

    path: Path
    form: str  # in a person's words
    file: BinaryIO
    size: int  # bytes
    topics: Container[str] = ()  # whose results, logged live, are among the records
    records: Iterator[Record] = field(default_factory=lambda: iter(()))
    truncated: bool = False  # the end is missing
    skipped: dict[str, int] = field(default_factory=dict)  # what was no frame for the decoder -> count

    def skip(self, reason: str) -> None:
        self.skipped[reason] = self.skipped.get(reason, 0) + 1

    def position(self) -> int:
        """Bytes read so far, for a progress bar."""
        return self.size if self.file.closed else min(self.file.tell(), self.size)
