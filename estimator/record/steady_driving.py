"""When is the rig in a steady turn, or steadily straight? Poses in, averages over steady blocks out.

Steady means that wheel angle, yaw rate and speed have held for a block and that the implement has had the
distance to fall in line since they last changed. What is refused has a reason.
"""

import math
from collections import deque
from dataclasses import dataclass, field

from tilth.schemas.flow import MISPLACED, WITHOUT_RTK, FlagKind, Pose

SLOWEST = 2.0  # m/s: below, slip is too small against noise
BLOCK = 5  # poses that are averaged into one sample
SETTLING_LENGTHS = 6.0  # in lengths d + e that an implement needs to fall in line: e^-6 of a step is left
SETTLING_S = 3.0
STEER_RANGE = math.radians(1.2)  # of the wheel angle within a block
YAW_ACCELERATION = 0.08  # rad/s^2
SPEED_RANGE = 0.4  # m/s
LARGEST_ANGLE = math.radians(15.0)  # of wheel and articulation: small-angle model
LONGEST_GAP_S = 1.0

_DISQUALIFYING = (
    (MISPLACED, "receivers do not fit the rig"),
    (WITHOUT_RTK, "no RTK fix"),
    ({FlagKind.LATE}, "late receiver"),
    ({FlagKind.NO_ROLL}, "roll not measured"),  # unseen, a side slope of 3 degrees moves C_ai by a third
    (
        {FlagKind.HEADING_BY_HITCH, FlagKind.HEADING_BY_REPORTED, FlagKind.HEADING_BY_YAW_RATE},
        "heading not from two receivers",
    ),
)


@dataclass(frozen=True, slots=True)
class Sample:
    """What steady driving looks like: one pose of it, or the mean over a block. SI, rad.

    sd: standard deviation of the white noise of each value named.
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
    """What the detection remembers. Distances m, times s."""

    block: deque[Sample] = field(default_factory=lambda: deque(maxlen=BLOCK))
    fresh: int = 0  # poses of the block that have not been part of an average
    unsettled_m: float = 0.0  # still to go until the implement is in line
    unsettled_s: float = 0.0


def observe(
    state: Steadiness, pose: Pose, seconds: float, implement_length: float
) -> tuple[Sample | None, str]:
    """(the mean over a steady block once one is complete, why this pose teaches nothing or "").

    seconds: since the pose before; implement_length: d + e, m.
    """
    sample, reason = _sample(pose)
    if sample is None or seconds > LONGEST_GAP_S:
        state.block.clear()
        _unsettle(state, implement_length)
        return None, reason or "gap in the poses"
    state.unsettled_m -= sample.u * seconds
    state.unsettled_s -= seconds
    state.block.append(sample)
    reason = _unsteady(state, implement_length, seconds)
    if reason:
        state.fresh = 0
        return None, reason
    state.fresh += 1
    if state.fresh < BLOCK:
        return None, ""
    state.fresh = 0
    return _mean(list(state.block)), ""


def _unsettle(state: Steadiness, implement_length: float) -> None:
    state.unsettled_m = SETTLING_LENGTHS * implement_length
    state.unsettled_s = SETTLING_S
    state.fresh = 0


def _unsteady(state: Steadiness, implement_length: float, seconds: float) -> str:
    if len(state.block) < BLOCK:
        return "settling"
    rates = [s.yaw_rate for s in state.block]
    angles = [s.wheel_angle for s in state.block]
    speeds = [s.u for s in state.block]
    half = BLOCK // 2
    ramp = (sum(rates[-half:]) - sum(rates[:half])) / half / max((BLOCK - half) * seconds, 1e-3)
    if max(angles) - min(angles) > STEER_RANGE or abs(ramp) > YAW_ACCELERATION:
        _unsettle(state, implement_length)
        return "turning in or out"
    if max(speeds) - min(speeds) > SPEED_RANGE:
        return "speed not steady"
    if state.unsettled_m > 0 or state.unsettled_s > 0:
        return "settling"
    return ""


def _mean(block: list[Sample]) -> Sample:
    """Of values the mean; of standard deviations the mean's."""

    def value(name: str) -> float:
        return float(sum(getattr(s, name) for s in block)) / len(block)

    def sd(name: str) -> float:
        return math.sqrt(sum(getattr(s, name) ** 2 for s in block)) / len(block)

    names = Sample.__dataclass_fields__
    means = {name: sd(name) if name.startswith("sd_") else value(name) for name in names if name != "v"}
    return Sample(v=None if any(s.v is None for s in block) else value("v"), **means)


def _sample(pose: Pose) -> tuple[Sample | None, str]:
    """The pose's numbers, or why it cannot teach."""
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
    if max(abs(pose.wheel_angle), abs(pose.articulation)) > LARGEST_ANGLE:
        return None, "outside the small-angle model"
    sample = Sample(
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
