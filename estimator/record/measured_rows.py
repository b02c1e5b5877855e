"""The receivers' samples between two poses, each used once, as rows of a record."""

import dataclasses
from collections import deque
from dataclasses import field
from typing import Final

from tilth.estimator.pose.aligner import ALIGNMENT, MOUNTS, Aligner
from tilth.estimator.pose.receiver_track import Stamped
from tilth.estimator.pose.roll_pitch import RollPitch
from tilth.estimator.record.record import EAST, HEADING, NORTH, ROLL_ANGLE, VELOCITY, YAW_RATE
from tilth.estimator.rig.geometry import between, lever, rotate, wrap
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Receiver
from tilth.schemas.reasons import Code
from tilth.schemas.values import dataclass


@dataclasses.dataclass(frozen=True, slots=True)
class MeasuredRowsTuning:
    """Which measurements are in time for a segment."""

    slack_ns: int = tuned(2_000_000, "ns", "by which a new latency may move a sample before its segment")


MEASURED_ROWS: Final = MeasuredRowsTuning()

_POSITION, _VELOCITY, _YAW_RATE, _HEADING, _ROLL = range(5)  # columns of UsedSamples.newest_ns

Row = tuple[int, float, float, float, float]  # ns after the first tick; kind, place, value, sd of record.ROWS
Line = tuple[float, float]  # value at the start and at the end of a segment


@dataclass(frozen=True, slots=True)
class Knot:
    """One pose, as far as records need it."""

    t_ns: int
    origin_deg: tuple[float, float]
    reason: Code | None  # why nothing may be learned from the segments next to it
    repeating: tuple[int, ...]  # receivers that repeat old positions, as in flow.Mount
    values: tuple[float, ...]  # u, psi_t, psi_i, r_t, r_i; () if incomplete
    roll_pitch: tuple[RollPitch, RollPitch]  # of tractor and implement


@dataclass(slots=True)
class UsedSamples:
    """Which samples have been used."""

    newest_ns: list[list[int]] = field(default_factory=lambda: [[0] * 5 for _ in MOUNTS])
    """Stamp of the newest used sample, of each receiver: position, velocity, yaw rate, heading,
    roll."""
    cut_ns: int = 0  # end of the last segment
    late: int = 0  # samples that came after their segment had been built, and were dropped


@dataclass(frozen=True, slots=True)
class _Span:
    """One body between two poses."""

    start_ns: int
    end_ns: int
    psi: Line
    yaw_rate: Line
    pitch: Line


def rows_between(used: UsedSamples, aligner: Aligner, start: Knot, end: Knot) -> list[Row]:
    """All samples of the segment, not sorted. They count as used even if they are not returned.

    start, end: the poses at its ends.
    """
    out: list[Row] = []
    spans = [_span(body, start, end) for body in (0, 1)]
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


def _span(body: int, start: Knot, end: Knot) -> _Span:
    psi = yaw_rate = (0.0, 0.0)
    if start.values and end.values:
        psi = (start.values[1 + body], end.values[1 + body])
        yaw_rate = (start.values[3 + body], end.values[3 + body])
    pitch = (start.roll_pitch[body].pitch, end.roll_pitch[body].pitch)
    return _Span(start.t_ns, end.t_ns, psi, yaw_rate, pitch)


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
        while found and found[-1][0] < start_ns - MEASURED_ROWS.slack_ns:
            found.pop()
            used.late += follows_last
        return found

    for t_ns, rate, sd in unused(track.yaw_rates, _YAW_RATE):
        if not track.smoothed:
            out.append((max(0, t_ns - start_ns), YAW_RATE, body, rate, sd))
    for t_ns, north, east, sd in unused(track.velocities, _VELOCITY):
        since = max(0, t_ns - start_ns)
        out.append((since, VELOCITY, index, _velocity_across(span, receiver, since, north, east), sd))
    for t_ns, north, east, sd in unused(track.positions, _POSITION):
        since = max(0, t_ns - start_ns)
        north, east = _position_upright(span, receiver, since, north, east)
        out.append((since, NORTH, index, north, sd))
        out.append((since, EAST, index, east, sd))
    for t_ns, roll, sd in unused(track.rolls, _ROLL):
        out.append((max(0, t_ns - start_ns), ROLL_ANGLE, index, roll, sd))
    for t_ns, heading, sd in unused(track.headings, _HEADING):
        if only_receiver:
            since = max(0, t_ns - start_ns)
            psi = _at(span.psi, since)
            out.append((since, HEADING, body, psi + wrap(heading - psi), sd))
    return out if track.usable() and not track.left_out else []


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
    return line[0] + (line[1] - line[0]) * (since_ns / ALIGNMENT.pose_ns)


def _pitch_displacement(span: _Span, receiver: Receiver, since_ns: int) -> float:
    """How far forward pitch shifts a receiver's reported point, m. Roll is a state of the filters."""
    forward, _ = lever(receiver.position, 0.0, receiver.roll_corrected, 0.0, _at(span.pitch, since_ns))
    return forward - receiver.position[0]


def _velocity_across(span: _Span, receiver: Receiver, since_ns: int, north: float, east: float) -> float:
    """Velocity to the right of psi, corrected for pitch, m/s."""
    _, across = rotate((north, east), -_at(span.psi, since_ns))
    return across - _pitch_displacement(span, receiver, since_ns) * _at(span.yaw_rate, since_ns)


def _position_upright(
    span: _Span, receiver: Receiver, since_ns: int, north: float, east: float
) -> tuple[float, float]:
    """Position (north, east), corrected for pitch, m."""
    forward = _pitch_displacement(span, receiver, since_ns)
    return between((north, east), rotate((forward, 0.0), _at(span.psi, since_ns)))
