"""The motion with roll, against the planar model as its limit and against statics."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.estimator.models import nonlinear
from tilth.estimator.models.parameters import TABLE_5_1, Rig
from tilth.estimator.models.rolling import LEAN, N_ROLLING, RollModes, rates_rolling, roll_work

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
    w = np.zeros(11)
    w[:4] = [*RNG.uniform(-0.3, 0.3, 3), 4.5]
    return w


@pytest.mark.parametrize("_", range(5))
def test_with_everything_at_the_ground_it_is_the_planar_model(_: int) -> None:
    low = TABLE_5_1._replace(h_t=0.0, h_i=0.0, h_h=0.0)
    modes = MODES._replace(pin=0.0)
    x, w = some_state(), some_inputs()
    planar = nonlinear.derivative(low, np.concatenate([x[:LEAN], [w[0], 0.0]]), w[:9])
    np.testing.assert_allclose(rates(x, w, low, modes)[:LEAN], planar[:LEAN], rtol=1e-9, atol=1e-12)


def test_left_and_right_are_alike() -> None:
    x, w = some_state(), some_inputs()
    x[LEAN:] = RNG.uniform(-0.03, 0.03, 4)
    mirror = np.ones(N_ROLLING)
    mirror[[1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14]] = -1.0
    turned = w * np.where(np.isin(np.arange(11), [3, 4]), 1.0, -1.0)
    there, back = rates(x, w, TABLE_5_1), rates(mirror * x, turned, TABLE_5_1)
    np.testing.assert_allclose(back, mirror * there, rtol=1e-9, atol=1e-12)


def test_on_a_slope_a_body_at_rest_leans_downhill_by_what_statics_say() -> None:
    """Held sideways by its tyres, with no hitch force: k phi = m h g sin, both bodies."""
    x, w = np.zeros(N_ROLLING), np.zeros(11)
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
