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

from tilth.estimator.pose.moments import Moments
from tilth.estimator.rig.residuals import CRUISE, path_angle
from tilth.schemas.diagnosis import Diagnosis
from tilth.schemas.flow import Pose
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]

MEMORY: Final = 100.0  # poses (20 s)
SMOOTHING: Final = 10.0  # poses (2 s), time constant
LEAST_POSES: Final = 25.0  # poses
LEAST_ANGLE_SD: Final = math.radians(1.0)  # smallest sd of an angle that is judged
SURE_CORRELATION: Final = 0.7
NO_CORRELATION: Final = 0.3  # below, the two signals are unrelated
LARGEST_RATIO: Final = 2.7  # sd of the reading over sd of the angle without slip
SMALLEST_RATIO: Final = 0.38
STUCK_RATIO: Final = 0.12  # below, the reading does not move although the tractor turns


@dataclass(slots=True)
class WheelCheck:
    """Moments of (angle without slip, reading), rad, over the last MEMORY poses."""

    smoothed: Array = field(default_factory=lambda: np.zeros(2))  # the two after the low-pass filter
    moments: Moments = field(default_factory=lambda: Moments.of(2))


def observe(state: WheelCheck, machine: Machine, pose: Pose) -> None:
    """Take one pose."""
    u, r, reading = pose.tractor.forward_velocity, pose.tractor.yaw_rate, pose.wheel_angle
    if u is None or r is None or reading is None or u < CRUISE:
        return
    sample = np.array([path_angle(machine.tractor.wheelbase, u, r), reading])
    state.smoothed += (sample - state.smoothed) / SMOOTHING
    state.moments.add(state.smoothed, MEMORY)


def verdict(state: WheelCheck) -> Diagnosis | None:
    """What is wrong, if anything is."""
    if state.moments.weight < LEAST_POSES:
        return None
    moments = state.moments.covariance
    path_sd, reading_sd = np.sqrt(np.diag(moments))
    if max(path_sd, reading_sd) < LEAST_ANGLE_SD:
        return None
    if path_sd > LEAST_ANGLE_SD and reading_sd < STUCK_RATIO * path_sd:
        return _wrong_scale(reading_sd / path_sd)
    correlation = moments[0, 1] / max(path_sd * reading_sd, 1e-12)
    if path_sd < LEAST_ANGLE_SD / 3.0:
        return Diagnosis(Code.WHEEL_MOVES_ALONE, "wheel_angle")
    if correlation < -SURE_CORRELATION:
        return Diagnosis(Code.WHEEL_OPPOSITE, "wheel_angle.sign")
    if correlation > SURE_CORRELATION and not SMALLEST_RATIO < reading_sd / path_sd < LARGEST_RATIO:
        return _wrong_scale(reading_sd / path_sd)
    if abs(correlation) < NO_CORRELATION and path_sd > LEAST_ANGLE_SD and reading_sd > LEAST_ANGLE_SD:
        return Diagnosis(Code.WHEEL_UNRELATED, "wheel_angle")
    return None


def _wrong_scale(ratio: float) -> Diagnosis:
    return Diagnosis(Code.WHEEL_SCALE, "wheel_angle.scale", numbers=("wheel_gain",), amounts=(float(ratio),))
