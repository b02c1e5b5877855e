"""Finds wrong settings of receivers while driving: smoothed turn rates, wrong roll correction.

turn_rate_lag finds how far a turn rate lags behind the heading: that of a body's two antennas or, if the body
has only one receiver, the heading that it reports.

With roll φ, the point reported by an antenna at height h moves to the right by c h sin φ. The response c is
1, or 0 if the receiver reports the point on the ground. It is observed in two ways: in the gap between the
hitch as seen from either body, and in a body's heading change against the integral of its turn rate. Both are
linear in c, so c follows from the normal equations (information and vector). Noise of the measured rolls
would pull c towards 0: its square is subtracted from the information, and nothing is reported before rolls
are clearly larger than their noise. On a constant slope the offset of the hitch is the evidence, within the
accuracy of the survey; uneven ground needs no such accuracy.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.driving import DRIVING
from tilth.estimator.pose.aligner import ALIGNMENT, MOUNTS, Aligner
from tilth.estimator.pose.body import ReportedPoint, baseline, hitch
from tilth.estimator.pose.receiver_track import RECEIVER_TRACK, angle_at, sample_at
from tilth.estimator.pose.turn_rate_lag import (
    TURN_RATE_LAG,
    Lag,
    regress,
    settled,
    time_constant,
    update_verdict,
)
from tilth.estimator.rig.geometry import Vector, between, length, wrap
from tilth.estimator.rig.residuals import hitch_gap, hitch_shares
from tilth.estimator.tuning import tuned
from tilth.schemas.diagnosis import Diagnosis
from tilth.schemas.flow import WITHOUT_RTK, Flag, FlagKind, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code
from tilth.schemas.spread import WITHIN

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ReceiverCheckTuning:
    """When a receiver is accused of smoothing, or of another roll correction than the file has."""

    interval: int = tuned(10, "poses", "2 s: about as long as it takes to turn in")
    hitch_sample_poses: int = tuned(5, "poses", "1 s between two samples of the gap at the hitch")
    hitch_samples_in_one: float = tuned(4.0, "samples", "that count as one")
    """Errors of receivers last for half a minute, and so does a roll on a slope. Counted as independent, they
    accused 6 of 93 right files on plants of a stranger."""
    largest_gap: float = tuned(1.0, "m", "a larger gap has another cause")
    offset_sd: float = tuned(0.04, "m", "of the gap at the hitch, by antennas and yaw of the pairs")
    response_prior: tuple[float, ...] = tuned((0.5, 0.5), "1", "mean and sd of c before any data")
    least_roll_to_noise: float = tuned(3.0, "1", "least mean square of rolls over their noise's")
    least_roll_noise: float = tuned(math.radians(0.05), "rad", "of a roll")


RECEIVER_CHECKS: Final = ReceiverCheckTuning()

SMOOTHED: Final = FlagKind.SMOOTHED_YAW_RATE
TWICE: Final = FlagKind.ROLL_CORRECTED_TWICE
NOT: Final = FlagKind.NOT_ROLL_CORRECTED
UNCLEAR: Final = FlagKind.ROLL_CORRECTION
KINDS: Final = (SMOOTHED, TWICE, NOT, UNCLEAR)  # of all faults that are found here


@dataclass(slots=True)
class TurnInterval:
    """The interval of one body over which a heading change is compared with turn rates."""

    heading: float = 0.0  # rad, at its start
    roll: float = 0.0  # rad, at its start
    poses: int = -1  # since its start; -1: none has begun


@dataclass(slots=True)
class ReceiverChecks:
    """State of the checks; lists of four in the order of flow.Mount, lists of two tractor, implement."""

    lags: list[Lag] = field(default_factory=lambda: [Lag() for _ in MOUNTS])
    turns: list[TurnInterval] = field(default_factory=lambda: [TurnInterval(), TurnInterval()])
    information: Array = field(default_factory=lambda: np.zeros((5, 5)))
    """Information matrix of the data on c of each receiver, as in flow.Mount, and on the hitch's offset,
    m."""
    vector: Array = field(default_factory=lambda: np.zeros(5))
    rolls: Array = field(default_factory=lambda: np.zeros((2, 3)))
    """Of both bodies: sums of squares of the rolls and of their noise over the hitch samples, rad^2, and the
    mean of half the difference of two receivers' rolls, rad: their zeros differ, which is no noise."""
    hitch_samples: int = 0
    wrong: list[FlagKind | None] = field(default_factory=lambda: [None] * 4)  # TWICE, NOT
    unclear: bool = False  # roll_corrected is wrong somewhere, but it is not known where
    last_pose_ns: int = 0
    reported: list[Flag] = field(default_factory=list)  # flags for which an event has been published


@dataclass(frozen=True, slots=True)
class _Pair:
    """A body's two antennas at one instant, without any correction for roll."""

    heading: float  # rad
    sd_heading: float  # rad
    hitch: Vector  # north, east, m, as seen from this body
    sd_hitch: float  # m
    shares: tuple[float, float]  # lateral shift of the hitch per lateral shift of front and rear antenna
    length: float  # of the baseline, m


def observe(state: ReceiverChecks, aligner: Aligner, pose: Pose) -> None:
    """Take one pose, and from the aligner the measurements at the instant of the pose before.

    The pose before, since a pose is due as soon as the positions are there, and turn rate and roll of the
    same epoch come after them.
    """
    follows = pose.t_ns - state.last_pose_ns == ALIGNMENT.pose_ns
    state.last_pose_ns = pose.t_ns
    t_ns = pose.t_ns - ALIGNMENT.pose_ns
    kinds = {flag.kind for flag in pose.flags}
    speed = pose.tractor.forward_velocity
    pairs: list[_Pair | None] = [None, None]
    if speed is not None and speed > DRIVING.under_way and not kinds & WITHOUT_RTK:
        pairs = [_pair(aligner, body, t_ns) for body in (0, 1)]
    rolls = [_rolls(state, aligner, body, t_ns) for body in (0, 1)]
    for body, pair in enumerate(pairs):
        _update_intervals(state, aligner, body, pair, rolls[body], t_ns, follows)
    if (pose.t_ns // ALIGNMENT.pose_ns) % RECEIVER_CHECKS.hitch_sample_poses == 0:
        _add_hitch_sample(state, aligner.machine, pairs, rolls)
        _judge(state, aligner.machine)


def lagging(state: ReceiverChecks) -> frozenset[str]:
    """Mounts of the receivers whose turn rates may not be used, since they are smoothed."""
    return frozenset(m.value for m, lag in zip(MOUNTS, state.lags, strict=True) if lag.smoothed)


def turn_rates_known(state: ReceiverChecks) -> bool:
    """Whether the lag is decided for each turn rate that can be compared with a heading."""
    compared = [lag for lag in state.lags if lag.intervals]
    return bool(compared) and all(settled(lag) for lag in compared)


def flags(state: ReceiverChecks) -> list[Flag]:
    """Flags of all present faults: of a mount, or of `rig` if it is not known which receiver it is."""
    out = [Flag(SMOOTHED, mount.value) for mount, lag in zip(MOUNTS, state.lags, strict=True) if lag.smoothed]
    out += [Flag(kind, mount.value) for mount, kind in zip(MOUNTS, state.wrong, strict=True) if kind]
    return [*out, Flag(UNCLEAR, "rig")] if state.unclear else out


def begun(state: ReceiverChecks) -> list[tuple[Flag, Diagnosis]]:
    """Each fault found since the last call."""
    now, before = flags(state), state.reported
    state.reported = now
    return [(flag, diagnosis(state, flag)) for flag in now if flag not in before]


def diagnosis(state: ReceiverChecks, flag: Flag) -> Diagnosis:
    """Of a flag of `flags`: how far it is off."""
    key = f"receiver.{flag.of}.roll_corrected"
    if flag.kind == UNCLEAR:
        return Diagnosis(Code.ROLL_CORRECTION_UNCLEAR, key)
    k = [mount.value for mount in MOUNTS].index(flag.of)
    if flag.kind == SMOOTHED:
        tau, sd = time_constant(state.lags[k])
        return Diagnosis(Code.YAW_RATE_SMOOTHED, "receiver", (flag.of,), amounts=(tau,), sds=(sd,))
    c, sds = responses(state)
    code = Code.CORRECTED_TWICE if flag.kind == TWICE else Code.NOT_CORRECTED
    return Diagnosis(code, key, (flag.of,), amounts=(float(c[k]),), sds=(float(sds[k]),))


def clock_stepped(state: ReceiverChecks) -> None:
    """The log's clock stepped back: the present intervals are given up; faults and sums stay."""
    state.last_pose_ns = 0


def responses(state: ReceiverChecks) -> tuple[Array, Array]:
    """(c, its sd) of each receiver, shape (4,), as in flow.Mount; the sd is infinite without usable rolls."""
    prior = np.array([*[RECEIVER_CHECKS.response_prior[1] ** -2] * 4, RECEIVER_CHECKS.offset_sd**-2])
    information, vector = _informative(state)
    covariance = np.linalg.inv(information + np.diag(prior))
    mean = covariance @ (vector + prior * np.array([*[RECEIVER_CHECKS.response_prior[0]] * 4, 0.0]))
    sds = np.sqrt(np.diag(covariance))[:4]
    for body in (0, 1):
        if not _roll_is_observable(state, body):
            sds[2 * body : 2 * body + 2] = math.inf
    return mean[:4], sds


def _informative(state: ReceiverChecks) -> tuple[Array, Array]:
    """(information (5, 5), vector (5,)) of the data, without directions in which rolls are no more than their
    noise: less what that adds on average, information is below zero there."""
    values, vectors = np.linalg.eigh(state.information)
    kept = vectors[:, values > 0.0]
    return (kept * values[values > 0.0]) @ kept.T, kept @ (kept.T @ state.vector)


# The samples of one pose.


def _pair(aligner: Aligner, body: int, t_ns: int) -> _Pair | None:
    """Both antennas of a body, not corrected for roll; None if one is missing or extrapolated."""
    machine = aligner.machine
    places = {receiver.mount: receiver.position[:2] for receiver in machine.receiver}
    antennas = []
    for index, track, at_ns in aligner.in_use(body, t_ns):
        found = track.position_at(at_ns) if track.usable() else None
        if found is None or found[2]:
            return None
        antennas.append(ReportedPoint(found[0], found[1], places[MOUNTS[index]], None, 0.0, 0.0))
    if len(antennas) != 2:
        return None
    front, rear = antennas
    pair = baseline(front, rear, 0.0)
    place = -machine.tractor.c.value if body == 0 else machine.implement.d.value
    shares = hitch_shares(front.lever, rear.lever, place)
    return _Pair(
        pair.heading, pair.sd_heading, hitch(front, rear, pair.heading, place),
        max(front.sd, rear.sd) * math.hypot(*shares), shares, length(between(front.lever, rear.lever)),
    )  # fmt: skip


def _rolls(
    state: ReceiverChecks, aligner: Aligner, body: int, t_ns: int
) -> tuple[float, float, float] | None:
    """(roll, rad; variance of its noise; half the difference of two receivers' rolls less its mean, which
    gives the noise) of a body."""
    match [
        found
        for _, track, at in aligner.in_use(body, t_ns)
        if (found := sample_at(track.rolls, at, RECEIVER_TRACK.slow_hold_ns))
    ]:
        case [(one, _), (other, _)]:
            apart, n = (one - other) / 2 - state.rolls[body, 2], state.hitch_samples
            noise = apart**2 * n / (n + 1)  # the first tells of the zeros alone
            return (one + other) / 2, max(noise, RECEIVER_CHECKS.least_roll_noise**2), apart
        case [(roll, sd)]:
            return roll, sd**2, 0.0
    return None


def _update_intervals(
    state: ReceiverChecks,
    aligner: Aligner,
    body: int,
    pair: _Pair | None,
    roll: tuple[float, float, float] | None,
    t_ns: int,
    follows: bool,
) -> None:
    """Continue the interval of a body and the integrals of its turn rates; evaluate them at the end."""
    interval = state.turns[body]
    heading = _reported_heading(aligner, body, t_ns) if pair is None else (pair.heading, pair.sd_heading)
    rates = [_rate(aligner, index, t_ns) for index in (2 * body, 2 * body + 1)]
    if heading is None or not follows:
        interval.poses = -1
    else:
        interval.poses += interval.poses >= 0
    ended = interval.poses >= RECEIVER_CHECKS.interval
    change = wrap(heading[0] - interval.heading) if heading is not None else 0.0
    complete = []
    for lag, rate in zip(state.lags[2 * body : 2 * body + 2], rates, strict=True):
        if rate is None or interval.poses < 0:
            lag.poses = -1
        elif lag.poses >= 0:
            lag.integral += (lag.rate + rate) / 2 * ALIGNMENT.pose_ns * 1e-9
            lag.poses += 1
        lag.rate = rate or 0.0
        if ended and heading is not None and lag.poses == RECEIVER_CHECKS.interval:
            regress(lag, change, RECEIVER_CHECKS.interval * ALIGNMENT.pose_ns * 1e-9, heading[1])
            if not lag.smoothed:
                complete.append(lag.integral)
    if ended and pair is not None and roll is not None and complete:
        excess = change - sum(complete) / len(complete)
        _add_heading_sample(state, aligner.machine, body, excess, pair, roll)
    if heading is not None and (ended or interval.poses < 0):
        interval.heading, interval.roll, interval.poses = heading[0], roll[0] if roll else 0.0, 0
        for lag, rate in zip(state.lags[2 * body : 2 * body + 2], rates, strict=True):
            lag.integral, lag.first_rate, lag.poses = 0.0, rate or 0.0, -1 if rate is None else 0


def _reported_heading(aligner: Aligner, body: int, t_ns: int) -> tuple[float, float] | None:
    """(heading, sd), rad, as reported by the only receiver of a body; None if it has two, or none."""
    indices = [MOUNTS.index(receiver.mount) for receiver in aligner.machine.receiver]
    (index, *others) = [index for index in indices if index // 2 == body] or [-1]
    if index < 0 or others:
        return None  # with two receivers only the baseline serves: a change of the source is no turn
    headings = aligner.tracks[MOUNTS[index].value].headings
    return angle_at(headings, t_ns + aligner.latency.excess_ns(index), RECEIVER_TRACK.hold_ns)


def _rate(aligner: Aligner, index: int, t_ns: int) -> float | None:
    track = aligner.tracks.get(MOUNTS[index].value)
    if track is None:
        return None
    found = sample_at(track.yaw_rates, t_ns + aligner.latency.excess_ns(index), RECEIVER_TRACK.hold_ns)
    return found[0] if found else None


def _arms(machine: Machine) -> list[float]:
    """Height of each receiver above the ground, m, as in flow.Mount; 0 for a mount without a receiver."""
    by_mount = {receiver.mount: receiver.position[2] for receiver in machine.receiver}
    return [by_mount.get(mount, 0.0) for mount in MOUNTS]


def _add_heading_sample(
    state: ReceiverChecks, machine: Machine, body: int, excess: float, pair: _Pair,
    roll: tuple[float, float, float],
) -> None:  # fmt: skip
    """Add one interval. excess: heading change of the antennas minus integral of the turn rate, rad."""
    front, rear = 2 * body, 2 * body + 1
    heights = _arms(machine)
    arm = np.zeros(5)
    arm[front], arm[rear] = heights[front] / pair.length, -heights[rear] / pair.length
    roll_change = math.sin(roll[0]) - math.sin(state.turns[body].roll)
    _add(state, arm * roll_change, [arm], [2 * roll[1]], excess, 2 * pair.sd_heading**2)


def _add_hitch_sample(
    state: ReceiverChecks,
    machine: Machine,
    pairs: list[_Pair | None],
    rolls: list[tuple[float, float, float] | None],
) -> None:
    """Add the gap at the hitch: tractor's hitch minus implement's, to the right of the implement, m."""
    tractor, implement = pairs
    if tractor is None or implement is None or rolls[0] is None or rolls[1] is None:
        return
    _, gap = hitch_gap(tractor.hitch, implement.hitch, implement.heading)
    if abs(gap) > RECEIVER_CHECKS.largest_gap:
        return
    heights = _arms(machine)
    across = (math.cos(tractor.heading - implement.heading), -1.0)
    arms = []
    for body, pair in enumerate((tractor, implement)):
        arm = np.zeros(5)
        for k in (0, 1):
            arm[2 * body + k] = across[body] * pair.shares[k] * heights[2 * body + k]
        arms.append(arm)
    both = [rolls[0], rolls[1]]
    row = sum((arm * math.sin(roll) for arm, (roll, *_) in zip(arms, both, strict=True)), np.zeros(5))
    row[4] = 1.0
    variance, noises = tractor.sd_hitch**2 + implement.sd_hitch**2, [noise for _, noise, _ in both]
    _add(state, row, arms, noises, gap, RECEIVER_CHECKS.hitch_samples_in_one * variance)
    state.hitch_samples += 1
    for body, (roll, noise, apart) in enumerate(both):
        state.rolls[body] += roll**2, noise, apart / state.hitch_samples


def _add(
    state: ReceiverChecks,
    row: Array,
    arms: list[Array],
    noises: list[float],
    measured: float,
    variance: float,
) -> None:
    """Add one sample to the normal equations, without the part that noise of the rolls adds to the squares.

    row: (5,), slope over c and offset. arms: (5,) each, derivative of the row by a roll. noises: of these
    rolls, rad^2. variance: of the measured value.
    """
    if not (math.isfinite(measured) and np.all(np.isfinite(row))):
        return
    added = np.outer(row, row)
    for arm, noise in zip(arms, noises, strict=True):
        added -= noise * np.outer(arm, arm)
    state.information += added / variance
    state.vector += row * measured / variance


def _judge(state: ReceiverChecks, machine: Machine) -> None:
    """Update the faults: a fault begins once it is certain and stays until the opposite is certain."""
    for lag in state.lags:
        update_verdict(lag)
    _judge_rolls(state, machine)


def _judge_rolls(state: ReceiverChecks, machine: Machine) -> None:
    """Compare all settings of roll_corrected by their likelihood; set `wrong` and `unclear`."""
    declared = np.zeros(4)
    free = []
    for receiver in machine.receiver:
        k = MOUNTS.index(receiver.mount)
        declared[k] = 0.0 if receiver.roll_corrected else 1.0
        if _roll_is_observable(state, k // 2):
            free.append(k)
    if not free:
        return
    settings = [declared.copy() for _ in range(2 ** len(free))]
    for number, setting in enumerate(settings):
        for bit, k in enumerate(free):
            setting[k] = abs(declared[k] - (number >> bit & 1))  # number 0 is as declared
    known = _informative(state)
    scores = np.array([_log_likelihood(*known, setting) for setting in settings])
    likely = np.array(settings)[scores > scores.max() - TURN_RATE_LAG.sure**2 / 2]
    lead = scores.max() - scores[0]
    if lead == 0.0:
        state.wrong, state.unclear = [None] * 4, False
    elif lead > TURN_RATE_LAG.sure**2 / 2 and lead > _best_log_likelihood(*known) - scores.max():
        # What it explains is more than what no setting explains: something else may move antennas. A receiver
        # is named if its own response says so, too.
        c, sds = responses(state)
        sure = np.all(likely != declared, axis=0) & (np.abs(c - declared) > WITHIN * sds)
        kinds = [TWICE if t == 1.0 else NOT for t in declared]
        state.wrong = [kind if yes else None for kind, yes in zip(kinds, sure, strict=True)]
        state.unclear = not sure.any()


def _log_likelihood(information: Array, vector: Array, setting: Array) -> float:
    """Log-likelihood of a setting of c, shape (4,), up to a constant, at the offset that fits best."""
    free = vector[4] - information[4, :4] @ setting
    total = information[4, 4] + RECEIVER_CHECKS.offset_sd**-2
    fits = vector[:4] @ setting - setting @ information[:4, :4] @ setting / 2
    return float(fits + free**2 / total / 2)


def _best_log_likelihood(information: Array, vector: Array) -> float:
    """The same of the responses that fit best, be they 0, 1 or anything."""
    total = information[4, 4] + RECEIVER_CHECKS.offset_sd**-2
    apart = information[:4, :4] - np.outer(information[:4, 4], information[4, :4]) / total
    best = np.linalg.lstsq(apart, vector[:4] - information[:4, 4] * vector[4] / total, rcond=1e-9)[0]
    return _log_likelihood(information, vector, best)


def _roll_is_observable(state: ReceiverChecks, body: int) -> bool:
    """Whether a body has rolled clearly more than the noise of its measured rolls."""
    return bool(0.0 < state.rolls[body, 0] > RECEIVER_CHECKS.least_roll_to_noise * state.rolls[body, 1])
