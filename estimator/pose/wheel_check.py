"""Does the wheels' angle answer the yaw rate? Sign and rough scale of the sensor, before any model of tyres.

Without slip the wheels of a tractor that turns at yaw rate r at speed u stand at atan((a + b) r / u).
Slip changes that by a third at the most; what is off by a factor of three, or goes the other way, is wrong in
the machine file. What is off by less is found by open_tracker. Both are smoothed alike: in a fast chirp the
yaw rate lags by as much as a quarter of a wave, and says nothing of sign or scale.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.schemas.flow import Pose
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

SLOWEST: Final = 1.5  # m/s
MEMORY: Final = 100.0  # poses (20 s)
SMOOTH: Final = 10.0  # poses (2 s), time constant
ENOUGH: Final = 25.0  # poses
TURNING: Final = math.radians(1.0)  # sd of either angle from which on they tell
AGREES: Final = 0.7  # correlation
STRANGE: Final = 0.3  # correlation below which they have nothing to do with each other
LARGEST: Final = 2.7  # of the reading over the angle without slip
SMALLEST: Final = 0.38
STILL: Final = 0.12  # and below which the wheels seem not to move at all
DEGREES: Final = (20.0, 160.0)  # a factor near 57.3: degrees and radians were taken for each other


@dataclass(slots=True)
class WheelCheck:
    """Moments of (angle without slip, reading), rad, over the last MEMORY poses. Plain data."""

    smooth: Array = field(default_factory=lambda: np.zeros(2))
    weight: float = 0.0
    mean: Array = field(default_factory=lambda: np.zeros(2))
    square: Array = field(default_factory=lambda: np.zeros((2, 2)))


def observe(state: WheelCheck, machine: Machine, pose: Pose) -> None:
    """Take one pose."""
    u, r, reading = pose.tractor.forward_velocity, pose.tractor.yaw_rate, pose.wheel_angle
    if u is None or r is None or reading is None or u < SLOWEST:
        return
    wheelbase = machine.tractor.a.value + machine.tractor.b.value
    sample = np.array([math.atan(wheelbase * r / u), reading])
    state.smooth += (sample - state.smooth) / SMOOTH
    keep = 1.0 - 1.0 / MEMORY
    state.weight = keep * state.weight + 1.0
    off = state.smooth - state.mean
    state.mean += off / state.weight
    state.square = keep * state.square + np.outer(off, state.smooth - state.mean)


def verdict(state: WheelCheck) -> tuple[str, str]:
    """(key of the machine file, what is wrong), or ("", "")."""
    if state.weight < ENOUGH:
        return "", ""
    turned, read = np.sqrt(np.diag(state.square) / state.weight)
    if max(turned, read) < TURNING:
        return "", ""
    if turned > TURNING and read < STILL * turned:
        return _factor(read / turned)
    together = state.square[0, 1] / state.weight
    correlation = together / max(turned * read, 1e-12)
    if turned < TURNING / 3.0:
        return "wheel_angle", "the wheels' angle moves, the tractor does not turn: wheel_angle?"
    if correlation < -AGREES:
        text = "the wheels' angle answers the yaw rate with the opposite sign: wheel_angle.sign?"
        return "wheel_angle.sign", text
    if correlation > AGREES and not SMALLEST < read / turned < LARGEST:
        return _factor(read / turned)
    if abs(correlation) < STRANGE and turned > TURNING and read > TURNING:
        text = "the wheels' angle has nothing to do with the yaw rate: wheel_angle (id, bytes, delay)?"
        return "wheel_angle", text
    return "", ""


def _factor(ratio: float) -> tuple[str, str]:
    size = f"{ratio:.2g} times" if ratio >= 1.0 else f"1/{1.0 / max(ratio, 1e-3):.2g} of"
    text = f"the wheels' angle is {size} what the yaw rate asks for: wheel_angle.scale?"
    if DEGREES[0] < max(ratio, 1.0 / max(ratio, 1e-3)) < DEGREES[1]:
        text += " (degrees per bit, not radians)"
    return "wheel_angle.scale", text
