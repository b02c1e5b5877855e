"""The wheel angle against the yaw rate."""

import math

import numpy as np
import pytest
from circle import demo_machine
from posed import pose_of

from tilth.estimator.pose import wheel_check
from tilth.estimator.pose.wheel_check import WheelCheck
from tilth.schemas.sentences import sentence


@pytest.mark.parametrize(
    ("factor", "key"),
    [
        (1.0, ""), (0.5, ""), (2.0, ""), (-1.0, "wheel_angle.sign"), (-0.5, "wheel_angle.sign"),
        (4.0, "wheel_angle.scale"), (57.3, "wheel_angle.scale"), (0.3, "wheel_angle.scale"),
        (1 / 57.3, "wheel_angle.scale"), (0.0, "wheel_angle.scale"),
    ],
)  # fmt: skip
def test_wheel_angle_against_yaw_rate(factor: float, key: str) -> None:
    machine, state = demo_machine(), WheelCheck()
    rng = np.random.default_rng(1)
    for k in range(150):
        r = 0.2 * math.sin(0.2 * k)
        angle = factor * math.atan(2.9 * r / 4.0) + rng.normal(0.0, 0.002)
        wheel_check.observe(state, machine, pose_of(4.0, r, angle))
    found = wheel_check.verdict(state)
    assert (found.key if found else "") == key
    assert ("radians" in sentence(found.reason if found else None)) == (factor in (57.3, 1 / 57.3))


@pytest.mark.parametrize("lag_s", [0.0, 0.15, 0.3])
def test_a_chirp_in_which_the_yaw_rate_lags_accuses_nobody(lag_s: float) -> None:
    """From 0.1 to 1.2 Hz in 40 s, as drivers are asked for."""
    machine, state = demo_machine(), WheelCheck()
    rng = np.random.default_rng(3)

    def angle(t: float) -> float:
        return 0.09 * math.sin(2 * math.pi * (0.1 + 1.1 * t / 80.0) * t)

    for k in range(200):
        t = 0.2 * k
        rate = 4.0 * math.tan(angle(max(t - lag_s, 0.0))) / 2.9 + rng.normal(0.0, 0.002)
        wheel_check.observe(state, machine, pose_of(4.0, rate, angle(t)))
        assert wheel_check.verdict(state) is None


def test_the_wheels_say_nothing_on_straight_rows_at_standstill_and_in_reverse() -> None:
    machine, state = demo_machine(), WheelCheck()
    for u, r, wheel in ((4.0, 0.001, -0.001), (0.2, 0.2, -0.3), (-2.0, 0.2, 0.3), (4.0, 0.1, None)):
        for _ in range(100):
            wheel_check.observe(state, machine, pose_of(u, r, wheel))
    assert wheel_check.verdict(state) is None
