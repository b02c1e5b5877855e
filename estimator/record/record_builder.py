"""Poses and raw samples in, segments of the record out, each with the reason if nothing may be learned from
it.

A segment is what lies between two poses. It is built when the next pose is there: then samples that were late
by less than the aligner's deadline have come, and a fix that was lost in between is known.
"""

import math
from collections import deque
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import Final

import numpy as np

from tilth.estimator.driving import DRIVING
from tilth.estimator.pose.aligner import ALIGNMENT, MOUNTS, Aligner
from tilth.estimator.pose.receiver_track import Sample
from tilth.estimator.pose.roll_pitch import roll_pitch_at
from tilth.estimator.record.measured_rows import Knot, Row, UsedSamples, rows_between
from tilth.estimator.record.record import INPUTS, ROWS, TICK_NS, Record, Segment, mean_of_three
from tilth.estimator.rig.geometry import wrap
from tilth.estimator.ties import exceeds
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import MISPLACED, WITHOUT_RTK, Flag, FlagKind, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code
from tilth.schemas.tolerances import MADE

TICKS = ALIGNMENT.pose_ns // TICK_NS  # of a segment


@dataclass(frozen=True, slots=True)
class RecordTuning:
    """Which driving is learned from."""

    largest_wheel_angle: float = tuned(math.radians(37.0), "rad", "full lock of a tractor, with a margin")
    largest_articulation: float = tuned(
        math.radians(62.0), "rad", "a headland turn at full lock, with a margin"
    )
    """Up to there the motion model is exact; beyond, a wheel angle is more likely wrong, and a hitch near its
    stop."""
    roughest_heading: float = tuned(math.radians(2.0), "rad", "largest sd of a heading to linearise about")
    wheel_gap_ns: int = tuned(150_000_000, "ns", "longest gap to interpolate: of a 10 Hz sensor with jitter")
    settling: int = tuned(10, "segments", "driven after a refusal (2 s) before anything is learned again")


RECORD: Final = RecordTuning()

WAYS_OF_DRIVING = (
    None, Code.SETTLING, Code.REVERSE, Code.TOO_SLOW, Code.BEYOND_WHEEL_ANGLE, Code.BEYOND_ARTICULATION,
)  # fmt: skip
"""Reasons of segments in which nothing is wrong with the data; None where something may be learned."""

_REFUSING = (
    (MISPLACED, Code.RECEIVERS_MISPLACED),
    (WITHOUT_RTK, Code.NO_RTK),
    ({FlagKind.LATE_FRAMES}, Code.FRAMES_LATE),
    ({FlagKind.NO_ROLL}, Code.NO_ROLL),
)
_HALVES = (0.0, 0.5, 1.0)


@dataclass(slots=True)
class RecordState:
    """State from pose to pose."""

    knots: list[Knot] = field(default_factory=list)  # the last four poses
    psi: list[float] = field(default_factory=lambda: [0.0, 0.0])  # last headings, not wrapped
    used: UsedSamples = field(default_factory=UsedSamples)
    settled: int = 0  # segments since the last one that was refused
    usable: bool = False  # whether the last segment may be learned from
    segments: int = 0  # number of these
    samples: int = 0  # rows in them
    refused: dict[Code, int] = field(default_factory=dict)  # reason -> segments


def initial(machine: Machine) -> RecordState:
    """The state before the first pose."""
    return RecordState()


def clock_stepped(state: RecordState) -> None:
    """The log's clock stepped back: earlier poses are useless now. Counts stay."""
    state.knots.clear()
    state.used = UsedSamples(late=state.used.late)
    state.settled, state.usable = 0, False


def observe(state: RecordState, aligner: Aligner, pose: Pose) -> Segment | None:
    """The segment that ends where the pose before this one stands; None before the third pose."""
    knots = state.knots
    if knots and pose.t_ns <= knots[-1].t_ns:
        clock_stepped(state)
    knots.append(_knot(state, aligner, pose))
    if len(knots) < 3:
        return None
    del knots[:-4]
    start, end, after = knots[-3:]
    record, reason = Record(start.t_ns), _gap_reason(start, end, after)
    rows = rows_between(state.used, aligner, start, end)
    if not reason:
        wheel = wheel_angles(aligner.wheel, start.t_ns)
        if wheel is None:
            reason = Code.NO_WHEEL_ANGLE
        elif aligner.wheel_stands():
            reason = Code.WHEEL_ANGLE_STANDS
        elif start.values and end.values:
            speeds = _speed(knots[:-3], start, end), _speed([start], end, after)
            record = _assemble(start, end, speeds, wheel, rows)
    reason = _settle(state, reason or _refusal(start, end, after, record))
    follows = state.usable and not reason
    state.usable = not reason
    if not reason:
        state.segments += 1
        state.samples += len(record.rows)
    return Segment(record, follows, reason)


def _settle(state: RecordState, reason: Code | None) -> Code | None:
    """The reason to refuse the segment, which is counted; None if it may be learned from."""
    if reason:
        state.settled = 0
    elif state.settled < RECORD.settling:
        state.settled += 1
        reason = Code.SETTLING
    if reason:
        state.refused[reason] = state.refused.get(reason, 0) + 1
    return reason


def _gap_reason(start: Knot, end: Knot, after: Knot) -> Code | None:
    """Why these poses are not consecutive in one plane."""
    if end.t_ns - start.t_ns != ALIGNMENT.pose_ns or after.t_ns - end.t_ns != ALIGNMENT.pose_ns:
        return Code.POSE_GAP
    if not start.origin_deg == end.origin_deg == after.origin_deg:
        return Code.NEW_ORIGIN
    return None


def _refusal(start: Knot, end: Knot, after: Knot, record: Record) -> Code | None:
    """Why nothing may be learned from this segment."""
    # The flags of the next pose show a fix that was lost in between, and positions that are doubtful.
    reason = start.reason or end.reason or after.reason
    if not reason and exceeds(float(np.abs(record.ticks[:, 0]).max()), RECORD.largest_wheel_angle, MADE):
        return Code.BEYOND_WHEEL_ANGLE
    return reason


# Inputs of the record.


def _knot(state: RecordState, aligner: Aligner, pose: Pose) -> Knot:
    tractor, implement = pose.tractor, pose.implement
    values: tuple[float, ...] = ()
    u, r_t = tractor.forward_velocity, tractor.yaw_rate
    heading_t, heading_i = tractor.heading, implement.heading
    if u is not None and heading_t is not None and heading_i is not None and r_t is not None:
        psi_t = state.psi[0] + wrap(heading_t - state.psi[0])
        psi_i = psi_t + wrap(heading_i - heading_t)
        state.psi[:] = psi_t, psi_i
        r_i = r_t if implement.yaw_rate is None else implement.yaw_rate
        values = (u, psi_t, psi_i, r_t, r_i)
    return Knot(
        pose.t_ns,
        (pose.origin_latitude_deg, pose.origin_longitude_deg),
        _reason(pose),
        tuple(i for i, mount in enumerate(MOUNTS) if Flag(FlagKind.REPEATING, mount.value) in pose.flags),
        values,
        (roll_pitch_at(aligner, 0, pose.t_ns), roll_pitch_at(aligner, 1, pose.t_ns)),
    )


def _reason(pose: Pose) -> Code | None:
    """Why nothing may be learned next to this pose."""
    # A lost receiver gives no rows, so its fix need not be known.
    lost = {replace(flag, kind=FlagKind.FIX_UNKNOWN) for flag in pose.flags if flag.kind is FlagKind.LOST}
    kinds = {flag.kind for flag in pose.flags if flag not in lost}
    for refusing, reason in _REFUSING:
        if kinds & refusing:
            return reason
    if pose.direction < 0:
        return Code.REVERSE
    bodies, u = (pose.tractor, pose.implement), pose.tractor.forward_velocity
    if any(
        body.sd_heading is None or exceeds(body.sd_heading, RECORD.roughest_heading, MADE) for body in bodies
    ):
        return Code.NO_HEADING
    if u is None or pose.tractor.yaw_rate is None or pose.articulation is None:
        return Code.POSE_INCOMPLETE
    if exceeds(DRIVING.under_way, u, MADE):
        return Code.TOO_SLOW
    if exceeds(abs(pose.articulation), RECORD.largest_articulation, MADE):
        return Code.BEYOND_ARTICULATION
    return None


def wheel_angles(samples: deque[Sample], t_ns: int) -> list[float] | None:
    """The wheel angle at each tick of a segment that starts at t_ns, rad; None after a gap that is too long.

    The samples around each tick (± half a tick) are averaged, values and times; the value at the tick is
    linear between these means. So the phase of the sensor against the ticks causes no delay.
    """
    # If every tick has samples, the means of one tick on either side suffice.
    return _interpolate(_means(samples, t_ns, 1)) or _interpolate(
        _means(samples, t_ns, RECORD.wheel_gap_ns // TICK_NS + 1)
    )


def _means(samples: deque[Sample], t_ns: int, beyond: int) -> list[tuple[float, float]]:
    """(ns after t, angle): means around the ticks of a segment and `beyond` more ticks on either side."""
    half = TICK_NS // 2
    origin_ns = t_ns - half
    count, total_ns, total = ([0.0] * (TICKS + 2 * beyond) for _ in range(3))
    for at_ns, angle, _ in reversed(samples):
        k = (at_ns - origin_ns) // TICK_NS + beyond
        if k < 0:
            break
        if k < len(count):
            count[k] += 1.0
            total_ns[k] += at_ns - t_ns
            total[k] += angle
    return [(at / n, angle / n) for n, at, angle in zip(count, total_ns, total, strict=True) if n]


def _interpolate(means: list[tuple[float, float]]) -> list[float] | None:
    """The value at each tick, linear between means; None if a gap is too long or an end is missing."""
    out: list[float] = []
    k = 1
    for tick in range(0, ALIGNMENT.pose_ns, TICK_NS):
        while k < len(means) and means[k][0] < tick:
            k += 1
        if k >= len(means) or means[k - 1][0] > tick:
            return None
        (before, low), (after, high) = means[k - 1], means[k]
        if after - before > RECORD.wheel_gap_ns:
            return None
        out.append(low + (high - low) * (tick - before) / (after - before))
    return out


def _speed(before: list[Knot], at: Knot, after: Knot) -> float:
    """Forward speed at a pose, m/s, by the poses beside it, too.

    The rate of the speed is an input of the motion, and pulls a folded implement sideways. Between two poses
    alone it has a noise of 0.16 m/s^2, of these means 0.05. Noise of an input makes the rig look heavier and
    its tyres softer than they are.
    """
    own = at.values[0]
    if not (before and before[-1].values and after.values):
        return own
    if not at.t_ns - before[-1].t_ns == after.t_ns - at.t_ns == ALIGNMENT.pose_ns:
        return own
    return mean_of_three(before[-1].values[0], own, after.values[0])


def _assemble(
    start: Knot, end: Knot, speeds: tuple[float, float], wheel: list[float], rows: list[Row]
) -> Record:
    """speeds: at the start and at the end, m/s."""
    shares = np.arange(TICKS) / TICKS
    low, high = (np.array([u, *knot.values[1:]]) for u, knot in zip(speeds, (start, end), strict=True))
    ticks = np.empty((TICKS, len(INPUTS)))
    ticks[:, 0] = wheel
    ticks[:, 1:6] = low + np.outer(shares, high - low)
    for body, (first, last) in enumerate(zip(start.roll_pitch, end.roll_pitch, strict=True)):
        ticks[:, 6 + body] = np.interp(shares, _HALVES, (first.roll, last.roll_before, last.roll))
    rows.sort(key=itemgetter(0))
    table = [
        (since // TICK_NS, (since % TICK_NS) * 1e-9, kind, place, value, sd)
        for since, kind, place, value, sd in rows
    ]
    return Record(start.t_ns, ticks, np.array(table, dtype=np.float64).reshape(-1, len(ROWS)))
