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
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

from tilth.estimator.driving import DRIVING
from tilth.estimator.pose.aligner import ALIGNMENT, Aligner
from tilth.estimator.pose.receiver_track import sample_at
from tilth.estimator.rig.numbers import HYPOTHESIS, WHEEL_SPEED
from tilth.estimator.rig.residuals import speed_off
from tilth.estimator.tuning import tuned
from tilth.schemas.diagnosis import Diagnosis, DiagnosisState
from tilth.schemas.flow import WITHOUT_RTK, Accepted, Pose
from tilth.schemas.machine import Machine


@dataclass(frozen=True, slots=True)
class TyreWatchTuning:
    """When the tyres turn more than they did."""

    straight: float = tuned(0.1, "rad/s", "turn rates of straight driving")
    average: int = tuned(20, "poses", "4 s whose speeds are averaged")
    each: int = tuned(5, "poses", "1 s from one average to the next")
    steady: float = tuned(0.3, "m/s", "between slowest and fastest of them: else the wheels' delay matters")
    possible: float = tuned(0.3, "1", "of the ratio's logarithm; beyond, it is no speed of these wheels")
    turn: float = tuned(1.0, "rad", "after which a stretch ends")
    shortest: int = tuned(8, "averages", "of a stretch; what is shorter goes into the next one")
    longest: int = tuned(120, "averages", "of a stretch")
    recent: int = tuned(5, "stretches", "that are compared")
    agreeing: int = tuned(4, "stretches", "of these, that have the floor")
    at_turn: int = tuned(8, "averages", "at the ends of a stretch, where an implement is lifted")
    hardly_more: float = tuned(0.008, "1", "of the logarithm, than the lowest ratio of the stretch")
    agree: float = tuned(0.01, "1", "of the logarithm, within which they have it")
    floor_sd: float = tuned(0.005, "1", "of the logarithm: light driving slips too, on each soil otherwise")
    least: float = tuned(0.018, "1", "of the logarithm: a smaller change is not told from that")
    sds: float = tuned(2.5, "sd", "of floor and known factor; a smaller change is none")
    back: float = tuned(0.5, "1", "share of the limit below which the change is over")
    stand_ns: int = tuned(300_000_000_000, "ns", "standing so long, tyres may be changed")


TYRE_WATCH: Final = TyreWatchTuning()


@dataclass(slots=True)
class RadiusChange:
    """A factor that is not the known one any more, and has not been accepted. Factors, not logarithms."""

    before: float
    sd_before: float
    now: float
    sd: float
    since_ns: int

    @property
    def diagnosis(self) -> Diagnosis:
        """By how much the radius has changed."""
        row = HYPOTHESIS[WHEEL_SPEED]
        return Diagnosis(
            row.code, row.key, (WHEEL_SPEED,), row.numbers, (self.now, self.before),
            (self.sd, self.sd_before), self.since_ns, DiagnosisState.ISOLATED,
        )  # fmt: skip


@dataclass(slots=True)
class WheelSpeedState:
    """Plain data; logarithms of indicated over true speed where not said otherwise."""

    poses: int = 0  # in a row, up to now, of which an average may be made
    wheels: list[float] = field(default_factory=list)  # m/s, of the last `average` of them
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


def observe(state: WheelSpeedState, aligner: Aligner, pose: Pose) -> Diagnosis | None:
    """Take one pose. Returns what was found with it."""
    wheels = sample_at(aligner.wheel_speeds, pose.t_ns, ALIGNMENT.wheel_hold_ns)
    ground = pose.tractor.forward_velocity
    if any(flag.kind in WITHOUT_RTK and flag.of.startswith("tractor") for flag in pose.flags):
        ground = None
    now = Instant(pose.t_ns, ground, None if wheels is None else wheels[0], pose.tractor.yaw_rate)
    return take(state, aligner.machine, now)


def take(state: WheelSpeedState, machine: Machine, now: Instant) -> Diagnosis | None:
    """The same with the speeds of one instant."""
    _stand(state, now)
    if now.yaw_rate is not None and abs(now.yaw_rate) > TYRE_WATCH.straight:
        state.turned += abs(now.yaw_rate) * ALIGNMENT.pose_ns * 1e-9
    ratio = _average(state, now)
    if ratio is None:
        return None
    ends = state.turned > TYRE_WATCH.turn or len(state.averages) >= TYRE_WATCH.longest
    if not ends or len(state.averages) < TYRE_WATCH.shortest:
        state.averages.append(ratio)
        return None
    _end_stretch(state)
    state.averages.append(ratio)
    return _look(state, machine)


def _stand(state: WheelSpeedState, now: Instant) -> None:
    """After the machine has stood for long, all is counted anew: tyres may have been changed."""
    if max(now.ground or 0.0, now.wheels or 0.0) < DRIVING.moving:
        return
    if state.since_ns == 0 or now.t_ns - state.moving_ns > TYRE_WATCH.stand_ns:
        if state.floor is not None and state.change is None:
            state.learned = state.floor if state.learned is None else min(state.floor, state.learned)
        state.lows, state.lowest, state.floor, state.since_ns = [], math.inf, None, now.t_ns
        _begin_stretch(state)
        _begin_average(state)
    state.moving_ns = now.t_ns


def _average(state: WheelSpeedState, now: Instant) -> float | None:
    """Logarithm of the mean ratio of the last 4 s, each second in which they were straight and steady."""
    ground, wheels, yaw_rate = now.ground, now.wheels, now.yaw_rate
    straight = yaw_rate is not None and abs(yaw_rate) < TYRE_WATCH.straight
    if ground is None or wheels is None or not straight or ground < DRIVING.cruise:
        _begin_average(state)
        return None
    state.poses += 1
    state.wheels = [*state.wheels, wheels][-TYRE_WATCH.average :]
    state.ground = [*state.ground, ground][-TYRE_WATCH.average :]
    if state.poses < TYRE_WATCH.average or state.poses % TYRE_WATCH.each:
        return None
    if max(state.ground) - min(state.ground) > TYRE_WATCH.steady:
        return None
    ratio = speed_off(max(sum(state.wheels), 1e-3), sum(state.ground))
    return ratio if abs(ratio) < TYRE_WATCH.possible else None


def _begin_average(state: WheelSpeedState) -> None:
    state.poses, state.wheels, state.ground = 0, [], []


def _begin_stretch(state: WheelSpeedState) -> None:
    state.averages, state.turned = [], 0.0


def _end_stretch(state: WheelSpeedState) -> None:
    """Of no use for the floor is a stretch that was driven lightest far from its turns."""
    low = min(state.averages)
    at_turns = min(state.averages[: TYRE_WATCH.at_turn] + state.averages[-TYRE_WATCH.at_turn :])
    state.lows = [*state.lows, low if at_turns < low + TYRE_WATCH.hardly_more else math.inf][
        -TYRE_WATCH.recent :
    ]
    state.lowest = min(state.lowest, low)
    _begin_stretch(state)


def floor_of(lows: list[float]) -> float | None:
    """The floor of the lowest ratios of some stretches; None where they do not agree on one."""
    ordered = sorted(lows)
    for k in range(len(ordered) - TYRE_WATCH.agreeing + 1):
        chosen = ordered[k : k + TYRE_WATCH.agreeing]
        if chosen[-1] - chosen[0] < TYRE_WATCH.agree:
            return sum(chosen) / TYRE_WATCH.agreeing
    return None


def known(state: WheelSpeedState, machine: Machine) -> tuple[float, float] | None:
    """(logarithm, sd) of the factor at no slip as it was; None where nothing tells it."""
    factor = machine.tractor.wheel_speed_factor
    if factor is not None:
        return math.log(factor.value), factor.sd / factor.value
    return None if state.learned is None else (state.learned, TYRE_WATCH.floor_sd)


def _look(state: WheelSpeedState, machine: Machine) -> Diagnosis | None:
    recent = floor_of(state.lows)
    if recent is None:
        return None
    state.floor = recent if state.floor is None else min(state.floor, recent)
    factor = known(state, machine)
    if factor is None:
        return None
    mean, sd = factor
    limit = max(TYRE_WATCH.least, TYRE_WATCH.sds * math.hypot(sd, TYRE_WATCH.floor_sd))
    change = state.change
    if change is not None:
        change.now, change.sd = math.exp(recent), math.exp(recent) * TYRE_WATCH.floor_sd
        if abs(recent - mean) > TYRE_WATCH.back * limit:
            return None
        state.change = None
        return replace(change.diagnosis, state=DiagnosisState.CLEARED)
    larger = recent < mean - limit
    all_agree = len(state.lows) == TYRE_WATCH.recent and max(state.lows) - min(state.lows) < TYRE_WATCH.agree
    smaller = all_agree and state.floor > mean + limit and state.lowest > mean + TYRE_WATCH.back * limit
    if not larger and not smaller:
        return None
    before, now = math.exp(mean), math.exp(recent)
    state.change = RadiusChange(before, before * sd, now, now * TYRE_WATCH.floor_sd, state.since_ns)
    return state.change.diagnosis


def proposal(state: WheelSpeedState, t_ns: int) -> Accepted | None:
    """The value that may be accepted; None where there is none."""
    if state.change is None:
        return None
    found = state.change.diagnosis
    return Accepted(t_ns, WHEEL_SPEED, found.amounts, found.sds)


def accept(state: WheelSpeedState) -> None:
    """The machine file has the value from now on."""
    state.change = None
