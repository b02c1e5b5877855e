"""Distances against speeds, roll against turns."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from posed import pose_of

from tilth.estimator.pose import motion_check
from tilth.estimator.pose.aligner import ALIGNMENT
from tilth.estimator.pose.motion_check import MotionCheck
from tilth.schemas.flow import (
    Pose,
)
from tilth.schemas.reasons import Code
from tilth.schemas.sentences import sentence


def on_a_slope(speed: float = 1.0, gradient: float = 0.013, lean_i: float = 0.05) -> Iterator[Pose]:
    """Two minutes of turns at 4 m/s: the way over the speed, roll per m/s^2, the implement's roll."""
    rng = np.random.default_rng(2)
    x = y = psi = 0.0
    for k in range(600):
        r = 0.35 * math.sin(0.05 * k)
        psi += 0.2 * r
        x, y = x + 0.2 * 4.0 * speed * math.cos(psi), y + 0.2 * 4.0 * speed * math.sin(psi)
        pose = pose_of(4.0, r, None)
        tractor = replace(
            pose.tractor, x=x + rng.normal(0.0, 0.02), y=y + rng.normal(0.0, 0.02), heading=psi,
            roll=0.05 + gradient * 4.0 * r + rng.normal(0.0, 0.01),
        )  # fmt: skip
        implement = replace(tractor, roll=lean_i + rng.normal(0.0, 0.01))
        yield replace(pose, t_ns=k * ALIGNMENT.pose_ns, tractor=tractor, implement=implement)


@pytest.mark.parametrize(
    ("wrong", "texts"),
    [
        ({}, ()), ({"speed": 1.06}, ()), ({"speed": 1.3}, ("1.30 times as far",) * 2),
        ({"speed": 0.5}, ("0.50 times as far",) * 2), ({"gradient": 0.03}, ()),
        ({"gradient": 0.1}, ("roll follows its turns",)), ({"gradient": -0.1}, ("as no vehicle leans",)),
        ({"lean_i": 0.15}, ()), ({"lean_i": -0.2}, ("lean apart by +14°",)),
    ],
)  # fmt: skip
def test_ways_and_speeds_rolls_and_turns(wrong: dict[str, float], texts: tuple[str, ...]) -> None:
    state = MotionCheck()
    for pose in on_a_slope(**wrong):
        motion_check.observe(state, pose)
    found = [sentence(one.reason) for one in motion_check.found(state)]
    assert len(found) == len(texts)
    assert all(part in text for part, text in zip(texts, found, strict=True)), found


@pytest.mark.parametrize("slope_deg", [3.0, -5.0])
def test_a_slope_that_is_turned_round_on_is_no_lean(slope_deg: float) -> None:
    """Straight up a field and back: only the turn goes across the slope, and only it has side force."""
    state, psi = MotionCheck(), 0.0
    for k in range(225):
        r = math.pi / 12.0 if 125 <= k < 185 else 0.0  # 180 degrees in 12 s
        psi += 0.2 * r
        pose = pose_of(2.5, r, None)
        roll = math.radians(slope_deg) * math.sin(psi)
        bodies = (replace(body, heading=psi, roll=roll) for body in (pose.tractor, pose.implement))
        tractor, implement = bodies
        pose = replace(pose, t_ns=k * ALIGNMENT.pose_ns, tractor=tractor, implement=implement)
        motion_check.observe(state, pose)
        assert not any(one.code is Code.ROLL_FOLLOWS_TURNS for one in motion_check.found(state))


@pytest.mark.parametrize("seed", [6, 11, 17, 42])  # of 60, 6 were accused before
def test_waves_of_the_ground_that_go_with_two_turns_by_chance_are_no_wrong_roll(seed: int) -> None:
    """Steps of the wheels, 11 s each, at 0.5 m/s^2: rig 812 of the fleet was accused on ground of 2 cm."""
    state, rng, wave, psi = MotionCheck(), np.random.default_rng(seed), 0.0, 0.0
    for k in range(200):
        wave += -wave / 40.0 + rng.normal(0.0, 0.06 * math.sqrt(2.0 / 40.0))  # 8 s long
        r = (0.0, 0.12, 0.0, -0.12)[int(np.searchsorted((20, 75, 95), k % 150, side="right"))]
        psi += 0.2 * r
        pose = pose_of(4.0, r, None)
        tractor, implement = (
            replace(body, heading=psi, roll=wave) for body in (pose.tractor, pose.implement)
        )
        pose = replace(pose, t_ns=k * ALIGNMENT.pose_ns, tractor=tractor, implement=implement)
        motion_check.observe(state, pose)
        assert not any(one.code is Code.ROLL_FOLLOWS_TURNS for one in motion_check.found(state)), k
