"""When was it measured? One clock model per receiver, from arrival stamps alone.

A receiver measures at regular epochs and sends a clump of messages after each. Frames queue on the bus, so a
clump can only be *late*: the epochs are the lower envelope of the arrivals, on a grid of the receiver's own
period. The machine file's latency leads from that envelope back to the instant of measurement.

Arrival times alone would put 10 to 30 ms of jitter (4 to 13 cm at 4.5 m/s) into every position.
"""

from collections import deque
from dataclasses import dataclass, field

CLUMP_NS = 50_000_000  # frames of one epoch come within this, unless their SID ties them
SAME_SID_NS = 200_000_000
LEAK = 300e-6  # the envelope rises by this share of time: above any quartz's skew (100 ppm)
PERIODS = 15  # intervals whose median is the period
RESET_NS = 500_000_000  # arrivals this far off the grid: the device's timing has changed
PERIOD_RANGE_NS = (40_000_000, 2_000_000_000)


@dataclass(slots=True)
class EpochClock:
    """Grid of one receiver's epochs. All times in ns on the clock of Frame.rx_ns."""

    group_ns: int = 0  # arrival of the current clump's first frame
    group_sid: int | None = None
    group_pgns: list[int] = field(default_factory=list)
    epoch_ns: int = 0  # the current clump's time on the lower envelope
    period_ns: int = 0  # 0: not known yet
    intervals: deque[int] = field(default_factory=lambda: deque(maxlen=PERIODS))
    jitter_ns: float = 20e6  # mean lateness against the envelope, 10 s memory
    resets: int = 0

    def arrive(self, rx_ns: int, pgn: int, sid: int | None) -> int:
        """Envelope time of the epoch that this message belongs to, ns."""
        if not self._same_clump(rx_ns, pgn, sid):
            self._new_clump(rx_ns)
            self.group_pgns.clear()
            self.group_sid = None
        if sid is not None:
            self.group_sid = sid
        self.group_pgns.append(pgn)
        return self.epoch_ns

    def _same_clump(self, rx_ns: int, pgn: int, sid: int | None) -> bool:
        if not self.group_pgns or pgn in self.group_pgns:
            return False
        since = rx_ns - self.group_ns
        if sid is not None and self.group_sid is not None:
            return sid == self.group_sid and 0 <= since < SAME_SID_NS
        return 0 <= since < CLUMP_NS

    def _new_clump(self, rx_ns: int) -> None:
        interval = rx_ns - self.group_ns
        self.group_ns = rx_ns
        if PERIOD_RANGE_NS[0] <= interval <= PERIOD_RANGE_NS[1]:
            self.intervals.append(interval)
            self._learn_period()
        if self.period_ns == 0 or self.epoch_ns == 0:
            self.epoch_ns = rx_ns
            return
        epochs = round((rx_ns - self.epoch_ns) / self.period_ns)
        late = rx_ns - (self.epoch_ns + epochs * self.period_ns)
        if epochs <= 0 and rx_ns >= self.epoch_ns:
            return  # a second clump within one epoch: the same instant
        if epochs < 0 or epochs * self.period_ns > 10 * RESET_NS:
            self.epoch_ns = rx_ns  # time stepped, or a long silence: start the grid anew
            self.resets += 1
            return
        elapsed = epochs * self.period_ns
        self.epoch_ns += elapsed + min(late, int(LEAK * elapsed))
        share = min(1.0, elapsed / 10e9)
        self.jitter_ns += share * (rx_ns - self.epoch_ns - self.jitter_ns)

    def _learn_period(self) -> None:
        """Median interval, to the millisecond: devices keep whole milliseconds, arrivals do not."""
        if len(self.intervals) < 5 or (self.period_ns and len(self.intervals) < PERIODS):
            return
        median = sorted(self.intervals)[len(self.intervals) // 2]
        period = max(1, round(median / 1e6)) * 1_000_000
        for nominal in (100_000_000, 200_000_000, 1_000_000_000):
            if abs(period - nominal) <= nominal // 25:
                period = nominal
        if period != self.period_ns:
            self.period_ns = period
            self.epoch_ns = self.group_ns
        self.intervals.clear()


@dataclass(slots=True)
class UtcClock:
    """UTC against the host's clock, from messages that carry a time: the lower envelope of arrival − UTC."""

    offset_ns: int | None = None  # host − UTC, at the earliest arrivals
    at_ns: int = 0
    resolution_s: float = 1.0

    def arrive(self, arrival_ns: int, utc_ns: int, resolution_s: float) -> None:
        """Take a time message; a finer one replaces a coarser one, a jump starts anew."""
        offset = arrival_ns - utc_ns
        jumped = self.offset_ns is not None and abs(offset - self.offset_ns) > 2_000_000_000
        if self.offset_ns is None or jumped or resolution_s < self.resolution_s:
            self.offset_ns, self.at_ns, self.resolution_s = offset, arrival_ns, resolution_s
        elif resolution_s == self.resolution_s:
            risen = self.offset_ns + int(LEAK * (arrival_ns - self.at_ns))
            self.offset_ns, self.at_ns = min(offset, risen), arrival_ns

    def utc_ns(self, host_ns: int) -> int | None:
        """UTC at a host time, good to the resolution of the messages; None before the first."""
        return None if self.offset_ns is None else host_ns - self.offset_ns
