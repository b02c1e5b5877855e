"""Levers lean with their body; directions and turns are the same for one and for many."""

import math

import numpy as np
import pytest

from tilth.estimator.rig.geometry import direction, lever, rotate, rotation, turned, wrap

ANGLES = np.random.default_rng(1).uniform(-10.0, 10.0, (4, 5))


def test_a_lever_leans_with_its_body() -> None:
    assert lever((1.0, 0.5, 3.0), 1.0, False, 0.0, 0.0) == (1.0, 0.5)
    forward, right = lever((1.0, 0.5, 3.0), 1.0, False, 0.1, 0.0)
    assert forward == 1.0 and right == pytest.approx(0.5 * math.cos(0.1) + 2.0 * math.sin(0.1))
    right = lever((1.0, 0.5, 3.0), 1.0, True, 0.1, 0.0)[1]
    assert right == pytest.approx(0.5 * math.cos(0.1) - math.sin(0.1))


def test_an_angle_is_wrapped_and_points_where_it_did() -> None:
    wrapped = wrap(ANGLES)
    assert np.all((wrapped >= -math.pi) & (wrapped < math.pi))
    assert np.cos(wrapped) == pytest.approx(np.cos(ANGLES)) and np.sin(wrapped) == pytest.approx(
        np.sin(ANGLES)
    )
    assert [wrap(angle) for angle in ANGLES.ravel().tolist()] == wrapped.ravel().tolist()


def test_a_vector_that_is_rotated_points_so_much_further_to_the_right() -> None:
    north, east = rotate((np.full(ANGLES.shape, 2.0), np.full(ANGLES.shape, 0.5)), ANGLES)
    assert wrap(direction((north, east)) - ANGLES) == pytest.approx(
        np.full(ANGLES.shape, math.atan2(0.5, 2.0))
    )
    assert rotation(ANGLES) @ np.array([2.0, 0.5]) == pytest.approx(np.stack([north, east], axis=-1))
    quarter = rotate((2.0, 0.5), math.pi / 2)
    assert turned(np.array([2.0, 0.5])) == pytest.approx(quarter)
