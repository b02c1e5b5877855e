"""Does each body go as far as its speed says, and lean as a body on wheels does? Before any model of tyres.

A receiver tells position and speed each on its own: over seconds the way and the speed's integral are equal.
A body leans outward in a turn by a few hundredths of a radian per m/s^2 at the most; a roll that follows the
lateral acceleration by a tenth is that of a level nobody corrected for acceleration (atan(a/g)). Tractor and
implement drive over the same slope, so that over half a minute their rolls agree but for a furrow.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.pose.geometry import rotate
from tilth.schemas.flow import BodyPose, Pose

Array = NDArray[np.float64]

NAMES: Final = ("tractor", "implement")
STEP_NS: Final = 200_000_000  # from pose to pose
INTERVAL: Final = 10  # poses (2 s): several metres, beside which the noise of positions is small
SLOWEST: Final = 1.5  # m/s
WAYS: Final = 10.0  # intervals (20 s) of the mean
ENOUGH: Final = 5.0
TOO_FAR: Final = 0.1  # of the way: no slip, slope or latency at a nearly constant speed does as much
MEMORY: Final = 300.0  # poses (60 s) of the moments of roll
LONG: Final = 75.0  # poses (15 s) before rolls are believed
PUSHED: Final = 0.3  # m/s^2, sd of the lateral acceleration from which on it tells
FOLLOWS: Final = 0.8  # correlation
GRADIENT: Final = 0.05  # rad/(m/s^2); a body on its tyres leans by 0.004 to 0.03
APART: Final = math.radians(10.0)  # one wheel in a furrow leans a tractor by less


@dataclass(slots=True)
class Body:
    """Plain data."""

    place: tuple[float, float] | None = None  # north, east, m, where the interval began
    integral: tuple[float, float] = (0.0, 0.0)  # of the velocity since, m
    velocity: tuple[float, float] = (0.0, 0.0)  # north, east, m/s, at the pose before
    poses: int = 0
    weight: float = 0.0  # intervals
    way: float = 0.0  # sums over the last WAYS intervals, m^2: way times integral
    square: float = 0.0  # and integral squared
    rolled: float = 0.0  # poses of the moments
    mean: Array = field(default_factory=lambda: np.zeros(2))  # lateral acceleration, roll
    moments: Array = field(default_factory=lambda: np.zeros((2, 2)))


@dataclass(slots=True)
class MotionCheck:
    """Plain data."""

    bodies: list[Body] = field(default_factory=lambda: [Body(), Body()])
    seen_ns: int = 0


def observe(state: MotionCheck, pose: Pose) -> None:
    """Take one pose."""
    follows = pose.t_ns - state.seen_ns == STEP_NS
    state.seen_ns = pose.t_ns
    for body, now in zip(state.bodies, (pose.tractor, pose.implement), strict=True):
        if not follows:
            body.place = None
        _go(body, now)
        _lean(body, now)


def found(state: MotionCheck) -> dict[str, str]:
    """What contradicts itself: key of the machine file -> what is wrong."""
    wrong = {}
    for name, body in zip(NAMES, state.bodies, strict=True):
        if body.weight >= ENOUGH and abs(body.way / body.square - 1.0) > TOO_FAR:
            key = f"receiver on the {name} (source, latency)"
            ratio = f"{body.way / body.square:.2f} times as far as its receivers' speed says"
            wrong[key] = f"the {name} goes {ratio}: {key}?"
        gradient = _gradient(body)
        if abs(gradient) > GRADIENT:
            key = f"receiver on the {name} (roll)"
            size = f"{math.degrees(gradient):+.1f}° per m/s² of lateral acceleration"
            wrong[key] = (
                f"the {name}'s measured roll follows its turns by {size}, as no tractor leans: {key}?"
            )
    tractor, implement = state.bodies
    apart = float(tractor.mean[1] - implement.mean[1])
    if min(tractor.rolled, implement.rolled) >= LONG and abs(apart) > APART:
        key = "receiver (roll)"
        size = f"{math.degrees(apart):+.0f}° on average"
        wrong[key] = f"tractor and implement lean apart by {size}, on the same ground: {key}?"
    return wrong


def waits(state: MotionCheck) -> bool:
    """Whether both bodies tell their roll, but not long enough to compare them."""
    tractor, implement = (body.rolled for body in state.bodies)
    return min(tractor, implement) > 0.0 and min(tractor, implement) < LONG


def _go(body: Body, now: BodyPose) -> None:
    """Carry on the interval; at its end its way is compared with the integral of its velocity."""
    speed = now.forward_velocity
    if now.x is None or now.y is None or speed is None or now.heading is None or abs(speed) < SLOWEST:
        body.place = None
        return
    before, body.velocity = body.velocity, rotate((speed, now.lateral_velocity or 0.0), now.heading)
    if body.place is None:
        body.place, body.integral, body.poses = (now.x, now.y), (0.0, 0.0), 0
        return
    half_s = STEP_NS * 1e-9 / 2
    north, east = ((one + other) * half_s for one, other in zip(before, body.velocity, strict=True))
    body.integral = (body.integral[0] + north, body.integral[1] + east)
    body.poses += 1
    if body.poses == INTERVAL:
        _compare(body, (now.x - body.place[0], now.y - body.place[1]))
        body.place, body.integral, body.poses = (now.x, now.y), (0.0, 0.0), 0


def _compare(body: Body, way: tuple[float, float]) -> None:
    keep = 1.0 - 1.0 / WAYS
    body.weight = keep * body.weight + 1.0
    body.way = keep * body.way + way[0] * body.integral[0] + way[1] * body.integral[1]
    body.square = keep * body.square + body.integral[0] ** 2 + body.integral[1] ** 2


def _lean(body: Body, now: BodyPose) -> None:
    if now.roll is None or now.forward_velocity is None or now.yaw_rate is None:
        return
    if abs(now.forward_velocity) < SLOWEST:
        return
    sample = np.array([now.forward_velocity * now.yaw_rate, now.roll])
    keep = 1.0 - 1.0 / MEMORY
    body.rolled = keep * body.rolled + 1.0
    off = sample - body.mean
    body.mean += off / body.rolled
    body.moments = keep * body.moments + np.outer(off, sample - body.mean)


def _gradient(body: Body) -> float:
    """Roll per lateral acceleration, rad/(m/s^2), where one follows the other; else 0."""
    if body.rolled < LONG:
        return 0.0
    pushed, rolled = np.sqrt(np.diag(body.moments) / body.rolled)
    together = body.moments[0, 1] / body.rolled
    if pushed < PUSHED or abs(together) < FOLLOWS * pushed * max(rolled, 1e-9):
        return 0.0
    return float(together / pushed**2)
