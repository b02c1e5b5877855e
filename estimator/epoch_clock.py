"""When was it measured? One clock model per receiver, from arrival stamps alone.

A receiver measures at regular epochs and sends a clump of messages after each. Frames queue on the bus, so a
clump can only be *late*: the epochs are the lower envelope of the arrivals, on a grid of the receiver's own
period. The machine file's latency leads from that envelope back to the instant of measurement.

Arrival times alone would put 10 to 30 ms of jitter (4 to 13 cm at 4.5 m/s) into every position.
"""

from dataclasses import dataclass, field

CLUMP_NS = 50_000_000  # frames of one epoch come within this, unless their SID ties them
SAME_SID_NS = 200_000_000
LEAK = 300e-6  # the envelope rises by this share of time: above any quartz's skew (100 ppm)
QUEUE_S = 0.03  # how late a clump may queue: what the period's estimate may be off by, over its baseline
FIRST_INTERVALS = 5  # their median is the first idea of the period
COMMON_PERIODS_NS = (50_000_000, 100_000_000, 200_000_000, 250_000_000, 500_000_000, 1_000_000_000)
COMMON_SHARE = 0.04  # a period this close to a common one is that one
WHOLE_MS_AFTER = 120  # epochs after which the mean interval tells the millisecond
OFF_GRID_LIMIT = 12  # reached in a dozen clumps where every second one is between the epochs
RESET_NS = 5_000_000_000  # a silence this long, or any step back in time, starts the grid anew
UTC_JUMP_NS = 2_000_000_000
PERIOD_RANGE_NS = (40_000_000, 2_000_000_000)


@dataclass(slots=True)
class EpochClock:
    """Grid of one receiver's epochs. All times in ns on the clock of Frame.rx_ns."""

    group_ns: int = 0  # arrival of the current clump's first frame
    group_sid: int | None = None
    group_pgns: list[int] = field(default_factory=list)
    epoch_ns: int = 0  # the current clump's time on the lower envelope
    period_ns: int = 0  # 0: not known yet
    period_sure: bool = False  # common, or measured to the millisecond
    first_intervals: list[int] = field(default_factory=list)
    anchor_ns: int = 0  # arrival from which the period is measured
    anchor_epochs: int = 0  # epochs since
    off_grid: int = 0  # twice the clumps between epochs, less those on them
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
        if self.period_ns == 0:
            self._first_idea(interval, rx_ns)
            self.epoch_ns = rx_ns
            return
        since = rx_ns - self.epoch_ns
        epochs = round(since / self.period_ns)
        if self._off_grid(since - epochs * self.period_ns, rx_ns):
            return
        if epochs <= 0 <= since:
            return  # a second clump within one epoch: the same instant
        if since < -self.period_ns or since > RESET_NS:
            self.epoch_ns = self.anchor_ns = rx_ns
            self.anchor_epochs = 0
            self.resets += 1
            return
        self._measure_period(rx_ns, epochs)
        elapsed = epochs * self.period_ns
        late = since - elapsed
        self.epoch_ns += elapsed + min(late, round(self._leak() * elapsed))
        share = min(1.0, elapsed / 10e9)
        self.jitter_ns += share * (rx_ns - self.epoch_ns - self.jitter_ns)

    def _off_grid(self, late: int, rx_ns: int) -> bool:
        """Whether so many clumps came between the epochs that the device must have changed its period."""
        self.off_grid = self.off_grid + 2 if abs(late) > self.period_ns // 4 else max(0, self.off_grid - 1)
        if self.off_grid < OFF_GRID_LIMIT:
            return False
        self.period_ns, self.period_sure, self.anchor_epochs, self.off_grid = 0, False, 0, 0
        self.first_intervals.clear()
        self.epoch_ns = rx_ns
        self.resets += 1
        return True

    def _leak(self) -> float:
        """By what share of time the envelope may rise: skew, and what the period may still be off by."""
        if self.period_sure:
            return LEAK
        return LEAK + QUEUE_S * 1e9 / (self.period_ns * max(self.anchor_epochs, 1))

    def _first_idea(self, interval: int, rx_ns: int) -> None:
        if PERIOD_RANGE_NS[0] <= interval <= PERIOD_RANGE_NS[1]:
            self.first_intervals.append(interval)
        if len(self.first_intervals) == FIRST_INTERVALS:
            self.period_ns = sorted(self.first_intervals)[FIRST_INTERVALS // 2]
            self.anchor_ns = rx_ns

    def _measure_period(self, rx_ns: int, epochs: int) -> None:
        if self.period_sure:
            return
        self.anchor_epochs += epochs
        mean = (rx_ns - self.anchor_ns) // self.anchor_epochs
        if self.anchor_epochs >= WHOLE_MS_AFTER:
            self.period_ns, self.period_sure = round(mean / 1e6) * 1_000_000, True
            return
        self.period_ns = mean
        if self.anchor_epochs >= FIRST_INTERVALS:
            for common in COMMON_PERIODS_NS:
                if abs(mean - common) <= COMMON_SHARE * common:
                    self.period_ns, self.period_sure = common, True


@dataclass(slots=True)
class UtcClock:
    """UTC against the host's clock, from messages that carry a time: the lower envelope of host − UTC."""

    offset_ns: int | None = None  # host − UTC, at the earliest
    at_ns: int = 0
    resolution_s: float = 1.0

    def measured(self, host_ns: int, utc_ns: int, resolution_s: float) -> None:
        """Take an epoch's host time and UTC; a finer message replaces a coarser, a jump starts anew."""
        offset = host_ns - utc_ns
        jumped = self.offset_ns is not None and abs(offset - self.offset_ns) > UTC_JUMP_NS
        if self.offset_ns is None or jumped or resolution_s < self.resolution_s:
            self.offset_ns, self.at_ns, self.resolution_s = offset, host_ns, resolution_s
        elif resolution_s == self.resolution_s:
            risen = self.offset_ns + round(LEAK * (host_ns - self.at_ns))
            self.offset_ns, self.at_ns = min(offset, risen), host_ns

    def utc_ns(self, host_ns: int) -> int | None:
        """UTC at a host time, good to the resolution of the messages; None before the first."""
        return None if self.offset_ns is None else host_ns - self.offset_ns
