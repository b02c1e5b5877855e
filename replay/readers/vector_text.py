"""Vector's ASC, as CANoe, CANalyzer, python-can and BUSMASTER write it.

    date Mon Oct 5 03:06:13.191 pm 2026
    base hex  timestamps absolute
    internal events logged
    Begin Triggerblock Mon Oct 5 03:06:13.191 pm 2026
       0.100000 1  18EEFF1Cx       Rx   d 8 11 27 00 0B 00 91 78 C0  Length = 270000 BitCount = 141
       0.200000 CANFD   1 Rx   18EEFF1Cx  name  1 0 8 8 11 27 00 0B 00 91 78 C0 …
       0.300000 1  ErrorFrame
    End TriggerBlock

Times count from the date of the trigger block where one is told, else from that of the head. BUSMASTER's
count from midnight. The dates are of a local clock, in any of the languages of written_dates.py.
"""

import re
from typing import Final

from tilth.replay.readers.columns import frame_of
from tilth.replay.readers.log import NO_ZONE, ForeignLog, OpenLog
from tilth.replay.readers.text_clock import DAY, SECOND
from tilth.replay.readers.written_dates import utc_ns
from tilth.schemas.flow import Frame

_DATE: Final = re.compile(r"\s*(?:date|(begin\s+triggerblock))\s+(\S.*?)\s*$", re.IGNORECASE)
_BASE: Final = re.compile(r"\s*base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?", re.IGNORECASE)
_HEAD: Final = ("begin ", "end ", "//", "internal ", "no internal ")
_STAMPED: Final = re.compile(r"\s*(\d+)[.,](\d+)\s+(\S.*?)\s*$")
_CLASSIC: Final = re.compile(
    r"(?P<channel>\d+)\s+(?:(?P<error>ErrorFrame\b.*)|(?P<id>[0-9A-Fa-f]+)(?P<x>x?)\s+[RT]x\s+"
    r"(?:(?P<remote>r)\b.*|d\s+(?P<dlc>[0-9A-Fa-f]+)(?P<data>(?:\s+[0-9A-Fa-f]+)*).*))$",
    re.IGNORECASE,
)
_FD: Final = re.compile(
    r"CANFD\s+(?P<channel>\d+)\s+[RT]x\s+(?:(?P<error>ErrorFrame\b.*)|(?P<id>[0-9A-Fa-f]+)(?P<x>x?)\s+"
    r"(?:\D\S*\s+)?[01]\s+[01]\s+(?P<dlc>[0-9A-Fa-f]+)\s+(?P<length>\d+)(?P<data>(?:\s+[0-9A-Fa-f]+)*).*)$",
    re.IGNORECASE,
)
_UNLIKE: Final = re.compile(r"CANFD|\d+\s+\w+\s+[RT]x\s", re.IGNORECASE)  # as frames begin
_LATER: Final = 3600 * SECOND  # from the date in a head of BUSMASTER to its first frame, at most


class Asc:
    """Reads lines of a log, one after the other."""

    def __init__(self, log: OpenLog) -> None:
        self._log = log
        self._base = 16
        self._origin_ns = 0
        self._pending_ns: int | None = None  # date of a trigger block whose first stamp is still to come
        self._last_ns = -1
        self._head_ns: int | None = None
        self._triggered = False

    def take(self, line: str) -> Frame | str | None:
        """The frame of a line, or why it has none; None of heads and comments.

        Raises ValueError, and ForeignLog for times that count from the frame before.
        """
        stamped = _STAMPED.match(line)
        if stamped is not None:
            return self._event(stamped)
        if (match := _DATE.match(line)) is not None:
            self._date(match[2], bool(match[1]))
        elif (match := _BASE.match(line)) is not None:
            self._base = 10 if match[1].lower() == "dec" else 16
            if (match[2] or "").lower() == "relative":
                raise ForeignLog(
                    f"{self._log.path}: its time stamps count from the frame before; "
                    "export it with absolute ones"
                )
        elif line.strip() and not line.strip().lower().startswith(_HEAD):
            raise ValueError("no line of an ASC")
        return None

    def whole(self, line: str) -> bool:
        """Whether a line that gave a frame is known to be whole without its end."""
        return self._base == 16 and len(line.split()[-1]) == 2 and not line[-1].isspace()

    def _date(self, text: str, of_trigger: bool) -> None:
        try:
            found = utc_ns(text)
        except ValueError:
            if text.strip():
                self._log.remark(f'its date "{text}" cannot be read')
            return
        self._log.remark(NO_ZONE)
        self._triggered = self._triggered or of_trigger
        self._head_ns = self._head_ns if of_trigger else found
        self._pending_ns = found

    def _event(self, stamped: re.Match[str]) -> Frame | str | None:
        seconds, fraction, rest = stamped.groups()
        # What survives in a float are microseconds: what other readers give, and all that Vector writes.
        passed_ns = int(seconds) * SECOND + round(int(fraction) * 1_000_000 / 10 ** len(fraction)) * 1000
        self._begin(passed_ns)
        if rest.lower() == "start of measurement":
            return None
        match = _CLASSIC.match(rest) or _FD.match(rest)
        if match is None:
            if _UNLIKE.match(rest):
                raise ValueError("a frame that cannot be read")
            return "other_event"
        return self._frame(match, self._origin_ns + passed_ns)

    def _begin(self, passed_ns: int) -> None:
        """A block whose times begin anew begins at its own date; others go on counting from the first."""
        if self._pending_ns is not None and (self._last_ns < 0 or passed_ns < self._last_ns):
            self._origin_ns = self._pending_ns
            of_day_ns = self._pending_ns % DAY
            late_ns = passed_ns - of_day_ns + SECOND
            if self._head_ns is not None and abs(self._pending_ns - self._head_ns - passed_ns) < 2 * SECOND:
                self._origin_ns = self._head_ns  # a trigger long after the start that it counts from
            if not self._triggered and of_day_ns >= 60 * SECOND and 0 <= late_ns < _LATER:
                self._origin_ns -= of_day_ns  # BUSMASTER's
        self._pending_ns = None
        self._last_ns = passed_ns

    def _frame(self, match: re.Match[str], t_ns: int) -> Frame | str:
        bus = f"can{int(match['channel']) - 1}"
        if match["error"]:
            return frame_of((t_ns, t_ns), bus, 0, b"", error=True)
        groups = match.groupdict()
        dlc = int(match["dlc"], self._base) if match["dlc"] else 0
        length = int(groups["length"]) if groups.get("length") else None
        remote = bool(groups.get("remote")) or (length == 0 and dlc > 0)
        data = match["data"].split() if match["data"] else []
        count = length if length is not None else min(dlc, 8)
        return frame_of(
            (t_ns, t_ns),
            bus,
            int(match["id"], self._base),
            b"" if remote else bytes(int(octet, self._base) for octet in data[:count]),
            extended=bool(match["x"]),
            remote=remote,
            length=count,
        )
