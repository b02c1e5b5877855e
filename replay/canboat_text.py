"""Text logs with one frame a line: candump -l, canboat's plain text and the raw text of NMEA 2000 gateways.

    (1502984866.421964) slcan0 09F112CC#FF725AFF7FFF7FFD                   candump
    2021-08-06-11:45:30.505,2,127237,5,255,8,80,15,00,40,1f,ff,7f,ff       plain: priority, PGN, source,
    2016-04-09T16:41:09.078Z,2,129029,0,255,43,…                           destination, length, bytes
    14:23:39.128 R 0DF20D4B 01 00 54 FA FF FF FF FF                        gateway: time of day, identifier

Lines of all forms may be mixed; empty lines and comments (#) are passed over; anything else is counted.
A plain line longer than 8 bytes is a message that the recorder has assembled: one Frame with long data.
Dates without a zone are read as UTC, so that a log gives the same stamps on every computer. A time of day
counts from midnight of the last date that the log has told, else of day 0; one that falls by more than 12 h
is the next day.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime

from tilth.replay.readers_log import Log
from tilth.schemas import can_id
from tilth.schemas.flow import Frame

BUS = "can0"  # plain and gateway lines do not name their bus

_SECOND = 1_000_000_000
_DAY = 86_400 * _SECOND
_ERROR_FLAG = 0x20000000  # CAN_ERR_FLAG of linux/can.h
_LAST_PGN = 0x3FFFF  # canboat numbers what gateways say of themselves beyond

_TIME = r"(?P<h>[01]\d|2[0-3]):(?P<m>[0-5]\d):(?P<s>[0-5]\d|60)(?:[.,](?P<fraction>\d{1,9}))?"
_CANDUMP = re.compile(
    r"\((?P<s>\d{1,10})\.(?P<fraction>\d{1,9})\)\s+(?P<bus>\S+)\s+"
    r"(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})#(?P<data>\S*)(?:\s+[RT])?\s*$"
)
_PLAIN = re.compile(
    rf"(?P<date>\d{{4}}-\d\d-\d\d)[-T Z]{_TIME}Z?,(?P<priority>[0-7]),(?P<pgn>\d{{1,8}}),"
    r"(?P<source>\d{1,3}),(?P<destination>\d{1,3}),(?P<length>\d{1,4})(?P<data>(?:,[0-9A-Fa-f]{2})*)\s*$"
)
_GATEWAY = re.compile(rf"{_TIME} [RT] (?P<id>[01][0-9A-Fa-f]{{7}})(?P<data>(?: [0-9A-Fa-f]{{2}}){{0,8}})\s*$")


class _Day:
    """The date that a bare time of day belongs to."""

    def __init__(self) -> None:
        self.midnight_ns = 0
        self._date = ""
        self._last_ns = 0

    def on(self, date: str, time_ns: int) -> int:
        if date != self._date:
            self.midnight_ns = int(datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp()) * _SECOND
            self._date = date
        self._last_ns = time_ns
        return self.midnight_ns + time_ns

    def at(self, time_ns: int) -> int:
        if self._last_ns - time_ns > _DAY // 2:
            self.midnight_ns += _DAY
            self._date = ""
        self._last_ns = time_ns
        return self.midnight_ns + time_ns


def _nanoseconds(fraction: str | None) -> int:
    return int(fraction.ljust(9, "0")) if fraction else 0


def _time_ns(match: re.Match[str]) -> int:
    h, m, s, fraction = match.group("h", "m", "s", "fraction")
    return (int(h) * 3600 + int(m) * 60 + int(s)) * _SECOND + _nanoseconds(fraction)


def _candump(match: re.Match[str], day: _Day) -> Frame | str:
    s, fraction, bus, identifier, text = match.group("s", "fraction", "bus", "id", "data")
    if text[:1] in ("R", "r"):
        return "remote_frame"
    text = text[2:] if text[:1] == "#" else text.partition("_")[0]  # ##<flags> of CAN FD, _<raw DLC>
    data = bytes.fromhex(text)
    if len(data) > 8:
        return "can_fd_frame"
    number = int(identifier, 16)
    extended = len(identifier) == 8
    error = extended and bool(number & _ERROR_FLAG)
    t_ns = int(s) * _SECOND + _nanoseconds(fraction)
    return Frame(t_ns, t_ns, bus, number & 0x1FFFFFFF, extended, error, data)


def _plain(match: re.Match[str], day: _Day) -> Frame | str:
    t_ns = day.on(match["date"], _time_ns(match))
    priority, pgn, source, destination, length = map(
        int, match.group("priority", "pgn", "source", "destination", "length")
    )
    data = bytes.fromhex(match["data"].replace(",", ""))
    if pgn > _LAST_PGN:
        return "gateway_message"
    if length != len(data) or source > 255 or destination > 255:
        raise ValueError("a length that does not fit")
    return Frame(t_ns, t_ns, BUS, can_id.join(priority, pgn, source, destination), True, False, data)


def _gateway(match: re.Match[str], day: _Day) -> Frame | str:
    t_ns = day.at(_time_ns(match))
    return Frame(t_ns, t_ns, BUS, int(match["id"], 16), True, False, bytes.fromhex(match["data"]))


FORMS: tuple[tuple[re.Pattern[str], Callable[[re.Match[str], _Day], Frame | str], str], ...] = (
    (_CANDUMP, _candump, "candump -l"),
    (_PLAIN, _plain, "canboat's plain text"),
    (_GATEWAY, _gateway, "a gateway's raw text"),
)


def form_of(line: str) -> str | None:
    """Which form a line has, in a person's words; None for none of them."""
    return next((name for pattern, _, name in FORMS if pattern.match(line)), None)


def frames(lines: Iterable[str], log: Log) -> Iterator[Frame]:
    """Frames of the lines in their order; what is none is counted in log.skipped.

    A last line without its end is the cut when it is no frame or holds fewer than 8 bytes: it is left out and
    log.truncated says so.
    """
    day = _Day()
    for line in lines:
        if line[:1] == "#" or line.isspace():
            continue
        found = _frame(line, day)
        if not line.endswith("\n") and (isinstance(found, str) or len(found.data) < 8):
            log.truncated = True
        elif isinstance(found, str):
            log.skip(found)
        else:
            yield found


def _frame(line: str, day: _Day) -> Frame | str:
    """The frame of a line, or why it is none."""
    for pattern, take, _ in FORMS:
        match = pattern.match(line)
        if match:
            try:
                return take(match, day)
            except ValueError:  # an odd digit, a 13th month, a length that is not so
                break
    return "unreadable_line"
