"""The one clock of a run: CLOCK_REALTIME at its start plus what CLOCK_MONOTONIC has counted since.

It never steps. The wall clock may (NTP, a GNSS time source, a person); the relation of the two is recorded,
and so is what the receivers say of UTC: a computer without a battery-backed clock begins each day in 1970.
"""

import statistics
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

STEP_NS = 100_000_000  # a change of (wall clock - this clock) that counts as a step, between two looks
OLDEST_NS = 10_000_000_000  # a stamp further back is none of this frame: no adapter holds so much of a bus
NEWEST_NS = -1_000_000  # nor one this far in the future; a little, because two clocks are read in turn
LOOKS = 20  # at both clocks, to begin with
WRONG_NS = 2_000_000_000  # receivers tell the time up to a second late: only more than this is a wrong clock
EARLIEST_NS = 1_735_689_600_000_000_000  # 2025-01-01: no clock that is right says less
YEARS = range(2025, 2100)  # a clock that is right is in one of these
DATED_NS = 315_532_800_000_000_000  # 1980-01-01: a time before is of a clock that nobody has set
LEAST_TIMES = (
    8  # times told by receivers before they are believed, and at most so many times that are remembered:
)
REMEMBERED = 64


@dataclass(frozen=True, slots=True)
class Relation:
    """Readings of the computer's clocks at one instant, ns."""

    t_ns: int
    realtime_ns: int
    monotonic_ns: int
    boottime_ns: int


class Clock:
    """`offset_ns` is what has to be added to CLOCK_MONOTONIC to give t_ns."""

    def __init__(self) -> None:
        self.offset_ns = time.time_ns() - time.monotonic_ns()
        self.bad_stamps = 0
        self._wall_ahead_ns = 0
        self._gnss_ahead: deque[int] = deque(maxlen=REMEMBERED)
        self._ahead_least_ns = 1  # an empty interval: the first look fills it
        self._ahead_most_ns = 0
        ahead_ns = 0
        for _ in range(LOOKS):
            ahead_ns = self.wall_ahead_ns()
        self.offset_ns += ahead_ns
        self._ahead_least_ns -= ahead_ns
        self._ahead_most_ns -= ahead_ns

    def t_ns(self) -> int:
        """Time now, ns since 1970 by the wall clock at the start of the run; it never steps."""
        return time.monotonic_ns() + self.offset_ns

    def wall_ahead_ns(self) -> int:
        """The wall clock less this one, to much less than a microsecond.

        Both run at the same rate, slewed alike, so that their difference stands between two steps: each look
        narrows what the looks before it have left possible.
        """
        before_ns = time.monotonic_ns()
        wall_ns = time.time_ns() - self.offset_ns
        least_ns, most_ns = wall_ns - time.monotonic_ns(), wall_ns - before_ns
        if least_ns > self._ahead_most_ns or most_ns < self._ahead_least_ns:  # the wall clock was set
            self._ahead_least_ns, self._ahead_most_ns = least_ns, most_ns
        else:
            self._ahead_least_ns = max(least_ns, self._ahead_least_ns)
            self._ahead_most_ns = min(most_ns, self._ahead_most_ns)
        return (self._ahead_least_ns + self._ahead_most_ns) // 2

    def rx_ns(self, stamp_ns: int, t_ns: int, empty_ns: int) -> int:
        """A receive stamp on this clock, of a frame taken at t_ns; t_ns where it cannot be that, counted.

        empty_ns: when its port was last found empty. The frame may have waited ever since, for a loop that
        was busy, and is no older for that.
        """
        age_ns = t_ns - stamp_ns
        if age_ns >= 0 and stamp_ns >= empty_ns - OLDEST_NS:
            return stamp_ns
        self.bad_stamps += not NEWEST_NS <= age_ns < 0
        return t_ns

    def add_gnss_time(self, rx_ns: int, utc_ns: int) -> None:
        """Take the UTC time that a receiver reported at rx_ns."""
        self._gnss_ahead.append(utc_ns - rx_ns)

    @property
    def gnss_ahead_ns(self) -> int | None:
        """UTC by the receivers less this clock; None until enough of them agree. Good to about a second."""
        if len(self._gnss_ahead) < LEAST_TIMES:
            return None
        return int(statistics.median(self._gnss_ahead))

    @property
    def correction_ns(self) -> int:
        """What has to be added to t_ns to give UTC; 0 where the computer's clock was right at the start."""
        ahead_ns = self.gnss_ahead_ns
        if ahead_ns is not None:
            return ahead_ns if abs(ahead_ns) > WRONG_NS else 0
        began_wrong = self.t_ns() < EARLIEST_NS
        return self._wall_ahead_ns if began_wrong and self.t_ns() + self._wall_ahead_ns > EARLIEST_NS else 0

    def utc_ns(self, t_ns: int) -> int | None:
        """UTC at an instant of this clock, as far as it is known by now; None where it is not."""
        utc_ns = t_ns + self.correction_ns
        return utc_ns if utc_ns >= EARLIEST_NS else None

    def relation(self) -> Relation:
        """Readings of all clocks now."""
        monotonic_ns = time.monotonic_ns()
        return Relation(
            t_ns=monotonic_ns + self.offset_ns,
            realtime_ns=time.time_ns(),
            monotonic_ns=monotonic_ns,
            boottime_ns=time.clock_gettime_ns(time.CLOCK_BOOTTIME),
        )

    def step_ns(self, relation: Relation) -> int:
        """How far the wall clock has stepped since the last look, a second ago; 0 where it only drifted."""
        ahead_ns = relation.realtime_ns - relation.t_ns
        moved_ns = ahead_ns - self._wall_ahead_ns
        self._wall_ahead_ns = ahead_ns
        return moved_ns if abs(moved_ns) > STEP_NS else 0


def boot_id() -> str:
    """Tells one start of this computer from the next; empty where the system has none."""
    path = Path("/proc/sys/kernel/random/boot_id")
    return path.read_text().strip() if path.exists() else ""


def utc_text(t_ns: int, pattern: str = "%Y-%m-%dT%H:%M:%SZ") -> str:
    """UTC of an instant, ns since 1970, in a format of time.strftime."""
    return time.strftime(pattern, time.gmtime(t_ns // 1_000_000_000))
