"""Roll and pitch of the bodies from their receivers, and the share of a measured roll rate that is not
noise."""

import math
from dataclasses import dataclass

from tilth.estimator.pose.aligner import MOUNTS, POSE_NS, Aligner
from tilth.estimator.pose.receiver_track import SLOW_HOLD_NS, sample_at

HALF_NS = POSE_NS // 2
ROLL_RATE_MEMORY = 50.0  # segments (10 s) over which the mean squares of roll rate and noise are taken


@dataclass(frozen=True, slots=True)
class RollPitch:
    """Roll and pitch of a body at a pose and half a pose interval before it, rad; 0 if not measured."""

    roll_before: float  # half a pose interval before
    roll: float
    pitch: float
    half_difference_before: float  # half the difference of its two receivers, at the instant of roll_before
    sd: float  # of the roll if only one receiver measures it; else 0


def roll_pitch_at(aligner: Aligner, body: int, t_ns: int) -> RollPitch:
    """Roll and pitch of a body (0 tractor, 1 implement) at t_ns: the means over its receivers."""
    rolls: list[tuple[float, float]] = []
    pitches: list[float] = []
    sd = 0.0  # of the last one
    for index in (2 * body, 2 * body + 1):
        track = aligner.tracks.get(MOUNTS[index].value)
        if track is None:
            continue
        at_ns = t_ns + aligner.latency.excess_ns(index)
        before = sample_at(track.rolls, at_ns - HALF_NS, SLOW_HOLD_NS)
        roll = sample_at(track.rolls, at_ns, SLOW_HOLD_NS)
        pitch = sample_at(track.pitches, at_ns, SLOW_HOLD_NS)
        if roll is not None and before is not None:
            rolls.append((before[0], roll[0]))
            sd = roll[1]
        if pitch is not None:
            pitches.append(pitch[0])
    pitch_mean = sum(pitches) / len(pitches) if pitches else 0.0
    before_mean = sum(before for before, _ in rolls) / max(len(rolls), 1)
    roll_mean = sum(roll for _, roll in rolls) / max(len(rolls), 1)
    if len(rolls) == 2:
        return RollPitch(before_mean, roll_mean, pitch_mean, (rolls[0][0] - rolls[1][0]) / 2, 0.0)
    return RollPitch(before_mean, roll_mean, pitch_mean, 0.0, sd)


def roll_rate_noise(one: RollPitch, other: RollPitch) -> float:
    """Noise of the roll rate between two poses, rad/s: by the difference of two receivers, or their sd."""
    sd = max(one.sd, other.sd)
    change = sd * math.sqrt(2) if sd else other.half_difference_before - one.half_difference_before
    return change / (POSE_NS * 1e-9)


def trusted_share(mean_squares: list[float], rate: float, noise: float) -> float:
    """Factor on a measured roll rate for the least mean square error (a Wiener gain), 0 to 1.

    On even ground the rate is only noise. Times the height of an antenna, it would be a larger error than the
    motion that it should correct. mean_squares: of rate and noise, rad^2/s^2; updated in place.
    """
    for k, value in enumerate((rate, noise)):
        mean_squares[k] += (value**2 - mean_squares[k]) / ROLL_RATE_MEMORY
    return max(0.0, 1.0 - mean_squares[1] / mean_squares[0]) if mean_squares[0] > 0.0 else 0.0
