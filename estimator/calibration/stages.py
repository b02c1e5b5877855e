"""How far a calibration drive is, stage by stage: a fold over measurements, with nothing of the rig trusted.

It takes what a wrong machine file cannot spoil: courses over ground, the line through the two receivers of
a body (without its direction), RTK. So receivers that are exchanged on a body, a pair that is turned and a
wheel angle that reads wrongly count like others. What it counts is added up: any order of driving gives the
same, and a gap costs only what was under way.
"""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration import receivers
from tilth.estimator.calibration.initial_guess import INITIAL_GUESS
from tilth.estimator.calibration.receivers import HeardReceivers
from tilth.estimator.driving import DRIVING
from tilth.estimator.pose.aligner import ALIGNMENT
from tilth.estimator.pose.geometry import to_plane
from tilth.estimator.rig.geometry import between, direction, wrap
from tilth.estimator.rig.residuals import path_angle
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Fix, FixType, Measurement, Mount, Position, Velocity, WheelAngle
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice, NoticeCode, notice

Array = NDArray[np.float64]

MOUNTS: Final = tuple(Mount)
TICK_S: Final = ALIGNMENT.pose_ns * 1e-9


@dataclass(frozen=True, slots=True)
class TallyTuning:
    """What counts for a stage."""

    old_ticks: int = tuned(6, "ticks", "a value that is older counts as not heard")
    gap_ticks: int = tuned(10, "ticks", "after this, what was under way is forgotten")
    window: int = tuned(10, "ticks", "2 s, over which courses are compared")
    directions: int = tuned(72, "directions", "of straight driving")
    alike: int = tuned(4, "directions", "to either side that belong to one line: 45° together")
    angles_deg: tuple[float, ...] = tuned((6.0, 14.0, 22.0), "°", "the wheels are turned a little, half, far")
    steady: float = tuned(math.radians(5.0), "rad", "of the wheels within the window, in a circle")
    turning: float = tuned(0.03, "rad/s", "a turn to a side, in weaving")
    weave_ticks: int = tuned(40, "ticks", "the next turn to the other side follows within 8 s")
    weave_speeds: tuple[float, ...] = tuned(
        (1.9, 3.3), "m/s", "slowly from the first, quickly from the second"
    )


TALLY: Final = TallyTuning()

SIDES: Final = ("left", "right")


@dataclass(slots=True)
class StageTally:
    """What was driven, in sums."""

    parked: int = 0  # instants of TICK_S
    straight: Array = field(default_factory=lambda: np.zeros(TALLY.directions))  # m, by course from north
    rounds: Array = field(default_factory=lambda: np.zeros((2, 3)))  # by SIDES and `angles_deg`
    swings: int = 0  # of the implement from one side to the other
    weaved: list[int] = field(default_factory=lambda: [0, 0])  # instants, slowly and quickly
    moving: int = 0  # instants of driving with everything heard


class SeenNow(NamedTuple):
    """One instant."""

    tick: int
    velocity: tuple[float, float]  # m/s north and east, of the tractor
    turned: float  # rad, of the tractor's line against the implement's, in ±pi/2


@dataclass(slots=True)
class StageFold:
    """Between measurements. Of each mount: what was heard last, and in which instant."""

    wheelbase: float  # m
    origin_deg: tuple[float, float] | None = None  # of the plane in which lines are seen
    tick: int | None = None
    places: dict[Mount, tuple[int, float, float]] = field(default_factory=dict)  # degrees, north and east
    velocities: dict[Mount, tuple[int, float, float]] = field(default_factory=dict)  # m/s north and east
    fixes: dict[Mount, tuple[int, FixType]] = field(default_factory=dict)
    wheel_tick: int | None = None
    window: deque[SeenNow] = field(default_factory=lambda: deque(maxlen=TALLY.window))
    angles: deque[float] = field(default_factory=lambda: deque(maxlen=TALLY.window))  # rad
    folded: int = 0  # the side on which the implement was folded last
    turn: int = 0  # the side of the last turn
    turn_tick: int = 0  # when it followed one to the other side
    stood: int = 0  # instants, since it stands
    doing: str = ""  # the stage that the last instant counts for
    lately: str = ""  # the one that an instant counted for last
    lately_tick: int = 0  # and when
    trouble: Notice | None = None  # why it does not count
    tally: StageTally = field(default_factory=StageTally)
    senders: HeardReceivers = field(default_factory=HeardReceivers)


def initial(machine: Machine) -> StageFold:
    """Of the file only the wheelbase is used."""
    return StageFold(machine.tractor.wheelbase)


def take(state: StageFold, measurement: Measurement) -> None:
    """Count what an instant has shown once the next one begins."""
    receivers.take(state.senders, measurement)
    tick = measurement.rx_ns // ALIGNMENT.pose_ns
    if state.tick is None or abs(tick - state.tick) > TALLY.gap_ticks:
        _forget(state)
        state.tick = tick
    elif tick > state.tick:
        _count(state)
        state.tick = tick
    if isinstance(measurement, WheelAngle):
        state.wheel_tick = tick
        return
    mount = measurement.origin.mount
    if mount is None:
        return
    match measurement:
        case Position(latitude_deg=latitude, longitude_deg=longitude):
            state.places[mount] = (tick, latitude, longitude)
        case Velocity(course=course, speed=speed):
            state.velocities[mount] = (tick, speed * math.cos(course), speed * math.sin(course))
        case Fix(fix=fix):
            state.fixes[mount] = (tick, fix)
        case _:
            pass


def _forget(state: StageFold) -> None:
    """What was under way."""
    for heard in (state.places, state.velocities, state.fixes):
        heard.clear()
    state.wheel_tick = None
    _interrupt(state)


def _interrupt(state: StageFold) -> None:
    state.window.clear()
    state.angles.clear()
    state.folded = state.turn = state.stood = 0


def _count(state: StageFold) -> None:
    """The instant that has ended."""
    assert state.tick is not None
    state.doing, state.trouble = "", _trouble(state)
    if state.trouble is not None:
        _interrupt(state)
        return
    _count_seen(state, _seen(state))
    if state.doing:
        state.lately, state.lately_tick = state.doing, state.tick


def _count_seen(state: StageFold, now: SeenNow) -> None:
    state.window.append(now)
    speed = math.hypot(*now.velocity)
    state.stood = state.stood + 1 if speed < DRIVING.standstill else 0
    if speed < DRIVING.standstill:
        state.tally.parked += 1
        state.doing = "park"
    if speed < INITIAL_GUESS.moving:
        state.angles.clear()
        return
    state.tally.moving += 1
    _count_swing(state, now)
    if len(state.window) < TALLY.window:
        return
    rate, course = _turning(state.window)
    state.angles.append(path_angle(state.wheelbase, speed, rate))
    if speed > DRIVING.cruise and abs(rate) < INITIAL_GUESS.straight:
        state.tally.straight[int(course / math.tau * TALLY.directions) % TALLY.directions] += speed * TICK_S
        state.doing = "straight"
    _count_circle(state, rate, speed)
    _count_weaving(state, rate, speed)


def _trouble(state: StageFold) -> Notice | None:
    """Why nothing can be learned now, None where it can."""
    assert state.tick is not None
    heard = (state.places, state.velocities)
    fresh = [all(_is_fresh(state.tick, table.get(mount)) for table in heard) for mount in MOUNTS]
    silent = [mount.value for mount, is_fresh in zip(MOUNTS, fresh, strict=True) if not is_fresh]
    if silent:
        return notice(NoticeCode.NOT_HEARD, mounts=_listed(silent))
    without = [
        mount.value
        for mount in MOUNTS
        if mount in state.fixes and state.fixes[mount][1] is not FixType.RTK_FIXED
    ]
    if without:
        return notice(NoticeCode.WITHOUT_RTK, mounts=_listed(without))
    if state.wheel_tick is None or state.tick - state.wheel_tick > TALLY.old_ticks:
        return notice(NoticeCode.NO_WHEEL_ANGLE)
    return None


def _is_fresh(tick: int, row: tuple[int, float, float] | None) -> bool:
    return row is not None and tick - row[0] <= TALLY.old_ticks


def _seen(state: StageFold) -> SeenNow:
    assert state.tick is not None
    if state.origin_deg is None:
        state.origin_deg = state.places[MOUNTS[0]][1:]
    at = [to_plane(state.origin_deg, *state.places[mount][1:]) for mount in MOUNTS]
    front, rear = (state.velocities[mount][1:] for mount in MOUNTS[:2])
    velocity = ((front[0] + rear[0]) / 2, (front[1] + rear[1]) / 2)
    lines = [direction(between(at[k], at[k + 1])) for k in (0, 2)]
    turned = (lines[0] - lines[1] + math.pi / 2) % math.pi - math.pi / 2  # whichever is in front
    return SeenNow(state.tick, velocity, turned)


def _turning(window: Iterable[SeenNow]) -> tuple[float, float]:
    """(rad/s, course in rad) from the mean velocities of both halves of a full window."""
    rows = list(window)
    half = TALLY.window // 2
    courses, middles = [], []
    for part in (rows[:half], rows[half:]):
        courses.append(
            direction((sum(row.velocity[0] for row in part), sum(row.velocity[1] for row in part)))
        )
        middles.append(sum(row.tick for row in part) / half)
    apart = wrap(courses[1] - courses[0])
    return apart / ((middles[1] - middles[0]) * TICK_S), courses[1] % math.tau


def _count_swing(state: StageFold, now: SeenNow) -> None:
    if abs(now.turned) < INITIAL_GUESS.folded:
        return
    side = 1 if now.turned > 0 else -1
    if state.folded == -side:
        state.tally.swings += 1
        state.doing = "fold"
    state.folded = side


def _count_circle(state: StageFold, rate: float, speed: float) -> None:
    angles = state.angles
    if len(angles) < TALLY.window or speed > INITIAL_GUESS.slow or max(angles) - min(angles) > TALLY.steady:
        return
    size = math.degrees(abs(sum(angles) / TALLY.window))
    bands = [k for k, least in enumerate(TALLY.angles_deg) if size >= least]
    if bands:
        state.tally.rounds[1 if rate > 0 else 0, bands[-1]] += abs(rate) * TICK_S / math.tau
        state.doing = "circles"


def _count_weaving(state: StageFold, rate: float, speed: float) -> None:
    assert state.tick is not None
    if abs(rate) > TALLY.turning:
        side = 1 if rate > 0 else -1
        if state.turn == -side:
            state.turn_tick = state.tick
        elif not state.turn:
            state.turn_tick = state.tick - TALLY.weave_ticks - 1
        state.turn = side
    weaves = state.turn != 0 and state.tick - state.turn_tick <= TALLY.weave_ticks
    if weaves and speed >= TALLY.weave_speeds[0]:
        state.tally.weaved[1 if speed >= TALLY.weave_speeds[1] else 0] += 1
        state.doing = "weave"


def there_and_back(tally: StageTally, wanted: float) -> tuple[float, float]:
    """m driven straight there and back, the longer way first, on the line where most of `wanted` each way is
    driven."""
    there = np.zeros(TALLY.directions)
    for k in range(-TALLY.alike, TALLY.alike + 1):
        there += np.roll(tally.straight, k)
    back = np.roll(there, TALLY.directions // 2)
    best = int(np.argmax(np.minimum(there, wanted) + np.minimum(back, wanted)))
    ways = float(there[best]), float(back[best])
    return max(ways), min(ways)


def _listed(mounts: list[str]) -> str:
    return ", ".join(mounts).replace("_", " ")
