"""Systems, simulation, poles and what can be steered or seen, over every row of MODELS."""

import numpy as np
import pytest
from linear_tyres import linear_tyres
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from tilth.estimator.models import linear_analysis as la
from tilth.estimator.models.actuator import BOSSERD, Actuator, with_actuator
from tilth.estimator.models.family import MODELS, Model, model_named
from tilth.estimator.models.parameters import TABLE_5_1, TABLE_7_2, Rig
from tilth.estimator.models.steady_turn import steady_turn
from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]

RIG = linear_tyres(TABLE_5_1)._replace(roll_f=0.0, roll_r=0.0, roll_i=0.0)
every_model = pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
every_actuator = pytest.mark.parametrize("actuator", [None, BOSSERD], ids=["bare", "actuator"])


@every_model
@every_actuator
def test_a_row_is_consistent(model: Model, actuator: Actuator | None) -> None:
    sys = la.system(model, RIG, 4.5, outputs=tuple(la.OUTPUTS), actuator=actuator)
    n, m, p = len(sys.states), len(sys.inputs), len(sys.outputs)
    assert (sys.a.shape, sys.b.shape, sys.c.shape, sys.d.shape) == ((n, n), (n, m), (p, n), (p, m))
    assert sys.inputs[1:] == ("gravity_t", "gravity_i")
    assert sys.inputs[0] == ("delta" if actuator is None else "command")
    assert np.isfinite(sys.a).all() and np.isfinite(sys.b).all()
    if model.at_rest:
        assert np.isfinite(model.matrices(RIG, 0.0)[0]).all()
    else:
        with pytest.raises(ValueError, match="standstill"):
            model.matrices(RIG, 0.0)
    changed = [
        name
        for name in ("C_af", "C_ar", "C_ai", "sigma_f", "sigma_r", "sigma_i")
        if not np.allclose(
            model.matrices(RIG._replace(**{name: 2 * getattr(RIG, name)}), 4.5)[0],
            model.matrices(RIG, 4.5)[0],
            atol=1e-4,
        )
    ]
    assert tuple(changed) == model.parameters


@every_model
@pytest.mark.parametrize("speed", [1.0, 4.5])
def test_a_long_run_ends_in_the_closed_form(model: Model, speed: float) -> None:
    n = round(60 / speed / 0.02) * 4
    inputs = np.tile([0.01, 0.0, 0.0], (n, 1))
    states = la.simulate(model, RIG, speed, inputs, np.zeros(len(model.states)), 0.02)
    sys = la.system(model, RIG, speed, outputs=("v", "r_t", "r_i", "articulation"))
    found = la.outputs_of(sys, states[:-1], inputs)[-1] / 0.01
    stiff = RIG._replace(C_af=1e12, C_ar=1e12, C_ai=1e12) if model.name == "kinematic" else RIG
    v, r, lam = la.steady_gains(stiff, speed)
    np.testing.assert_allclose(found, [v, r, r, lam], rtol=1e-6)


@pytest.mark.parametrize("speed", [-4.5, -1.0, 1.0, 4.5, 9.0])
def test_the_closed_form_is_where_the_dynamic_model_rests(speed: float) -> None:
    """Forward and in reverse, with gravity along the slope."""
    roll = (0.03, -0.05)
    row = np.array([[RIG.C_af, RIG.C_ar, RIG.C_ai, RIG.m_t, RIG.m_i, speed, 0.02, *roll]])
    v, r, lam = steady_turn(row, *RIG.geometry[:5].tolist())[0]
    a, b = model_named("dynamic").matrices(RIG, speed)
    rate = a @ [v, r, r, 0.0, lam, 0.0] + b @ [0.02, *(GRAVITY * np.sin(roll))]
    np.testing.assert_allclose(rate[:3], 0.0, atol=1e-9)


@every_model
@every_actuator
@pytest.mark.parametrize("linear", [False, True], ids=["held", "linear"])
def test_simulation_is_exact(model: Model, actuator: Actuator | None, linear: bool) -> None:
    rng = np.random.default_rng(1)
    inputs = rng.normal(0, [0.1, 0.5, 0.5], (41 if linear else 40, 3))
    sys = la.system(model, RIG, 3.0, actuator=actuator)
    x0 = rng.normal(0, 0.1, len(sys.states))
    states = la.simulate(model, RIG, 3.0, inputs, x0, 0.05, actuator=actuator, linear=linear)

    def rate(t: float, x: Array) -> Array:
        k = min(int(t / 0.05 + 1e-9), 39)
        w = inputs[k] + ((inputs[k + 1] - inputs[k]) * (t / 0.05 - k) if linear else 0.0)
        return np.asarray(sys.a @ x + sys.b @ w)

    x = x0
    for k in range(4):  # stepwise, since held inputs jump
        span = (k * 0.05, (k + 1) * 0.05 - 1e-12)
        x = solve_ivp(rate, span, x, rtol=1e-10, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(states[k + 1], x, rtol=1e-7, atol=1e-9)


@every_model
def test_a_varying_speed_is_followed(model: Model) -> None:
    n, dt = 100, 0.02
    speed = 4.0 + 0.2 * np.sin(np.arange(n) * 4 * dt)
    inputs = np.column_stack([0.1 * np.sin(np.arange(n) * 0.05), np.zeros((n, 2))])
    states = la.simulate(model, RIG, speed, inputs, np.zeros(len(model.states)), dt)
    x = np.zeros(len(model.states))
    worst = 0.0
    for k in range(0, n):
        a, b = model.matrices(RIG, float(speed[k]))
        f, g0, g1 = la.discretise(a, b, dt)
        x = f @ x + (g0 + g1) @ inputs[k]
        worst = max(worst, float(np.abs(states[k + 1] - x).max()))
    assert worst < 2e-5 * float(np.abs(states).max())


def test_discretisation_is_that_of_the_exponential() -> None:
    a, b = MODELS[2].matrices(RIG, 4.5)
    f, g0, g1 = la.discretise(a, b, 0.1)
    np.testing.assert_allclose(f, expm(0.1 * a), atol=1e-12)
    middle = (np.arange(200) + 0.5) * 0.1 / 200  # the convolution integral, by midpoints
    through = [expm((0.1 - s) * a) @ b * 0.1 / 200 for s in middle]
    np.testing.assert_allclose(g0 + g1, np.sum(through, axis=0), atol=1e-5)
    ramp = [share * s / 0.1 for share, s in zip(through, middle, strict=True)]
    np.testing.assert_allclose(g1, np.sum(ramp, axis=0), atol=1e-5)


@every_model
def test_gravity_pulls_downhill_and_reverse_mirrors_it(model: Model) -> None:
    inputs = np.tile([0.0, 0.5, 0.5], (100, 1))
    for speed in (4.5, -4.5):
        last_state = la.simulate(model, RIG, speed, inputs, np.zeros(len(model.states)), 0.02)[-1]
        lateral = last_state[model.states.index("y_t")]
        assert lateral == 0.0 if model.name == "kinematic" else lateral > 0.01


@every_model
def test_position_may_be_left_out(model: Model) -> None:
    outputs = ("v", "r_t", "r_i", "articulation")
    whole, less = (la.system(model, RIG, 4.5, outputs=outputs, position=p) for p in (True, False))
    assert less.states == tuple(name for name in whole.states if name != "y_t")
    omega = np.array([0.3, 2.0])
    np.testing.assert_allclose(
        la.frequency_response(less, omega), la.frequency_response(whole, omega), atol=1e-9
    )
    with pytest.raises(ValueError, match="cannot be left out"):
        la.system(model, RIG, 4.5, outputs=("y_i",), position=False)


@every_model
def test_outputs_agree_with_trigonometry(model: Model) -> None:
    """Places and velocities of the implement from those of the tractor, along a simulated run."""
    n, dt, u = 500, 0.01, 4.5
    inputs = np.column_stack([0.02 * np.sin(np.arange(n + 1) * 0.03), np.zeros((n + 1, 2))])
    states = la.simulate(model, RIG, u, inputs, np.zeros(len(model.states)), dt, linear=True)
    names = ("y_t", "y_i", "y_axle", "v", "v_i", "r_t", "r_i", "psi_t", "psi_i", "articulation")
    sys = la.system(model, RIG, u, outputs=names)
    out: dict[str, Array] = dict(zip(names, la.outputs_of(sys, states, inputs).T, strict=True))
    towed = out["y_t"] - RIG.c * np.sin(out["psi_t"]) - RIG.d * np.sin(out["psi_i"])
    np.testing.assert_allclose(out["y_i"], towed, atol=1e-3)
    np.testing.assert_allclose(out["y_axle"], towed - RIG.e * np.sin(out["psi_i"]), atol=1e-3)
    np.testing.assert_allclose(out["articulation"], out["psi_t"] - out["psi_i"], atol=1e-12)
    inner = slice(5, -5)
    for of, rate in (("psi_t", "r_t"), ("psi_i", "r_i")):
        np.testing.assert_allclose(np.gradient(out[of], dt)[inner], out[rate][inner], atol=1e-3)
    for y, psi, v in (("y_t", "psi_t", "v"), ("y_i", "psi_i", "v_i")):
        across = np.gradient(out[y], dt) - u * out[psi]
        np.testing.assert_allclose(across[inner], out[v][inner], atol=4e-3)


def test_limits_join_the_models() -> None:
    """Without relaxation the dynamic model is left; without slip the kinematic one."""
    brief = RIG._replace(sigma_f=1e-4, sigma_r=1e-4, sigma_i=1e-4)
    for speed in (4.5, -4.5):
        slow = la.eigenvalues(model_named("relaxation").matrices(brief, speed)[0])[-6:]
        there = la.eigenvalues(model_named("dynamic").matrices(RIG, speed)[0])
        np.testing.assert_allclose(slow, there, rtol=2e-3, atol=1e-6)
    hard = RIG._replace(C_af=1e10, C_ar=1e10, C_ai=1e10)
    last = la.eigenvalues(model_named("dynamic").matrices(hard, 4.5)[0])[-3:]
    np.testing.assert_allclose(
        last, la.eigenvalues(model_named("kinematic").matrices(RIG, 4.5)[0]), atol=1e-4
    )


@every_model
def test_frequency_response_is_what_a_long_sine_gives(model: Model) -> None:
    omega, dt = 2.0, 0.01
    n = round(2 * np.pi / omega / dt * 20)
    time = np.arange(n + 1) * dt
    inputs = np.column_stack([0.01 * np.sin(omega * time), np.zeros((n + 1, 2))])
    sys = la.system(model, RIG, 4.5)
    out = la.outputs_of(
        sys, la.simulate(model, RIG, 4.5, inputs, np.zeros(len(sys.states)), dt, linear=True), inputs
    )
    period = round(2 * np.pi / omega / dt)
    basis = np.column_stack([np.sin(omega * time), np.cos(omega * time)])[-4 * period :]
    parts, *_ = np.linalg.lstsq(basis, out[-4 * period :], rcond=None)
    response = la.frequency_response(sys, np.array([omega]))[0, :, 0]
    np.testing.assert_allclose((parts[0] + 1j * parts[1]) / 0.01, response, rtol=2e-3)


@pytest.mark.parametrize("table", [TABLE_5_1, TABLE_7_2], ids=["5.1", "7.2"])
def test_understeer_gradient_is_that_of_the_steady_turn(table: Rig) -> None:
    rig = table._replace(e=0.7)  # a tongue that weighs
    for speed in (1.0, 4.5, 9.0):
        gain = la.steady_gains(rig, speed)[1]
        assert (speed / gain - rig.wheelbase) / speed**2 == pytest.approx(la.understeer_gradient(rig))
    fast = la.characteristic_speed(rig)
    speeds = fast * np.array([0.9, 1.0, 1.1])
    gains = [la.steady_gains(rig, float(u))[1] for u in speeds]
    assert la.understeer_gradient(rig) > 0 and gains[1] == max(gains)
    loose = rig._replace(C_ar=100e3)
    assert la.understeer_gradient(loose) < 0
    critical = -la.characteristic_speed(loose)
    below, above = (
        la.eigenvalues(la.system(MODELS[1], loose, u, position=False).a).real.max()
        for u in (0.99 * critical, 1.01 * critical)
    )
    assert below < 1e-6 < above


def test_poles() -> None:
    poles = la.eigenvalues(np.array([[0.0, 1.0, 0.0], [-4.0, -1.0, 0.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(poles, [-0.5 - 1.9364917j, -0.5 + 1.9364917j, 0.0], atol=1e-7)
    np.testing.assert_allclose(la.damping(poles)[:2], 0.25)
    assert np.isnan(la.damping(poles)[2])
    assert la.dominant(poles) == pytest.approx(-0.5 + 1.9364917j)
    assert la.settling_time(poles) == pytest.approx(8.0)
    assert la.settling_distance(poles, -3.0) == pytest.approx(24.0)
    assert la.settling_time(np.array([0.2 + 0j])) == np.inf
    with pytest.raises(ValueError, match="integrators only"):
        la.dominant(np.zeros(2, complex))


@every_model
@every_actuator
@pytest.mark.parametrize("speed", [0.5, 4.5, 10.0])
def test_each_model_is_controllable_and_observable(
    model: Model, actuator: Actuator | None, speed: float
) -> None:
    """As the dissertation has it: full rank, with position and both headings measured."""
    outputs = ("y_t", "psi_t", "psi_i") if actuator is None else ("y_t", "psi_t", "psi_i", "delta")
    if actuator is None:
        sys = la.system(model, TABLE_5_1, speed, outputs=outputs)
    else:
        sys = la.system(model, TABLE_5_1, speed, outputs=outputs[:3], actuator=actuator)
    assert la.controllability(sys.a, sys.b[:, :1])[0] == len(sys.states)
    assert la.observability(sys.a, sys.c)[0] == len(sys.states)


def test_uncontrollable_and_unobservable_states_lower_the_rank() -> None:
    sys = la.system(model_named("relaxation"), TABLE_5_1, 4.5, outputs=("psi_t",))
    rank, condition = la.observability(sys.a, sys.c)
    assert rank < len(sys.states) and condition == np.inf  # neither position nor where the implement points
    standing = la.system(model_named("kinematic"), TABLE_5_1, 0.0)
    assert la.controllability(standing.a, standing.b[:, :1])[0] == 0


def test_unknown_names_are_named() -> None:
    with pytest.raises(ValueError, match="sideslip is no output"):
        la.system(MODELS[0], RIG, 4.5, outputs=("sideslip",))
    with pytest.raises(ValueError, match="kinematic, dynamic, relaxation, nonlinear"):
        model_named("bicycle")


def test_the_corrected_actuator_is_stable() -> None:
    a, _ = with_actuator(np.zeros((1, 1)), np.ones((1, 1)))
    np.testing.assert_allclose(la.eigenvalues(a), [-10.0, 0.0, 0.0])
