"""Turns the times in lines of a text log into nanoseconds, since 1970 where the log has a date."""

from datetime import UTC, datetime
from typing import Final

SECOND: Final = 1_000_000_000
DAY: Final = 86_400 * SECOND

TIME: Final = r"(?P<h>[01]\d|2[0-3]):?(?P<m>[0-5]\d):?(?P<s>[0-5]\d|60)(?:[.,](?P<fraction>\d{1,9}))?"
ZONE: Final = r"(?P<zone>Z|[+-](?:[01]\d|2[0-3])(?::?[0-5]\d)?)?"


class TextClock:
    """Turns the times of the lines, in order, into stamps.

    Dates without a zone are read as UTC, so that a log gives the same stamps on every computer. A time of day
    counts from midnight of the last date that the log has told, else of day 0; one that falls by more than
    12 h is the next day.
    """

    def __init__(self, deltas: bool = False) -> None:
        """`deltas`: what counts from a start counts from the line before instead."""
        self._deltas = deltas
        self._midnight_ns = 0
        self._last_ns = 0
        self._sum_ns = 0
        self.untimed = 0  # lines that told nothing; they are put at 0
        self.zoneless = False  # some date had no zone

    def on(self, date: str, time_ns: int, zone: str | None = None) -> int:
        """Of a date, YYYY-MM-DD, and a time of that day. Raises ValueError."""
        midnight_ns = int(datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp()) * SECOND
        self.zoneless = self.zoneless or not zone
        t_ns = midnight_ns + time_ns - _ahead_ns(zone)
        self._midnight_ns, self._last_ns = t_ns // DAY * DAY, t_ns % DAY
        return t_ns

    def at(self, time_ns: int) -> int:
        """Of a bare time of day."""
        if self._last_ns - time_ns > DAY // 2:
            self._midnight_ns += DAY
        self._last_ns = time_ns
        return self._midnight_ns + time_ns

    def since(self, passed_ns: int) -> int:
        """Of what has passed since the first line or the one before."""
        self._sum_ns += passed_ns
        return self._sum_ns if self._deltas else passed_ns

    def nothing(self) -> int:
        self.untimed += 1
        return 0


def nanoseconds(fraction: str | None) -> int:
    """Of the digits behind the point of seconds."""
    return int(fraction.ljust(9, "0")) if fraction else 0


def time_ns(h: str, m: str, s: str, fraction: str | None) -> int:
    return (int(h) * 3600 + int(m) * 60 + int(s)) * SECOND + nanoseconds(fraction)


def _ahead_ns(zone: str | None) -> int:
    """How far clocks of a zone are ahead of UTC."""
    if not zone or zone == "Z":
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    ahead_ns = (int(digits[:2]) * 60 + int(digits[2:])) * 60 * SECOND
    return -ahead_ns if zone[0] == "-" else ahead_ns
