"""When was it measured? One clock model per receiver, from arrival stamps alone.

A receiver measures at regular epochs and sends a clump of messages after each. Frames queue on the bus, so
a message can only be *late*: the epochs are the lower envelope of the arrivals of its positions, on a grid of
its own period. Its other messages belong to the epoch they follow, or, sent by a timer of their own, to none;
they never move the grid. The machine file's latency leads from the envelope back to the instant measured.

Arrival times alone would put 10 to 30 ms of jitter (4 to 13 cm at 4.5 m/s) into every position.
"""

from dataclasses import dataclass, field

CLUMP_NS = 60_000_000  # other messages follow the epoch's position within this
BEFORE_NS = 30_000_000  # or precede it within this
SAME_SID_NS = 200_000_000
LEAK = 300e-6  # the envelope rises by this share of time: above any quartz's skew (100 ppm)
QUEUE_S = 0.03  # how late a message may queue: what the period's estimate may be off by, over its baseline
FIRST_INTERVALS = 5  # their median is the first idea of the period
COMMON_PERIODS_NS = (50_000_000, 100_000_000, 200_000_000, 250_000_000, 500_000_000, 1_000_000_000)
COMMON_SHARE = 0.01  # a period measured this close to a common one is that one, for now
WHOLE_MS_AFTER = (
    120  # epochs after which the mean interval tells the millisecond; looked at again after as many
)
OFF_GRID_LIMIT = 12  # reached in a dozen positions where every second one is between the epochs
RESET_NS = 5_000_000_000  # a silence this long, or a step back in time, starts the grid anew
UTC_JUMP_NS = 2_000_000_000
PERIOD_RANGE_NS = (40_000_000, 2_000_000_000)


@dataclass(slots=True)
class EpochClock:
    """Grid of one receiver's epochs. All times in ns on the clock of Frame.rx_ns."""

    arrived_ns: int = 0  # the last position's arrival
    epoch_ns: int = 0  # its epoch, on the lower envelope; 0 before the first
    period_ns: int = 0  # 0: not known yet
    period_sure: bool = False  # measured to the millisecond
    first_intervals: list[int] = field(default_factory=list)
    anchor_ns: int = 0  # arrival from which the period is measured
    anchor_epochs: int = 0  # epochs since
    off_grid: int = 0  # twice the positions between epochs, less those on them
    sid: int | None = None  # of the last message that had one
    sid_pgns: list[int] = field(default_factory=list)  # heard with it
    sid_ns: int = 0  # its instant
    sid_changes: bool = False  # a device may send one SID for ever: that ties nothing
    resets: int = 0

    def position(self, rx_ns: int) -> int:
        """Epoch of a position that arrived at rx_ns."""
        interval = rx_ns - self.arrived_ns
        self.arrived_ns = rx_ns
        if self.period_ns == 0:
            self._first_idea(interval, rx_ns)
            self.epoch_ns = rx_ns
            return rx_ns
        since = rx_ns - self.epoch_ns
        epochs = round(since / self.period_ns)
        late = since - epochs * self.period_ns
        if since < -self.period_ns or since > RESET_NS:
            self._restart(rx_ns)
        elif self._off_grid(late):
            self.period_ns, self.period_sure = 0, False
            self.first_intervals.clear()
            self._restart(rx_ns)
        elif epochs <= 0:
            self.epoch_ns = min(self.epoch_ns, rx_ns)  # the same epoch, told twice
        else:
            self._measure_period(rx_ns, epochs)
            elapsed = epochs * self.period_ns
            self.epoch_ns += elapsed + min(since - elapsed, round(self._leak() * elapsed))
        return self.epoch_ns

    def other(self, rx_ns: int, pgn: int, sid: int | None) -> int:
        """Epoch of another message; its own arrival where it follows none."""
        instant = self._on_grid(rx_ns)
        if sid is None:
            return instant
        if sid == self.sid and pgn not in self.sid_pgns:
            if self.sid_changes and 0 <= rx_ns - self.sid_ns < SAME_SID_NS:
                instant = self.sid_ns
        else:
            self.sid_changes |= self.sid is not None and sid != self.sid
            self.sid, self.sid_ns = sid, instant
            self.sid_pgns.clear()
        self.sid_pgns.append(pgn)
        return instant

    def _on_grid(self, rx_ns: int) -> int:
        if self.period_ns == 0:
            return rx_ns
        late = (rx_ns - self.epoch_ns) % self.period_ns
        if late <= CLUMP_NS:
            return rx_ns - late
        if self.period_ns - late <= min(BEFORE_NS, self.period_ns // 4):
            return rx_ns + self.period_ns - late
        return rx_ns

    def _restart(self, rx_ns: int) -> None:
        self.epoch_ns = self.anchor_ns = rx_ns
        self.anchor_epochs = self.off_grid = 0
        self.resets += 1

    def _off_grid(self, late: int) -> bool:
        """Whether so many positions came between the epochs that the device must have changed its period."""
        self.off_grid = self.off_grid + 2 if abs(late) > self.period_ns // 4 else max(0, self.off_grid - 1)
        return self.off_grid >= OFF_GRID_LIMIT

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
            self.anchor_epochs = 0

    def _measure_period(self, rx_ns: int, epochs: int) -> None:
        self.anchor_epochs += epochs
        mean = (rx_ns - self.anchor_ns) // self.anchor_epochs
        if self.anchor_epochs >= WHOLE_MS_AFTER:
            self.period_ns, self.period_sure = round(mean / 1e6) * 1_000_000, True
            self.anchor_ns, self.anchor_epochs = rx_ns, 0
        elif not self.period_sure:
            near = min(COMMON_PERIODS_NS, key=lambda common: abs(mean - common))
            self.period_ns = near if abs(mean - near) <= COMMON_SHARE * near else mean


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
