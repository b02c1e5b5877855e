"""Stores measurements until the pose: one track per receiver, the wheel angle; decides when a pose is due.

Pose instants are multiples of `pose_ns` on the log's clock. A pose is due when every active receiver has a
position at or after its instant, at the latest `deadline_ns` after it.
"""

import math
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field, fields
from typing import Final

from tilth.estimator.pose import latency, lateness, plausibility
from tilth.estimator.pose.geometry import to_plane
from tilth.estimator.pose.latency import Latency
from tilth.estimator.pose.lateness import Lateness
from tilth.estimator.pose.log_time import LOG_TIME
from tilth.estimator.pose.receiver_lost import lost
from tilth.estimator.pose.receiver_track import RECEIVER_TRACK, Sample, Track
from tilth.estimator.pose.screen import SCREEN, Screens
from tilth.estimator.state_json import NOT_STORED
from tilth.estimator.tuning import tuned
from tilth.schemas.channels import TOPIC_OF
from tilth.schemas.flow import (
    Attitude,
    EventKind,
    Fix,
    Heading,
    Measurement,
    Mount,
    Position,
    UtcTime,
    VehicleSpeed,
    Velocity,
    WheelAngle,
    YawRate,
)
from tilth.schemas.machine import Machine, Receiver
from tilth.schemas.notices import Notice, NoticeCode, notice
from tilth.schemas.pgn_table import DAY_NS
from tilth.schemas.rejections import Rejection, count


@dataclass(frozen=True, slots=True)
class AlignmentTuning:
    """How measurements of many clocks become instants of poses."""

    pose_ns: int = tuned(200_000_000, "ns", "time between two poses")
    deadline_ns: int = tuned(
        500_000_000, "ns", "longest wait of a pose for what receivers still have to send"
    )
    fix_ns: int = tuned(5_000_000_000, "ns", "a fix that was reported longer ago counts as unknown")
    moved_sd: float = tuned(0.03, "s", "least sd of the learned latency of a moved receiver: 0.1 m at 3 m/s")
    farthest_from_origin: float = tuned(
        5_000.0, "m", "further away, grid north is off by more than a milliradian"
    )
    origin_agreement: float = tuned(100.0, "m", "two positions this close may both be right")
    clocks_apart_ns: int = tuned(3_000_000_000, "ns", "of two that tell UTC: some tell it a second late")
    wheel_hold_ns: int = tuned(250_000_000, "ns", "for which the wheels' angle or speed is still used")
    wheel_speed_sd: float = tuned(0.1, "m/s", "sd of the speed that a vehicle reports of its wheels")


ALIGNMENT: Final = AlignmentTuning()

LEAP_SECONDS_NS = (16_000_000_000, 20_000_000_000)  # some tell GPS time for UTC
MOUNTS = tuple(Mount)
WHEEL_BASED_PGN = 65096
WHEEL = "wheel_angle"
WHEEL_NAME = f"{WHEEL} {WHEEL}"  # of its screen
_NUMBERS = {kind: tuple(f.name for f in fields(kind) if f.type in (float, float | None)) for kind in TOPIC_OF}
_RECEIVER_KINDS = (Velocity, YawRate, Attitude, Heading, Fix, UtcTime)  # of a receiver, besides positions


@dataclass(slots=True)
class Aligner:
    """The measurements that poses are computed from. Times in ns on the clock of Frame.rx_ns."""

    machine: Machine = field(metadata=NOT_STORED)
    tracks: dict[str, Track]  # by mount, in the order of flow.Mount
    latency: Latency
    wheel: deque[Sample] = field(default_factory=lambda: deque(maxlen=256))
    wheel_ns: int = 0
    wheel_speeds: deque[Sample] = field(default_factory=lambda: deque(maxlen=32))  # m/s, of PGN 65096
    wheel_speeds_of: str = ""  # bus and source address of who sends them; a second sender is not heard
    direction: int = 0  # as the vehicle reports it: +1 forward, -1 reverse; 0 if it does not report it
    direction_ns: int = 0
    origin_deg: tuple[float, float] | None = None
    origin_candidate_deg: tuple[float, float] | None = None
    screens: Screens = field(default_factory=Screens)
    lateness: Lateness = field(default_factory=Lateness)
    moving: bool = False  # the rig, at the last pose
    due_ns: int = 0  # instant of the next pose; 0 before the first position
    last_pose_ns: int = 0
    last_heading: list[tuple[int, float, float] | None] = field(default_factory=lambda: [None, None])
    """Of tractor and implement: instant, heading and its sd (rad) at the last pose with both receivers."""
    clocks_told: bool = False  # that two buses are not on one clock
    suspicion: plausibility.Suspicion = field(default_factory=plausibility.Suspicion)
    long_term: plausibility.LongTermMeans = field(default_factory=plausibility.LongTermMeans)

    def wheel_stands(self) -> bool:
        """Whether the readings of the wheel angle stand still, as they never do or as they cannot."""
        screen = self.screens.by.get(WHEEL_NAME)
        return screen is not None and (screen.stands or screen.failed)

    def in_use(self, body: int, t_ns: int) -> list[tuple[int, Track, int]]:
        """(index into MOUNTS, track, t_ns on its clock) of the receivers of a body that are not left out,
        front first. body: 0 tractor, 1 implement."""
        return [
            (index, track, t_ns + self.latency.excess_ns(index))
            for index in (2 * body, 2 * body + 1)
            if (track := self.tracks.get(MOUNTS[index].value)) is not None and not track.left_out
        ]


def initial(machine: Machine) -> Aligner:
    """The state before the first measurement."""
    by_mount = {r.mount: r for r in machine.receiver}
    present = [by_mount[m] for m in MOUNTS if m in by_mount]
    sds = [by_mount[m].latency.sd if m in by_mount else 0.0 for m in MOUNTS]
    return Aligner(
        machine=machine,
        tracks={r.mount.value: _track(r) for r in present},
        latency=latency.prior(sds),
    )


def use(state: Aligner, machine: Machine) -> None:
    """Another description of the same rig, from now on.

    Where its lengths are others, latencies were learned to explain the difference: they begin from the prior.
    So do the means of what did not fit.
    """
    before, state.machine = state.machine, machine
    if (machine.receiver, machine.implement) != (before.receiver, before.implement):
        state.latency, state.long_term = initial(machine).latency, plausibility.LongTermMeans()


def leave_out(state: Aligner, mounts: Collection[str]) -> None:
    """Do not use these receivers for poses, but all others; what was found with them is forgotten."""
    for index, mount in enumerate(MOUNTS):
        track = state.tracks.get(mount.value)
        if track is None:
            continue
        if track.left_out != (mount in mounts):  # being moved along its body was taken for latency
            state.latency.covariance[index, index] += ALIGNMENT.moved_sd**2
        track.left_out = mount in mounts
    state.suspicion, state.long_term = plausibility.Suspicion(), plausibility.LongTermMeans()
    state.last_heading = [None, None]


def leave_out_turn_rates(state: Aligner, mounts: Collection[str]) -> None:
    """Do not use the turn rates of these receivers, but those of all others."""
    for mount, track in state.tracks.items():
        track.smoothed = mount in mounts


def forget(state: Aligner, mounts: Collection[Mount]) -> None:
    """What these receivers have sent was another's."""
    for receiver in state.machine.receiver:
        if receiver.mount in mounts:
            state.tracks[receiver.mount.value] = _track(receiver)
    state.suspicion, state.long_term = plausibility.Suspicion(), plausibility.LongTermMeans()
    state.last_heading = [None, None]


def _track(receiver: Receiver) -> Track:
    zero = 0.0 if receiver.roll_zero is None else math.radians(receiver.roll_zero.value)
    return Track(round(receiver.latency.value * 1e9), zero, receiver.roll_sign, receiver.yaw_rate_sign)


def is_number(measurement: Measurement) -> bool:
    """Whether all its values are finite: one that is not would spoil every pose for a while."""
    for name in _NUMBERS[type(measurement)]:
        value = getattr(measurement, name)
        if value is not None and not math.isfinite(value):
            return False
    return True


def take(state: Aligner, measurement: Measurement) -> None:
    """Store one measurement."""
    state.screens.late = state.lateness.doubts(measurement.rx_ns)
    if isinstance(measurement, WheelAngle):
        lateness.take_wheel(state.lateness, measurement.rx_ns)
        delay_ns = round(state.machine.wheel_angle.delay * 1e9)
        reading = (measurement.rx_ns - delay_ns, measurement.angle, 0.0, measurement.sd)
        for t_ns, angle, _, sd in state.screens.near(WHEEL, WHEEL, reading, state.moving):
            state.wheel.append((t_ns, angle, sd))
        state.wheel_ns = measurement.rx_ns
        return
    if isinstance(measurement, VehicleSpeed):
        _take_vehicle_speed(state, measurement)
        return
    mount = measurement.origin.mount
    if mount is None:
        return
    track = state.tracks[mount.value]
    if isinstance(measurement, Position):
        _take_position(state, track, measurement)
    elif isinstance(measurement, _RECEIVER_KINDS):
        track.take(measurement, state.screens, state.moving)


def _take_vehicle_speed(state: Aligner, measurement: VehicleSpeed) -> None:
    if measurement.direction is not None:
        state.direction = 1 if measurement.direction == "forward" else -1
        state.direction_ns = measurement.rx_ns
    if measurement.pgn != WHEEL_BASED_PGN:
        return
    sender = f"{measurement.origin.bus} {measurement.origin.source}"
    state.wheel_speeds_of = state.wheel_speeds_of or sender
    if sender == state.wheel_speeds_of:
        reading = (measurement.rx_ns, measurement.speed, 0.0, ALIGNMENT.wheel_speed_sd)
        for t_ns, speed, _, _ in state.screens.near(WHEEL, "wheel_speed", reading, state.moving):
            state.wheel_speeds.append((t_ns, speed, 0.0))


def _take_position(state: Aligner, track: Track, position: Position) -> None:
    if position.pgn != track.position_pgn:
        # A receiver may send each position twice, as PGN 129025 and as 129029. The higher PGN is used only
        # when the lower one has stopped, so that no position counts twice.
        silent = not track.positions or lost(track.last_position_ns, position.rx_ns)
        if not silent and position.pgn > track.position_pgn:
            return
        track.position_pgn = position.pgn
    if not track.usable():
        return
    here = (position.latitude_deg, position.longitude_deg)
    if state.origin_deg is None:
        if not _agrees(state, here):
            return
        _set_origin(state, here, position.rx_ns)
    assert state.origin_deg is not None
    at = to_plane(state.origin_deg, *here)
    if not math.hypot(*at) <= ALIGNMENT.farthest_from_origin:  # also where the plane has no numbers
        drove_there = (
            track.positions and math.dist(at, track.positions[-1][1:3]) <= ALIGNMENT.origin_agreement
        )
        if not drove_there and not _is_elsewhere(track, here):
            count(state.screens.rejected, Rejection.SPIKE)
            return
        _set_origin(state, here, position.rx_ns)
        at = (0.0, 0.0)
    track.elsewhere_deg = None
    track.take_position(position, at, state.screens, state.moving)


def _is_elsewhere(track: Track, here: tuple[float, float]) -> bool:
    """Whether a receiver has been far from the origin, at one place, for `SCREEN.lasting` positions."""
    before, track.elsewhere_deg = track.elsewhere_deg, here
    near = before is not None and math.hypot(*to_plane(before, *here)) <= ALIGNMENT.origin_agreement
    track.elsewhere = track.elsewhere + 1 if near else 1
    return track.elsewhere >= SCREEN.lasting


def _agrees(state: Aligner, here: tuple[float, float]) -> bool:
    """Whether the position before agrees: a single one may be a first guess."""
    candidate, state.origin_candidate_deg = state.origin_candidate_deg, here
    return candidate is not None and math.hypot(*to_plane(candidate, *here)) <= ALIGNMENT.origin_agreement


def _set_origin(state: Aligner, here: tuple[float, float], rx_ns: int) -> None:
    """Set the origin of the plane here."""
    state.origin_deg = here
    state.due_ns = state.due_ns or (rx_ns // ALIGNMENT.pose_ns + 1) * ALIGNMENT.pose_ns
    state.screens.forget_places()
    for track in state.tracks.values():
        track.positions.clear()
        track.elsewhere_deg = None


def news(state: Aligner) -> list[tuple[str, Notice]]:
    """(kind, notice) of the events since the last call: how often receivers give positions, and buses whose
    clocks are apart."""
    out = _clocks_apart(state)
    for mount, track in state.tracks.items():
        out += [
            (kind, notice(NoticeCode(kind), of=mount, times=times, per_s=per_s))
            for kind, times, per_s in track.rate.news
        ]
        track.rate.news.clear()
    return out


def _clocks_apart(state: Aligner) -> list[tuple[str, Notice]]:
    """An event, once, if by the UTC that receivers tell two buses are not on one clock: in a log that was
    sorted by its stamps nothing else shows it."""
    offsets: dict[str, int] = {}  # bus -> its clock less UTC
    for receiver in state.machine.receiver:
        offset_ns = state.tracks[receiver.mount.value].utc.offset_ns
        if offset_ns is not None:
            offsets[receiver.bus] = min(offset_ns, offsets.get(receiver.bus, offset_ns))
    if state.clocks_told or len(offsets) < 2:
        return []
    (one, ns), (other, other_ns) = list(offsets.items())[:2]
    apart_ns = abs(ns - other_ns)
    of_leap_seconds = LEAP_SECONDS_NS[0] < apart_ns < LEAP_SECONDS_NS[1]
    another_time = apart_ns > DAY_NS  # a receiver tells it
    if apart_ns < ALIGNMENT.clocks_apart_ns or of_leap_seconds or another_time:
        return []
    state.clocks_told = True
    ahead, behind = (one, other) if ns > other_ns else (other, one)
    apart = notice(NoticeCode.BUSES_APART, ahead=ahead, behind=behind, apart_s=apart_ns * 1e-9)
    return [(EventKind.OTHER_CLOCK, apart)]


def due(state: Aligner, now_ns: int) -> int | None:
    """The instant of the pose that is due at now_ns (Frame.rx_ns of the latest frame), or None."""
    if state.due_ns == 0 or now_ns < state.due_ns:
        return None
    if now_ns - state.due_ns > LOG_TIME.silence_ns:
        state.due_ns = (now_ns - ALIGNMENT.deadline_ns) // ALIGNMENT.pose_ns * ALIGNMENT.pose_ns
    if not _positions_are_in(state, now_ns):
        return None
    instant = state.due_ns
    state.due_ns += ALIGNMENT.pose_ns
    return instant


def _positions_are_in(state: Aligner, now_ns: int) -> bool:
    if now_ns >= state.due_ns + ALIGNMENT.deadline_ns:
        return True
    return all(
        track.positions[-1][0] - state.latency.excess_ns(index) >= state.due_ns - RECEIVER_TRACK.near_ns
        for index, track in _active_receivers(state, now_ns)
    )


def _active_receivers(state: Aligner, now_ns: int) -> list[tuple[int, Track]]:
    """(index into MOUNTS, track) of the receivers that had a usable position lately."""
    return [
        (index, track)
        for index, mount in enumerate(MOUNTS)
        if (track := state.tracks.get(mount.value)) is not None
        and track.positions
        and track.usable()
        and not lost(track.last_position_ns, now_ns)
    ]
