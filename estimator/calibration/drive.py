"""A drive as arrays on one grid of time, before any geometry of the machine file is trusted.

Positions stand in one plane, at the instants that the latencies of the machine file give. What is missing is
not a number.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.pose.geometry import to_plane
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import (
    Attitude,
    Fix,
    FixType,
    Heading,
    Measurement,
    Mount,
    Position,
    Velocity,
    WheelAngle,
    YawRate,
)
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]
Rows = list[tuple[float, ...]]

MOUNTS: Final = tuple(Mount)


@dataclass(frozen=True, slots=True)
class DriveTuning:
    """The grid on which a drive is looked at."""

    step_s: float = tuned(0.2, "s", "of the grid")
    longest_gap_s: float = tuned(1.1, "s", "longest gap to interpolate")
    silent_s: float = tuned(2.0, "s", "silence of the better of two positions until the other counts")
    mean_s: float = tuned(0.2, "s", "over which wheel angle, turn rates, rolls and pitches are averaged")


DRIVE: Final = DriveTuning()


@dataclass(slots=True)
class MeasuredLists:
    """What was measured, in lists. Times s on the clock of Frame.rx_ns, since the first measurement."""

    first_ns: int | None = None
    origin_deg: tuple[float, float] | None = None
    positions: list[Rows] = field(default_factory=lambda: [[] for _ in MOUNTS])  # t, north, east
    velocities: list[Rows] = field(default_factory=lambda: [[] for _ in MOUNTS])  # t, north, east
    yaw_rates: list[Rows] = field(default_factory=lambda: [[] for _ in MOUNTS])  # t, rad/s
    headings: list[Rows] = field(default_factory=lambda: [[] for _ in MOUNTS])  # t, rad
    rolls: list[Rows] = field(default_factory=lambda: [[] for _ in MOUNTS])  # t, rad
    pitches: list[Rows] = field(default_factory=lambda: [[] for _ in MOUNTS])  # t, rad
    wheel: Rows = field(default_factory=list)  # t, rad
    fixes: list[dict[FixType, int]] = field(default_factory=lambda: [{} for _ in MOUNTS])
    position_pgns: list[int] = field(default_factory=lambda: [0] * len(MOUNTS))


def take(heard: MeasuredLists, measurement: Measurement) -> None:
    """Keep one measurement of a mounted receiver or of the wheel-angle sensor."""
    if heard.first_ns is None:
        heard.first_ns = measurement.rx_ns
    t = (measurement.rx_ns - heard.first_ns) * 1e-9
    if isinstance(measurement, WheelAngle):
        heard.wheel.append((t, measurement.angle))
        return
    if measurement.origin.mount is None:
        return
    k = MOUNTS.index(measurement.origin.mount)
    match measurement:
        case Position():
            _take_position(heard, k, t, measurement)
        case Velocity(course=course, speed=speed):
            heard.velocities[k].append((t, speed * np.cos(course), speed * np.sin(course)))
        case YawRate(yaw_rate=rate):
            heard.yaw_rates[k].append((t, rate))
        case Heading(heading=heading):
            heard.headings[k].append((t, heading))
        case Attitude(roll=roll, pitch=pitch):
            for rows, angle in ((heard.rolls[k], roll), (heard.pitches[k], pitch)):
                if angle is not None:
                    rows.append((t, angle))
        case Fix(fix=fix):
            heard.fixes[k][fix] = heard.fixes[k].get(fix, 0) + 1
        case _:
            pass


def _take_position(heard: MeasuredLists, k: int, t: float, position: Position) -> None:
    known, rows = heard.position_pgns[k], heard.positions[k]
    if position.repeat or (known and position.pgn > known and t - rows[-1][0] < DRIVE.silent_s):
        return  # a receiver may send each position in two messages
    heard.position_pgns[k] = position.pgn
    here = (position.latitude_deg, position.longitude_deg)
    if heard.origin_deg is None:
        heard.origin_deg = here
    heard.positions[k].append((t, *to_plane(heard.origin_deg, *here)))


@dataclass(frozen=True, slots=True)
class DriveGrid:
    """n instants, `step_s` apart; receivers in the order of flow.Mount."""

    t: Array  # s, (n,)
    at: Array  # m north and east, (n, 4, 2)
    velocity: Array  # m/s north and east, (n, 4, 2)
    yaw_rate: Array  # rad/s, (n, 4)
    roll: Array  # rad, (n, 4)
    pitch: Array  # rad, (n, 4)
    wheel: Array  # rad, (n,)

    @property
    def complete(self) -> NDArray[np.bool_]:
        """(n,): where all four receivers give positions and velocities."""
        return np.asarray(np.isfinite(self.at).all((1, 2)) & np.isfinite(self.velocity).all((1, 2)))


def drive_of(heard: MeasuredLists, machine: Machine) -> DriveGrid:
    """On the grid. Without a position at all it has no instant."""
    delay = {r.mount: r.latency.value for r in machine.receiver}
    by_mount = {r.mount: r for r in machine.receiver}
    starts = [rows[0][0] for rows in heard.positions if rows]
    ends = [rows[-1][0] for rows in heard.positions if rows]
    n = int((max(ends) - min(starts)) / DRIVE.step_s) if starts else 0
    t: Array = (min(starts) if starts else 0.0) + DRIVE.step_s * np.arange(max(n, 0), dtype=np.float64)
    shape = (len(t), len(MOUNTS))
    at, velocity = np.full((*shape, 2), np.nan), np.full((*shape, 2), np.nan)
    yaw_rate, roll, pitch = np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
    for k, mount in enumerate(MOUNTS):
        then: Array = t + delay.get(mount, 0.0)
        for axis in range(2):
            at[:, k, axis] = _between(heard.positions[k], 1 + axis, then)
            velocity[:, k, axis] = _between(heard.velocities[k], 1 + axis, then)
        pitch[:, k] = _mean(heard.pitches[k], then)
        if mount in by_mount:
            given = by_mount[mount]
            zero = 0.0 if given.roll_zero is None else np.radians(given.roll_zero.value)
            yaw_rate[:, k] = given.yaw_rate_sign * _mean(heard.yaw_rates[k], then)
            roll[:, k] = given.roll_sign * _mean(heard.rolls[k], then) - zero
    wheel = _mean(heard.wheel, t + machine.wheel_angle.delay)
    return DriveGrid(t, at, velocity, yaw_rate, roll, pitch, wheel)


def _columns(rows: Sequence[tuple[float, ...]]) -> Array:
    found = np.array(rows, np.float64)
    later = np.concatenate([[True], np.diff(found[:, 0]) > 0.0])
    return np.asarray(found[later], np.float64)


def _gaps(times: Array, at: Array) -> NDArray[np.bool_]:
    """(n,): outside of the times, or in a gap of them."""
    after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    return np.asarray(
        (times[after] - times[after - 1] > DRIVE.longest_gap_s) | (at < times[0]) | (at > times[-1])
    )


def _between(rows: Rows, column: int, at: Array) -> Array:
    """Linear between rows."""
    if len(rows) < 2:
        return np.full(len(at), np.nan)
    table = _columns(rows)
    return np.where(_gaps(table[:, 0], at), np.nan, np.interp(at, table[:, 0], table[:, column]))


def _mean(rows: Rows, at: Array) -> Array:
    """Means over `mean_s`, of what is linear between rows."""
    if len(rows) < 2:
        return np.full(len(at), np.nan)
    table = _columns(rows)
    times, values = table[:, 0], table[:, 1]
    steps = np.diff(times) * (values[1:] + values[:-1]) / 2
    integral = np.concatenate([[0.0], np.cumsum(steps)])
    ends = [np.interp(at + side * DRIVE.mean_s / 2, times, integral) for side in (-1.0, 1.0)]
    return np.where(_gaps(times, at), np.nan, (ends[1] - ends[0]) / DRIVE.mean_s)
