"""Poses: the receivers' positions interpolated to one instant, and both bodies solved there.

Flags of the pose name what is missing. What can be given depends on the receivers of a body:

- both: everything of that body;
- one: its heading comes from the position of the hitch, if the other body has both receivers; else from the
  heading that the receiver reports; else from the last heading and the yaw rate, for a few seconds;
- none: nothing of that body.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from tilth.estimator.driving import DRIVING
from tilth.estimator.once import once_for_a_machine
from tilth.estimator.pose import plausibility
from tilth.estimator.pose.aligner import ALIGNMENT, MOUNTS, WHEEL, Aligner, due
from tilth.estimator.pose.body import Baseline, ReportedPoint, baseline, cg_position, cg_velocity, hitch
from tilth.estimator.pose.receiver_lost import LOST
from tilth.estimator.pose.receiver_track import RECEIVER_TRACK, angle_at, sample_at
from tilth.estimator.rig.geometry import Vector, lever, wrap
from tilth.estimator.rig.residuals import hitch_gap, pair_of, sideways
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import BodyPose, FixType, Flag, FlagKind, Mount, Pose
from tilth.schemas.machine import Implement, Machine, Receiver, Tractor


@dataclass(frozen=True, slots=True)
class PoseTuning:
    """What poses hold, continue and compare."""

    straight: float = tuned(0.05, "rad/s", "at smaller yaw rates a body at cruise moves where it points")
    sharp_position_sd: float = tuned(0.1, "m", "positions with a larger sd are not compared with the survey")
    latency_sds: float = tuned(2.5, "sd", "of the machine file: further off, latency or position is wrong")
    latency_slack_s: float = tuned(0.02, "s", "by which it may be further off all the same")
    unknown_tilt: float = tuned(math.radians(1.5), "rad", "sd of a roll or pitch that is not measured")
    longest_yaw_rate_heading_ns: int = tuned(5_000_000_000, "ns", "a heading goes on by the yaw rate at most")
    yaw_rate_heading_walk: float = tuned(math.radians(0.3), "rad/s^0.5", "growth of its sd")


POSE: Final = PoseTuning()

_PLACE: Final = {mount.value: index for index, mount in enumerate(MOUNTS)}
BODIES = ((0, 1), (2, 3))  # indices into MOUNTS: tractor, implement
NAMES = ("tractor", "implement")


def poses(state: Aligner, now_ns: int) -> list[Pose]:
    """Every pose that is due at now_ns (Frame.rx_ns of the latest frame), in order."""
    out: list[Pose] = []
    while (instant := due(state, now_ns)) is not None:
        out.append(_pose_at(state, instant))
    return out


@dataclass(slots=True)
class _Body:
    """One body while its pose is computed. SI, rad; tuples are (value, sd) where not said otherwise."""

    index: int  # 0 tractor, 1 implement
    roll: tuple[float, float] | None
    yaw_rate: tuple[float, float] | None
    antennas: dict[int, ReportedPoint]
    heading: float | None = None
    sd_heading: float = 0.0
    cg: Vector | None = None
    sd_cg: float = 0.0
    velocity: tuple[float, float, float] | None = None  # forward u, lateral v, sd per axis, m/s
    pair: Baseline | None = None
    pair_velocity: tuple[float, float, float] | None = None  # as velocity, with the heading of the pair


def _pose_at(state: Aligner, t_ns: int) -> Pose:
    flags = _receiver_flags(state, t_ns)
    late = state.lateness.doubts(t_ns)
    if late:
        flags.append(Flag(FlagKind.LATE_FRAMES, "rig"))
    bodies = [_interpolate_body(state, index, t_ns, flags) for index in range(2)]
    for body in bodies:
        _solve_pair(state, body)
    flags += _withhold_doubtful(state, bodies, late)
    for body, other in zip(bodies, reversed(bodies), strict=True):
        if body.heading is None and body.antennas:
            _solve_single(state, body, other, t_ns, flags)
    if not late:
        _update_latency(state, bodies, t_ns)
    for body in bodies:
        _solve_body(state, body, t_ns, flags)
    state.last_pose_ns = t_ns
    state.moving = bodies[0].velocity is not None and abs(bodies[0].velocity[0]) >= DRIVING.under_way
    return _assemble(state, bodies, t_ns, flags)


def _receiver_flags(state: Aligner, t_ns: int) -> list[Flag]:
    flags: list[Flag] = []
    for mount, track in state.tracks.items():
        index = _PLACE[mount]
        excess_s = abs(state.latency.excess_ns(index)) * 1e-9
        if (
            excess_s
            > POSE.latency_sds * _receiver(state.machine, MOUNTS[index]).latency.sd + POSE.latency_slack_s
        ):
            flags.append(Flag(FlagKind.LATENCY, mount))
        if track.left_out:
            flags.append(Flag(FlagKind.LEFT_OUT, mount))
        if not track.usable():
            flags.append(Flag(FlagKind.NO_FIX, mount))
        elif not track.positions:
            flags.append(Flag(FlagKind.WAITING, mount))
        if track.fix is not None and t_ns - track.fix_ns > ALIGNMENT.fix_ns:
            flags.append(Flag(FlagKind.FIX_UNKNOWN, mount))
        elif track.fix is FixType.RTK_FLOAT:
            flags.append(Flag(FlagKind.FLOATING, mount))
        elif track.fix in (FixType.GNSS, FixType.DGNSS, FixType.PRECISE):
            flags.append(Flag(FlagKind.NO_RTK, mount))
    return flags


def _interpolate_body(state: Aligner, index: int, t_ns: int, flags: list[Flag]) -> _Body:
    """The measurements of one body's receivers, interpolated to t_ns; adds flags for what is missing."""
    present = state.in_use(index, t_ns)
    roll = _mean([s for _, tr, at in present if (s := sample_at(tr.rolls, at, RECEIVER_TRACK.slow_hold_ns))])
    pitch = _mean(
        [s for _, tr, at in present if (s := sample_at(tr.pitches, at, RECEIVER_TRACK.slow_hold_ns))]
    )
    yaw_rate = _mean([s for _, tr, at in present if (s := tr.yaw_rate_at(at))])
    body = _Body(index, roll, yaw_rate, {})
    section = _section(state.machine, index)
    tilt = (roll[0] if roll else 0.0, pitch[0] if pitch else 0.0)
    for i, track, at in present:
        found = track.position_at(at) if track.usable() else None
        if found is None:
            if track.usable() and track.positions:
                repeating = track.repeated_ns > max(track.last_position_ns, t_ns - LOST.lost_ns)
                flags.append(Flag(FlagKind.REPEATING if repeating else FlagKind.LOST, MOUNTS[i].value))
            continue
        point, sd, extrapolated = found
        if extrapolated:
            flags.append(Flag(FlagKind.LATE, MOUNTS[i].value))
        receiver = _receiver(state.machine, MOUNTS[i])
        arm = lever(receiver.position, section.cg_height.value, receiver.roll_corrected, *tilt)
        velocity_found = track.velocity_at(at)
        speed = math.hypot(*velocity_found[0]) if velocity_found else 0.0
        partner = BODIES[index][0] + BODIES[index][1] - i
        sd_time = state.latency.sd_difference(i, partner, speed) / math.sqrt(2)
        velocity, sd_velocity = velocity_found if velocity_found else (None, 0.0)
        body.antennas[i] = ReportedPoint(point, sd, arm, velocity, sd_velocity, sd_time)
    return body


def _section(machine: Machine, index: int) -> Tractor | Implement:
    return machine.tractor if index == 0 else machine.implement


def _receiver(machine: Machine, mount: Mount) -> Receiver:
    return _receivers(machine)[mount]


@once_for_a_machine
def _receivers(machine: Machine) -> dict[Mount, Receiver]:
    return {receiver.mount: receiver for receiver in machine.receiver}


def _mean(values: list[tuple[float, float]]) -> tuple[float, float] | None:
    """Mean of (value, sd), weighted by variance."""
    if not values:
        return None
    weights = [1 / sd**2 for _, sd in values]
    total = sum(weights)
    return sum(w * v for w, (v, _) in zip(weights, values, strict=True)) / total, math.sqrt(1 / total)


def _withhold_doubtful(state: Aligner, bodies: list[_Body], late: bool) -> list[Flag]:
    """Remove the receivers that do not fit the surveyed rig. Returns the flags that say so. late: whether
    frames came late, so that nobody need have been moved."""
    antennas = {MOUNTS[i]: antenna for body in bodies for i, antenna in body.antennas.items()}
    speed = max((math.hypot(*a.velocity) for a in antennas.values() if a.velocity), default=0.0)
    smear = max((speed * a.sd_time + a.sd for a in antennas.values()), default=0.0)
    c, d = state.machine.tractor.c.value, state.machine.implement.d.value
    levers = {mount: antenna.lever for mount, antenna in antennas.items()}
    found = plausibility.check_instant({m: a.at for m, a in antennas.items()}, levers, c, d, smear)
    if not late:
        _update_long_term_means(state, bodies)
    if not found:
        timing = max((speed * a.sd_time for a in antennas.values()), default=0.0)
        wrong = [*state.long_term.bodies(state.machine, timing), *_reversed_bodies(state, bodies)]
        found = tuple(Flag(FlagKind.MOVED, MOUNTS[i].value) for body in wrong for i in bodies[body].antennas)
    persistent = () if late else state.suspicion.judge(found)
    for flag in found:
        index = MOUNTS.index(Mount(flag.of))
        body = bodies[index // 2]
        body.antennas.pop(index, None)
        body.pair = body.pair_velocity = body.heading = None
    return list(persistent) or [Flag(FlagKind.DOUBTFUL, flag.of) for flag in found]


def _update_long_term_means(state: Aligner, bodies: list[_Body]) -> None:
    """Add this instant to the means of baseline excess and crab angle, which should be zero."""
    axles = -state.machine.tractor.b.value, -state.machine.implement.e.value
    for body, axle in zip(bodies, axles, strict=True):
        if body.pair is None:
            continue
        state.long_term.excess[body.index].add(body.pair.excess)
        if body.pair_velocity is None or body.yaw_rate is None or abs(body.yaw_rate[0]) >= POSE.straight:
            continue
        u, v, _ = body.pair_velocity
        if math.hypot(u, v) > DRIVING.cruise:
            # The absolute value makes forward and reverse alike: reversing is no fault.
            at_axle = sideways(v, body.yaw_rate[0], axle)
            state.long_term.crab_angle[body.index].add(math.atan2(at_axle, abs(u)))


def _update_parked_means(state: Aligner, bodies: list[_Body], ahead: float, across: float) -> None:
    """Add this instant to the means while parked, if the rig is so slow that latency has no effect."""
    antennas = [antenna for body in bodies for antenna in body.antennas.values()]
    speeds = [math.hypot(*antenna.velocity) if antenna.velocity else math.inf for antenna in antennas]
    if max(speeds) > DRIVING.creep or max(antenna.sd for antenna in antennas) > POSE.sharp_position_sd:
        return
    excesses = [body.pair.excess for body in bodies if body.pair is not None]
    for mean, value in zip(state.long_term.parked, (*excesses, ahead, across), strict=True):
        mean.add(value)


def _reversed_bodies(state: Aligner, bodies: list[_Body]) -> list[int]:
    """[0], the tractor, if its receivers show the opposite of the direction that the vehicle reports; else
    []."""
    pair_velocity = bodies[0].pair_velocity
    if (
        pair_velocity is None
        or state.direction == 0
        or state.last_pose_ns - state.direction_ns > LOST.lost_ns
    ):
        return []
    backwards = abs(pair_velocity[0]) >= DRIVING.cruise and pair_velocity[0] * state.direction < 0
    return [0] if backwards else []


def _solve_pair(state: Aligner, body: _Body) -> None:
    front, rear = (body.antennas.get(i) for i in BODIES[body.index])
    if front is None or rear is None:
        return
    body.pair = baseline(front, rear, _sd_tilt(state, body))
    body.heading, body.sd_heading = body.pair.heading, body.pair.sd_heading
    rate = body.yaw_rate[0] if body.yaw_rate else 0.0
    body.pair_velocity = cg_velocity([front, rear], body.pair.heading, rate, 0.0)


def _sd_tilt(state: Aligner, body: _Body) -> float:
    """Sd of the shift between the two antennas from the error of the roll, m."""
    heights = []
    for i in BODIES[body.index]:
        receiver = _receiver(state.machine, MOUNTS[i])
        heights.append(0.0 if receiver.roll_corrected else receiver.position[2])
    return abs(heights[0] - heights[1]) * (body.roll[1] if body.roll else POSE.unknown_tilt)


def _solve_single(state: Aligner, body: _Body, other: _Body, t_ns: int, flags: list[Flag]) -> None:
    """Heading of a body with one receiver: by the hitch, as reported, or continued by the yaw rate."""
    ((index, antenna),) = body.antennas.items()
    track = state.tracks[MOUNTS[index].value]
    whole = other.heading is not None and len(other.antennas) == 2
    sources = {
        FlagKind.HEADING_BY_HITCH: _heading_by_hitch(state, body, other, antenna) if whole else None,
        FlagKind.HEADING_BY_REPORTED: angle_at(
            track.headings, t_ns + state.latency.excess_ns(index), RECEIVER_TRACK.hold_ns
        ),
        FlagKind.HEADING_BY_YAW_RATE: _heading_by_yaw_rate(state, body, t_ns),
    }
    for kind, found in sources.items():
        if found is not None:
            flags.append(Flag(kind, NAMES[body.index]))
            body.heading, body.sd_heading = wrap(found[0]), found[1]
            return
    flags.append(Flag(FlagKind.NO_HEADING, NAMES[body.index]))


def _heading_by_yaw_rate(state: Aligner, body: _Body, t_ns: int) -> tuple[float, float] | None:
    """(heading, sd), rad: that of the last pose with both receivers plus the integral of the yaw rate
    since."""
    previous = state.last_heading[body.index]
    if previous is None or body.yaw_rate is None or t_ns - previous[0] > POSE.longest_yaw_rate_heading_ns:
        return None
    carried = previous[1] + body.yaw_rate[0] * (t_ns - state.last_pose_ns) * 1e-9
    state.last_heading[body.index] = (previous[0], carried, previous[2])
    return carried, previous[2] + POSE.yaw_rate_heading_walk * math.sqrt((t_ns - previous[0]) * 1e-9)


def _heading_by_hitch(
    state: Aligner, body: _Body, other: _Body, antenna: ReportedPoint
) -> tuple[float, float] | None:
    """(heading, sd), rad, from the direction of the hitch, as the other body has it, seen from this
    antenna."""
    c, d = state.machine.tractor.c.value, state.machine.implement.d.value
    hitch_here, hitch_there = (-c, d) if body.index == 0 else (d, -c)
    if other.heading is None:
        return None
    front, rear = other.antennas.values()
    _, sd_cg = cg_position([front, rear], other.heading, other.sd_heading)
    seen = pair_of(
        hitch(front, rear, other.heading, hitch_there), antenna.at, (hitch_here, 0.0), antenna.lever
    )
    reach = math.dist((hitch_here, 0.0), antenna.lever)
    if reach < 0.5:
        return None  # the antenna is at the hitch: there is no direction
    sd = math.sqrt(antenna.sd**2 + sd_cg**2 + (abs(hitch_there) * other.sd_heading) ** 2) / reach
    return wrap(seen.heading), sd


def _update_latency(state: Aligner, bodies: list[_Body], t_ns: int) -> None:
    """Update the receivers' relative latencies with the two baseline lengths and the gap at the hitch."""
    if state.last_pose_ns:
        state.latency.drift(max(0, t_ns - state.last_pose_ns) * 1e-9)
    if any(body.pair is None for body in bodies) or state.suspicion.verdict:
        return
    speeds: list[float] = []
    hitches: list[Vector] = []
    heading = 0.0
    for body, to_hitch in zip(
        bodies, (-state.machine.tractor.c.value, state.machine.implement.d.value), strict=True
    ):
        if body.pair is None or body.heading is None:
            return
        front, rear = (body.antennas[i] for i in BODIES[body.index])
        row = np.zeros(4)
        row[list(BODIES[body.index])] = 1.0, -1.0
        sd = math.hypot(front.sd, rear.sd)
        state.latency.update(row, body.pair.excess, sd, body.pair.speed_along)
        heading = body.heading
        hitches.append(hitch(front, rear, heading, to_hitch))
        speeds.append(body.pair.speed_along)
    ahead, right = hitch_gap(hitches[0], hitches[1], heading)
    _update_parked_means(state, bodies, ahead, right)
    sd = max(a.sd for body in bodies for a in body.antennas.values())
    state.latency.update(np.array([0.5, 0.5, -0.5, -0.5]), ahead, sd, sum(speeds) / 2)


def _solve_body(state: Aligner, body: _Body, t_ns: int, flags: list[Flag]) -> None:
    name = NAMES[body.index]
    if body.roll is None:
        flags.append(Flag(FlagKind.NO_ROLL, name))
    if body.yaw_rate is None:
        body.yaw_rate = _rate_of_heading(state, body, t_ns)
        flags.append(Flag(FlagKind.YAW_RATE_OF_HEADING if body.yaw_rate else FlagKind.NO_YAW_RATE, name))
    if body.heading is None:
        flags.append(Flag(FlagKind.MISSING, name))
        return
    antennas = list(body.antennas.values())
    rate, sd_rate = body.yaw_rate or (0.0, 0.0)
    body.velocity = cg_velocity(antennas, body.heading, rate, sd_rate)
    cg, sd = cg_position(antennas, body.heading, body.sd_heading)
    speed = math.hypot(*body.velocity[:2]) if body.velocity else 0.0
    common = state.latency.sd_mean(list(body.antennas)) * speed
    tilt = _roll_arm(state, body) * (body.roll[1] if body.roll else POSE.unknown_tilt)
    body.cg, body.sd_cg = cg, math.sqrt(sd**2 + common**2 + tilt**2)
    if len(antennas) == 2:
        state.last_heading[body.index] = (t_ns, body.heading, body.sd_heading)


def _roll_arm(state: Aligner, body: _Body) -> float:
    """Height between the CG and the reported points, m: the lever arm of a roll error."""
    cg_height = _section(state.machine, body.index).cg_height.value
    reaches = []
    for i in body.antennas:
        receiver = _receiver(state.machine, MOUNTS[i])
        reaches.append(cg_height - (0.0 if receiver.roll_corrected else receiver.position[2]))
    return abs(sum(reaches)) / len(reaches)


def _rate_of_heading(state: Aligner, body: _Body, t_ns: int) -> tuple[float, float] | None:
    """(yaw rate, sd), rad/s, from this heading and the one before, for a body without a measured yaw rate."""
    previous = state.last_heading[body.index]
    if body.heading is None or previous is None or not 0 < t_ns - previous[0] <= 2 * ALIGNMENT.pose_ns:
        return None
    seconds = (t_ns - previous[0]) * 1e-9
    return wrap(body.heading - previous[1]) / seconds, math.hypot(body.sd_heading, previous[2]) / seconds


def _direction(state: Aligner, tractor: _Body, t_ns: int) -> int:
    """+1, −1 or 0: from the velocity along the heading; without one, as the vehicle reports it."""
    if tractor.velocity is not None:
        u = tractor.velocity[0]
        return 0 if abs(u) < DRIVING.moving else (1 if u > 0 else -1)
    return state.direction if abs(t_ns - state.direction_ns) < LOST.lost_ns else 0


def _assemble(state: Aligner, bodies: list[_Body], t_ns: int, flags: list[Flag]) -> Pose:
    tractor, implement = bodies
    articulation, sd_articulation = None, None
    if tractor.heading is not None and implement.heading is not None:
        articulation = wrap(tractor.heading - implement.heading)
        sd_articulation = math.hypot(tractor.sd_heading, implement.sd_heading)
    wheel = sample_at(state.wheel, t_ns, ALIGNMENT.wheel_hold_ns)
    if wheel is None:
        kind = FlagKind.LOST if state.wheel_ns else FlagKind.WAITING
        flags.append(Flag(FlagKind.STANDS_STILL if state.wheel_stands() else kind, WHEEL))
    finest = min(
        (track.utc for track in state.tracks.values() if track.utc.offset_ns is not None),
        key=lambda utc: utc.resolution_s,
        default=None,
    )
    used = [index for body in bodies for index in body.antennas]
    assert state.origin_deg is not None
    return Pose(
        t_ns=t_ns,
        origin_latitude_deg=state.origin_deg[0],
        origin_longitude_deg=state.origin_deg[1],
        tractor=_body_pose(tractor),
        implement=_body_pose(implement),
        articulation=articulation,
        sd_articulation=sd_articulation,
        wheel_angle=wheel[0] if wheel else None,
        sd_wheel_angle=wheel[1] if wheel else None,
        direction=_direction(state, tractor, t_ns),
        utc_ns=finest.utc_ns(t_ns) if finest else None,
        sd_time=state.latency.sd_mean(used) if used else 0.0,
        receivers=len(used),
        flags=tuple(sorted(set(flags))),
    )


def _body_pose(body: _Body) -> BodyPose:
    u, v, sd_velocity = body.velocity or (None, None, None)
    sd_lateral = None
    if u is not None and sd_velocity is not None:
        sd_lateral = math.hypot(sd_velocity, u * body.sd_heading)
    return BodyPose(
        x=body.cg[0] if body.cg else None,
        y=body.cg[1] if body.cg else None,
        sd_position=body.sd_cg if body.cg else None,
        heading=body.heading,
        sd_heading=body.sd_heading if body.heading is not None else None,
        forward_velocity=u,
        lateral_velocity=v,
        sd_velocity=sd_velocity,
        sd_lateral_velocity=sd_lateral,
        yaw_rate=body.yaw_rate[0] if body.yaw_rate else None,
        sd_yaw_rate=body.yaw_rate[1] if body.yaw_rate else None,
        roll=body.roll[0] if body.roll else None,
        sd_roll=body.roll[1] if body.roll else None,
    )
