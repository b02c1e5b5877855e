"""Does the wheel angle fit the yaw rate? Checks sign and rough scale of the sensor; needs no tyre model.

Without slip the wheel angle of a tractor with yaw rate r at speed u is atan((a + b) r / u). Slip changes that
by a third at most. So a factor of three, or the opposite sign, is an error of the machine file; open_tracker
finds smaller errors. Both signals pass the same low-pass filter: in a fast chirp the yaw rate lags by up to a
quarter of a period, and then shows neither sign nor scale.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.driving import DRIVING
from tilth.estimator.pose.moments import Moments
from tilth.estimator.rig.residuals import path_angle
from tilth.estimator.tuning import tuned
from tilth.schemas.diagnosis import Diagnosis
from tilth.schemas.flow import Pose
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WheelCheckTuning:
    """When a wheel angle does not go with the path."""

    memory: float = tuned(100.0, "poses", "20 s over which moments forget")
    smoothing: float = tuned(10.0, "poses", "2 s, time constant")
    least_poses: float = tuned(25.0, "poses", "before anything is judged")
    least_angle_sd: float = tuned(math.radians(1.0), "rad", "smallest sd of an angle that is judged")
    sure_correlation: float = tuned(0.7, "1", "above, the two signals go together")
    no_correlation: float = tuned(0.3, "1", "below, the two signals are unrelated")
    largest_ratio: float = tuned(2.7, "1", "sd of the reading over sd of the angle without slip")
    smallest_ratio: float = tuned(0.38, "1", "the same, least")
    stuck_ratio: float = tuned(0.12, "1", "below, the reading does not move although the tractor turns")


WHEEL_CHECK: Final = WheelCheckTuning()


@dataclass(slots=True)
class WheelCheck:
    """Moments of (angle without slip, reading), rad, over the last `memory` poses."""

    smoothed: Array = field(default_factory=lambda: np.zeros(2))  # the two after the low-pass filter
    moments: Moments = field(default_factory=lambda: Moments.of(2))


def observe(state: WheelCheck, machine: Machine, pose: Pose) -> None:
    """Take one pose."""
    u, r, reading = pose.tractor.forward_velocity, pose.tractor.yaw_rate, pose.wheel_angle
    if u is None or r is None or reading is None or u < DRIVING.cruise:
        return
    sample = np.array([path_angle(machine.tractor.wheelbase, u, r), reading])
    state.smoothed += (sample - state.smoothed) / WHEEL_CHECK.smoothing
    state.moments.add(state.smoothed, WHEEL_CHECK.memory)


def verdict(state: WheelCheck) -> Diagnosis | None:
    """What is wrong, if anything is."""
    if state.moments.weight < WHEEL_CHECK.least_poses:
        return None
    moments = state.moments.covariance
    path_sd, reading_sd = np.sqrt(np.diag(moments))
    if max(path_sd, reading_sd) < WHEEL_CHECK.least_angle_sd:
        return None
    if path_sd > WHEEL_CHECK.least_angle_sd and reading_sd < WHEEL_CHECK.stuck_ratio * path_sd:
        return _wrong_scale(reading_sd / path_sd)
    correlation = moments[0, 1] / max(path_sd * reading_sd, 1e-12)
    if path_sd < WHEEL_CHECK.least_angle_sd / 3.0:
        return Diagnosis(Code.WHEEL_MOVES_ALONE, "wheel_angle")
    if correlation < -WHEEL_CHECK.sure_correlation:
        return Diagnosis(Code.WHEEL_OPPOSITE, "wheel_angle.sign")
    if (
        correlation > WHEEL_CHECK.sure_correlation
        and not WHEEL_CHECK.smallest_ratio < reading_sd / path_sd < WHEEL_CHECK.largest_ratio
    ):
        return _wrong_scale(reading_sd / path_sd)
    if (
        abs(correlation) < WHEEL_CHECK.no_correlation
        and path_sd > WHEEL_CHECK.least_angle_sd
        and reading_sd > WHEEL_CHECK.least_angle_sd
    ):
        return Diagnosis(Code.WHEEL_UNRELATED, "wheel_angle")
    return None


def _wrong_scale(ratio: float) -> Diagnosis:
    return Diagnosis(Code.WHEEL_SCALE, "wheel_angle.scale", numbers=("wheel_gain",), amounts=(float(ratio),))
