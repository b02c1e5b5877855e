"""PEAK's TRC, versions 1.0 to 2.1 (PEAK CAN TRC File Format, 2023).

         1)      1841 0001 8 00 00 00 00 00 00 00 00              1.0: ms, identifier, length
         1)      1059.9  Rx         0300  7  00 00 00 00 04 00 00  1.1: and the direction
         1)      1059.900  1  Rx    0300  7  00 00 00 00 04 00 00  1.2: and the bus
         1)      1059.900 1  Rx     0300 -  7    00 00 00 00 04 00 00  1.3: and a reserved column
          1      1059.900 DT     0300 Rx 7  00 00 00 00 04 00 00   2.0, 2.1: columns as $COLUMNS says

Of 1.x the words of a line tell which it is. Times count from $STARTTIME, days since 1899 of a local clock.
"""

import re
from datetime import UTC, datetime, timedelta
from typing import Final

from tilth.replay.readers.columns import bus_of, frame_of
from tilth.replay.readers.log import NO_ZONE, OpenLog
from tilth.replay.readers.written_dates import utc_ns
from tilth.schemas.flow import Frame

# Types of lines that are no frames: bus state, error counters, errors, remarks; an identifier of bus state.
_EVENTS: Final = frozenset(("warng", "error", "event", "st", "ec", "er", "ev", "ffffffff"))
_DIRECTIONS: Final = ("rx", "tx")
_FRAMES: Final = frozenset(("DT", "FD", "FB", "FE", "BI", "RR"))
_DAY_0: Final = datetime(1899, 12, 30, tzinfo=UTC)
_1970: Final = datetime(1970, 1, 1, tzinfo=UTC)
_DEFAULT: Final = {"2.0": "N,O,T,I,d,l,D", "2.1": "N,O,T,B,I,d,R,L,D"}
_WRITTEN: Final = re.compile(r";\s*Start time:\s*(\S.*?)\s*$", re.IGNORECASE)
BUS: Final = "1"  # where a line names none


class Trc:
    """Reads lines of a trace, one after the other."""

    def __init__(self, log: OpenLog) -> None:
        self._log = log
        self._start_us: int | None = None
        self._columns: list[str] = []

    def take(self, line: str) -> Frame | str | None:
        """The frame of a line, or why it has none; None of heads and comments. Raises ValueError."""
        words = line.split()
        if not words:
            return None
        if line.lstrip().startswith(";"):
            self._head(line.strip())
            return None
        if any(word.lower() in _EVENTS for word in words[1:4]) or words[4:5] == ["ERROR"]:
            return "other_event"
        if len(words) < 4:
            raise ValueError("too few columns")
        return self._by_columns(words) if self._columns else self._by_words(words)

    def whole(self, line: str) -> bool:
        """Whether a line that gave a frame is known to be whole without its end."""
        return len(line.split()[-1]) == 2 and not line[-1].isspace()

    def _head(self, line: str) -> None:
        key, _, value = line.partition("=")
        key, value = key.upper(), value.strip().rstrip(";")
        if key == ";$FILEVERSION":
            self._columns = _DEFAULT.get(value, "").split(",") if value in _DEFAULT else []
        elif key == ";$COLUMNS":
            self._columns = [column.strip() for column in value.split(",")]
        elif key == ";$STARTTIME":
            try:
                since = _DAY_0 + timedelta(days=float(value.replace(",", "."))) - _1970
            except (ValueError, OverflowError):
                self._start(None, value)
            else:
                self._start(since // timedelta(microseconds=1), value)
        elif self._start_us is None and (match := _WRITTEN.match(line)) is not None:
            try:
                self._start(utc_ns(match[1]) // 1000, match[1])
            except ValueError:
                self._start(None, match[1])

    def _start(self, start_us: int | None, text: str) -> None:
        self._start_us = start_us
        self._log.remark(f'its start time "{text}" cannot be read' if start_us is None else NO_ZONE)

    def _t_ns(self, milliseconds: str) -> int:
        return (round(float(milliseconds) * 1000) + (self._start_us or 0)) * 1000

    def _by_words(self, words: list[str]) -> Frame | str:
        """A line of version 1.x."""
        _, time, *rest = words
        bus = BUS
        if rest[0].lower() not in _DIRECTIONS and rest[1].lower() in _DIRECTIONS:
            bus, *rest = rest
        if rest[0].lower() in _DIRECTIONS:
            rest = rest[1:]
        identifier, *rest = rest
        if rest[:1] == ["-"]:
            rest = rest[1:]
        dlc, *data = rest
        return self._frame(time, bus, identifier, data, dlc=int(dlc), remote=data[:1] == ["RTR"])

    def _by_columns(self, words: list[str]) -> Frame | str:
        """A line of version 2.x; the data are the last column."""
        named = dict(zip(self._columns, words, strict=False))
        if named["T"] not in _FRAMES:
            raise ValueError("an unknown type")
        data = words[self._columns.index("D") :] if "D" in self._columns else []
        length, dlc = named.get("l"), named.get("L")
        return self._frame(
            named["O"],
            named.get("B", BUS),
            named["I"],
            data,
            length=int(length) if length is not None else None,
            dlc=int(dlc) if dlc is not None else None,
            remote=named["T"] == "RR",
        )

    def _frame(
        self,
        time: str,
        bus: str,
        identifier: str,
        data: list[str],
        *,
        remote: bool,
        length: int | None = None,
        dlc: int | None = None,
    ) -> Frame | str:
        if length is None and dlc is None:
            raise ValueError("no length")
        t_ns = self._t_ns(time)
        bare = identifier.removesuffix("h").removesuffix("x")
        return frame_of(
            (t_ns, t_ns),
            bus_of(bus),
            int(bare, 16),
            b"" if remote else bytes.fromhex("".join(f"{octet:0>2}" for octet in data)),
            extended=len(bare) > 4,
            remote=remote,
            length=length,
            dlc=dlc,
        )
