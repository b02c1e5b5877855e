"""The recent samples of one receiver, and their interpolation to any instant.

Samples are stored at their instants of measurement (epoch clock minus latency). Between two positions the
path is a cubic through positions and velocities. After the last one it is extrapolated with velocity and yaw
rate, and the standard deviation grows.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, TypeVar

from tilth.estimator.driving import DRIVING
from tilth.estimator.pose.epoch_clock import EpochClock, UtcClock
from tilth.estimator.pose.position_rate import PositionRate, observe
from tilth.estimator.pose.screen import Reading, Screens
from tilth.estimator.rig.geometry import Vector, wrap
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import (
    Attitude,
    Fix,
    FixType,
    Heading,
    Measurement,
    Position,
    UtcTime,
    Velocity,
    YawRate,
)


@dataclass(frozen=True, slots=True)
class ReceiverTrackTuning:
    """For how long what a receiver said is continued."""

    longest_interpolated_ns: int = tuned(
        1_100_000_000, "ns", "longest gap to interpolate: a receiver at 1 Hz"
    )
    hold_ns: int = tuned(600_000_000, "ns", "longest extrapolation of a position")
    near_ns: int = tuned(20_000_000, "ns", "so short an extrapolation costs less than a position's noise")
    slow_hold_ns: int = tuned(1_500_000_000, "ns", "roll, pitch and headings change slowly: held so long")
    unknown_acceleration: float = tuned(0.7, "m/s^2", "sd of the acceleration that an extrapolation ignores")
    position_sd: Mapping[FixType, float] = tuned(
        {  # smallest sd of a position that is not RTK fixed, m
            FixType.RTK_FLOAT: 0.4,
            FixType.PRECISE: 0.1,
            FixType.DGNSS: 0.5,
            FixType.GNSS: 1.5,
        },
        "m",
        "smallest sd of a position that is not RTK fixed",
    )


RECEIVER_TRACK: Final = ReceiverTrackTuning()


NO_POSITION = (FixType.NONE, FixType.DEAD_RECKONING, FixType.MANUAL)

Sample = tuple[int, float, float]  # t_ns, value, sd
Planar = tuple[int, float, float, float]  # t_ns, north, east, sd per axis
Stamped = TypeVar("Stamped", Sample, Planar)


@dataclass(slots=True)
class Track:
    """One receiver's recent samples. Times in ns on the clock of Frame.rx_ns."""

    latency_ns: int
    roll_zero: float = 0.0  # rad, of the machine file
    roll_sign: int = 1
    yaw_rate_sign: int = 1
    clock: EpochClock = field(default_factory=EpochClock)
    utc: UtcClock = field(default_factory=UtcClock)
    positions: deque[Planar] = field(default_factory=lambda: deque(maxlen=32))
    velocities: deque[Planar] = field(default_factory=lambda: deque(maxlen=48))
    yaw_rates: deque[Sample] = field(default_factory=lambda: deque(maxlen=128))  # 1.2 s at 100 Hz
    headings: deque[Sample] = field(default_factory=lambda: deque(maxlen=64))
    rolls: deque[Sample] = field(default_factory=lambda: deque(maxlen=48))
    pitches: deque[Sample] = field(default_factory=lambda: deque(maxlen=48))
    fix: FixType | None = None
    fix_ns: int = 0  # arrival of the message that reported it
    position_pgn: int = 0  # the message that its positions come from: the most frequent one that it sends
    last_position_ns: int = 0  # arrival of the last position that was new, or repeated at standstill
    repeated_ns: int = 0  # arrival of the last position that was repeated while moving
    repeated_epoch_ns: int = 0  # of that position: what is sent with it repeats, too
    rate: PositionRate = field(default_factory=PositionRate)
    smoothed: bool = False  # its turn rates are smoothed (receiver_checks): they are stored, but not used
    elsewhere_deg: Vector | None = None  # its last position far from the origin, and how many were there
    elsewhere: int = 0
    left_out: bool = False  # it has been moved (watch): it is stored, but not used

    def take(self, measurement: Measurement, screens: Screens, moving: bool) -> None:
        """Store a measurement other than a position, if `screens` does not leave it out. moving: whether the
        rig moves."""
        epoch_ns = self.clock.other(measurement.rx_ns, measurement.pgn, measurement.sid)
        t_ns = epoch_ns - self.latency_ns
        who = measurement.origin.mount or ""

        def store(samples: deque[Sample], quantity: str, value: float, sd: float) -> None:
            if self._repeats(samples, (t_ns, value, sd)):
                return
            for at_ns, good, _, sd_good in screens.near(who, quantity, (t_ns, value, 0.0, sd), moving):
                samples.append((at_ns, good, sd_good))

        match measurement:
            case Velocity(course=course, speed=speed, sd=sd):
                along = (t_ns, speed * math.cos(course), speed * math.sin(course), sd)
                if not self._repeats(self.velocities, along):
                    self.velocities.extend(screens.near(who, "velocity", along, moving))
            case YawRate(yaw_rate=rate, sd=sd):
                store(self.yaw_rates, "yaw_rate", self.yaw_rate_sign * rate, sd)
            case Attitude(roll=roll, pitch=pitch, sd=sd):
                if roll is not None:
                    store(self.rolls, "roll", self.roll_sign * roll - self.roll_zero, sd)
                if pitch is not None:
                    store(self.pitches, "pitch", pitch, sd)
            case Heading(heading=heading, sd=sd):
                store(self.headings, "heading", heading, sd)
            case Fix(fix=fix):
                self.fix, self.fix_ns = fix, measurement.rx_ns
            case UtcTime(utc_ns=utc_ns, sd=sd):
                self.utc.update(t_ns, utc_ns, sd)
            case _:
                pass

    def _repeats(self, samples: deque[Stamped], sample: Stamped) -> bool:
        """Whether it repeats the one before together with a repeated position."""
        epoch_ns = sample[0] + self.latency_ns
        return epoch_ns == self.repeated_epoch_ns and bool(samples) and samples[-1][1:] == sample[1:]

    def take_position(self, position: Position, at: Vector, screens: Screens, moving: bool) -> None:
        """Store a position, if `screens` does not leave it out. at: north, east, m. A repeated one counts as
        new only at standstill. moving: whether the rig moves."""
        rx_ns, repeat = position.rx_ns, position.repeat
        t_ns = self.clock.position(rx_ns) - self.latency_ns
        moves = moving or math.hypot(*self._last_velocity() or (0.0, 0.0)) > DRIVING.standstill
        if moves:
            observe(self.rate, rx_ns, repeat)
        if repeat and moves:
            self.repeated_ns, self.repeated_epoch_ns = rx_ns, t_ns + self.latency_ns
            return
        if self.positions and t_ns <= self.positions[-1][0]:
            return
        self.last_position_ns = rx_ns
        least_sd = RECEIVER_TRACK.position_sd.get(self.fix, 0.0) if self.fix else 0.0
        here: Reading = (t_ns, at[0], at[1], max(position.sd, least_sd))
        who = position.origin.mount or ""
        self.positions.extend(screens.near_path(who, here, self._last_velocity()))

    def _last_velocity(self) -> Vector | None:
        return self.velocities[-1][1:3] if self.velocities else None

    def usable(self) -> bool:
        """Whether positions can be used with this fix. A receiver that never reports its fix is trusted."""
        return self.fix not in NO_POSITION

    def velocity_at(self, t_ns: int) -> tuple[Vector, float] | None:
        """((north, east) m/s, sd per axis) at t, or None."""
        before, after = _around(self.velocities, t_ns)
        if before is None or t_ns - before[0] > RECEIVER_TRACK.hold_ns:
            return None
        if after is None or after[0] - before[0] > RECEIVER_TRACK.longest_interpolated_ns:
            age = (t_ns - before[0]) * 1e-9
            rotated = _rotate((before[1], before[2]), self._rate_near(t_ns) * age)
            return rotated, math.hypot(before[3], RECEIVER_TRACK.unknown_acceleration * age)
        share = (t_ns - before[0]) / (after[0] - before[0])
        return (
            (before[1] + share * (after[1] - before[1]), before[2] + share * (after[2] - before[2])),
            max(before[3], after[3]),
        )

    def position_at(self, t_ns: int) -> tuple[Vector, float, bool] | None:
        """((north, east) m, sd per axis m, whether it had to be extrapolated) at t, or None."""
        before, after = _around(self.positions, t_ns)
        if before is None:
            return None
        if after is not None and after[0] - before[0] <= RECEIVER_TRACK.longest_interpolated_ns:
            return self._interpolate(before, after, t_ns), max(before[3], after[3]), False
        age_ns = t_ns - before[0]
        if age_ns > RECEIVER_TRACK.hold_ns:
            return None
        age = age_ns * 1e-9
        found = self.velocity_at(before[0])
        if found is None:
            return None
        (north, east), sd_velocity = found
        north, east = _rotate((north, east), self._rate_near(t_ns) * age / 2)
        sd = math.sqrt(
            before[3] ** 2
            + (sd_velocity * age) ** 2
            + (RECEIVER_TRACK.unknown_acceleration * age**2 / 2) ** 2
        )
        return (before[1] + north * age, before[2] + east * age), sd, age_ns > RECEIVER_TRACK.near_ns

    def _interpolate(self, before: Planar, after: Planar, t_ns: int) -> Vector:
        """Cubic Hermite path; a straight line where velocities are missing."""
        span = (after[0] - before[0]) * 1e-9
        s = (t_ns - before[0]) / (after[0] - before[0])
        start, end = self.velocity_at(before[0]), self.velocity_at(after[0])
        line = (before[1] + s * (after[1] - before[1]), before[2] + s * (after[2] - before[2]))
        if start is None or end is None:
            return line
        start_weight, end_weight = s * (1 - s) ** 2, -(s**2) * (1 - s)
        blend = s * (1 - s) * (1 - 2 * s)  # of the chord, in the cubic's departure from the line
        return (
            line[0]
            - blend * (after[1] - before[1])
            + span * (start_weight * start[0][0] + end_weight * end[0][0]),
            line[1]
            - blend * (after[2] - before[2])
            + span * (start_weight * start[0][1] + end_weight * end[0][1]),
        )

    def yaw_rate_at(self, t_ns: int) -> tuple[float, float] | None:
        """(yaw rate, sd) at t; None where it is not known, or smoothed."""
        return None if self.smoothed else sample_at(self.yaw_rates, t_ns, RECEIVER_TRACK.hold_ns)

    def _rate_near(self, t_ns: int) -> float:
        found = self.yaw_rate_at(t_ns)
        return found[0] if found else 0.0


def _around(samples: deque[Stamped], t_ns: int) -> tuple[Stamped | None, Stamped | None]:
    """(the last sample at or before t, the first one after it); None where there is none."""
    after: Stamped | None = None
    for sample in reversed(samples):
        if sample[0] <= t_ns:
            return sample, after
        after = sample
    return None, after


def _rotate(vector: Vector, angle: float) -> Vector:
    cosine, sine = math.cos(angle), math.sin(angle)
    return vector[0] * cosine - vector[1] * sine, vector[0] * sine + vector[1] * cosine


def sample_at(samples: deque[Sample], t_ns: int, hold_ns: int) -> tuple[float, float] | None:
    """(value, sd) at t: linear between samples, constant for at most hold_ns after the last; else None."""
    return _value_at(samples, t_ns, hold_ns, lambda difference: difference)


def angle_at(samples: deque[Sample], t_ns: int, hold_ns: int) -> tuple[float, float] | None:
    """As `sample_at`, for angles that wrap."""
    return _value_at(samples, t_ns, hold_ns, wrap)


def _value_at(
    samples: deque[Sample], t_ns: int, hold_ns: int, shortest: Callable[[float], float]
) -> tuple[float, float] | None:
    before, after = _around(samples, t_ns)
    if before is None or t_ns - before[0] > hold_ns:
        return None
    if after is None or after[0] - before[0] > RECEIVER_TRACK.longest_interpolated_ns:
        return before[1], before[2]
    share = (t_ns - before[0]) / (after[0] - before[0])
    return before[1] + share * shortest(after[1] - before[1]), max(before[2], after[2])
