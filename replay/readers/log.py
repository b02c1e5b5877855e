"""What is common to every log reader: the log itself, its records, the errors."""

from collections.abc import Container, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from tilth.schemas.flow import Frame
from tilth.schemas.proto.tilth_pb2 import Snapshot

UNREADABLE = "unreadable_line"
NO_DATE = "it has no date: its times count from its own start"
NO_ZONE = "its dates have no time zone; they are taken as UTC, though a computer's clock shows local time"
_YEAR_NS = 365 * 86_400 * 1_000_000_000
CUT_OFF = "cut off; replayed as far as it is whole"
MOST_TOLD = 8  # places that are damaged
LATEST_NS = 2**63 - 1  # stamps are kept in 64 bits


class LogError(Exception):
    """A log cannot be read; one sentence that says why. `status` is the exit status of a command."""

    status = 1


class EmptyLog(LogError):
    """There is no frame in it."""


class ForeignLog(LogError):
    """It is no log of CAN frames, or of a kind that nobody here can read."""

    status = 2


class OtherKind(ForeignLog):
    """The same; the message should list what can be read, which `readers` adds."""


@dataclass(frozen=True, slots=True)
class Logged:
    """A result as it was logged live."""

    topic: str
    t_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class RunPlace:
    """Which run a log belongs to and the place it has there; nothing is known of logs that others wrote."""

    run: tuple[str, str] = ("", "")  # id, start
    part: int = 0  # from 1

    def gap_after(self, last: "RunPlace") -> str:
        """What is missing or wrong between that log and this one, as the end of a sentence; "": nothing."""
        if self.run != last.run:
            return "another run begins here; counts are of all runs, estimates of the last one alone"
        if self.part > last.part + 1:
            return f"part {self.part} of its run follows part {last.part}; what is between is missing"
        if 0 < self.part <= last.part:
            return f"part {self.part} after part {last.part} of the same run; give each once and in order"
        return ""

    def goes_on_from(self, last: "RunPlace") -> bool:
        """Whether what was learned before this log is of its own past."""
        return self.run == last.run and (self.part > last.part or not self.part)


@dataclass(frozen=True, slots=True)
class Gap:
    """Here messages are missing, since the log is damaged. t_ns: of the last one before, 0 for none."""

    t_ns: int
    text: str  # where, and what it cost


Record = Frame | Snapshot | Logged | Gap


def stamp_fault(t_ns: int) -> str:
    """Why a frame cannot have this stamp; "" where it can."""
    if t_ns < 0:
        return "negative_time_stamp"  # before 1970
    return "time_stamp_after_2262" if t_ns > LATEST_NS else ""


@dataclass(slots=True)
class OpenLog:
    """A log opened for reading; `truncated`, `skipped`, `note` and `damage` are complete once `records` is
    used up.

    Records come in the order of the file, which is the order in which they were processed, and are never
    sorted, whatever their stamps say.
    """

    path: Path
    form: str  # in a person's words
    file: BinaryIO
    size: int  # bytes
    packed: bool = False  # by gzip
    topics: Container[str] = ()  # whose results, logged live, are among the records
    records: Iterator[Record] = field(default_factory=lambda: iter(()))
    truncated: bool = False  # the end is missing
    skipped: dict[str, int] = field(default_factory=dict)  # what was no frame for the decoder -> count
    note: str = ""  # what else a person should know of it
    damage: list[str] = field(default_factory=list)  # where, and what it cost, in sentences

    def skip(self, reason: str) -> None:
        self.skipped[reason] = self.skipped.get(reason, 0) + 1

    def remark(self, text: str) -> None:
        """Something that a person should know of it, said once."""
        if text not in self.note:
            self.note += f"; {text}" if self.note else text

    def began(self, t_ns: int) -> None:
        """The first frame of a log that another program wrote."""
        if 0 <= t_ns < _YEAR_NS:
            self.remark(NO_DATE)

    def lacks(self) -> list[str]:
        """What is missing in it, in sentences without its name."""
        found = [CUT_OFF] if self.truncated else []
        found += [self.note] if self.note else []
        return [*found, *self.told_damage()]

    def told_damage(self) -> list[str]:
        """`damage`, the first places of it."""
        more = len(self.damage) - MOST_TOLD
        return self.damage[:MOST_TOLD] + ([f"damaged at {more} places more"] if more > 0 else [])

    def position(self) -> int:
        """Bytes read so far, for a progress bar."""
        return self.size if self.file.closed else min(self.file.tell(), self.size)
