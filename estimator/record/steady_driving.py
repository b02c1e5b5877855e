"""Finds steady turns and steady straight driving. Poses in, averages over steady blocks out.

Steady means that wheel angle and speed are constant over a block, and that the slip angles have had the time
to follow the wheels. The implement need not be in line yet: how fast the rig folds is part of a
sample. Waiting for it would leave nothing of most headland turns. A refused pose has a reason.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Final

from tilth.estimator.record.record_builder import RECORD
from tilth.estimator.ties import exceeds
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import MISPLACED, WITHOUT_RTK, FlagKind, Pose
from tilth.schemas.reasons import Code
from tilth.schemas.tolerances import MADE


@dataclass(frozen=True, slots=True)
class SteadyDrivingTuning:
    """Which driving is steady."""

    slowest: float = tuned(1.2, "m/s", "at lower speeds slip is too small for the noise of one sample")
    block: int = tuned(5, "poses", "that are averaged into one sample")
    settling: float = tuned(2.0, "1", "of the implement's time constant: then slip angles follow it")
    settling_s: float = tuned(3.0, "s", "after a change, in which nothing is steady")
    steer_range: float = tuned(math.radians(1.2), "rad", "of the wheel angle within a block")
    speed_range: float = tuned(0.4, "m/s", "of the speed within a block")
    longest_gap_s: float = tuned(1.0, "s", "between two samples of one turn")


STEADY_DRIVING: Final = SteadyDrivingTuning()


_DISQUALIFYING = (
    (MISPLACED, Code.RECEIVERS_MISPLACED),
    (WITHOUT_RTK, Code.NO_RTK),
    ({FlagKind.LATE}, Code.RECEIVER_LATE),
    ({FlagKind.LATE_FRAMES}, Code.FRAMES_LATE),
    ({FlagKind.NO_ROLL}, Code.NO_ROLL),  # an unknown side slope of 3 degrees changes C_ai by a third
    (
        {FlagKind.HEADING_BY_HITCH, FlagKind.HEADING_BY_REPORTED, FlagKind.HEADING_BY_YAW_RATE},
        Code.HEADING_NOT_OF_PAIR,
    ),
)


@dataclass(frozen=True, slots=True)
class SteadySample:
    """One pose of steady driving, or the mean over a block. SI, rad.

    sd_…: standard deviation of the white noise of that value.
    """

    u: float
    v: float | None
    yaw_rate: float
    articulation: float
    folding: float  # rate of the articulation: yaw rate of the tractor less that of the implement
    wheel_angle: float
    roll_t: float
    roll_i: float
    sd_velocity: float
    sd_yaw_rate: float
    sd_yaw_rate_i: float
    sd_heading_t: float
    sd_heading_i: float
    sd_wheel_angle: float
    sd_roll_t: float
    sd_roll_i: float


@dataclass(slots=True)
class Steadiness:
    """State of the detection."""

    block: deque[SteadySample] = field(default_factory=lambda: deque(maxlen=STEADY_DRIVING.block))
    unaveraged: int = 0  # poses of the block that have not been part of an average
    settled: float = 0.0  # s over time constants of the implement, since the last change
    settling_s: float = 0.0  # s still to wait


def observe(
    state: Steadiness, pose: Pose, seconds: float, implement_length: float
) -> tuple[SteadySample | None, Code | None]:
    """(the mean over a steady block when one is complete, else None; why this pose is refused).

    seconds: since the pose before; implement_length: d + e, m.
    """
    sample, reason = _sample(pose)
    if sample is None or seconds > STEADY_DRIVING.longest_gap_s:
        state.block.clear()
        _start_settling(state)
        return None, reason or Code.POSE_GAP
    state.settled += seconds * sample.u / implement_length
    state.settling_s -= seconds
    state.block.append(sample)
    reason = _unsteady_reason(state)
    if reason:
        state.unaveraged = 0
        return None, reason
    state.unaveraged += 1
    if state.unaveraged < STEADY_DRIVING.block:
        return None, None
    state.unaveraged = 0
    return _mean(list(state.block)), None


def _start_settling(state: Steadiness) -> None:
    state.settled = 0.0
    state.settling_s = STEADY_DRIVING.settling_s
    state.unaveraged = 0


def _unsteady_reason(state: Steadiness) -> Code | None:
    if len(state.block) < STEADY_DRIVING.block:
        return Code.SETTLING
    angles = [s.wheel_angle for s in state.block]
    speeds = [s.u for s in state.block]
    if exceeds(max(angles) - min(angles), STEADY_DRIVING.steer_range, MADE):
        _start_settling(state)
        return Code.TURNING_IN_OR_OUT
    if exceeds(max(speeds) - min(speeds), STEADY_DRIVING.speed_range, MADE):
        return Code.SPEED_NOT_STEADY
    if state.settled < STEADY_DRIVING.settling or state.settling_s > 0:
        return Code.SETTLING
    return None


def _mean(block: list[SteadySample]) -> SteadySample:
    """The mean of each value; of each standard deviation, that of the mean."""

    def value(name: str) -> float:
        return float(sum(getattr(s, name) for s in block)) / len(block)

    def sd(name: str) -> float:
        return math.sqrt(sum(getattr(s, name) ** 2 for s in block)) / len(block)

    names = SteadySample.__dataclass_fields__
    means = {name: sd(name) if name.startswith("sd_") else value(name) for name in names if name != "v"}
    return SteadySample(v=None if any(s.v is None for s in block) else value("v"), **means)


def _sample(pose: Pose) -> tuple[SteadySample | None, Code | None]:
    """(the values of a pose, None), or (None, why it is refused)."""
    kinds = {flag.kind for flag in pose.flags}
    for disqualifying, reason in _DISQUALIFYING:
        if kinds & disqualifying:
            return None, reason
    if pose.direction < 0:
        return None, Code.REVERSE
    tractor, implement = pose.tractor, pose.implement
    u = tractor.forward_velocity
    if u is not None and exceeds(STEADY_DRIVING.slowest, u, MADE):
        return None, Code.TOO_SLOW
    if pose.wheel_angle is None:
        return None, Code.NO_WHEEL_ANGLE
    if pose.articulation is None or tractor.yaw_rate is None or implement.yaw_rate is None or u is None:
        return None, Code.POSE_INCOMPLETE
    if exceeds(abs(pose.wheel_angle), RECORD.largest_wheel_angle, MADE):
        return None, Code.BEYOND_WHEEL_ANGLE
    if exceeds(abs(pose.articulation), RECORD.largest_articulation, MADE):
        return None, Code.BEYOND_ARTICULATION
    sample = SteadySample(
        u=u,
        v=tractor.lateral_velocity,
        yaw_rate=tractor.yaw_rate,
        articulation=pose.articulation,
        folding=tractor.yaw_rate - implement.yaw_rate,
        wheel_angle=pose.wheel_angle,
        roll_t=tractor.roll or 0.0,
        roll_i=implement.roll or 0.0,
        sd_velocity=tractor.sd_velocity or 0.0,
        sd_yaw_rate=tractor.sd_yaw_rate or 0.0,
        sd_yaw_rate_i=implement.sd_yaw_rate or 0.0,
        sd_heading_t=tractor.sd_heading or 0.0,
        sd_heading_i=implement.sd_heading or 0.0,
        sd_wheel_angle=pose.sd_wheel_angle or 0.0,
        sd_roll_t=tractor.sd_roll or 0.0,
        sd_roll_i=implement.sd_roll or 0.0,
    )
    return sample, None
