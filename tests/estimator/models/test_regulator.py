"""Linear quadratic regulators over every model."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tilth.estimator.models import nonlinear
from tilth.estimator.models.actuator import BOSSERD, Actuator
from tilth.estimator.models.family import MODELS, Model, model_named
from tilth.estimator.models.linear_analysis import system
from tilth.estimator.models.parameters import TABLE_5_1
from tilth.estimator.models.regulator import closed_loop, gain_on, regulator

every_model = pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
every_actuator = pytest.mark.parametrize("actuator", [None, BOSSERD], ids=["bare", "actuator"])


@every_model
@every_actuator
def test_the_gain_is_optimal(model: Model, actuator: Actuator | None) -> None:
    """Any other gain nearby costs more; the cost by a long run of the closed loop."""
    sys = system(model, TABLE_5_1, 3.0, actuator=actuator)
    found = regulator(sys, q=1.0, r=800.0)
    assert found.poles.real.max() < 0
    x0 = np.zeros(len(sys.states))
    x0[sys.states.index("y_t")] = 1.0

    def cost(gain: np.ndarray) -> float:
        a = closed_loop(sys, gain)

        def rate(t: float, z: np.ndarray) -> np.ndarray:
            x = z[:-1]
            return np.append(a @ x, x @ x + 800.0 * (gain @ x) ** 2)

        return float(
            solve_ivp(rate, (0, 60), np.append(x0, 0.0), method="LSODA", rtol=1e-9, atol=1e-11).y[-1, -1]
        )

    best = cost(found.gain)
    for name in ("y_t", "psi_t"):
        other = found.gain.copy()
        other[sys.states.index(name)] *= 1.1
        assert cost(other) > best


def test_weights_may_be_one_each_or_a_matrix() -> None:
    sys = system(model_named("dynamic"), TABLE_5_1, 4.5)
    one = regulator(sys, 2.0, 100.0).gain
    np.testing.assert_allclose(regulator(sys, np.full(6, 2.0), 100.0).gain, one)
    np.testing.assert_allclose(regulator(sys, 2.0 * np.eye(6), 100.0).gain, one)
    assert np.abs(regulator(sys, 2.0, 1000.0).gain).max() < np.abs(one).max()


def test_standstill_is_refused_with_a_reason() -> None:
    with pytest.raises(ValueError, match=r"no gain steadies this rig at 0 m/s: choose another speed"):
        regulator(system(model_named("kinematic"), TABLE_5_1, 0.0))


@every_model
def test_a_reversing_rig_can_be_steadied(model: Model) -> None:
    assert regulator(system(model, TABLE_5_1, -1.0)).poles.real.max() < 0


def test_a_gain_goes_by_name() -> None:
    np.testing.assert_array_equal(gain_on(("b", "a"), np.array([2.0, 1.0]), ("a", "x", "b")), [1.0, 0.0, 2.0])
    with pytest.raises(ValueError, match="needs delta_rate"):
        gain_on(("a", "delta_rate"), np.ones(2), ("a",))


def test_the_relaxation_gain_steers_the_nonlinear_rig() -> None:
    """From 5 m and 20 degrees at 4.5 m/s, as in the dissertation's study: some 10 % over, and settled."""
    sys = system(model_named("relaxation"), TABLE_5_1, 4.5, actuator=BOSSERD)
    found = regulator(sys)
    gain = gain_on(found.states, found.gain, nonlinear.STATES)
    angle = np.radians(20.0)
    x = nonlinear.running(4.5, y_t=5.0, psi_t=angle, psi_i=angle)
    track = [x]
    for _ in range(2000):
        command = nonlinear.inputs_of(1, command=-gain @ x, speed=4.5)
        x = nonlinear.simulate(TABLE_5_1, command, x, 0.01, actuator=BOSSERD)[-1]
        track.append(x)
    y = np.array(track)[:, 1]
    assert 0.05 * 5 < -y.min() < 0.2 * 5
    assert np.abs(y[1400:]).max() < 0.15
