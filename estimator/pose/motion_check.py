"""Does each body move as far as its speed says, and roll as a body on wheels does? Needs no tyre model.

A receiver measures position and speed independently: over seconds, the displacement equals the integral of
the velocity. In a turn a body rolls outwards by a few hundredths of a radian per m/s^2 at most; a roll of a
tenth per m/s^2 is that of an inclinometer which is not corrected for acceleration (atan(a/g)). Tractor and
implement drive over the same slope, so over half a minute their rolls agree, except for a furrow.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.driving import DRIVING
from tilth.estimator.pose.aligner import ALIGNMENT
from tilth.estimator.pose.moments import Moments
from tilth.estimator.rig.geometry import rotate
from tilth.estimator.tuning import tuned
from tilth.schemas.diagnosis import Diagnosis
from tilth.schemas.flow import BodyPose, Pose
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]

NAMES: Final = ("tractor", "implement")


@dataclass(frozen=True, slots=True)
class MotionCheckTuning:
    """When distances or rolls do not go with the motion."""

    interval: int = tuned(10, "poses", "2 s: several metres, large against the noise of positions")
    interval_memory: float = tuned(10.0, "intervals", "20 s over which the mean forgets")
    least_intervals: float = tuned(5.0, "intervals", "before a distance is judged")
    largest_distance_error: float = tuned(0.1, "1", "slip, slope and latency at constant speed cause less")
    roll_memory: float = tuned(300.0, "poses", "60 s over which the moments of roll forget")
    least_roll_poses: float = tuned(75.0, "poses", "15 s before rolls are judged")
    least_acceleration_sd: float = tuned(0.3, "m/s^2", "lateral: with less, its effect on roll is not judged")
    least_correlation: float = tuned(0.8, "1", "of roll and lateral acceleration")
    roll_correlated: float = tuned(25.0, "poses", "5 s that count as one: ground is as long")
    gradient_sds: float = tuned(3.0, "sd", "by which the gradient must be beyond its limit")
    turned: float = tuned(0.01, "1", "mean square of cosine and sine of the heading that shows a slope")
    largest_roll_gradient: float = tuned(0.05, "rad s^2/m", "a body on its tyres has 0.004 to 0.03")
    largest_roll_difference: float = tuned(math.radians(10.0), "rad", "more than a wheel in a furrow")


MOTION_CHECK: Final = MotionCheckTuning()


@dataclass(slots=True)
class BodyMotion:
    """Sums of one body, with exponential forgetting."""

    place: tuple[float, float] | None = None  # position at the start of the interval: north, east, m
    integral: tuple[float, float] = (0.0, 0.0)  # of the velocity since then: north, east, m
    velocity: tuple[float, float] = (0.0, 0.0)  # north, east, m/s, at the pose before
    poses: int = 0  # since the start of the interval
    weight: float = 0.0  # number of intervals in the two sums that follow
    displacement_integral: float = 0.0  # displacement times integral of the velocity, m^2
    integral_squared: float = 0.0  # the integral squared, m^2
    rolls: Moments = field(default_factory=lambda: Moments.of(4))
    """Of lateral acceleration (m/s^2), roll (rad), cosine and sine of the heading."""


@dataclass(slots=True)
class MotionCheck:
    """State of the check; bodies: tractor, implement."""

    bodies: list[BodyMotion] = field(default_factory=lambda: [BodyMotion(), BodyMotion()])
    last_pose_ns: int = 0


def observe(state: MotionCheck, pose: Pose) -> None:
    """Take one pose."""
    follows = pose.t_ns - state.last_pose_ns == ALIGNMENT.pose_ns
    state.last_pose_ns = pose.t_ns
    for body, body_pose in zip(state.bodies, (pose.tractor, pose.implement), strict=True):
        if not follows:
            body.place = None
        _take_motion(body, body_pose)
        _take_roll(body, body_pose)


def found(state: MotionCheck) -> list[Diagnosis]:
    """What is contradictory now."""
    wrong = []
    for name, body in zip(NAMES, state.bodies, strict=True):
        ratio = (
            body.displacement_integral / body.integral_squared
            if body.weight >= MOTION_CHECK.least_intervals
            else 1.0
        )
        if abs(ratio - 1.0) > MOTION_CHECK.largest_distance_error:
            key = f"receiver on the {name} (source, latency)"
            wrong.append(Diagnosis(Code.FARTHER_THAN_SPEED, key, (name,), amounts=(ratio,)))
        gradient = _gradient(body)
        if gradient:
            key = f"receiver on the {name} (roll)"
            wrong.append(Diagnosis(Code.ROLL_FOLLOWS_TURNS, key, (name,), amounts=(gradient,)))
    tractor, implement = state.bodies
    difference = float(tractor.rolls.mean[1] - implement.rolls.mean[1])
    if (
        min(tractor.rolls.weight, implement.rolls.weight) >= MOTION_CHECK.least_roll_poses
        and abs(difference) > MOTION_CHECK.largest_roll_difference
    ):
        wrong.append(Diagnosis(Code.LEAN_APART, "receiver (roll)", amounts=(difference,)))
    return wrong


def roll_check_pending(state: MotionCheck) -> bool:
    """Whether rolls of both bodies are measured, but not yet for long enough to compare them."""
    tractor, implement = (body.rolls.weight for body in state.bodies)
    return min(tractor, implement) > 0.0 and min(tractor, implement) < MOTION_CHECK.least_roll_poses


def _take_motion(body: BodyMotion, body_pose: BodyPose) -> None:
    """Continue the interval. At its end its displacement and the integral of the velocity are added up."""
    speed = body_pose.forward_velocity
    if (
        body_pose.x is None
        or body_pose.y is None
        or speed is None
        or body_pose.heading is None
        or abs(speed) < DRIVING.cruise
    ):
        body.place = None
        return
    before = body.velocity
    body.velocity = rotate((speed, body_pose.lateral_velocity or 0.0), body_pose.heading)
    if body.place is None:
        body.place, body.integral, body.poses = (body_pose.x, body_pose.y), (0.0, 0.0), 0
        return
    half_s = ALIGNMENT.pose_ns * 1e-9 / 2
    north, east = ((one + other) * half_s for one, other in zip(before, body.velocity, strict=True))
    body.integral = (body.integral[0] + north, body.integral[1] + east)
    body.poses += 1
    if body.poses == MOTION_CHECK.interval:
        _add_interval(body, (body_pose.x - body.place[0], body_pose.y - body.place[1]))
        body.place, body.integral, body.poses = (body_pose.x, body_pose.y), (0.0, 0.0), 0


def _add_interval(body: BodyMotion, displacement: tuple[float, float]) -> None:
    keep = 1.0 - 1.0 / MOTION_CHECK.interval_memory
    body.weight = keep * body.weight + 1.0
    body.displacement_integral = (
        keep * body.displacement_integral
        + displacement[0] * body.integral[0]
        + displacement[1] * body.integral[1]
    )
    body.integral_squared = keep * body.integral_squared + body.integral[0] ** 2 + body.integral[1] ** 2


def _take_roll(body: BodyMotion, body_pose: BodyPose) -> None:
    speed, psi = body_pose.forward_velocity, body_pose.heading
    if body_pose.roll is None or body_pose.yaw_rate is None or speed is None or psi is None:
        return
    if abs(speed) < DRIVING.cruise:
        return
    sample = np.array([speed * body_pose.yaw_rate, body_pose.roll, math.cos(psi), math.sin(psi)])
    body.rolls.add(sample, MOTION_CHECK.roll_memory)


def _gradient(body: BodyMotion) -> float:
    """Roll per lateral acceleration, rad/(m/s^2), if surely beyond the limit; else 0. What goes with the
    heading is the slope of the field, as a plane. In a turn or two waves of the ground may go with it by
    chance."""
    if body.rolls.weight < MOTION_CHECK.least_roll_poses:
        return 0.0
    moments = body.rolls.covariance
    if moments[0, 0] < 0.99 * MOTION_CHECK.least_acceleration_sd**2:  # what the heading explains is less yet
        return 0.0
    by_heading = np.linalg.solve(moments[2:, 2:] + MOTION_CHECK.turned * np.eye(2), moments[2:, :2])
    left = moments[:2, :2] - moments[:2, 2:] @ by_heading
    acceleration_sd, roll_sd = np.sqrt(np.maximum(np.diag(left), 0.0))
    covariance = left[0, 1]
    if acceleration_sd < MOTION_CHECK.least_acceleration_sd:
        return 0.0
    if abs(covariance) < MOTION_CHECK.least_correlation * acceleration_sd * max(roll_sd, 1e-9):
        return 0.0
    gradient = float(covariance / acceleration_sd**2)
    apart = math.sqrt(max(float(left[1, 1]) - gradient * float(covariance), 0.0))  # sd of roll without it
    alike = max(body.rolls.weight / MOTION_CHECK.roll_correlated, 1.0)
    sd = apart / (acceleration_sd * math.sqrt(alike))
    sure = abs(gradient) > MOTION_CHECK.largest_roll_gradient + MOTION_CHECK.gradient_sds * sd
    return gradient if sure else 0.0
