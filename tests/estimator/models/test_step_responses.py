"""Step responses side by side: held to an independent integrator and to the local sensitivities."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tilth.analysis.sensitivity.local import local_sensitivities
from tilth.analysis.sensitivity.outputs import NAMES, SIX
from tilth.analysis.sensitivity.slopes import VARIED
from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import TABLE_7_2, Rig
from tilth.estimator.models.step_responses import FIELDS, growth, packed_systems, step_changes

pytestmark = pytest.mark.long


ANGLE = math.radians(10)
COLUMNS = np.array([FIELDS.index(name) for name in VARIED])
LOW = np.array([20e3, 50e3, 10e3, 0.1, 0.15, 0.1, 1100, 3200])
HIGH = np.array([450e3, 980e3, 340e3, 2.2, 3.0, 2.2, 7000, 21000])
Array = NDArray[np.float64]


def _rigs(n: int) -> Array:
    rng = np.random.default_rng(6)
    rigs = np.tile(np.array([getattr(TABLE_7_2, name) for name in FIELDS]), (n, 1))
    rigs[1:, COLUMNS] = LOW + (HIGH - LOW) * rng.integers(0, 5, (n - 1, 8)) / 4
    return rigs


def _shares(model: str, rigs: Array, speed: float, samples: int) -> tuple[Array, Array]:
    a, b = packed_systems(model_named(model), TABLE_7_2, rigs, COLUMNS, 0.01, speed)
    shares = np.zeros((len(rigs), len(COLUMNS), 6))
    step_changes(a, b, ANGLE, speed, samples, 0.01, shares)
    return shares, growth(a[:, 0])


def _rig(values: Array) -> Rig:
    return TABLE_7_2._replace(**dict(zip(FIELDS, values.tolist(), strict=True)))


@pytest.mark.parametrize("model", ["dynamic", "relaxation", "nonlinear"])
def test_the_same_as_the_local_sensitivities(model: str) -> None:
    """Six points: a group and a half of those that lie side by side."""
    rigs = _rigs(6)
    shares, grows = _shares(model, rigs, 4.5, 150)
    assert grows.max() < 0
    for found, values in zip(shares, rigs, strict=True):
        local = local_sensitivities(
            model_named(model), _rig(values), 4.5, seconds=1.5, parameters=VARIED
        ).step[:, [NAMES.index(name) for name in SIX]]
        np.testing.assert_allclose(found / 0.01, local, rtol=0, atol=1e-6 if model == "nonlinear" else 1e-9)


def _integrated(values: Array, speed: float, samples: int) -> Array:
    """(7 states and path, samples) of the relaxation model by an integrator of its own."""
    a, b = model_named("relaxation").matrices(_rig(values), speed)

    def slope(_: float, x: Array) -> Array:
        return np.asarray(a @ x + ANGLE * b[:, 0])

    at = 0.01 * np.arange(samples)
    return np.asarray(solve_ivp(slope, (0, at[-1]), np.zeros(9), "DOP853", at, rtol=1e-11, atol=1e-13).y)


def test_velocities_and_headings_as_an_integrator_finds_them() -> None:
    rigs = _rigs(3)
    shares, _ = _shares("relaxation", rigs, 7.5, 150)
    for found, values in zip(shares, rigs, strict=True):
        reference = _integrated(values, 7.5, 150)
        for k, column in enumerate(COLUMNS):
            raised = values.copy()
            raised[column] *= 1.01
            change = _integrated(raised, 7.5, 150) - reference
            moved = np.sqrt((change[:3] ** 2).sum(axis=1) / (reference[:3] ** 2).sum(axis=1))
            np.testing.assert_allclose(found[k, :3], moved, rtol=1e-6, atol=1e-10)
            turned = np.abs(change[7:, -1] / reference[7:, -1])
            np.testing.assert_allclose(found[k, 4:], turned, rtol=1e-6, atol=1e-9)


def test_a_model_without_velocities_is_refused() -> None:
    with pytest.raises(ValueError, match="no velocities of its own"):
        _shares("kinematic", _rigs(1), 4.5, 10)


def test_growth_tells_an_unstable_rig() -> None:
    values = _rigs(1)
    values[0, [FIELDS.index("C_af"), FIELDS.index("C_ar")]] = 450e3, 50e3
    assert _shares("relaxation", values, 7.5, 10)[1][0] > 0.1
