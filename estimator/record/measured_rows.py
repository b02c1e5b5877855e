"""The receivers' samples between two poses, each used once, as rows of a record."""

import math
from collections import deque
from dataclasses import dataclass, field

from tilth.estimator.pose.aligner import MOUNTS, POSE_NS, Aligner
from tilth.estimator.pose.geometry import lever, rotate, wrap
from tilth.estimator.pose.receiver_track import Stamped
from tilth.estimator.pose.roll_pitch import HALF_NS, RollPitch, roll_rate_noise, trusted_share
from tilth.estimator.record.record import EAST, HEADING, NORTH, VELOCITY, YAW_RATE
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Receiver

SLACK_NS = 2_000_000  # a new latency may move a sample this far before its segment: it does not count as late
_POSITION, _VELOCITY, _YAW_RATE, _HEADING = range(4)  # columns of UsedSamples.newest_ns

COLOURED_NOISE_FACTOR = 4.0  # noise of a roll rate is correlated over many samples: it counts as one error
Row = tuple[int, float, float, float, float]  # ns after the first tick; kind, place, value, sd of record.ROWS
Line = tuple[float, float]  # value at the start and at the end of a segment
Halves = tuple[float, float, float]  # and in its middle


@dataclass(frozen=True, slots=True)
class Knot:
    """One pose, as far as records need it."""

    t_ns: int
    origin_deg: tuple[float, float]
    reason: str  # why nothing may be learned from the segments next to it, or ""
    repeating: tuple[int, ...]  # receivers that repeat old positions, as in flow.Mount
    values: tuple[float, ...]  # u, psi_t, psi_i, r_t, r_i; () if incomplete
    roll_pitch: tuple[RollPitch, RollPitch]  # of tractor and implement


@dataclass(slots=True)
class UsedSamples:
    """Which samples have been used."""

    newest_ns: list[list[int]] = field(default_factory=lambda: [[0] * 4 for _ in MOUNTS])
    """Stamp of the newest used sample, of each receiver: position, velocity, yaw rate, heading."""
    cut_ns: int = 0  # end of the last segment
    late: int = 0  # samples that came after their segment had been built, and were dropped
    roll_rate_squares: list[list[float]] = field(default_factory=lambda: [[0.0, 0.0], [0.0, 0.0]])
    """Of each body: recent mean squares of its roll rate and of the noise of that rate, rad^2/s^2."""


@dataclass(frozen=True, slots=True)
class _Span:
    """One body between two poses."""

    start_ns: int
    end_ns: int
    psi: Line
    yaw_rate: Line
    pitch: Line
    roll: Halves
    roll_rate: Halves  # rad/s, times the share that is not noise
    sd_roll_rate: float  # rad/s, of the remaining noise


def rows_between(used: UsedSamples, aligner: Aligner, start: Knot, end: Knot, after: Knot) -> list[Row]:
    """All samples of the segment, not sorted. They count as used even if they are not returned.

    start, end: the poses at its ends; after: the pose after its end.
    """
    out: list[Row] = []
    spans = [_span(used.roll_rate_squares[body], body, start, end, after) for body in (0, 1)]
    receivers = aligner.machine.receiver
    bodies = [_body(receiver) for receiver in receivers]
    for receiver, body in zip(receivers, bodies, strict=True):
        index = MOUNTS.index(receiver.mount)
        rows = _of_receiver(used, aligner, receiver, spans[body], bodies.count(body) == 1)
        if index not in start.repeating and index not in end.repeating:
            out += rows
    used.cut_ns = end.t_ns
    return out


def _body(receiver: Receiver) -> int:
    return int(receiver.mount in (Mount.IMPLEMENT_FRONT, Mount.IMPLEMENT_REAR))


def _span(roll_rate_squares: list[float], body: int, start: Knot, end: Knot, after: Knot) -> _Span:
    first, last, following = start.roll_pitch[body], end.roll_pitch[body], after.roll_pitch[body]
    psi = yaw_rate = (0.0, 0.0)
    if start.values and end.values:
        psi = (start.values[1 + body], end.values[1 + body])
        yaw_rate = (start.values[3 + body], end.values[3 + body])
    seconds = POSE_NS * 1e-9
    low, high = (last.roll - first.roll) / seconds, (following.roll_before - last.roll_before) / seconds
    share = trusted_share(roll_rate_squares, high, roll_rate_noise(last, following))
    noise_sd = math.sqrt(share * roll_rate_squares[1])
    early = share * (last.roll_before - first.roll_before) / seconds
    return _Span(
        start.t_ns, end.t_ns, psi, yaw_rate, (first.pitch, last.pitch),
        (first.roll, last.roll_before, last.roll), (early, share * low, share * high), noise_sd,
    )  # fmt: skip


def _of_receiver(
    used: UsedSamples, aligner: Aligner, receiver: Receiver, span: _Span, only_receiver: bool
) -> list[Row]:
    """A receiver's samples of the span. only_receiver: it is the only one of its body, so its heading is
    used."""
    track, index, body = aligner.tracks[receiver.mount.value], MOUNTS.index(receiver.mount), _body(receiver)
    newest, excess_ns = used.newest_ns[index], aligner.latency.excess_ns(index)
    start_ns, end_ns = span.start_ns + excess_ns, span.end_ns + excess_ns
    follows_last = used.cut_ns == span.start_ns  # else what is older was never to be used
    out: list[Row] = []

    def unused(samples: deque[Stamped], kind: int) -> list[Stamped]:
        found = _new_samples(samples, newest[kind], end_ns)
        if found:
            newest[kind] = found[0][0]
        while found and found[-1][0] < start_ns - SLACK_NS:
            found.pop()
            used.late += follows_last
        return found

    for t_ns, rate, sd in unused(track.yaw_rates, _YAW_RATE):
        if not track.smoothed:
            out.append((max(0, t_ns - start_ns), YAW_RATE, body, rate, sd))
    for t_ns, north, east, sd in unused(track.velocities, _VELOCITY):
        since = max(0, t_ns - start_ns)
        across, sd_tilt = _velocity_across(span, receiver, since, north, east)
        out.append((since, VELOCITY, index, across, math.hypot(sd, sd_tilt)))
    for t_ns, north, east, sd in unused(track.positions, _POSITION):
        since = max(0, t_ns - start_ns)
        north, east = _position_upright(span, receiver, since, north, east)
        out.append((since, NORTH, index, north, sd))
        out.append((since, EAST, index, east, sd))
    for t_ns, heading, sd in unused(track.headings, _HEADING):
        if only_receiver:
            since = max(0, t_ns - start_ns)
            psi = _at(span.psi, since)
            out.append((since, HEADING, body, psi + wrap(heading - psi), sd))
    return out if track.usable() else []


def _new_samples(samples: deque[Stamped], newest_ns: int, end_ns: int) -> list[Stamped]:
    """The samples before end_ns that are newer than newest_ns, the newest first.

    Times are those of the track; the learned excess latency is not subtracted.
    """
    out: list[Stamped] = []
    for sample in reversed(samples):
        if sample[0] <= newest_ns:
            break
        if sample[0] < end_ns:
            out.append(sample)
    return out


def _at(line: Line, since_ns: int) -> float:
    return line[0] + (line[1] - line[0]) * (since_ns / POSE_NS)


def _interpolate_halves(values: Halves, since_ns: int) -> float:
    if since_ns < HALF_NS:
        return values[0] + (values[1] - values[0]) * (since_ns / HALF_NS)
    return values[1] + (values[2] - values[1]) * (since_ns / HALF_NS - 1.0)


def _tilt_displacement(span: _Span, receiver: Receiver, since_ns: int) -> tuple[float, float, float]:
    """(forward, right, right per rad of roll): shift of a receiver's reported point by roll and pitch, m."""
    roll = 0.0  # a state of the filters
    forward, right = lever(receiver.position, 0.0, receiver.roll_corrected, roll, _at(span.pitch, since_ns))
    height = 0.0 if receiver.roll_corrected else receiver.position[2]
    per_roll = height * math.cos(roll) - receiver.position[1] * math.sin(roll)
    return forward - receiver.position[0], right - receiver.position[1], per_roll


def _velocity_across(
    span: _Span, receiver: Receiver, since_ns: int, north: float, east: float
) -> tuple[float, float]:
    """(velocity to the right of psi, corrected for roll and pitch; sd that this correction adds), m/s."""
    psi = _at(span.psi, since_ns)
    forward, _, per_roll = _tilt_displacement(span, receiver, since_ns)
    tilt_velocity = forward * _at(span.yaw_rate, since_ns)
    across = east * math.cos(psi) - north * math.sin(psi) - tilt_velocity
    return across, 0.0 * per_roll


def _position_upright(
    span: _Span, receiver: Receiver, since_ns: int, north: float, east: float
) -> tuple[float, float]:
    """Position (north, east), corrected for roll and pitch, m."""
    psi = _at(span.psi, since_ns)
    forward, right, _ = _tilt_displacement(span, receiver, since_ns)
    ahead, aside = rotate((forward, right), psi)
    return north - ahead, east - aside
