"""How the bodies lean, by their receivers, and how much of a measured roll rate is to be believed."""

import math
from dataclasses import dataclass

from tilth.estimator.pose.aligner import MOUNTS, POSE_NS, Aligner
from tilth.estimator.pose.receiver_track import SLOW_HOLD_NS, sample_at

HALF_NS = POSE_NS // 2
SWAY_MEMORY = 50.0  # stretches (10 s) whose roll rates tell how much of one is noise


@dataclass(frozen=True, slots=True)
class RollPitch:
    """How a body stands at a pose (t) and half a pose before it, rad; 0 where nobody tells."""

    roll_before: float
    roll: float
    pitch: float
    apart_before: float  # half of what its two receivers differ by, as roll_before
    sd: float  # of a roll where only one of them tells it; else 0


def roll_pitch_at(aligner: Aligner, body: int, t_ns: int) -> RollPitch:
    """From the rolls and pitches of a body's receivers at t and half a pose before."""
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


def noise_of_rate(one: RollPitch, other: RollPitch) -> float:
    """Of the roll rate between two that are a pose apart, rad/s: two receivers differ by it."""
    sd = max(one.sd, other.sd)
    change = sd * math.sqrt(2) if sd else other.apart_before - one.apart_before
    return change / (POSE_NS * 1e-9)


def share_of_sway(lately: list[float], rate: float, noise: float) -> float:
    """Which share of a measured roll rate is to be believed, so that the error left is least on average.

    On even ground the rate is noise only, and through the height of an antenna it would be worse than what
    is to be taken out. lately: mean squares of rate and noise, rad^2/s^2; changed in place.
    """
    for k, value in enumerate((rate, noise)):
        lately[k] += (value**2 - lately[k]) / SWAY_MEMORY
    return max(0.0, 1.0 - lately[1] / lately[0]) if lately[0] > 0.0 else 0.0
