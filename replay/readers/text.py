"""Text logs with one frame a line.

Those of candump, canboat and gateways (FORMS) have no head: lines of all forms may be mixed; empty lines and
comments (#) are passed over; anything else is counted. The others have a head that their lines depend on.
"""

import io
import re
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, islice
from typing import BinaryIO, Final, NamedTuple, Protocol, TextIO

from tilth.replay.readers import candump_text as candump
from tilth.replay.readers import gateway_text as gateway
from tilth.replay.readers.log import NO_ZONE, UNREADABLE, OpenLog, stamp_fault
from tilth.replay.readers.peak_text import Trc
from tilth.replay.readers.stream import without_zeros
from tilth.replay.readers.table_text import KVASER, TextTable
from tilth.replay.readers.text_clock import TextClock
from tilth.replay.readers.vector_text import Asc
from tilth.schemas.flow import Frame

PEEKED: Final = 1000  # lines that tell how their stamps count
UNTIMED: Final = "its lines have no time stamps: all its frames are put at 0 s, and nothing can be estimated"


_NO_FRAME = ("end", "//", ";", "#", "***")  # how lines begin that may end a file without their line end


class Form(NamedTuple):
    name: str  # in a person's words; "" for what is no log of its own
    pattern: re.Pattern[str]
    take: Callable[[re.Match[str], TextClock], Frame | str]
    tells_length: bool = False  # so that a line without its end is known to be whole
    of_eight: bool = False  # so is one of 8 bytes


FORMS: Final = (
    Form("candump -l", candump.LOG, candump.log_line, of_eight=True),
    Form("candump", candump.TERMINAL, candump.terminal_line, tells_length=True),
    Form("candump before 2008", candump.FORMER, candump.former_line, tells_length=True),
    Form("canboat's plain text", gateway.PLAIN, gateway.plain_line, tells_length=True),
    Form("a gateway's raw text", gateway.RAW, gateway.raw_line, of_eight=True),
    Form("Actisense's N2K ASCII", gateway.N2K_ASCII, gateway.n2k_ascii_line),
    Form("iKonvert", gateway.IKONVERT, gateway.ikonvert_line),
    Form("", gateway.IKONVERT_STATUS, gateway.ikonvert_status),
    Form("", gateway.NMEA_0183, gateway.other_line),
)


def text(log: OpenLog, stream: BinaryIO) -> TextIO:
    return io.TextIOWrapper(without_zeros(log, stream), encoding="utf-8-sig", errors="replace")


def lines(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """Of any of the FORMS."""
    with text(log, stream) as opened:
        yield from frames(opened, log)


def asc(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """Vector's ASC."""
    with text(log, stream) as opened:
        yield from _under_head(opened, log, Asc(log))


def trc(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """PEAK's TRC."""
    with text(log, stream) as opened:
        yield from _under_head(opened, log, Trc(log))


def table(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """A table whose header names its columns."""
    return _table(log, stream, TextTable(log))


def kvaser(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """The text of a Kvaser Memorator, with its head or without."""
    return _table(log, stream, TextTable(log, KVASER))


def _table(log: OpenLog, stream: BinaryIO, reader: TextTable) -> Iterator[Frame]:
    with text(log, stream) as opened:
        first = list(islice(opened, PEEKED))
        reader.peek(first)
        yield from _under_head(chain(first, opened), log, reader)
    if reader.clock.untimed:
        log.remark(UNTIMED)
    if reader.clock.zoneless:
        log.remark(NO_ZONE)


class _Reader(Protocol):
    """Of lines that depend on those before them.

    take: the frame of a line, or why it has none; None of heads and comments. Raises ValueError, LookupError,
    OverflowError. whole: whether a line that gave a frame is known to be whole without its end.
    """

    def take(self, line: str) -> Frame | str | None: ...
    def whole(self, line: str) -> bool: ...


def _under_head(lines: Iterable[str], log: OpenLog, reader: _Reader) -> Iterator[Frame]:
    """Frames of the lines in their order, counted and cut as by `frames`."""
    for line in lines:
        try:
            found = reader.take(line)
        except (ValueError, LookupError, OverflowError):
            found = UNREADABLE
        if isinstance(found, Frame):
            found = stamp_fault(found.t_ns) or found
        if not line.endswith("\n") and not _ended(line, found, reader):
            log.truncated = True
        elif isinstance(found, str):
            log.skip(found)
        elif found is not None:
            yield found


def _ended(line: str, found: Frame | str | None, reader: _Reader) -> bool:
    if isinstance(found, Frame):
        return reader.whole(line)
    return found is None and line.lower().startswith(_NO_FRAME)


def frames(lines: Iterable[str], log: OpenLog) -> Iterator[Frame]:
    """Frames of the lines in their order; what is none is counted in log.skipped.

    A last line without its end is the cut unless it is known to be whole: it is left out and log.truncated
    says so.
    """
    lines = iter(lines)
    first = list(islice(lines, PEEKED))
    clock = TextClock(deltas=candump.are_deltas([_bare(line) for line in first]))
    form = FORMS[0]
    for line in chain(first, lines):
        head = line[:1]
        if head == "#" or line.isspace() or (head == "\t" and candump.EXPLAINED.match(line)):
            continue
        form, found = _read(_bare(line), form, clock)
        if not line.endswith("\n") and not _whole(form, found):
            log.truncated = True
        elif isinstance(found, str):
            log.skip(found)
        else:
            yield found
    if clock.untimed:
        log.remark(UNTIMED)
    if clock.zoneless:
        log.remark(NO_ZONE)


def _read(line: str, last: Form, clock: TextClock) -> tuple[Form, Frame | str]:
    """The form of a line, likely the last one's, and its frame or why it is none."""
    form, match = last, last.pattern.match(line)
    if match is None:
        form, match = next(((f, m) for f in FORMS if (m := f.pattern.match(line))), (last, None))
    if match is None:
        return last, UNREADABLE
    try:
        found = form.take(match, clock)
    except ValueError:  # an odd digit, a 13th month, a length that is not so
        return last, UNREADABLE
    fault = "" if isinstance(found, str) else stamp_fault(found.t_ns)
    return form, fault or found


def _whole(form: Form, found: Frame | str) -> bool:
    return isinstance(found, Frame) and (form.tells_length or (form.of_eight and len(found.data) == 8))


def _bare(line: str) -> str:
    line = candump.COLOUR.sub("", line) if "\x1b" in line else line
    match = gateway.SIGNAL_K.match(line)
    return line if match is None else line[match.end() :]
