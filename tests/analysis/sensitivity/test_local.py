"""Local sensitivities: the published ones, and the derivative as the limit of the step."""

import json

import numpy as np
import pytest
from paths import shared
from scipy.integrate import solve_ivp

from tilth.analysis.sensitivity import local, outputs
from tilth.analysis.sensitivity.local import local_sensitivities, overall, response_slope
from tilth.analysis.sensitivity.outputs import NAMES, SIX, Unstable, case_of, measured, respond
from tilth.analysis.sensitivity.slopes import MACHINE_PARAMETERS, VARIED, scaled
from tilth.estimator.models.family import MODELS, Model, model_named
from tilth.estimator.models.manoeuvres import MANOEUVRES
from tilth.estimator.models.parameters import TABLE_7_2

RELAXATION = model_named("relaxation")
STEERINGS = [row.name for row in MANOEUVRES]
DISSERTATION = ((1.0, 30.0), (4.5, 6.0), (7.5, 3.0))  # m/s, s
LINEAR = MODELS[:3]
COLUMNS = [NAMES.index(name) for name in SIX]


def test_every_published_local_sensitivity() -> None:
    printed = json.loads(shared("reference/model_values.json").read_text())["local_sensitivity_table_7_2"]
    keys = ("Cf", "Cr", "Ci", "sf", "sr", "si", "mi", "Ii")
    for speed, seconds in DISSERTATION:
        found = local_sensitivities(RELAXATION, TABLE_7_2, speed, seconds=seconds, parameters=VARIED)
        assert set(printed[str(speed)]) == set(keys)
        with_mean = np.column_stack([found.step[:, COLUMNS], overall(found.step)])
        np.testing.assert_allclose(with_mean, [printed[str(speed)][key] for key in keys], rtol=0, atol=6e-5)


def test_local_sensitivity_to_the_front_stiffness() -> None:
    """A handful of the same numbers, so that these are held to them everywhere."""
    found = local_sensitivities(RELAXATION, TABLE_7_2, 4.5, seconds=6.0, parameters=("C_af",))
    printed = [0.2179, 0.1899, 0.1731, 0.1789, 0.137, 0.1413]
    np.testing.assert_allclose(found.step[0, COLUMNS], printed, rtol=0, atol=6e-5)
    assert overall(found.step)[0] == pytest.approx(np.mean(printed), abs=5e-5)


@pytest.mark.parametrize("model", LINEAR, ids=lambda m: m.name)
def test_the_derivative_is_the_limit_of_the_step(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    """The difference shrinks with the step, to a tenth for a tenth."""
    apart = []
    for share in (1e-2, 1e-3):
        monkeypatch.setattr(local, "SHARE", share)
        found = local_sensitivities(model, TABLE_7_2, 4.5, seconds=3.0)
        apart.append(np.abs(found.step - found.derivative).max())
    assert 0 < apart[1] < 0.11 * apart[0] < 0.11 * 0.02


@pytest.mark.parametrize(
    ("model", "steering"),
    [
        *((model, outputs.STEP) for model in LINEAR),
        *(pytest.param(model, outputs.STEP, marks=pytest.mark.long) for model in MODELS[len(LINEAR) :]),
        *((RELAXATION, name) for name in STEERINGS[1:]),
    ],
    ids=lambda one: getattr(one, "name", one),
)
def test_every_derivative_is_that_of_the_response(model: Model, steering: str) -> None:
    """Against central differences of the whole response, each part and each parameter; the nonlinear model's
    own matrices are differences, and rougher."""
    case = case_of(model, TABLE_7_2, 3.0, 1.0, steering=steering)
    h = 1e-4
    for name in MACHINE_PARAMETERS:
        slope = response_slope(case, TABLE_7_2, name)
        up, down = (respond(case, scaled(TABLE_7_2, {name: 1 + way * h})) for way in (1, -1))
        for part, after, before in zip(slope, up, down, strict=True):
            scale = np.abs(after).max()
            rough = 1e-4 if model.name == "nonlinear" else 2e-6
            np.testing.assert_allclose(part, (after - before) / (2 * h), rtol=0, atol=rough * scale)


def test_parameters_that_a_model_does_not_have_do_nothing() -> None:
    found = local_sensitivities(model_named("kinematic"), TABLE_7_2, 4.5, seconds=2.0)
    tyres = [found.parameters.index(name) for name in (*VARIED, "h_t", "h_i")]
    assert not found.step[tyres].any() and not found.derivative[tyres].any()
    assert found.derivative[found.parameters.index("d")].any()


def test_signs() -> None:
    """Stiffer front tyres turn the rig faster, stiffer rear ones slower."""
    found = local_sensitivities(RELAXATION, TABLE_7_2, 4.5, parameters=("C_af", "C_ar"))
    signs = np.sign(found.signed[:, [NAMES.index(name) for name in ("steady_r", "psi_t", "r_t")]])
    np.testing.assert_array_equal(signs, [[1, 1, 1], [-1, -1, -1]])
    np.testing.assert_array_equal(np.abs(found.signed), found.derivative)


def test_the_horizon_is_twice_the_settling_time() -> None:
    """Near the printed 30 and 6 s; the printed 3 s at 7.5 m/s is that of table 5.1's relaxation lengths."""
    shorter = TABLE_7_2._replace(sigma_f=0.75, sigma_r=1.0, sigma_i=0.75)
    seconds = [case_of(RELAXATION, TABLE_7_2, speed).seconds for speed in outputs.SPEEDS]
    np.testing.assert_allclose(seconds, [29.66, 6.14, 3.8], atol=0.01)
    assert case_of(RELAXATION, shorter, 7.5).seconds == pytest.approx(2.88)


def test_off_tracking_is_that_of_the_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """From positions of a long simulated turn, fitted by circles; in short steps, since paths are sums."""
    monkeypatch.setattr(outputs, "STEP_S", 1e-3)
    case = case_of(RELAXATION, TABLE_7_2, 4.5, 20.0, np.radians(4.0))
    series = []
    for seconds in np.linspace(10.0, 20.0, 41):
        part = case._replace(wheel=case.wheel[: round(seconds / outputs.STEP_S)])
        answer = respond(part, TABLE_7_2)
        series.append((answer.place, answer.implement_place))
    radii = []
    for body in (0, 1):
        points = np.array([pair[body] for pair in series])
        rows = np.column_stack([2 * points, np.ones(len(points))])
        north, east, rest = np.linalg.lstsq(rows, (points**2).sum(axis=1), rcond=None)[0]
        radii.append(np.sqrt(rest + north**2 + east**2))
    found = respond(case, TABLE_7_2).steady[3]
    assert found == pytest.approx(radii[0] - radii[1], abs=5e-4)


@pytest.mark.parametrize("steering", STEERINGS)
def test_a_change_is_measured_as_the_source_says(steering: str) -> None:
    """All equations of 6.2.2.1 by hand for a change that is known: every curve is 2 % larger."""
    case = case_of(RELAXATION, TABLE_7_2, 4.5, 6.0, steering=steering)
    reference = respond(case, TABLE_7_2)
    change = outputs.Response(*(0.02 * part for part in reference))
    found = dict(zip(NAMES, measured(case, reference, change), strict=True))
    r = reference.velocities[:, 1]
    radius = 4.5 / (r[-1] if steering == outputs.STEP else np.sqrt(np.mean(r**2)))
    for name in NAMES:
        if "position" not in name:
            assert found[name] == pytest.approx(0.02), name
    assert found["position"] == pytest.approx(0.02 * np.hypot(*reference.place) / radius)


def test_a_rig_that_oversteers_is_refused() -> None:
    loose = TABLE_7_2._replace(C_ar=60e3)
    with pytest.raises(Unstable, match=r"at 7.5 m/s this rig is unstable.*lower speed"):
        local_sensitivities(RELAXATION, loose, 7.5)


def test_an_unknown_parameter_is_named() -> None:
    with pytest.raises(ValueError, match=r"C_xx is no parameter; there are C_af"):
        local_sensitivities(RELAXATION, TABLE_7_2, 4.5, parameters=("C_xx",))


def test_a_simulation_without_end_is_refused() -> None:
    with pytest.raises(ValueError, match="give --seconds from"):
        case_of(RELAXATION, TABLE_7_2, 4.5, 1e6)


def test_the_answer_to_any_steering_is_that_of_an_integrator() -> None:
    """scipy's, with wheels that move linearly between the samples."""
    case = case_of(RELAXATION, TABLE_7_2, 4.5, 3.0, steering="random")
    a, b = RELAXATION.matrices(TABLE_7_2, 4.5)
    at = outputs.STEP_S * np.arange(case.samples)
    assert np.ptp(case.wheel) > np.radians(5.0)

    def rate(t: float, x: outputs.Array) -> outputs.Array:
        return np.asarray(a @ x + b[:, 0] * np.interp(t, at, case.wheel))

    x = solve_ivp(rate, (0, at[-1]), np.zeros(len(a)), "DOP853", at, rtol=1e-9, atol=1e-12, max_step=0.01).y.T
    found = respond(case, TABLE_7_2)
    np.testing.assert_allclose(found.velocities[:, :3], x[:, :3], atol=1e-6)
    psi = [RELAXATION.states.index(name) for name in ("psi_t", "psi_i")]
    np.testing.assert_allclose(found.headings, x[:, psi], atol=1e-6)
