"""When was it measured? A clock model of each receiver, from the arrival times of its messages.

A receiver measures at regular epochs and sends a burst of messages after each. Frames queue on the bus, so a
message can only be *late*. The epochs are therefore the lower envelope of the arrival times of its positions,
on a grid of its period. Its other messages belong to the epoch that they follow; if the receiver sends them
by another timer, they belong to none. They never shift the grid. The instant of measurement is the epoch
minus the latency of the machine file.

Arrival times alone would put 10 to 30 ms of jitter (4 to 13 cm at 4.5 m/s) into every position.
"""

from dataclasses import dataclass, field
from typing import Final

from tilth.estimator.tuning import tuned


@dataclass(frozen=True, slots=True)
class EpochClockTuning:
    """How the instants of a receiver's epochs are found from when its messages arrive."""

    burst_ns: int = tuned(60_000_000, "ns", "other messages of an epoch come so soon after its position")
    early_ns: int = tuned(30_000_000, "ns", "or within this time before it")
    same_sid_ns: int = tuned(200_000_000, "ns", "closer messages with one sequence number are of one epoch")
    envelope_rise: float = tuned(
        300e-6, "s/s", "of the envelope: above the skew of any quartz clock (100 ppm)"
    )
    queue_s: float = tuned(0.03, "s", "longest delay in a queue: a measured period's error times epochs")
    first_intervals: int = tuned(5, "intervals", "the median of so many is the first estimate of the period")
    common_periods_ns: tuple[int, ...] = tuned(
        (50_000_000, 100_000_000, 200_000_000, 250_000_000, 500_000_000, 1_000_000_000),
        "ns",
        "periods that receivers are set to",
    )
    common_share: float = tuned(0.01, "1", "a measured period so close to a common one is set to it at first")
    whole_ms_after: int = tuned(120, "epochs", "after which the mean interval is rounded to 1 ms, each time")
    off_grid_limit: int = tuned(12, "positions", "off the grid, until the grid is doubted")
    """A dozen positions reach it if every second one is between the epochs."""
    reset_ns: int = tuned(5_000_000_000, "ns", "so long a silence, or a step back in time, starts a new grid")
    utc_jump_ns: int = tuned(2_000_000_000, "ns", "a larger step of UTC against the clock is a jump")
    period_range_ns: tuple[int, ...] = tuned(
        (40_000_000, 2_000_000_000), "ns", "intervals outside of this range are no period"
    )


EPOCH_CLOCK: Final = EpochClockTuning()


@dataclass(slots=True)
class EpochClock:
    """Grid of one receiver's epochs. All times in ns on the clock of Frame.rx_ns."""

    arrived_ns: int = 0  # arrival of the last position
    epoch_ns: int = 0  # its epoch, on the lower envelope; 0 before the first
    period_ns: int = 0  # 0: not known yet
    period_exact: bool = False  # measured to the millisecond
    first_intervals: list[int] = field(default_factory=list)
    anchor_ns: int = 0  # arrival from which the period is measured
    anchor_epochs: int = 0  # epochs since then
    off_grid: int = 0  # counter: +2 for a position between epochs, -1 for one on an epoch
    sid: int | None = None  # sequence identifier of the last message that had one
    sid_pgns: list[int] = field(default_factory=list)  # messages received with it
    sid_ns: int = 0  # its instant
    sid_changes: bool = False  # a device that always sends the same SID does not group its messages by it
    resets: int = 0

    def position(self, rx_ns: int) -> int:
        """Epoch of a position that arrived at rx_ns."""
        interval = rx_ns - self.arrived_ns
        self.arrived_ns = rx_ns
        if self.period_ns == 0:
            self._estimate_first_period(interval, rx_ns)
            self.epoch_ns = rx_ns
            return rx_ns
        since = rx_ns - self.epoch_ns
        epochs = round(since / self.period_ns)
        lateness = since - epochs * self.period_ns
        if since < -self.period_ns or since > EPOCH_CLOCK.reset_ns:
            self._restart_grid(rx_ns)
        elif self._off_grid(lateness):
            self.period_ns, self.period_exact = 0, False
            self.first_intervals.clear()
            self._restart_grid(rx_ns)
        elif epochs <= 0:
            self.epoch_ns = min(self.epoch_ns, rx_ns)  # the same epoch, sent twice
        else:
            self._measure_period(rx_ns, epochs)
            elapsed = epochs * self.period_ns
            self.epoch_ns += elapsed + min(since - elapsed, round(self._envelope_rise() * elapsed))
        return self.epoch_ns

    def other(self, rx_ns: int, pgn: int, sid: int | None) -> int:
        """Epoch of another message; its own arrival time if it follows no epoch."""
        instant = self._on_grid(rx_ns)
        if sid is None:
            return instant
        if sid == self.sid and pgn not in self.sid_pgns:
            if self.sid_changes and 0 <= rx_ns - self.sid_ns < EPOCH_CLOCK.same_sid_ns:
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
        lateness = (rx_ns - self.epoch_ns) % self.period_ns
        if lateness <= EPOCH_CLOCK.burst_ns:
            return rx_ns - lateness
        if self.period_ns - lateness <= min(EPOCH_CLOCK.early_ns, self.period_ns // 4):
            return rx_ns + self.period_ns - lateness
        return rx_ns

    def _restart_grid(self, rx_ns: int) -> None:
        self.epoch_ns = self.anchor_ns = rx_ns
        self.anchor_epochs = self.off_grid = 0
        self.resets += 1

    def _off_grid(self, lateness: int) -> bool:
        """Whether positions came between the epochs so often that the device must have changed its period."""
        self.off_grid = (
            self.off_grid + 2 if abs(lateness) > self.period_ns // 4 else max(0, self.off_grid - 1)
        )
        return self.off_grid >= EPOCH_CLOCK.off_grid_limit

    def _envelope_rise(self) -> float:
        """Largest rise of the envelope, s/s: clock skew, plus the error that the period may still have."""
        if self.period_exact:
            return EPOCH_CLOCK.envelope_rise
        return EPOCH_CLOCK.envelope_rise + EPOCH_CLOCK.queue_s * 1e9 / (
            self.period_ns * max(self.anchor_epochs, 1)
        )

    def _estimate_first_period(self, interval: int, rx_ns: int) -> None:
        if EPOCH_CLOCK.period_range_ns[0] <= interval <= EPOCH_CLOCK.period_range_ns[1]:
            self.first_intervals.append(interval)
        if len(self.first_intervals) == EPOCH_CLOCK.first_intervals:
            self.period_ns = sorted(self.first_intervals)[EPOCH_CLOCK.first_intervals // 2]
            self.anchor_ns = rx_ns
            self.anchor_epochs = 0

    def _measure_period(self, rx_ns: int, epochs: int) -> None:
        self.anchor_epochs += epochs
        mean = (rx_ns - self.anchor_ns) // self.anchor_epochs
        if self.anchor_epochs >= EPOCH_CLOCK.whole_ms_after:
            self.period_ns, self.period_exact = round(mean / 1e6) * 1_000_000, True
            self.anchor_ns, self.anchor_epochs = rx_ns, 0
        elif not self.period_exact:
            near = min(EPOCH_CLOCK.common_periods_ns, key=lambda common: abs(mean - common))
            self.period_ns = near if abs(mean - near) <= EPOCH_CLOCK.common_share * near else mean


@dataclass(slots=True)
class UtcClock:
    """UTC relative to the host's clock, from messages that carry a time: the lower envelope of host − UTC."""

    offset_ns: int | None = None  # smallest host − UTC
    at_ns: int = 0
    resolution_s: float = 1.0

    def update(self, host_ns: int, utc_ns: int, resolution_s: float) -> None:
        """Take an epoch's host time and UTC. A finer resolution replaces a coarser one; a jump starts
        again."""
        offset = host_ns - utc_ns
        jumped = self.offset_ns is not None and abs(offset - self.offset_ns) > EPOCH_CLOCK.utc_jump_ns
        if self.offset_ns is None or jumped or resolution_s < self.resolution_s:
            self.offset_ns, self.at_ns, self.resolution_s = offset, host_ns, resolution_s
        elif resolution_s == self.resolution_s:
            risen = self.offset_ns + round(EPOCH_CLOCK.envelope_rise * (host_ns - self.at_ns))
            self.offset_ns, self.at_ns = min(offset, risen), host_ns

    def utc_ns(self, host_ns: int) -> int | None:
        """UTC at a host time, accurate to the resolution of the messages; None before the first."""
        return None if self.offset_ns is None else host_ns - self.offset_ns
