"""The motion with roll, against the planar model as its limit and against statics."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.estimator.models import nonlinear
from tilth.estimator.models.parameters import TABLE_5_1, Rig
from tilth.estimator.models.rolling import (
    HELD,
    LEAN,
    N_INPUTS,
    N_ROLLING,
    UNEVEN,
    RollModes,
    rates_rolling,
    roll_work,
)

Array = NDArray[np.float64]

MODES = RollModes(466e3, 1.0e6, 18e3, 20e3, 11.4e3, 3.1e3, 0.75, 466e3)
RNG = np.random.default_rng(5)
_rates = rates_rolling.interpreted()
_work = roll_work.interpreted()


def rates(x: Array, w: Array, rig: Rig, modes: RollModes = MODES) -> Array:
    out = np.zeros(N_ROLLING)
    _rates(x, w, rig.theta, rig, modes, np.zeros((6, 3)), _work(), out)
    return out


def some_state() -> Array:
    x = np.zeros(N_ROLLING)
    x[2:4] = RNG.uniform(-0.5, 0.5, 2)
    x[4:8] = [4.5, *RNG.uniform(-0.2, 0.2, 3)]
    x[8:11] = RNG.uniform(-0.1, 0.1, 3)
    return x


def some_inputs() -> Array:
    w = np.zeros(N_INPUTS)
    w[:4] = [*RNG.uniform(-0.3, 0.3, 3), 4.5]
    w[HELD] = RNG.uniform(-0.5, 0.5)
    return w


@pytest.mark.parametrize("front_drive", [0.0, 0.0, 0.4, 0.4, 1.0])
@pytest.mark.parametrize("narrow", [False, True])
def test_with_everything_at_the_ground_it_is_the_planar_model(front_drive: float, narrow: bool) -> None:
    """The planar model is driven by some force; this one is told only what u' that gives. Rates of slip are
    the planar model's without tracks: it has one slip angle for both wheels of an axle."""
    low = TABLE_5_1._replace(h_t=0.0, h_i=0.0, h_h=0.0, front_drive=front_drive, drive_gain=0.0)
    same = slice(0, 8)
    if narrow:
        low, same = low._replace(w_f=1e-6, w_r=1e-6, w_i=1e-6), slice(0, LEAN)
    x, w = some_state(), some_inputs()
    driven = w[:9].copy()
    driven[4] = RNG.uniform(-10e3, 10e3)
    planar = nonlinear.derivative(low, np.concatenate([x[:LEAN], [w[0], 0.0]]), driven)
    w[HELD] = planar[4]
    got = rates(x, w, low, MODES._replace(pin=0.0))
    np.testing.assert_allclose(got[same], planar[same], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("axle", [0, 1, 2])
def test_an_axle_slips_as_its_two_wheels_do_in_the_mean(axle: int) -> None:
    """Settled in a turn of 6 m radius, 8° of slip: the inner wheel is slower and slips at a larger angle."""
    rig, speed, turning, across = TABLE_5_1, 3.0, 0.5, 0.4
    ahead = (rig.a, -rig.b, -rig.c - rig.towed_length)[axle]
    x, w = np.zeros(N_ROLLING), np.zeros(N_INPUTS)
    x[4:8] = [speed, across - turning * ahead, turning, turning]
    half = 0.5 * turning * (rig.w_f, rig.w_r, rig.w_i)[axle]
    slips = []
    for angle in (math.atan(across / speed), _mean_slip(across, speed, half)):
        x[8 + axle] = angle
        slips.append(rates(x, w, rig, MODES._replace(pin=0.0))[8 + axle])
    assert abs(slips[1]) < 0.05 * abs(slips[0])


def _mean_slip(across: float, speed: float, half: float) -> float:
    """Mean of two wheels' slip angles, rad. half: of the difference of their speeds, m/s."""
    return 0.5 * (math.atan(across / (speed - half)) + math.atan(across / (speed + half)))


def test_the_speed_changes_as_it_is_told_whatever_the_drive() -> None:
    x, w = some_state(), some_inputs()
    x[LEAN:] = RNG.uniform(-0.03, 0.03, 4)
    pushed = w.copy()
    pushed[4] = 5e3
    free = TABLE_5_1._replace(drive_gain=0.0)
    assert rates(x, w, free)[4] == w[HELD]
    np.testing.assert_allclose(rates(x, pushed, free), rates(x, w, free), rtol=1e-9, atol=1e-12)


def test_left_and_right_are_alike() -> None:
    x, w = some_state(), some_inputs()
    x[LEAN:] = RNG.uniform(-0.03, 0.03, 4)
    mirror = np.ones(N_ROLLING)
    mirror[[1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14]] = -1.0
    w[UNEVEN : UNEVEN + 2] = RNG.uniform(-0.02, 0.02, 2)
    turned = w * np.where(np.isin(np.arange(N_INPUTS), [3, 4, HELD]), 1.0, -1.0)
    modes = MODES._replace(camber=0.2)
    there, back = rates(x, w, TABLE_5_1, modes), rates(mirror * x, turned, TABLE_5_1, modes)
    np.testing.assert_allclose(back, mirror * there, rtol=1e-9, atol=1e-12)


def test_on_a_slope_a_body_at_rest_leans_downhill_by_what_statics_say() -> None:
    """Held sideways by its tyres, with no hitch force: k phi = m h g sin, both bodies."""
    x, w = np.zeros(N_ROLLING), np.zeros(N_INPUTS)
    x[4] = 4.5
    w[1] = w[2] = 0.3
    apart = TABLE_5_1._replace(h_h=0.0, roll_f=0.0, roll_r=0.0, roll_i=0.0)
    x[LEAN], x[LEAN + 1] = (
        apart.m_t * apart.h_t * 0.3 / MODES.stiffness_t,
        apart.m_i * apart.h_i * 0.3 / MODES.stiffness_i,
    )
    # Side forces that hold the rig: of each axle its share of the gravity along the slope.
    front = apart.m_t * 0.3 * apart.b / (apart.a + apart.b)
    hitch = apart.m_i * 0.3 * apart.e / (apart.d + apart.e)
    front -= hitch * (apart.c - apart.b) / (apart.a + apart.b)
    rear = apart.m_t * 0.3 + hitch - front
    forces = (front, rear, apart.m_i * 0.3 - hitch)
    linear = apart._replace(grip_f=math.inf, grip_r=math.inf, grip_i=math.inf, load_exponent=0.0)
    x[8:11] = [force / stiffness for force, stiffness in zip(forces, linear.theta[:3], strict=True)]
    got = rates(x, w, linear, MODES._replace(pin=0.0))
    np.testing.assert_allclose(got[5:8], 0.0, atol=1e-9)
    np.testing.assert_allclose(got[LEAN + 2 : LEAN + 4], 0.0, atol=1e-9)
