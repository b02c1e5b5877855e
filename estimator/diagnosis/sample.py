"""What the watch looks at: both pairs of antennas, the hitch as seen from either body, the wheels.

Latencies are those of the machine file: what is learned of them (pose/latency.py) would follow an antenna
that was moved along its body. The watch learns them itself, beside the places.
"""

from tilth.estimator.once import once_for_a_machine
from tilth.estimator.pose.aligner import ALIGNMENT, MOUNTS, Aligner
from tilth.estimator.pose.body import ReportedPoint, baseline, cg_velocity, hitch
from tilth.estimator.pose.receiver_track import NO_POSITION, RECEIVER_TRACK, sample_at
from tilth.estimator.pose.roll_pitch import mean_of
from tilth.estimator.rig.geometry import Vector, lever, wrap
from tilth.estimator.rig.residuals import hitch_gap
from tilth.schemas.machine import Implement, Machine, Receiver, Tractor
from tilth.schemas.values import dataclass


@dataclass(frozen=True, slots=True)
class BodySample:
    """One body, by its two antennas and as surveyed."""

    heading: float  # rad
    excess: float  # m, measured minus surveyed distance of the antennas
    forward_velocity: float  # m/s, of the CG
    lateral_velocity: float  # m/s, to the right
    yaw_rate: float  # rad/s
    roll: float  # rad
    hitch: Vector  # m: north, east


@dataclass(frozen=True, slots=True)
class Sample:
    """Both bodies at one instant."""

    tractor: BodySample
    implement: BodySample
    gap: Vector  # m: the tractor's hitch minus the implement's, forward and right in the implement's axes
    wheel_angle: float | None  # rad

    @property
    def articulation(self) -> float:
        """rad, tractor minus implement."""
        return wrap(self.tractor.heading - self.implement.heading)


def sample(aligner: Aligner, t_ns: int) -> Sample | None:
    """The sample at t_ns; None unless all four receivers have a position there.

    t_ns: an instant one pose ago, since roll and yaw rate come after the positions of their epoch.
    """
    pairs = _pairs(aligner.machine)
    if pairs is None:
        return None
    machine = aligner.machine
    tractor = _body(aligner, machine.tractor, pairs[0], -machine.tractor.c.value, t_ns)
    implement = _body(aligner, machine.implement, pairs[1], machine.implement.d.value, t_ns)
    if tractor is None or implement is None:
        return None
    gap = hitch_gap(tractor.hitch, implement.hitch, implement.heading)
    wheel = sample_at(aligner.wheel, t_ns, ALIGNMENT.wheel_hold_ns)
    return Sample(tractor, implement, gap, wheel[0] if wheel else None)


Pair = tuple[Receiver, Receiver]


@once_for_a_machine
def _pairs(machine: Machine) -> tuple[Pair, Pair] | None:
    """Front and rear receiver of tractor and implement; None if one is not there."""
    by_mount = {receiver.mount: receiver for receiver in machine.receiver}
    if any(mount not in by_mount for mount in MOUNTS):
        return None
    front, rear, implement_front, implement_rear = (by_mount[mount] for mount in MOUNTS)
    return (front, rear), (implement_front, implement_rear)


def _body(
    aligner: Aligner, section: Tractor | Implement, pair: Pair, to_hitch: float, t_ns: int
) -> BodySample | None:
    """to_hitch: forward of the body's CG, m."""
    tracks = [aligner.tracks[receiver.mount.value] for receiver in pair]
    roll = mean_of(sample_at(track.rolls, t_ns, RECEIVER_TRACK.slow_hold_ns) for track in tracks)
    rate = mean_of(track.yaw_rate_at(t_ns) for track in tracks)
    if roll is None or rate is None:
        return None
    pitch = mean_of(sample_at(track.pitches, t_ns, RECEIVER_TRACK.slow_hold_ns) for track in tracks) or 0.0
    points = []
    for receiver, track in zip(pair, tracks, strict=True):
        place, velocity = track.position_at(t_ns), track.velocity_at(t_ns)
        if place is None or velocity is None or place[2] or track.fix in NO_POSITION:
            return None
        corrected = receiver.roll_corrected
        arm = lever(receiver.position, section.cg_height.value, corrected, roll, pitch)
        points.append(ReportedPoint(place[0], place[1], arm, *velocity, 0.0))
    front, rear = points
    line = baseline(front, rear, 0.0)
    speed = cg_velocity(points, line.heading, rate, 0.0)
    assert speed is not None
    seen = hitch(front, rear, line.heading, to_hitch)
    return BodySample(line.heading, line.excess, speed[0], speed[1], rate, roll, seen)
