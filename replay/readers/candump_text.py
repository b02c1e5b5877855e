"""What candump prints, one frame a line: its log, and what it shows on a terminal.

    (1502984866.421964) slcan0 09F112CC#FF725AFF7FFF7FFD         candump -l and -L
      can0  09F112CC   [8]  FF 72 5A FF 7F FF 7F FD              candump
     (1502984866.421964)  can0  09F112CC   [8]  FF 72 …          candump -ta
     (2017-08-17 15:47:46.421964)  can0  09F112CC   [8]  FF …    candump -tA: the computer's time of day
     (003.000125)  can0  09F112CC   [8]  FF 72 …                 candump -tz: since the first line; -td: since
    <0x09f112cc> [8] ff 72 5a ff 7f ff 7f fd                     the last; and candump of before 2008

What the options -a, -c, -e and -x add is passed over; -i and -S make lines that are not read.
"""

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from tilth.replay.readers.text_clock import SECOND, TIME, TextClock, nanoseconds, time_ns
from tilth.schemas.flow import Frame

BUS: Final = "can0"  # where a line does not name its bus
COLOUR: Final = re.compile(r"\x1b\[[0-9;]*m")
EXPLAINED: Final = re.compile(r"\t[a-z-]+(\{.*)?\s*$")  # -e, below an error frame

_ERROR_FLAG = 0x20000000  # CAN_ERR_FLAG of linux/can.h
_FEWEST = 10  # digits of seconds since 1970 as candump prints them; fewer count from a start

LOG: Final = re.compile(
    r"\((?P<s>\d{1,10})\.(?P<fraction>\d{1,9})\)\s+(?P<bus>\S+)\s+"
    r"(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})#(?P<data>\S*)(?:\s+[RT])?\s*$"
)
_BYTES = r"(?P<data>(?: [0-9A-Fa-f]{2})*)"
TERMINAL: Final = re.compile(
    rf"\s*(?:\((?:(?P<date>\d{{4}}-\d\d-\d\d) {TIME}|(?P<passed>\d+)\.(?P<part>\d{{1,9}}))\)\s+)?"
    r"(?P<bus>[^\s<(]\S*)\s+(?:[RT]X [B-] [E-]\s+)?(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})\s+"
    rf"\[(?P<length>\d\d?)\]\s{{0,2}}(?P<remote>\s*remote request)?{_BYTES}\s*(?:'.*'|ERRORFRAME)?\s*$"
)
FORMER: Final = re.compile(rf"<0x(?P<id>[0-9A-Fa-f]{{3,8}})> \[(?P<length>\d)\]{_BYTES}\s*$")


def log_line(match: re.Match[str], clock: TextClock) -> Frame | str:
    s, fraction, bus, identifier, text = match.group("s", "fraction", "bus", "id", "data")
    if text[:1] in ("R", "r"):
        return "remote_frame"
    text = text[2:] if text[:1] == "#" else text.partition("_")[0]  # ##<flags> of CAN FD, _<raw DLC>
    t_ns = int(s) * SECOND + nanoseconds(fraction)
    return _frame(t_ns, bus, identifier, len(identifier) == 8, bytes.fromhex(text))


def terminal_line(match: re.Match[str], clock: TextClock) -> Frame | str:
    identifier, bus = match.group("id", "bus")
    if match["remote"]:
        return "remote_frame"
    data = bytes.fromhex(match["data"])
    if len(data) != int(match["length"]):
        raise ValueError("a length that does not fit")
    return _frame(_terminal_ns(match, clock), bus, identifier, len(identifier) == 8, data)


def former_line(match: re.Match[str], clock: TextClock) -> Frame | str:
    data = bytes.fromhex(match["data"])
    if len(data) != int(match["length"]):
        raise ValueError("a length that does not fit")
    return _frame(clock.nothing(), BUS, match["id"], len(match["id"]) > 3, data)


def are_deltas(lines: Sequence[str]) -> bool:
    """Whether stamps that count from a start count from the line before: those that do not never fall."""
    passed = [
        int(match["passed"]) * SECOND + nanoseconds(match["part"])
        for match in map(TERMINAL.match, lines)
        if match and match["passed"] and len(match["passed"]) < _FEWEST
    ]
    falls = sum(later < earlier for earlier, later in pairwise(passed))
    return falls * 10 > len(passed)  # two buses of one candump may change places, now and then


def _terminal_ns(match: re.Match[str], clock: TextClock) -> int:
    date, passed = match.group("date", "passed")
    if date:
        return clock.on(date, time_ns(*match.group("h", "m", "s", "fraction")))
    if not passed:
        return clock.nothing()
    t_ns = int(passed) * SECOND + nanoseconds(match["part"])
    return t_ns if len(passed) >= _FEWEST else clock.since(t_ns)


def _frame(t_ns: int, bus: str, identifier: str, extended: bool, data: bytes) -> Frame | str:
    if len(data) > 8:
        return "can_fd_frame"
    number = int(identifier, 16)
    error = extended and bool(number & _ERROR_FLAG)
    return Frame(t_ns, t_ns, bus, number & 0x1FFFFFFF, extended, error, data)
