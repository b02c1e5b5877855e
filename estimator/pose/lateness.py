"""Frames that came late: a computer that was too busy to read them stamped many at once, after it was idle.

No bus carries two frames at one instant, and no sensor sends its readings in heaps. So where frames of one
bus are stamped closer together than it can carry them, or readings of the wheel angle far closer than they
come otherwise, the first of them had waited, at most since the frame before them. Their instants are wrong by
that, and nothing says which is wrong by how much. So nothing is learned around such a heap.
"""

from dataclasses import dataclass, field
from typing import Final

from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine


@dataclass(frozen=True, slots=True)
class LatenessTuning:
    """What tells that frames waited before they were stamped."""

    frame_bits: int = tuned(100, "bits", "of a frame; the shortest with 8 bytes and 29 bits have more")
    late_ns: int = tuned(30_000_000, "ns", "waiting that matters; adapters hold frames for up to half of it")
    heap_ns: int = tuned(2_000_000, "ns", "readings of one sensor that are closer together came in a heap")
    memory: float = tuned(200.0, "intervals", "over which the usual one is averaged")
    doubt_ns: int = tuned(1_000_000_000, "ns", "after a heap, in which nothing is learned")
    """After a heap: poses up to here may rest on it, and a busy computer is busy again soon."""


LATENESS: Final = LatenessTuning()


@dataclass(slots=True)
class Arrivals:
    """Frames of a bus, or readings of a sensor. Times ns, of Frame.rx_ns."""

    last_ns: int = 0
    usual_ns: float = 0.0  # mean interval; of a bus the shortest that it can carry
    idle_ns: int = 0  # between the present heap and what came before it
    waited_ns: float = 0.0  # how long the first of the heap must have waited
    heap: int = 0  # members of the heap


@dataclass(slots=True)
class Lateness:
    """What came late."""

    buses: dict[str, Arrivals] = field(default_factory=dict)
    wheel: Arrivals = field(default_factory=Arrivals)
    late: int = 0  # frames that are known to have come late
    from_ns: int = 0  # since when instants are doubtful, and until when
    until_ns: int = 0

    def doubts(self, t_ns: int) -> bool:
        """Whether what was measured at t_ns may have come late."""
        return self.from_ns <= t_ns <= self.until_ns

    def clock_stepped(self) -> None:
        """Times before now say nothing any more. The count stays."""
        self.buses.clear()
        self.wheel, self.from_ns, self.until_ns = Arrivals(), 0, 0


def take_frame(state: Lateness, machine: Machine, frame: Frame) -> None:
    """Take the stamp of a frame."""
    arrivals = state.buses.get(frame.bus)
    if arrivals is None:
        rate = next((bus.bitrate for bus in machine.bus if bus.name == frame.bus), 0)
        arrivals = state.buses[frame.bus] = Arrivals(
            frame.rx_ns, LATENESS.frame_bits * 1e9 / rate if rate else 0.0
        )
        return
    rx_ns, closest_ns = frame.rx_ns, round(arrivals.usual_ns)
    interval = rx_ns - arrivals.last_ns
    if interval >= closest_ns and interval > 0:  # as of nearly all
        arrivals.last_ns, arrivals.idle_ns, arrivals.waited_ns, arrivals.heap = rx_ns, interval, 0.0, 0
    else:
        _take(state, arrivals, rx_ns, closest_ns)


def take_wheel(state: Lateness, rx_ns: int) -> None:
    """Take the stamp of a reading of the wheel angle."""
    arrivals = state.wheel
    if arrivals.last_ns:
        interval = min(max(0, rx_ns - arrivals.last_ns), LATENESS.doubt_ns)
        arrivals.usual_ns += (
            (interval - arrivals.usual_ns) / LATENESS.memory if arrivals.usual_ns else interval
        )
    _take(state, arrivals, rx_ns, min(LATENESS.heap_ns, round(arrivals.usual_ns / 4.0)))


def _take(state: Lateness, arrivals: Arrivals, rx_ns: int, closest_ns: int) -> None:
    """closest_ns: what comes closer together than this came in a heap."""
    interval = rx_ns - arrivals.last_ns
    arrivals.last_ns = max(rx_ns, arrivals.last_ns)
    if interval >= closest_ns:
        arrivals.idle_ns, arrivals.waited_ns, arrivals.heap = interval, 0.0, 0
        return
    arrivals.heap += 1
    arrivals.waited_ns += arrivals.usual_ns - max(0, interval)
    if min(arrivals.waited_ns, arrivals.idle_ns) < LATENESS.late_ns:
        return
    state.late += arrivals.heap
    arrivals.heap = 0
    if state.until_ns < rx_ns - arrivals.idle_ns:
        state.from_ns = rx_ns - arrivals.idle_ns
    state.until_ns = rx_ns + LATENESS.doubt_ns
