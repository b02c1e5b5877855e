"""What the watch looks at: both pairs of antennas, the hitch as seen from either body, the wheels.

Latencies are those of the machine file: what is learned of them (pose/latency.py) would follow an antenna
that was moved along its body. The watch learns them itself, beside the places.
"""

from dataclasses import dataclass

from tilth.estimator.once import once_for_a_machine
from tilth.estimator.pose.aligner import MOUNTS, Aligner
from tilth.estimator.pose.body import ReportedPoint, baseline, cg_velocity
from tilth.estimator.pose.geometry import Vector, lever, rotate, wrap
from tilth.estimator.pose.receiver_track import NO_POSITION, RECEIVER_TRACK, Track, sample_at
from tilth.schemas.machine import Implement, Machine, Receiver, Tractor

WHEEL_HOLD_NS = 250_000_000


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
    gap = (tractor.hitch[0] - implement.hitch[0], tractor.hitch[1] - implement.hitch[1])
    wheel = sample_at(aligner.wheel, t_ns, WHEEL_HOLD_NS)
    return Sample(tractor, implement, rotate(gap, -implement.heading), wheel[0] if wheel else None)


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
    roll, rate = _mean_roll(tracks, t_ns), _mean_rate(tracks, t_ns)
    if roll is None or rate is None:
        return None
    pitches = [
        found[0] for track in tracks if (found := sample_at(track.pitches, t_ns, RECEIVER_TRACK.slow_hold_ns))
    ]
    pitch = sum(pitches) / len(pitches) if pitches else 0.0
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
    middle = [(front.lever[k] + rear.lever[k]) / 2 for k in (0, 1)]
    north, east = rotate((to_hitch - middle[0], -middle[1]), line.heading)
    hitch = ((front.at[0] + rear.at[0]) / 2 + north, (front.at[1] + rear.at[1]) / 2 + east)
    return BodySample(line.heading, line.excess, speed[0], speed[1], rate, roll, hitch)


def _mean_roll(tracks: list[Track], t_ns: int) -> float | None:
    found = [s[0] for track in tracks if (s := sample_at(track.rolls, t_ns, RECEIVER_TRACK.slow_hold_ns))]
    return sum(found) / len(found) if found else None


def _mean_rate(tracks: list[Track], t_ns: int) -> float | None:
    found = [s[0] for track in tracks if (s := track.yaw_rate_at(t_ns))]
    return sum(found) / len(found) if found else None
