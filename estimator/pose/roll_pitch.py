"""Roll and pitch of the bodies from their receivers."""

from dataclasses import dataclass

from tilth.estimator.pose.aligner import ALIGNMENT, MOUNTS, Aligner
from tilth.estimator.pose.receiver_track import RECEIVER_TRACK, sample_at

HALF_NS = ALIGNMENT.pose_ns // 2


@dataclass(frozen=True, slots=True)
class RollPitch:
    """Roll and pitch of a body at a pose and half a pose interval before it, rad; 0 if not measured."""

    roll_before: float  # half a pose interval before
    roll: float
    pitch: float


def roll_pitch_at(aligner: Aligner, body: int, t_ns: int) -> RollPitch:
    """Roll and pitch of a body (0 tractor, 1 implement) at t_ns: the means over its receivers
    but those that are left out."""
    rolls: list[tuple[float, float]] = []
    pitches: list[float] = []
    for index in (2 * body, 2 * body + 1):
        track = aligner.tracks.get(MOUNTS[index].value)
        if track is None or track.left_out:
            continue
        at_ns = t_ns + aligner.latency.excess_ns(index)
        before = sample_at(track.rolls, at_ns - HALF_NS, RECEIVER_TRACK.slow_hold_ns)
        roll = sample_at(track.rolls, at_ns, RECEIVER_TRACK.slow_hold_ns)
        pitch = sample_at(track.pitches, at_ns, RECEIVER_TRACK.slow_hold_ns)
        if roll is not None and before is not None:
            rolls.append((before[0], roll[0]))
        if pitch is not None:
            pitches.append(pitch[0])
    pitch_mean = sum(pitches) / len(pitches) if pitches else 0.0
    before_mean = sum(before for before, _ in rolls) / max(len(rolls), 1)
    roll_mean = sum(roll for _, roll in rolls) / max(len(rolls), 1)
    return RollPitch(before_mean, roll_mean, pitch_mean)
