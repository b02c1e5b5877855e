"""The logs that python-can reads: ASC, BLF, TRC, MF4, and its own CSV and SQLite.

python-can gives float seconds; they are rounded to the microsecond, which is what survives in them.
Importing it takes two seconds (it loads asammdf), so that is done where it is needed. Its text readers stop
at the first line that they cannot read; here such a line is counted and reading goes on.
"""

import io
import logging
import re
import sqlite3
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from datetime import UTC, datetime
from functools import lru_cache
from io import BufferedReader
from typing import TYPE_CHECKING, BinaryIO, TextIO, cast

from tilth.replay.readers.log import UNREADABLE, ForeignLog, OpenLog, OtherKind, stamp_fault
from tilth.replay.readers.stream import without_zeros
from tilth.schemas.flow import Frame
from tilth.schemas.invocation import installing

if TYPE_CHECKING:
    import can

# What python-can's readers raise on a file that is cut or damaged.
_DAMAGE = (
    ValueError,
    LookupError,
    TypeError,
    NotImplementedError,
    OverflowError,
    EOFError,
    struct.error,
    zlib.error,
)
_ASC_HEAD = ("date ", "base ", "begin ", "end ", "//", "internal ", "no internal ")
_STAMPED = re.compile(r"\d+(\.\d+)?\s")
# Types of lines that are no frames: bus state, error counters, errors, remarks; an identifier of bus state.
_TRC_EVENTS = frozenset(("Warng", "Error", "Event", "ST", "EC", "ER", "EV", "FFFFFFFF"))
_NO_FRAME = ("end", "//", ";")  # how lines begin that are no frame and may end a file without its line end

Shift = Callable[[], float]


def text(log: OpenLog, stream: BinaryIO) -> TextIO:
    return io.TextIOWrapper(without_zeros(log, stream), encoding="utf-8-sig", errors="replace")


def _no_shift() -> float:
    return 0.0


def _frame(message: "can.Message", shift_s: float = 0.0) -> Frame | str:
    """The frame of a message, or why it is none that a decoder wants."""
    if message.is_remote_frame:
        return "remote_frame"
    if len(message.data) > 8:
        return "can_fd_frame"
    if len(message.data) < message.dlc and not message.is_error_frame:
        return UNREADABLE
    t_ns = round((message.timestamp + shift_s) * 1e6) * 1000
    fault = stamp_fault(t_ns)
    if fault:
        return fault
    channel = message.channel
    bus = f"can{channel}" if isinstance(channel, int) else str(channel or "can0")
    data = bytes(message.data)
    return Frame(
        t_ns, t_ns, bus, message.arbitration_id, message.is_extended_id, message.is_error_frame, data
    )


class _Lines:
    """Lines of a text log as the file that a reader of python-can expects, and the last one it was given.

    A line from which the reader makes nothing is counted by what `silent` calls it; "" is one that may be so.
    """

    def __init__(self, log: OpenLog, stream: BinaryIO, silent: Callable[[str], str]) -> None:
        self._log = log
        self._lines = text(log, stream)
        self._silent = silent
        self._first: list[str] = []
        self._settled = True  # it is known what became of the last one
        self.last = ""
        self.count = 0

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        if self._first:
            return self._first.pop()
        if not self._settled and not self.cut():
            reason = self._silent(self.last)
            if reason:
                self._log.skip(reason)
        self._settled = True
        self.last = next(self._lines)
        self._settled = False
        self.count += 1
        return self.last

    def settle(self) -> None:
        """The last one gave a message, or an error."""
        self._settled = True

    def begin_again(self) -> None:
        """Before a reader is iterated once more: it takes the first line for a header."""
        self._first.append("\n")

    def cut(self) -> bool:
        """Whether the last line lacks its end and is something of which a frame could be missing."""
        return not self.last.endswith("\n") and not self.last.lower().startswith(_NO_FRAME)

    def close(self) -> None:
        self._lines.close()


def _from_text(
    log: OpenLog, lines: _Lines, reader: "Iterable[can.Message]", shift: Shift = _no_shift
) -> Iterator[Frame]:
    taken = ""  # the line of the last frame
    count = -1
    with closing(lines):
        while lines.count > count:
            count = lines.count
            try:
                for message in reader:
                    lines.settle()
                    found = _frame(message, shift())
                    if lines.cut() and (found == UNREADABLE or lines.last[-2:-1].isspace()):
                        break  # the last line lost bytes, or half of one
                    if isinstance(found, Frame):
                        taken = lines.last
                        yield found
                    else:
                        log.skip(found)
                break
            except _DAMAGE:
                lines.settle()
                if not lines.cut():
                    log.skip(UNREADABLE)
                if taken:
                    lines.begin_again()
    log.truncated = log.truncated or (lines.cut() and lines.last is not taken)


def asc(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """Vector's ASC. Its date has no zone: read as UTC, a log gives the same stamps everywhere."""
    import can

    lines = _Lines(log, stream, _silent_in_asc)
    reader = can.ASCReader(cast(TextIO, lines), relative_timestamp=False)

    def shift() -> float:
        if reader.timestamps_format == "relative":
            raise ForeignLog(
                f"{log.path}: its time stamps count from the frame before; export it with absolute ones"
            )
        return _local_as_utc(reader.start_time)

    return _from_text(log, lines, reader, shift)


def _silent_in_asc(line: str) -> str:
    """Headers and comments are nothing; what has a time stamp is an event of another kind."""
    line = line.strip().lower()
    if not line or line.startswith(_ASC_HEAD) or line.endswith("start of measurement"):
        return ""
    return "other_event" if _STAMPED.match(line) else UNREADABLE


@lru_cache(maxsize=4)
def _local_as_utc(start_s: float) -> float:
    """What to add where python-can took a date for one of this computer's time zone, s."""
    return datetime.fromtimestamp(start_s).replace(tzinfo=UTC).timestamp() - start_s if start_s else 0.0


def trc(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """PEAK's TRC, as python-can reads it."""
    import can

    logging.getLogger("can.io.trc").setLevel(logging.ERROR)  # of lines that are counted here
    lines = _Lines(log, stream, _silent_in_trc)
    return _from_text(log, lines, can.TRCReader(cast(TextIO, lines)))


def _silent_in_trc(line: str) -> str:
    if line.isspace() or line.startswith(";"):
        return ""
    return "other_event" if _TRC_EVENTS.intersection(line.split()[1:4]) else UNREADABLE


def csv(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """python-can's CSV."""
    import can

    lines = _Lines(log, stream, lambda line: "")
    return _from_text(log, lines, can.CSVReader(cast(TextIO, lines)))


def blf(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """Vector's BLF; one whose header tells more bytes than there are, or none at all, was cut."""
    import can
    from can.io.blf import BLFParseError

    class Reader(can.BLFReader):
        """python-can 4.6 reads an object of no length again and again, for ever."""

        def _parse_data(self, data: bytes) -> Iterator[can.Message]:
            end = _whole_objects(data)
            yield from super()._parse_data(data[:end])
            if end < len(data):
                raise BLFParseError("an object is shorter than its header")

    logging.getLogger("can.io.blf").setLevel(logging.ERROR)
    try:
        reader = Reader(stream)
        count = 0
        for message in reader:
            found = _frame(message)
            count += 1
            if isinstance(found, Frame):
                yield found
            else:
                log.skip(found)
    except (*_DAMAGE, BLFParseError):
        log.truncated = True
        return
    fewer = not log.packed and reader.file_size > log.size
    log.truncated = log.truncated or fewer or (count > 0 and reader.object_count == 0)


def _whole_objects(data: bytes) -> int:
    """Where a container's first object begins that is shorter than its header; else its length."""
    at = 0
    while (at := data.find(b"LOBJ", at, at + 8)) >= 0 and at + 16 <= len(data):
        length = int.from_bytes(data[at + 8 : at + 12], "little")
        if length < 16:
            return at
        at += length
    return len(data)


class _Incomplete(logging.Handler):
    """A logging handler that notices asammdf's message about a block that runs past the end of the file."""

    incomplete_block = False

    def emit(self, record: logging.LogRecord) -> None:
        self.incomplete_block = self.incomplete_block or "Incomplete block" in record.getMessage()


def mf4(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """ASAM MF4 with CAN bus logging, finished or not; read as far as asammdf finds whole blocks."""
    try:
        import asammdf
        from asammdf.blocks.utils import MdfException, count_channel_groups
    except ImportError:
        raise ForeignLog(f"{log.path}: reading MF4 needs one package more: {installing('mf4')}") from None
    import can

    asammdf.set_global_option("raise_on_incomplete_blocks", False)
    ear = _Incomplete()
    logger = logging.getLogger("asammdf")
    logger.addHandler(ear)
    try:
        # Fails on a file without its index, as MDF4 would with far more noise.
        count_channel_groups(cast(BufferedReader, log.file))
        yield from _from_binary(log, can.MF4Reader(str(log.path)))
    except (*_DAMAGE, MdfException):
        raise OtherKind(f"{log.path}: an MF4 file whose index is missing or damaged") from None
    finally:
        logger.removeHandler(ear)
    log.truncated = log.truncated or ear.incomplete_block


def sqlite(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """python-can's SQLite database."""
    import can

    try:
        yield from _from_binary(log, can.SqliteReader(log.path))
    except sqlite3.Error:
        raise OtherKind(f"{log.path}: an SQLite file that python-can did not write") from None


def _from_binary(log: OpenLog, reader: "can.MF4Reader | can.SqliteReader") -> Iterator[Frame]:
    """Frames up to the first damage, which is passed on where no frame came before it."""
    some = False
    with reader:
        try:
            for message in reader:
                found = _frame(message)
                some = True
                if isinstance(found, Frame):
                    yield found
                else:
                    log.skip(found)
        except (*_DAMAGE, sqlite3.Error):
            if not some:
                raise
            log.truncated = True
