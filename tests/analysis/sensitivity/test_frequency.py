"""Sensitivities of transfer functions: equal to differences, and to what symmetry and slow steering say."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.analysis.rig_report import steady_turn
from tilth.analysis.sensitivity.frequency import OMEGA, TRANSFERS, frequency_sensitivities
from tilth.analysis.sensitivity.slopes import MACHINE_PARAMETERS, VARIED, by_logarithm, scaled
from tilth.estimator.models.family import MODELS, Model, model_named
from tilth.estimator.models.linear_analysis import frequency_response, system
from tilth.estimator.models.parameters import TABLE_7_2, Rig

SPEEDS = (1.0, 4.5, 7.5)  # m/s
H = 3e-6  # of a logarithm; near a zero of v at 1 m/s 1e-5 is too wide for 1e-6


@pytest.mark.parametrize("model", MODELS[:3], ids=lambda m: m.name)
@pytest.mark.parametrize("speed", SPEEDS)
def test_equal_to_central_differences(model: Model, speed: float) -> None:
    """To 1e-6, of gains and phases, every parameter and transfer function."""
    found = frequency_sensitivities(model, TABLE_7_2, speed)

    def log_response(rig: Rig) -> NDArray[np.complex128]:
        return np.log(frequency_response(system(model, rig, speed, outputs=TRANSFERS), OMEGA)[:, :, 0])

    for k, name in enumerate(MACHINE_PARAMETERS):
        up, down = (log_response(scaled(TABLE_7_2, {name: np.exp(way * H)})) for way in (1, -1))
        apart: NDArray[np.complex128] = up - down
        apart -= 2j * np.pi * np.round(apart.imag / (2 * np.pi))  # a logarithm jumps where a phase wraps
        np.testing.assert_allclose(found.gain[:, :, k], apart.real / (2 * H), rtol=0, atol=1e-6)
        np.testing.assert_allclose(found.phase[:, :, k], apart.imag / (2 * H), rtol=0, atol=1e-6)


def test_the_nonlinear_model_in_small_motions() -> None:
    """Its matrices are differences themselves, so to 1e-4 against wider ones."""
    model = model_named("nonlinear")
    found = frequency_sensitivities(model, TABLE_7_2, 4.5, parameters=VARIED)

    def log_gain(rig: Rig) -> NDArray[np.float64]:
        return np.log(np.abs(frequency_response(system(model, rig, 4.5, outputs=TRANSFERS), OMEGA)[:, :, 0]))

    for k, name in enumerate(VARIED):
        up, down = (log_gain(scaled(TABLE_7_2, {name: np.exp(way * 1e-3)})) for way in (1, -1))
        np.testing.assert_allclose(found.gain[:, :, k], (up - down) / 2e-3, rtol=0, atol=1e-4)


def test_slow_steering_is_a_steady_turn() -> None:
    """At low frequency the slope of the gain is that of the steady turn, and the phase hangs on nothing."""
    model = model_named("relaxation")
    found = frequency_sensitivities(model, TABLE_7_2, 4.5, omega=np.array([1e-3]), outputs=("r_t",))

    def log_rate(rig: Rig) -> NDArray[np.float64]:
        turn = steady_turn(model, rig, 4.5)
        assert turn is not None
        return np.log([abs(turn["yaw_rate"])])

    for k, name in enumerate(found.parameters):
        assert found.gain[0, 0, k] == pytest.approx(by_logarithm(log_rate, TABLE_7_2, name)[0], abs=1e-6)
    assert np.abs(found.phase[0, 0]).max() < 2e-3


def test_all_scales_together_change_nothing() -> None:
    """Forces and masses in the same proportion: the slopes over them add up to zero at every frequency."""
    found = frequency_sensitivities(model_named("relaxation"), TABLE_7_2, 4.5)
    scales = [found.parameters.index(n) for n in ("C_af", "C_ar", "C_ai", "m_t", "m_i", "I_t", "I_i")]
    np.testing.assert_allclose(found.gain[:, :, scales].sum(axis=2), 0.0, atol=1e-9)
    np.testing.assert_allclose(found.phase[:, :, scales].sum(axis=2), 0.0, atol=1e-9)


def test_a_larger_rig_at_a_larger_speed_bends_alike() -> None:
    """Lengths and speed times k, time as it was: forces times k, inertias times k². Angles stay."""
    model, omega = model_named("relaxation"), np.array([1.0, 3.0, 8.0])
    found = frequency_sensitivities(model, TABLE_7_2, 4.5, omega=omega, outputs=("articulation",))
    once = ("a", "b", "c", "d", "e", "sigma_f", "sigma_r", "sigma_i", "C_af", "C_ar", "C_ai")
    powers = {**dict.fromkeys(once, 1.0), "I_t": 2.0, "I_i": 2.0}
    total = sum(power * found.gain[:, 0, found.parameters.index(name)] for name, power in powers.items())

    def log_gain(speed: float) -> NDArray[np.float64]:
        sys = system(model, TABLE_7_2, speed, outputs=("articulation",))
        return np.log(np.abs(frequency_response(sys, omega)[:, 0, 0]))

    by_speed = (log_gain(4.5 * np.exp(H)) - log_gain(4.5 * np.exp(-H))) / (2 * H)
    assert np.abs(total).max() > 0.1
    np.testing.assert_allclose(total, -by_speed, rtol=0, atol=1e-6)


def test_an_unknown_output_is_named() -> None:
    with pytest.raises(ValueError, match="x_y is no output of this model; there are"):
        frequency_sensitivities(model_named("dynamic"), TABLE_7_2, 4.5, outputs=("x_y",))
