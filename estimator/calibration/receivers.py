"""Who sends: of each receiver its address and NAME, how often it sends a position, and how much that jitters
while the rig stands. A fold over measurements, with nothing of the rig trusted.

The jitter is that of a position against the middle of those before and after it: neither a rig that creeps
downhill nor the slow drift of RTK is in it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from tilth.estimator.driving import DRIVING
from tilth.estimator.pose.geometry import to_plane
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Measurement, Mount, Origin, Position, Velocity
from tilth.schemas.machine import Machine


@dataclass(frozen=True, slots=True)
class StandingReceiverTuning:
    """What receivers tell while they stand."""

    settled_ns: int = tuned(2_000_000_000, "ns", "of standing, after which a body has come to rest")
    longest_ns: int = tuned(2_000_000_000, "ns", "between two positions: more is an interruption")
    fewest: int = tuned(20, "positions", "at standstill, or nothing is said of how they jitter")


STANDING_RECEIVER: Final = StandingReceiverTuning()


@dataclass(slots=True)
class HeardReceiver:
    """Of one mount. Sums are of positions."""

    origin: Origin
    pgn: int  # one receiver may send each position in two messages: the lower one counts
    last_ns: int = 0
    intervals: int = 0
    interval_ns: int = 0  # all of them together
    stands_ns: int | None = None  # since when it does
    latest: tuple[tuple[float, float], ...] = ()  # m north and east, of this stand, two at most
    count: int = 0  # of squares
    squares: float = 0.0  # m^2, of a position less the middle of its neighbours

    @property
    def per_s(self) -> float | None:
        """Hz, of its positions."""
        return self.intervals / (self.interval_ns * 1e-9) if self.interval_ns else None

    @property
    def jitter(self) -> float | None:
        """m, rms of both axes together; None without a standstill."""
        return (
            math.sqrt(self.squares / (1.5 * self.count)) if self.count >= STANDING_RECEIVER.fewest else None
        )


@dataclass(slots=True)
class HeardReceivers:
    """Of a drive. by_mount: of the machine file."""

    origin_deg: tuple[float, float] | None = None
    by_mount: dict[Mount, HeardReceiver] = field(default_factory=dict)


def take(heard: HeardReceivers, measurement: Measurement) -> None:
    mount = measurement.origin.mount
    if mount is None:
        return
    one = heard.by_mount.get(mount)
    match measurement:
        case Position():
            if one is None:
                one = heard.by_mount[mount] = HeardReceiver(measurement.origin, measurement.pgn)
            here = measurement.latitude_deg, measurement.longitude_deg
            heard.origin_deg = heard.origin_deg or here
            if _counts(one, measurement):
                _take_standing(one, to_plane(heard.origin_deg, *here))
        case Velocity(speed=speed) if one is not None:
            if speed >= DRIVING.standstill:
                one.stands_ns = None
            elif one.stands_ns is None:
                one.stands_ns, one.latest = measurement.rx_ns, ()
        case _:
            pass


def _counts(one: HeardReceiver, position: Position) -> bool:
    """Whether it tells how positions jitter; how often they come it tells all the same."""
    if position.pgn > one.pgn:
        return False
    one.origin, one.pgn = position.origin, position.pgn
    after_ns, one.last_ns = position.rx_ns - one.last_ns, position.rx_ns
    if not 0 < after_ns <= STANDING_RECEIVER.longest_ns:
        one.stands_ns = None
        return False
    one.intervals += 1
    one.interval_ns += after_ns
    return one.stands_ns is not None and position.rx_ns - one.stands_ns > STANDING_RECEIVER.settled_ns


def _take_standing(one: HeardReceiver, here: tuple[float, float]) -> None:
    if len(one.latest) == 2:
        (north, east), now = one.latest
        one.squares += (now[0] - (north + here[0]) / 2) ** 2 + (now[1] - (east + here[1]) / 2) ** 2
        one.count += 1
    one.latest = (*one.latest[-1:], here)


class ReceiverRow(NamedTuple):
    """Of one receiver, for people. None: not known."""

    mount: str  # where it stands
    bus: str
    source: int | None
    name: str  # its NAME, 16 hexadecimal digits; "" where it has told none
    per_s: float | None  # Hz, of its positions
    jitter: float | None  # m, of its positions at standstill
    latency: float  # s
    stated: float  # s: the file's

    @property
    def words(self) -> str:
        """A sentence without its end."""
        place = self.mount.replace("_", " ")
        if self.source is None:
            return f"{place}: not heard"
        name = f"NAME {self.name}, " if self.name else ""
        rate = "a single position" if self.per_s is None else f"{self.per_s:.1f} positions a second"
        still = "no standstill"
        if self.jitter is not None:
            still = f"jitter {self.jitter * 1e3:.0f} mm at standstill"
        delay = f"latency {self.latency * 1e3:.0f} ms"
        delay += " by the file" if self.latency == self.stated else f", {self.stated * 1e3:.0f} by the file"
        return f"{place}: {name}address {self.source} on {self.bus}, {rate}, {still}, {delay}"


def rows(
    heard: HeardReceivers, machine: Machine, places: Mapping[str, str], found: Machine | None = None
) -> tuple[ReceiverRow, ...]:
    """machine: that the measurements were made with. places: mount in it -> where the receiver stands, as far
    as it is another one. found: with the latencies that the drive told."""
    delay = {r.mount.value: r.latency.value for r in (found or machine).receiver}
    made = []
    for receiver in machine.receiver:
        mount = receiver.mount.value
        stands, one = places.get(mount, mount), heard.by_mount.get(receiver.mount)
        row = ReceiverRow(stands, receiver.bus, None, "", None, None, delay[stands], receiver.latency.value)
        if one is not None:
            name = "" if one.origin.name is None else f"{one.origin.name:016X}"
            row = row._replace(source=one.origin.source, name=name, per_s=one.per_s, jitter=one.jitter)
        made.append(row)
    return tuple(made)
