"""Scale length, mass and time: each result scales as its unit says. The units are those of the table."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.estimator.models import nonlinear
from tilth.estimator.models.family import MODELS, Model
from tilth.estimator.models.linear_analysis import (
    characteristic_speed,
    eigenvalues,
    settling_distance,
    steady_gains,
    understeer_gradient,
)
from tilth.estimator.models.parameters import RIG_PARAMETERS, TABLE_5_1, Rig

Array = NDArray[np.float64]

LENGTH, MASS, TIME = 1.7, 0.6, 1.3  # new units per old
POWERS = {
    "1": (0, 0, 0), "m": (1, 0, 0), "kg": (0, 1, 0), "kg m^2": (2, 1, 0), "N/rad": (1, 1, -2),
    "N": (1, 1, -2), "m/s^2": (1, 0, -2), "N s/m": (0, 1, -1), "m/s": (1, 0, -1),
    "rad/s": (0, 0, -1), "rad": (0, 0, 0), "N m": (2, 1, -2), "1/s": (0, 0, -1), "rad s^2/m": (-1, 0, 2),
}  # fmt: skip
STATE_UNITS = {
    "x_t": "m", "y_t": "m", "psi_t": "rad", "psi_i": "rad", "u": "m/s", "v": "m/s", "r_t": "rad/s",
    "r_i": "rad/s", "alpha_f": "rad", "alpha_r": "rad", "alpha_i": "rad", "delta": "rad",
    "delta_rate": "rad/s",
}  # fmt: skip
INPUT_UNITS = {
    "delta": "rad", "gravity_t": "m/s^2", "gravity_i": "m/s^2", "speed": "m/s", "drive": "N", "force_t": "N",
    "moment_t": "N m", "force_i": "N", "moment_i": "N m",
}  # fmt: skip


def scale(unit: str) -> float:
    length, mass, time = POWERS[unit]
    return float(LENGTH**length * MASS**mass * TIME**time)


SCALED = Rig(*(value * scale(row.unit) for value, row in zip(TABLE_5_1, RIG_PARAMETERS, strict=True)))
SPEED = 4.5


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_matrices_scale(model: Model) -> None:
    a, b = model.matrices(TABLE_5_1, SPEED)
    scaled_a, scaled_b = model.matrices(SCALED, SPEED * scale("m/s"))
    states = np.array([scale(STATE_UNITS[name]) for name in model.states])
    inputs = np.array([scale(INPUT_UNITS[name]) for name in model.inputs])
    np.testing.assert_allclose(scaled_a, a * np.outer(states, 1 / states) / TIME, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(scaled_b, b * np.outer(states, 1 / inputs) / TIME, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(eigenvalues(scaled_a), eigenvalues(a) / TIME, rtol=1e-5, atol=1e-6)


def test_results_scale() -> None:
    fast = SPEED * scale("m/s")
    units = np.array([scale("m/s"), scale("rad/s"), 1.0])
    np.testing.assert_allclose(steady_gains(SCALED, fast), steady_gains(TABLE_5_1, SPEED) * units)
    assert understeer_gradient(SCALED) == pytest.approx(understeer_gradient(TABLE_5_1) * scale("rad s^2/m"))
    assert characteristic_speed(SCALED) == pytest.approx(characteristic_speed(TABLE_5_1) * scale("m/s"))
    poles = eigenvalues(MODELS[2].matrices(TABLE_5_1, SPEED)[0])
    scaled = eigenvalues(MODELS[2].matrices(SCALED, fast)[0])
    assert settling_distance(scaled, fast) == pytest.approx(settling_distance(poles, SPEED) * LENGTH)


def test_nonlinear_runs_scale() -> None:
    rng = np.random.default_rng(4)
    size = np.array([0.3, 0.5, 0.5, 0.5, 2e3, 2e3, 2e3, 1e3, 1e3])
    inputs = rng.normal(0, 1, (300, 9)) * size + np.array([0.1, 0, 0, SPEED, 0, 0, 0, 0, 0])
    x0 = nonlinear.running(SPEED, y_t=1.0, psi_t=0.2, v=0.1)
    one = nonlinear.simulate(TABLE_5_1, inputs, x0, 0.005)
    states = np.array([scale(STATE_UNITS[name]) for name in nonlinear.STATES])
    columns = np.array([scale(INPUT_UNITS[name]) for name in nonlinear.INPUTS])
    other = nonlinear.simulate(SCALED, inputs * columns, x0 * states, 0.005 * TIME)
    np.testing.assert_allclose(other / states, one, rtol=1e-8, atol=1e-9)
    assert one[:, 4].min() > 2.0  # where the sign of rolling resistance is not in doubt
