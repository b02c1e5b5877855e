"""Leaves out what no neighbour bears out: spikes of a sensor, and readings that stand still while the rig
moves.

A loose plug or a disturbed cable puts single readings anywhere. A reading is a spike if it is further from
both its neighbours than the thing can move in between. So one that is near the last reading used is used at
once. Another waits: it is left out when the next one is near the last one used again, and used, with all that
wait, when `lasting` in a row are near each other; then the thing has really moved. Where nothing is wrong
nothing ever waits.

A sensor that has failed may go on sending its last reading. Noise lets few readings repeat to the bit, but a
coarse sensor repeats them whenever nothing moves. So each sensor is measured by itself: a run of equal
readings is no measurement where it is far longer than any that was seen of it while the rig moved (`stands`).
What a run contradicts is looked at in standing.py.
"""

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from tilth.estimator.rig.geometry import Vector, wrap
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Flag, FlagKind
from tilth.schemas.rejections import Rejection, count

Reading = tuple[int, float, float, float]
"""t_ns, a value, a second one or 0, sd of each."""


class RateLimits(NamedTuple):
    """How fast a quantity can change, per second."""

    rate: float
    wraps: bool = False  # an angle that goes round


@dataclass(frozen=True, slots=True)
class ScreenTuning:
    """Which readings are spikes, and which have stood still for too long."""

    sds: float = tuned(5.0, "sd", "of the difference of two readings, that are noise")
    stamp_s: float = tuned(0.02, "s", "by which a frame may come later than another: it queued on the bus")
    lasting: int = tuned(4, "readings", "in a row that are no spikes: bursts are of up to three")
    wheel_angle_rate: float = tuned(math.radians(60.0), "rad/s", "the fastest steering cylinders")
    acceleration: float = tuned(8.0, "m/s^2", "brakes, and the antenna's own motion on a mast over bumps")
    yaw_acceleration: float = tuned(4.0, "rad/s^2", "full lock at 10 m/s in half a second")
    turn_rate: float = tuned(1.5, "rad/s", "of headings, roll and pitch")
    position_rate: float = tuned(20.0, "m/s", "of a position, where the receiver reports no velocity")
    position_share: float = tuned(0.3, "1", "of the speed, by which a position may leave the velocity before")
    position_acceleration: float = tuned(6.0, "m/s^2", "the same, whatever the speed")
    memory: float = tuned(1000.0, "readings", "over which the share of spikes is averaged")
    least_spikes: int = tuned(5, "spikes", "before a share is told")
    often: float = tuned(0.005, "1", "share of spikes from which on a sensor counts as disturbed")
    seldom: float = tuned(0.001, "1", "share below which it no longer does")
    known_runs: int = tuned(100, "runs", "of equal readings after which it is known how long they get")
    shortest: int = tuned(5, "readings", "a run no longer than this is nothing unusual")
    longer: int = tuned(2, "1", "times the longest run so far, for one that is unusual")


SCREEN: Final = ScreenTuning()

LIMITS: Final = {
    "wheel_angle": RateLimits(math.radians(60.0)),  # the fastest steering cylinders
    "wheel_speed": RateLimits(8.0),  # m/s^2: brakes, and the antenna's own motion on a mast over bumps
    "velocity": RateLimits(8.0),
    "yaw_rate": RateLimits(4.0),  # rad/s^2: full lock at 10 m/s in half a second
    "heading": RateLimits(1.5, wraps=True),  # rad/s
    "roll": RateLimits(1.5),
    "pitch": RateLimits(1.5),
    "position": RateLimits(20.0),  # m/s, where the receiver reports no velocity
}


@dataclass(slots=True)
class SensorScreen:
    """One quantity of one sensor. Times ns."""

    last: Reading | None = None  # used
    waiting: list[Reading] = field(default_factory=list)  # one after another, each near the one before
    spikes: int = 0
    share: float = 0.0  # of spikes in the last `memory` readings
    often: bool = False
    raw: tuple[float, float] | None = None  # the last reading, used or not
    run: int = 0  # how many equal to it came in a row while the rig moved
    run_ns: int = 0  # instant of the first of them
    runs: int = 0  # complete ones
    longest: int = 0  # of the complete ones, readings
    failed: bool = False  # in this run the rig has moved as it could not with such readings (standing.py)

    @property
    def stands(self) -> bool:
        """Whether readings stay the same for longer than they ever did while the rig moved."""
        return self.runs >= SCREEN.known_runs and self.run > max(
            SCREEN.shortest, SCREEN.longer * self.longest
        )


STILL: Final[Vector] = (0.0, 0.0)


@dataclass(slots=True)
class Screens:
    """All of a rig, and what they have left out."""

    by: dict[str, SensorScreen] = field(default_factory=dict)  # "who quantity" -> screen
    rejected: dict[str, int] = field(default_factory=dict)  # Rejection -> readings
    late: bool = False  # frames come late just now (lateness.py)

    def clock_stepped(self) -> None:
        """What comes next is not near in time to what was there. What is known of the sensors stays."""
        for screen in self.by.values():
            screen.last, screen.raw, screen.run = None, None, 0
            screen.waiting.clear()

    def flags(self) -> list[Flag]:
        """A flag for each sensor of which a share of the readings are spikes."""
        disturbed = (name.partition(" ")[0] for name, screen in self.by.items() if screen.often)
        return sorted({Flag(FlagKind.SPIKES, who) for who in disturbed})

    def forget_places(self) -> None:
        """Positions count from another origin now."""
        for name, screen in self.by.items():
            if name.endswith(" position"):
                screen.last = None
                screen.waiting.clear()

    def near(self, who: str, quantity: str, reading: Reading, moving: bool) -> list[Reading]:
        """The readings of who's quantity (a key of LIMITS) that are used now that this one has come, in their
        order. moving: whether the rig moves."""
        screen = self._screen(f"{who} {quantity}")
        _count_run(screen, reading, moving)
        # A pose needs the wheel angle: one that may yet be right is refused by record_builder only.
        if screen.failed or (screen.stands and quantity != "wheel_angle"):
            count(self.rejected, Rejection.STANDS_STILL)
            return []
        return self._decide(screen, reading, LIMITS[quantity], STILL)

    def near_path(self, who: str, reading: Reading, velocity: Vector | None) -> list[Reading]:
        """The same of positions, m. velocity: the last known, north, east, m/s. Positions that repeat are
        looked at elsewhere."""
        screen = self._screen(f"{who} position")
        if velocity is None:
            return self._decide(screen, reading, LIMITS["position"], STILL)
        elapsed = abs(reading[0] - (screen.last or reading)[0]) * 1e-9
        rate = SCREEN.position_share * math.hypot(*velocity) + SCREEN.position_acceleration * (
            elapsed + SCREEN.stamp_s
        )
        return self._decide(screen, reading, RateLimits(rate), velocity)

    def _screen(self, name: str) -> SensorScreen:
        screen = self.by.get(name)
        if screen is None:
            screen = self.by[name] = SensorScreen()
        return screen

    def _decide(
        self, screen: SensorScreen, reading: Reading, limits: RateLimits, velocity: Vector
    ) -> list[Reading]:
        waiting, last = screen.waiting, screen.last
        back = last is None or _are_near(last, reading, limits, velocity)
        if back and last is not None and waiting:  # what has time enough may come back, or go on
            gone_on = _apart(waiting[-1], reading, limits, velocity)
            back = _apart(last, reading, limits, velocity) < gone_on
        if back:
            self._leave_out(screen)
            used = [reading]
        else:
            if waiting and not _are_near(waiting[-1], reading, limits, velocity):
                self._leave_out(screen)
            waiting.append(reading)
            if len(waiting) < SCREEN.lasting:
                return []
            used = waiting.copy()
            waiting.clear()
        for _ in used:
            _note(screen, False)
        screen.last = used[-1]
        return used

    def _leave_out(self, screen: SensorScreen) -> None:
        if screen.waiting and not self.late:  # else the computer is to blame, and they are counted as late
            count(self.rejected, Rejection.SPIKE, len(screen.waiting))
            for _ in screen.waiting:
                _note(screen, True)
        screen.waiting.clear()


def _apart(one: Reading, other: Reading, limits: RateLimits, velocity: Vector) -> float:
    """How far one is from the other, if the values have changed at this velocity."""
    elapsed = (other[0] - one[0]) * 1e-9
    first = other[1] - one[1] - velocity[0] * elapsed
    second = other[2] - one[2] - velocity[1] * elapsed
    return math.hypot(wrap(first) if limits.wraps else first, second)


def _are_near(one: Reading, other: Reading, limits: RateLimits, velocity: Vector) -> bool:
    """Whether both may be true. velocity: at which the values change, as far as known."""
    seconds = abs(other[0] - one[0]) * 1e-9 + SCREEN.stamp_s
    room = SCREEN.sds * math.hypot(one[3], other[3]) + limits.rate * seconds
    if velocity is not STILL:
        room += math.hypot(*velocity) * SCREEN.stamp_s
    return _apart(one, other, limits, velocity) <= room


def _count_run(screen: SensorScreen, reading: Reading, moving: bool) -> None:
    """While the rig stands, readings may repeat for as long as they like."""
    raw = reading[1], reading[2]
    if raw != screen.raw or not moving:
        if screen.run and not screen.failed:  # a failure is no habit
            screen.runs += 1
            screen.longest = max(screen.longest, screen.run)
        screen.failed &= raw == screen.raw
        screen.raw, screen.run = raw, 0
    if moving:
        screen.run_ns = screen.run_ns if screen.run else reading[0]
        screen.run += 1


def _note(screen: SensorScreen, spike: bool) -> None:
    """Follow the share of spikes."""
    screen.spikes += spike
    screen.share += (spike - screen.share) / SCREEN.memory
    if screen.share < SCREEN.seldom:
        screen.often = False
    elif screen.share >= SCREEN.often and screen.spikes >= SCREEN.least_spikes:
        screen.often = True
