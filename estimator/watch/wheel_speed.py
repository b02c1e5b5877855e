"""Has the radius of the driven tyres changed? Their speed (PGN 65096) against that over ground by RTK.

Indicated over true speed is F / (1 - s): a factor F, which holds the radius, and the slip s of the driven
tyres. Slip is 0 to 15 % and changes with draft and soil, so one ratio tells nothing of the radius. But slip
does not go below zero while the tyres pull, and it is near zero wherever the tractor runs light: on a
headland with the implement lifted, on a road. So driving goes into stretches, from turn to turn, and of each
only its lowest ratio counts. Where those of four out of five stretches agree within 1 %, they are the
**floor**: the ratio of light driving. By chance, draft that varies seldom gives the same lowest ratio four
times.

A floor below the known factor cannot be slip: the tyres are larger. A floor above it may be slip, so more is
asked: tyres are changed while the machine stands, and so all driving since it last stood for five minutes, or
since the run began, must have been above it.

The known factor is that of the machine file. Where that has none, it is the floor of what was driven before
the machine stood, if there was one; then only a change while the run goes on is found.

What this cannot do: see a change of less than 2 %, since light driving on other soil gives as much; tell a
floor from slip that is the same all over a field, headlands included; find anything in work without light
driving in each stretch, on long rows sooner than four turns, or where nobody sends wheel-based speed.
"""

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from tilth.estimator.pose.aligner import ALIGNMENT, Aligner
from tilth.estimator.pose.receiver_track import sample_at
from tilth.estimator.watch.accepted import WHEEL_SPEED, in_words
from tilth.schemas.flow import WITHOUT_RTK, Accepted, Pose
from tilth.schemas.machine import Machine

SLOWEST: Final = 1.5  # m/s
STRAIGHT: Final = 0.1  # rad/s
MOVING: Final = 0.3  # m/s
HOLD_NS: Final = 250_000_000  # of the last wheel-based speed
AVERAGE: Final = 20  # poses (4 s) whose speeds are averaged
EACH: Final = 5  # poses (1 s) from one average to the next
STEADY: Final = 0.3  # m/s, between slowest and fastest of them: else the delay of the wheels' speed matters
POSSIBLE: Final = 0.3  # of the logarithm of the ratio, about 1; beyond, it is no speed of these wheels
TURN: Final = 1.0  # rad, after which a stretch ends
SHORTEST, LONGEST = 8, 120  # averages of a stretch; what is shorter goes into the next one
RECENT, AGREEING = 5, 4  # stretches; how many of them have the floor
AT_TURN: Final = 8  # averages of a stretch, next to the turns at its ends, where an implement is lifted
HARDLY_MORE: Final = 0.008  # of the logarithm, than the lowest ratio of the stretch
AGREE: Final = 0.01  # of the logarithm, within which they have it
FLOOR_SD: Final = 0.005  # of the logarithm: light driving has some slip too, on each soil another
LEAST: Final = 0.018  # of the logarithm: a smaller change is not told from that
SDS: Final = 2.5  # of floor and known factor; a smaller change is none
BACK: Final = 0.5  # share of the limit below which the change is over
STAND_NS: Final = 300_000_000_000  # standing so long, tyres may be changed


@dataclass(slots=True)
class RadiusChange:
    """A factor that is not the known one any more, and has not been accepted. Factors, not logarithms."""

    before: float
    sd_before: float
    now: float
    sd: float
    since_ns: int


@dataclass(slots=True)
class WheelSpeedState:
    """Plain data; logarithms of indicated over true speed where not said otherwise."""

    poses: int = 0  # in a row, up to now, of which an average may be made
    wheels: list[float] = field(default_factory=list)  # m/s, of the last AVERAGE of them
    ground: list[float] = field(default_factory=list)  # m/s
    averages: list[float] = field(default_factory=list)  # in the stretch of now
    turned: float = 0.0  # rad, in turns of the stretch
    moving_ns: int = 0  # when it last moved
    since_ns: int = 0  # since when it has not stood
    lows: list[float] = field(default_factory=list)  # of the last stretches since then
    lowest: float = math.inf  # of all stretches since then
    floor: float | None = None  # lowest floor since then
    learned: float | None = None  # lowest floor before that, where the machine file has no factor
    change: RadiusChange | None = None


class Instant(NamedTuple):
    """Speeds at the instant of a pose."""

    t_ns: int
    ground: float | None  # m/s, forward, None without RTK
    wheels: float | None  # m/s
    yaw_rate: float | None  # rad/s


class RadiusFound(NamedTuple):
    """What is new: the radius has changed, or it is what it was."""

    change: RadiusChange
    back: bool = False


def observe(state: WheelSpeedState, aligner: Aligner, pose: Pose) -> RadiusFound | None:
    """Take one pose. Returns what was found with it."""
    wheels = sample_at(aligner.wheel_speeds, pose.t_ns, HOLD_NS)
    ground = pose.tractor.forward_velocity
    if any(flag.kind in WITHOUT_RTK and flag.of.startswith("tractor") for flag in pose.flags):
        ground = None
    now = Instant(pose.t_ns, ground, None if wheels is None else wheels[0], pose.tractor.yaw_rate)
    return take(state, aligner.machine, now)


def take(state: WheelSpeedState, machine: Machine, now: Instant) -> RadiusFound | None:
    """The same with the speeds of one instant."""
    _stand(state, now)
    if now.yaw_rate is not None and abs(now.yaw_rate) > STRAIGHT:
        state.turned += abs(now.yaw_rate) * ALIGNMENT.pose_ns * 1e-9
    ratio = _average(state, now)
    if ratio is None:
        return None
    ends = state.turned > TURN or len(state.averages) >= LONGEST
    if not ends or len(state.averages) < SHORTEST:
        state.averages.append(ratio)
        return None
    _end_stretch(state)
    state.averages.append(ratio)
    return _look(state, machine)


def _stand(state: WheelSpeedState, now: Instant) -> None:
    """After the machine has stood for long, all is counted anew: tyres may have been changed."""
    if max(now.ground or 0.0, now.wheels or 0.0) < MOVING:
        return
    if state.since_ns == 0 or now.t_ns - state.moving_ns > STAND_NS:
        if state.floor is not None and state.change is None:
            state.learned = state.floor if state.learned is None else min(state.floor, state.learned)
        state.lows, state.lowest, state.floor, state.since_ns = [], math.inf, None, now.t_ns
        _begin_stretch(state)
        _begin_average(state)
    state.moving_ns = now.t_ns


def _average(state: WheelSpeedState, now: Instant) -> float | None:
    """Logarithm of the mean ratio of the last 4 s, each second in which they were straight and steady."""
    ground, wheels, yaw_rate = now.ground, now.wheels, now.yaw_rate
    straight = yaw_rate is not None and abs(yaw_rate) < STRAIGHT
    if ground is None or wheels is None or not straight or ground < SLOWEST:
        _begin_average(state)
        return None
    state.poses += 1
    state.wheels = [*state.wheels, wheels][-AVERAGE:]
    state.ground = [*state.ground, ground][-AVERAGE:]
    if state.poses < AVERAGE or state.poses % EACH:
        return None
    if max(state.ground) - min(state.ground) > STEADY:
        return None
    ratio = math.log(max(sum(state.wheels), 1e-3) / sum(state.ground))
    return ratio if abs(ratio) < POSSIBLE else None


def _begin_average(state: WheelSpeedState) -> None:
    state.poses, state.wheels, state.ground = 0, [], []


def _begin_stretch(state: WheelSpeedState) -> None:
    state.averages, state.turned = [], 0.0


def _end_stretch(state: WheelSpeedState) -> None:
    """Of no use for the floor is a stretch that was driven lightest far from its turns."""
    low = min(state.averages)
    at_turns = min(state.averages[:AT_TURN] + state.averages[-AT_TURN:])
    state.lows = [*state.lows, low if at_turns < low + HARDLY_MORE else math.inf][-RECENT:]
    state.lowest = min(state.lowest, low)
    _begin_stretch(state)


def floor_of(lows: list[float]) -> float | None:
    """The floor of the lowest ratios of some stretches; None where they do not agree on one."""
    ordered = sorted(lows)
    for k in range(len(ordered) - AGREEING + 1):
        chosen = ordered[k : k + AGREEING]
        if chosen[-1] - chosen[0] < AGREE:
            return sum(chosen) / AGREEING
    return None


def known(state: WheelSpeedState, machine: Machine) -> tuple[float, float] | None:
    """(logarithm, sd) of the factor at no slip as it was; None where nothing tells it."""
    factor = machine.tractor.wheel_speed_factor
    if factor is not None:
        return math.log(factor.value), factor.sd / factor.value
    return None if state.learned is None else (state.learned, FLOOR_SD)


def _look(state: WheelSpeedState, machine: Machine) -> RadiusFound | None:
    recent = floor_of(state.lows)
    if recent is None:
        return None
    state.floor = recent if state.floor is None else min(state.floor, recent)
    factor = known(state, machine)
    if factor is None:
        return None
    mean, sd = factor
    limit = max(LEAST, SDS * math.hypot(sd, FLOOR_SD))
    change = state.change
    if change is not None:
        change.now, change.sd = math.exp(recent), math.exp(recent) * FLOOR_SD
        if abs(recent - mean) > BACK * limit:
            return None
        state.change = None
        return RadiusFound(change, back=True)
    larger = recent < mean - limit
    all_agree = len(state.lows) == RECENT and max(state.lows) - min(state.lows) < AGREE
    smaller = all_agree and state.floor > mean + limit and state.lowest > mean + BACK * limit
    if not larger and not smaller:
        return None
    before, now = math.exp(mean), math.exp(recent)
    state.change = RadiusChange(before, before * sd, now, now * FLOOR_SD, state.since_ns)
    return RadiusFound(state.change)


def message(found: RadiusFound) -> str:
    """For the event."""
    if found.back:
        return "the tyres' radius is what it was before: tractor.wheel_speed_factor"
    return f"{describe(found.change)}. No estimate uses it; accept it as it is now ({WHEEL_SPEED})"


def describe(change: RadiusChange) -> str:
    """By how much the radius has changed."""
    one = _accepted(change, 0)
    return in_words(WHEEL_SPEED, one.amounts, one.sds)


def proposal(state: WheelSpeedState, t_ns: int) -> Accepted | None:
    """The value that may be accepted; None where there is none."""
    return None if state.change is None else _accepted(state.change, t_ns)


def _accepted(change: RadiusChange, t_ns: int) -> Accepted:
    return Accepted(t_ns, WHEEL_SPEED, (change.now, change.before), (change.sd, change.sd_before))


def accept(state: WheelSpeedState) -> None:
    """The machine file has the value from now on."""
    state.change = None
