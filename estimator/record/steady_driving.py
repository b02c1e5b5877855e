"""Finds steady turns and steady straight driving. Poses in, averages over steady blocks out.

Steady means that wheel angle, yaw rate and speed are constant over a block, that the wheels have not crept
since, and that the implement has had the distance to fall in line but for a fiftieth of the way. What is left
of the way is added to the articulation, by the kinematics of the towed axle, and half of it to its sd. Of
simulated headland loops those of 10 m radius and more are steady for about 5 s each; those of 8 m for a
second or not at all. Taken after three time constants instead of four, these have given C_ai too low, by 2.3
sds in the mean of ten runs, since the wheels still creep. A refused pose has a reason.
"""

import math
from collections import deque
from dataclasses import dataclass, field, replace

from tilth.estimator.record.record_builder import (
    BEYOND_ARTICULATION,
    BEYOND_WHEEL_ANGLE,
    LARGEST_ARTICULATION,
    LARGEST_WHEEL_ANGLE,
)
from tilth.schemas.flow import MISPLACED, WITHOUT_RTK, FlagKind, Pose

SLOWEST = 2.0  # m/s: at lower speeds slip is too small compared with noise
BLOCK = 5  # poses that are averaged into one sample
SETTLING = 4.0  # time constants of the implement; at small angles this is a distance of 4 (d + e)
LEFT_SD = 0.5  # sd of what is left of the way to the steady articulation, over what is left by the kinematics
SETTLING_S = 3.0
STEER_RANGE = math.radians(1.2)  # of the wheel angle within a block
YAW_ACCELERATION = 0.08  # rad/s^2
SPEED_RANGE = 0.4  # m/s
LONGEST_GAP_S = 1.0

_DISQUALIFYING = (
    (MISPLACED, "receivers do not fit the rig"),
    (WITHOUT_RTK, "no RTK fix"),
    ({FlagKind.LATE}, "late receiver"),
    ({FlagKind.NO_ROLL}, "roll not measured"),  # an unknown side slope of 3 degrees changes C_ai by a third
    (
        {FlagKind.HEADING_BY_HITCH, FlagKind.HEADING_BY_REPORTED, FlagKind.HEADING_BY_YAW_RATE},
        "heading not from two receivers",
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
    wheel_angle: float
    roll_t: float
    roll_i: float
    sd_velocity: float
    sd_yaw_rate: float
    sd_heading_t: float
    sd_heading_i: float
    sd_wheel_angle: float
    sd_roll_t: float
    sd_roll_i: float


@dataclass(slots=True)
class Steadiness:
    """State of the detection."""

    block: deque[SteadySample] = field(default_factory=lambda: deque(maxlen=BLOCK))
    unaveraged: int = 0  # poses of the block that have not been part of an average
    settled: float = 0.0  # s over time constants of the implement, since the last change
    start: float = 0.0  # articulation then, rad
    wheel_angle: float = 0.0  # then, rad: wheels that creep are not steady either
    settling_s: float = 0.0  # s still to wait


def observe(
    state: Steadiness, pose: Pose, seconds: float, implement_length: float
) -> tuple[SteadySample | None, str]:
    """(the mean over a steady block when one is complete, else None; why this pose is refused, or "").

    seconds: since the pose before; implement_length: d + e, m.
    """
    sample, reason = _sample(pose)
    if sample is None or seconds > LONGEST_GAP_S:
        state.block.clear()
        _start_settling(state, sample)
        return None, reason or "gap in the poses"
    state.settled += seconds / time_constant(sample, implement_length)
    state.settling_s -= seconds
    state.block.append(sample)
    reason = _unsteady_reason(state, seconds)
    if reason:
        state.unaveraged = 0
        return None, reason
    state.unaveraged += 1
    if state.unaveraged < BLOCK:
        return None, ""
    state.unaveraged = 0
    mean = _mean(list(state.block))
    middle = state.settled - (BLOCK - 1) / 2 * seconds / time_constant(mean, implement_length)
    return at_its_end(mean, state.start, middle), ""


def time_constant(sample: SteadySample, implement_length: float) -> float:
    """Of the articulation at this speed and angle, s: it is larger the further the rig is folded.

    It is the derivative over λ of the yaw rate of an implement without slip, (u sin λ + (v − c r) cos λ)/
    (d + e), where that is r. implement_length: d + e, m.
    """
    rate = sample.u - implement_length * sample.yaw_rate * math.sin(sample.articulation)
    return implement_length * math.cos(sample.articulation) / max(rate, 0.2 * sample.u)


def at_its_end(mean: SteadySample, start: float, settled: float) -> SteadySample:
    """The sample with the articulation to which the implement is on its way.

    start: articulation at the last change, rad. settled: time constants since then.
    """
    left = math.exp(-settled) / (1.0 - math.exp(-settled)) * (mean.articulation - start)
    sd = math.hypot(mean.sd_heading_i, LEFT_SD * left)
    return replace(mean, articulation=mean.articulation + left, sd_heading_i=sd)


def _start_settling(state: Steadiness, sample: SteadySample | None) -> None:
    state.settled = 0.0
    if sample is not None:
        state.start, state.wheel_angle = sample.articulation, sample.wheel_angle
    state.settling_s = SETTLING_S
    state.unaveraged = 0


def _unsteady_reason(state: Steadiness, seconds: float) -> str:
    if len(state.block) < BLOCK:
        return "settling"
    rates = [s.yaw_rate for s in state.block]
    angles = [s.wheel_angle for s in state.block]
    speeds = [s.u for s in state.block]
    half = BLOCK // 2
    ramp = (sum(rates[-half:]) - sum(rates[:half])) / half / max((BLOCK - half) * seconds, 1e-3)
    crept = abs(sum(angles) / len(angles) - state.wheel_angle)
    if max(max(angles) - min(angles), crept) > STEER_RANGE or abs(ramp) > YAW_ACCELERATION:
        _start_settling(state, state.block[-1])
        return "turning in or out"
    if max(speeds) - min(speeds) > SPEED_RANGE:
        return "speed not steady"
    if state.settled < SETTLING or state.settling_s > 0:
        return "settling"
    return ""


def _mean(block: list[SteadySample]) -> SteadySample:
    """The mean of each value; of each standard deviation, that of the mean."""

    def value(name: str) -> float:
        return float(sum(getattr(s, name) for s in block)) / len(block)

    def sd(name: str) -> float:
        return math.sqrt(sum(getattr(s, name) ** 2 for s in block)) / len(block)

    names = SteadySample.__dataclass_fields__
    means = {name: sd(name) if name.startswith("sd_") else value(name) for name in names if name != "v"}
    return SteadySample(v=None if any(s.v is None for s in block) else value("v"), **means)


def _sample(pose: Pose) -> tuple[SteadySample | None, str]:
    """(the values of a pose, ""), or (None, why it is refused)."""
    kinds = {flag.kind for flag in pose.flags}
    for disqualifying, reason in _DISQUALIFYING:
        if kinds & disqualifying:
            return None, reason
    if pose.direction < 0:
        return None, "reverse"
    tractor, implement = pose.tractor, pose.implement
    u = tractor.forward_velocity
    if u is not None and u < SLOWEST:
        return None, "too slow"
    if pose.wheel_angle is None:
        return None, "no wheel angle"
    if pose.articulation is None or tractor.yaw_rate is None or u is None:
        return None, "pose incomplete"
    if abs(pose.wheel_angle) > LARGEST_WHEEL_ANGLE:
        return None, BEYOND_WHEEL_ANGLE
    if abs(pose.articulation) > LARGEST_ARTICULATION:
        return None, BEYOND_ARTICULATION
    sample = SteadySample(
        u=u,
        v=tractor.lateral_velocity,
        yaw_rate=tractor.yaw_rate,
        articulation=pose.articulation,
        wheel_angle=pose.wheel_angle,
        roll_t=tractor.roll or 0.0,
        roll_i=implement.roll or 0.0,
        sd_velocity=tractor.sd_velocity or 0.0,
        sd_yaw_rate=tractor.sd_yaw_rate or 0.0,
        sd_heading_t=tractor.sd_heading or 0.0,
        sd_heading_i=implement.sd_heading or 0.0,
        sd_wheel_angle=pose.sd_wheel_angle or 0.0,
        sd_roll_t=tractor.sd_roll or 0.0,
        sd_roll_i=implement.sd_roll or 0.0,
    )
    return sample, ""
