"""Roll and pitch of the bodies from their receivers."""

from collections.abc import Iterable

from tilth.estimator.pose.aligner import ALIGNMENT, Aligner
from tilth.estimator.pose.receiver_track import RECEIVER_TRACK, sample_at
from tilth.schemas.values import dataclass

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
    befores, rolls, pitches = [], [], []
    for _, track, at_ns in aligner.in_use(body, t_ns):
        before = sample_at(track.rolls, at_ns - HALF_NS, RECEIVER_TRACK.slow_hold_ns)
        roll = sample_at(track.rolls, at_ns, RECEIVER_TRACK.slow_hold_ns)
        pitch = sample_at(track.pitches, at_ns, RECEIVER_TRACK.slow_hold_ns)
        if roll is not None and before is not None:
            befores.append(before)
            rolls.append(roll)
        pitches.append(pitch)
    return RollPitch(mean_of(befores) or 0.0, mean_of(rolls) or 0.0, mean_of(pitches) or 0.0)


def mean_of(readings: Iterable[tuple[float, float] | None]) -> float | None:
    """Mean of the values of (value, sd), each of a receiver; None without any."""
    values = [reading[0] for reading in readings if reading is not None]
    return sum(values) / len(values) if values else None
