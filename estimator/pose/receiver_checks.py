"""What may be wrong with receivers from the start, found while driving: smoothed turn rates, wrong roll.

How far a turn rate lags is found by turn_rate_lag, behind the heading of a body's two antennas or, where it
has one receiver alone, behind the heading that this reports itself.

An antenna at height h that leans by the roll φ moves to the right by c h sin φ; c is 1, or 0 where the
receiver reports the point on the ground. That shows where both bodies see the hitch, and in a body's heading
against its turn rate. Measured rolls have noise, which alone would pass for c = 0: its square is taken out
again, and nothing is said before rolls are clearly larger than their noise. A constant slope tells by the
offset of the hitch, as far as the survey is good; uneven ground tells without.
"""

import math
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.pose.aligner import MOUNTS, POSE_NS, Aligner
from tilth.estimator.pose.body import ReportedPoint, baseline
from tilth.estimator.pose.geometry import rotate, wrap
from tilth.estimator.pose.receiver_track import HOLD_NS, SLOW_HOLD_NS, angle_at, sample_at
from tilth.estimator.pose.turn_rate_lag import SURE, Lag, judge, regress, settled, time_constant
from tilth.schemas.flow import WITHOUT_RTK, Flag, FlagKind, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.spread import plus_minus

Array = NDArray[np.float64]

INTERVAL: Final = 10  # poses (2 s): about as long as it takes to turn in
SLOWEST: Final = 1.0  # m/s
GAP_EVERY: Final = 5  # poses (1 s) from one look at the hitch to the next
LARGEST_GAP: Final = 1.0  # m: beyond, it is another fault
OFFSET_SD: Final = 0.04  # m, of the hitch by the survey of antennas and by yaw of the pairs
RESPONSE: Final = (0.5, 0.5)  # mean and sd of c before any data
LARGER: Final = 3.0  # mean square of rolls over that of their noise, from which on they tell
LEAST_ROLL_NOISE: Final = math.radians(0.05)
SMOOTHED: Final = FlagKind.SMOOTHED_YAW_RATE
TWICE: Final = FlagKind.ROLL_CORRECTED_TWICE
NOT: Final = FlagKind.NOT_ROLL_CORRECTED
UNCLEAR: Final = FlagKind.ROLL_CORRECTION
KINDS: Final = (SMOOTHED, TWICE, NOT, UNCLEAR)  # of what is found
_SET: Final = {TWICE: "true", NOT: "false"}


@dataclass(slots=True)
class TurnInterval:
    """Of one body, since an interval began."""

    heading: float = 0.0  # rad, where it began
    roll: float = 0.0
    poses: int = -1


@dataclass(slots=True)
class ReceiverChecks:
    """Plain data."""

    lags: list[Lag] = field(default_factory=lambda: [Lag() for _ in MOUNTS])
    turns: list[TurnInterval] = field(default_factory=lambda: [TurnInterval(), TurnInterval()])
    information: Array = field(default_factory=lambda: np.zeros((5, 5)))
    """What the data say of c of each receiver, as in flow.Mount, and of the hitch's offset, m."""
    vector: Array = field(default_factory=lambda: np.zeros(5))
    rolls: Array = field(default_factory=lambda: np.zeros((2, 2)))
    """Of both bodies: sums of squares of rolls and of their noise, rad^2, where they were looked at."""
    looks: int = 0
    wrong: list[FlagKind | None] = field(
        default_factory=lambda: [None] * 4
    )  # as in flow.Mount: a key of _SET
    unclear: bool = False  # it is wrong somewhere, but it is not known where
    seen_ns: int = 0
    reported: list[Flag] = field(default_factory=list)  # flags of which an event was given


@dataclass(frozen=True, slots=True)
class _Pair:
    """A body's two antennas at a pose, upright."""

    heading: float
    sd_heading: float
    hitch: tuple[float, float]  # north, east, m, as this body sees it
    sd_hitch: float
    weights: tuple[float, float]  # how far the hitch moves per metre of front and rear antenna, across
    length: float


def observe(state: ReceiverChecks, aligner: Aligner, pose: Pose) -> None:
    """Take one pose, and from the aligner what each receiver said at the instant of the one before.

    By then all has been heard: a pose is due at a position, and turn rate and roll come after it.
    """
    follows = pose.t_ns - state.seen_ns == POSE_NS
    state.seen_ns = pose.t_ns
    t_ns = pose.t_ns - POSE_NS
    kinds = {flag.kind for flag in pose.flags}
    speed = pose.tractor.forward_velocity
    pairs: list[_Pair | None] = [None, None]
    if speed is not None and speed > SLOWEST and not kinds & WITHOUT_RTK:
        pairs = [_pair(aligner, body, t_ns) for body in (0, 1)]
    rolls = [_rolls(aligner, body, t_ns) for body in (0, 1)]
    for body, pair in enumerate(pairs):
        _turn(state, aligner, body, pair, rolls[body], t_ns, follows)
    if (pose.t_ns // POSE_NS) % GAP_EVERY == 0:
        _look_at_hitch(state, aligner.machine, pairs, rolls)
        _judge(state, aligner.machine)


def usable_yaw_rates(state: ReceiverChecks) -> frozenset[str]:
    """Mounts of the receivers whose turn rates may be used: all but those found to be smoothed."""
    return frozenset(m.value for m, lag in zip(MOUNTS, state.lags, strict=True) if not lag.smoothed)


def turn_rates_known(state: ReceiverChecks) -> bool:
    """Whether of every turn rate that can be compared with a heading it is known how much it lags."""
    compared = [lag for lag in state.lags if lag.intervals]
    return bool(compared) and all(settled(lag) for lag in compared)


def flags(state: ReceiverChecks) -> list[Flag]:
    """Of all that is wrong now; of a mount, or of `rig` where it is not known which."""
    out = [Flag(SMOOTHED, mount.value) for mount, lag in zip(MOUNTS, state.lags, strict=True) if lag.smoothed]
    out += [Flag(kind, mount.value) for mount, kind in zip(MOUNTS, state.wrong, strict=True) if kind]
    return [*out, Flag(UNCLEAR, "rig")] if state.unclear else out


def events(state: ReceiverChecks) -> list[tuple[str, str]]:
    """(kind, what is wrong and what to do) of what has been found since the last call."""
    now, before = flags(state), state.reported
    state.reported = now
    return [(flag.kind, in_words(state, flag)) for flag in now if flag not in before]


def in_words(state: ReceiverChecks, flag: Flag) -> str:
    """What a flag of `flags` means, and what to do."""
    kind, who = flag.kind, flag.of
    if kind == UNCLEAR:
        return (
            "the hitch moves with roll as if roll_corrected were wrong on the tractor or on the implement: "
            "compare it with what their receivers are set to"
        )
    k = [mount.value for mount in MOUNTS].index(who)
    if kind == SMOOTHED:
        tau, sd = time_constant(state.lags[k])
        return (
            f"{who}: its turn rate lags by {plus_minus(tau, sd, 's')} and is not used, and what was learned "
            "with it is forgotten: turn its smoothing off"
        )
    c, sds = responses(state)
    leans = f"{who}: it moves with roll by {plus_minus(float(c[k]), float(sds[k]))} of its height"
    return f"{leans}: set roll_corrected = {_SET[kind]} in the machine file"


def clock_stepped(state: ReceiverChecks) -> None:
    """Time ran back: intervals under way are given up; what was found stays."""
    state.seen_ns = 0


def responses(state: ReceiverChecks) -> tuple[Array, Array]:
    """(c, its sd) of each receiver, shape (4,), as in flow.Mount; infinite where rolls tell nothing."""
    prior = np.array([*[RESPONSE[1] ** -2] * 4, OFFSET_SD**-2])
    values, vectors = np.linalg.eigh(state.information)
    information = (vectors * np.maximum(values, 0.0)) @ vectors.T + np.diag(prior)
    covariance = np.linalg.inv(information)
    mean = covariance @ (state.vector + prior * np.array([*[RESPONSE[0]] * 4, 0.0]))
    sds = np.sqrt(np.diag(covariance))[:4]
    for body in (0, 1):
        if not _rolls_tell(state, body):
            sds[2 * body : 2 * body + 2] = math.inf
    return mean[:4], sds


# What a pose shows.


def _pair(aligner: Aligner, body: int, t_ns: int) -> _Pair | None:
    """Both antennas of a body as reported, without any roll; None where one is missing or extrapolated."""
    antennas = []
    for receiver in aligner.machine.receiver:
        index = MOUNTS.index(receiver.mount)
        if index // 2 != body:
            continue
        track = aligner.tracks[receiver.mount.value]
        found = track.position_at(t_ns + aligner.latency.excess_ns(index)) if track.usable() else None
        if found is None or found[2]:
            return None
        antennas.append((index, ReportedPoint(found[0], found[1], receiver.position[:2], None, 0.0, 0.0)))
    if len(antennas) != 2:
        return None
    front, rear = (antenna for _, antenna in sorted(antennas, key=itemgetter(0)))
    arm = (front.lever[0] - rear.lever[0], front.lever[1] - rear.lever[1])
    length = math.hypot(*arm)
    pair = baseline(front, rear, 0.0)
    machine = aligner.machine
    place = -machine.tractor.c.value if body == 0 else machine.implement.d.value
    # The hitch is on the line through both antennas, or beside it: so many lengths from the rear one.
    behind = rear.lever
    share = ((place - behind[0]) * arm[0] - behind[1] * arm[1]) / length**2
    to_hitch = rotate((place - behind[0], -behind[1]), pair.heading)
    return _Pair(
        pair.heading, pair.sd_heading, (rear.at[0] + to_hitch[0], rear.at[1] + to_hitch[1]),
        max(front.sd, rear.sd) * math.hypot(share, 1 - share), (share, 1 - share), length,
    )  # fmt: skip


def _rolls(aligner: Aligner, body: int, t_ns: int) -> tuple[float, float] | None:
    """(roll, variance of its noise) of a body: two receivers show by their difference how noisy they are."""
    found_rolls = []
    for index in (2 * body, 2 * body + 1):
        track = aligner.tracks.get(MOUNTS[index].value)
        at_ns = t_ns + aligner.latency.excess_ns(index)
        found = sample_at(track.rolls, at_ns, SLOW_HOLD_NS) if track is not None else None
        if found is not None:
            found_rolls.append(found)
    if not found_rolls:
        return None
    if len(found_rolls) == 2:
        one, other = found_rolls[0][0], found_rolls[1][0]
        return (one + other) / 2, max(((one - other) / 2) ** 2, LEAST_ROLL_NOISE**2)
    return found_rolls[0][0], found_rolls[0][1] ** 2


def _turn(
    state: ReceiverChecks,
    aligner: Aligner,
    body: int,
    pair: _Pair | None,
    roll: tuple[float, float] | None,
    t_ns: int,
    follows: bool,
) -> None:
    """Carry on a body's interval and its receivers'; at their end they are looked at."""
    interval = state.turns[body]
    facing = _own_heading(aligner, body, t_ns) if pair is None else (pair.heading, pair.sd_heading)
    rates = [_rate(aligner, index, t_ns) for index in (2 * body, 2 * body + 1)]
    if facing is None or not follows:
        interval.poses = -1
    else:
        interval.poses += interval.poses >= 0
    ended = interval.poses >= INTERVAL
    change = wrap(facing[0] - interval.heading) if facing is not None else 0.0
    whole = []
    for lag, rate in zip(state.lags[2 * body : 2 * body + 2], rates, strict=True):
        if rate is None or interval.poses < 0:
            lag.poses = -1
        elif lag.poses >= 0:
            lag.integral += (lag.rate + rate) / 2 * POSE_NS * 1e-9
            lag.poses += 1
        lag.rate = rate or 0.0
        if ended and facing is not None and lag.poses == INTERVAL:
            regress(lag, change, INTERVAL * POSE_NS * 1e-9, facing[1])
            if not lag.smoothed:
                whole.append(lag.integral)
    if ended and pair is not None and roll is not None and whole:
        beyond = change - sum(whole) / len(whole)
        _look_at_heading(state, aligner.machine, body, beyond, pair, roll)
    if facing is not None and (ended or interval.poses < 0):
        interval.heading, interval.roll, interval.poses = facing[0], roll[0] if roll else 0.0, 0
        for lag, rate in zip(state.lags[2 * body : 2 * body + 2], rates, strict=True):
            lag.integral, lag.first_rate, lag.poses = 0.0, rate or 0.0, -1 if rate is None else 0


def _own_heading(aligner: Aligner, body: int, t_ns: int) -> tuple[float, float] | None:
    """(heading, sd) that the receiver of a body with one alone reports: where it stands still, too."""
    indices = [MOUNTS.index(receiver.mount) for receiver in aligner.machine.receiver]
    (index, *others) = [index for index in indices if index // 2 == body] or [-1]
    if index < 0 or others:
        return None  # of two, both antennas tell, or nobody: a change from one to the other is no turn
    headings = aligner.tracks[MOUNTS[index].value].headings
    return angle_at(headings, t_ns + aligner.latency.excess_ns(index), HOLD_NS)


def _rate(aligner: Aligner, index: int, t_ns: int) -> float | None:
    track = aligner.tracks.get(MOUNTS[index].value)
    if track is None:
        return None
    found = sample_at(track.yaw_rates, t_ns + aligner.latency.excess_ns(index), HOLD_NS)
    return found[0] if found else None


def _arms(machine: Machine) -> list[float]:
    """Height of each receiver above the ground, m, as in flow.Mount; 0 where there is none."""
    by_mount = {receiver.mount: receiver.position[2] for receiver in machine.receiver}
    return [by_mount.get(mount, 0.0) for mount in MOUNTS]


def _look_at_heading(
    state: ReceiverChecks, machine: Machine, body: int, beyond: float, pair: _Pair, roll: tuple[float, float]
) -> None:
    """beyond: by how much the antennas' heading changed more than the turn rate says, rad."""
    front, rear = 2 * body, 2 * body + 1
    heights = _arms(machine)
    arm = np.zeros(5)
    arm[front], arm[rear] = heights[front] / pair.length, -heights[rear] / pair.length
    sway = math.sin(roll[0]) - math.sin(state.turns[body].roll)
    _add(state, arm * sway, [arm], [2 * roll[1]], beyond, 2 * pair.sd_heading**2)


def _look_at_hitch(
    state: ReceiverChecks,
    machine: Machine,
    pairs: list[_Pair | None],
    rolls: list[tuple[float, float] | None],
) -> None:
    """Where the tractor sees the hitch to the right of where the implement sees it, across the implement."""
    tractor, implement = pairs
    if tractor is None or implement is None or rolls[0] is None or rolls[1] is None:
        return
    north, east = tractor.hitch[0] - implement.hitch[0], tractor.hitch[1] - implement.hitch[1]
    gap = east * math.cos(implement.heading) - north * math.sin(implement.heading)
    if abs(gap) > LARGEST_GAP:
        return
    heights = _arms(machine)
    across = (math.cos(tractor.heading - implement.heading), -1.0)
    arms = []
    for body, pair in enumerate((tractor, implement)):
        arm = np.zeros(5)
        for k in (0, 1):
            arm[2 * body + k] = across[body] * pair.weights[k] * heights[2 * body + k]
        arms.append(arm)
    both = [rolls[0], rolls[1]]
    row = sum((arm * math.sin(roll) for arm, (roll, _) in zip(arms, both, strict=True)), np.zeros(5))
    row[4] = 1.0
    variance = tractor.sd_hitch**2 + implement.sd_hitch**2
    _add(state, row, arms, [noise for _, noise in both], gap, variance)
    for body, (roll, noise) in enumerate(both):
        state.rolls[body] += roll**2, noise
    state.looks += 1


def _add(
    state: ReceiverChecks, row: Array, arms: list[Array], noises: list[float], seen: float, variance: float
) -> None:
    """One look, without what the noise of the rolls adds to the squares of the row."""
    if not (math.isfinite(seen) and np.all(np.isfinite(row))):
        return
    more = np.outer(row, row)
    for arm, noise in zip(arms, noises, strict=True):
        more -= noise * np.outer(arm, arm)
    state.information += more / variance
    state.vector += row * seen / variance


def _judge(state: ReceiverChecks, machine: Machine) -> None:
    """A fault is found once it is sure, and stays until the opposite is."""
    for lag in state.lags:
        judge(lag)
    _judge_rolls(state, machine)


def _judge_rolls(state: ReceiverChecks, machine: Machine) -> None:
    """Which settings of roll_corrected explain the data, of all there are."""
    declared = np.zeros(4)
    free = []
    for receiver in machine.receiver:
        k = MOUNTS.index(receiver.mount)
        declared[k] = 0.0 if receiver.roll_corrected else 1.0
        if _rolls_tell(state, k // 2):
            free.append(k)
    if not free:
        return
    settings = [declared.copy() for _ in range(2 ** len(free))]
    for number, setting in enumerate(settings):
        for bit, k in enumerate(free):
            setting[k] = abs(declared[k] - (number >> bit & 1))  # number 0 is as declared
    scores = np.array([_explains(state, setting) for setting in settings])
    likely = np.array(settings)[scores > scores.max() - SURE**2 / 2]
    if scores[0] == scores.max():
        state.wrong, state.unclear = [None] * 4, False
    elif scores[0] < scores.max() - SURE**2 / 2:
        sure = np.all(likely != declared, axis=0)
        kinds = [TWICE if t == 1.0 else NOT for t in declared]
        state.wrong = [kind if yes else None for kind, yes in zip(kinds, sure, strict=True)]
        state.unclear = not sure.any()


def _explains(state: ReceiverChecks, setting: Array) -> float:
    """Log-likelihood of a setting of c, shape (4,), but for a constant; the offset is what fits best."""
    free = state.vector[4] - state.information[4, :4] @ setting
    total = state.information[4, 4] + OFFSET_SD**-2
    fits = state.vector[:4] @ setting - setting @ state.information[:4, :4] @ setting / 2
    return float(fits + free**2 / total / 2)


def _rolls_tell(state: ReceiverChecks, body: int) -> bool:
    """Whether a body has rolled by clearly more than the noise of its rolls."""
    return bool(0.0 < state.rolls[body, 0] > LARGER * state.rolls[body, 1])
