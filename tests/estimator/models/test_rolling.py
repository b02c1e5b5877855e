"""The motion with roll, against the planar model as its limit, statics, and differences."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.deploy import motion_equations
from tilth.estimator.models import nonlinear
from tilth.estimator.models.parameters import TABLE_5_1, Rig, static_loads
from tilth.estimator.models.rolling import (
    BY_INPUT,
    N_COLUMNS,
    empty_motion,
    rates,
    rates_by_parameter,
    rates_by_state,
)
from tilth.estimator.models.rolling_terms import CONSTANTS, INPUTS, PARAMETERS, STATES

Array = NDArray[np.float64]
Values = dict[str, float]

MODES = {
    "k_t": 466e3, "k_i": 1.0e6, "d_t": 18e3, "d_i": 20e3, "j_t": 11.4e3, "j_i": 3.1e3, "pivot_height": 0.75,
    "k_f": 466e3, "camber": 0.0, "slip_dependence": 0.0, "parallel": 0.0, "two_track": 1.0,
}  # fmt: skip
RNG = np.random.default_rng(5)
_rates, _slopes = rates.interpreted(), rates_by_state.interpreted()
_by_parameter = rates_by_parameter.interpreted()


def parameters(rig: Rig, **changes: float) -> Array:
    """(36,), PARAMETERS and CONSTANTS of a rig and MODES."""
    named = dict(zip(PARAMETERS, [*rig.theta, *rig.geometry], strict=False))
    named |= {"h_t": rig.h_t, "h_i": rig.h_i, "h_h": rig.h_h, "rolling": rig.roll_f}
    named |= {"curvature": 1.0 / rig.grip_f}
    named |= {"w_f": rig.w_f, "w_r": rig.w_r, "w_i": rig.w_i, "exponent": rig.load_exponent}
    named |= {"front_drive": rig.front_drive, "g": rig.g} | MODES | changes
    return np.array([named[name] for name in (*PARAMETERS, *CONSTANTS)])


def moved(x: Values, w: Values, p: Array) -> Values:
    """x' by name."""
    out = np.zeros(len(STATES))
    state, inputs = (np.array([v[n] for n in names]) for v, names in ((x, STATES), (w, INPUTS)))
    _rates(state, inputs, p, empty_motion(), out)
    return dict(zip(STATES, out, strict=True))


def some_state(lean: float = 0.0) -> Values:
    sizes = [0.2] * 3 + [0.1] * 3 + [lean] * 4 + [0.5] * 2
    return dict(zip(STATES, RNG.uniform(-1.0, 1.0, len(STATES)) * sizes, strict=True))


def some_inputs(uneven: float = 0.0) -> Values:
    found = dict(zip(INPUTS, RNG.uniform(-1.0, 1.0, len(INPUTS)) * 0.3, strict=True))
    return found | {"u": 4.5, "uneven_t": uneven, "uneven_i": -uneven}


@pytest.mark.parametrize("front_drive", [0.0, 0.0, 0.4, 0.4, 1.0])
def test_with_everything_at_the_ground_it_is_the_planar_model(front_drive: float) -> None:
    """The planar model is driven by some force; this one is told only what u' that gives. Both wheels of an
    axle slip at one angle, as in a single-track model."""
    low = TABLE_5_1._replace(h_t=0.0, h_i=0.0, h_h=0.0, front_drive=front_drive, drive_gain=0.0)
    x, w = some_state(), some_inputs()
    planar = np.array([0.0, 0.0, x["psi_t"], x["psi_i"], 4.5, *list(x.values())[:6], w["delta"], 0.0])
    driven = np.zeros(len(nonlinear.INPUTS))
    driven[:5] = [w["delta"], w["gravity_t"], w["gravity_i"], 4.5, RNG.uniform(-10e3, 10e3)]
    wanted = dict(zip(nonlinear.STATES, nonlinear.derivative(low, planar, driven), strict=True))
    got = moved(x, w | {"u_rate": wanted["u"]}, parameters(low, pivot_height=0.0, two_track=0.0))
    for name in STATES[:6]:
        assert got[name] == pytest.approx(wanted[name], rel=1e-9, abs=1e-12), name


def test_left_and_right_are_alike() -> None:
    x, w, p = (
        some_state(0.03),
        some_inputs(0.01),
        parameters(TABLE_5_1, camber=0.2, slip_dependence=0.5, parallel=0.4),
    )
    there = moved(x, w, p)
    mirrored = {name: value if name in ("u", "u_rate") else -value for name, value in w.items()}
    back = moved({name: -value for name, value in x.items()}, mirrored, p)
    assert {name: -value for name, value in back.items()} == pytest.approx(there, rel=1e-9, abs=1e-12)


def test_on_a_slope_a_body_at_rest_leans_downhill_by_what_statics_say() -> None:
    """Held sideways by its tyres, with no hitch force: k phi = m h g sin, both bodies."""
    flat = TABLE_5_1._replace(h_h=0.0, roll_f=0.0, grip_f=1e4, load_exponent=0.0)
    x: Values = dict.fromkeys(STATES, 0.0)
    w: Values = dict.fromkeys(INPUTS, 0.0)
    w |= {"u": 4.5, "gravity_t": 0.3, "gravity_i": 0.3}
    x["phi_t"] = flat.m_t * flat.h_t * 0.3 / MODES["k_t"]
    x["phi_i"] = flat.m_i * flat.h_i * 0.3 / MODES["k_i"]
    # Side forces that hold the rig: of each axle its share of the gravity along the slope.
    front = flat.m_t * 0.3 * flat.b / (flat.a + flat.b)
    hitch = flat.m_i * 0.3 * flat.e / (flat.d + flat.e)
    front -= hitch * (flat.c - flat.b) / (flat.a + flat.b)
    rear = flat.m_t * 0.3 + hitch - front
    forces = (front, rear, flat.m_i * 0.3 - hitch)
    for name, force, stiffness in zip("fri", forces, flat.theta[:3], strict=True):
        x[f"alpha_{name}"] = force / stiffness
    got = moved(x, w, parameters(flat, pivot_height=0.0))
    assert [got[name] for name in ("v", "r_t", "r_i", "p_t", "p_i")] == pytest.approx([0.0] * 5, abs=1e-5)


def test_the_parameters_are_those_of_the_rig() -> None:
    p = dict(zip((*PARAMETERS, *CONSTANTS), parameters(TABLE_5_1), strict=True))
    assert [p[name] for name in ("a", "m_t", "C_r", "sigma_i")] == [1.7, 9391.0, 486e3, 0.75]
    assert sum(static_loads(TABLE_5_1)) == pytest.approx((p["m_t"] + p["m_i"]) * p["g"])


def test_a_pulled_implement_takes_load_off_the_front_wheels() -> None:
    """Moments of both bodies balance, in the vertical plane, at steady speed."""
    loads = motion_equations.axle_loads_when_driving()
    at = {motion_equations.P[name]: value for name, value in zip((*PARAMETERS, *CONSTANTS), parameters(
        TABLE_5_1._replace(roll_f=0.1, roll_r=0.1, roll_i=0.1)), strict=True)}  # fmt: skip
    front, cart = (float(loads[name][1].subs(at)) for name in "fi")
    rig, weight_t, weight_i = TABLE_5_1, TABLE_5_1.m_t * TABLE_5_1.g, TABLE_5_1.m_i * TABLE_5_1.g
    pull = 0.1 * float(loads["i"][0].subs(at))
    about_hitch = weight_i * rig.d - cart * (rig.d + rig.e) - pull * rig.h_h
    on_hitch = weight_i - cart
    about_rear = front * (rig.a + rig.b) - weight_t * rig.b + on_hitch * (rig.c - rig.b) + pull * rig.h_h
    assert [about_hitch, about_rear] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert 0.97 < front / float(loads["f"][0].subs(at)) < 0.995


@pytest.mark.parametrize("seed", range(8))
def test_the_derivatives_are_those_of_differences(seed: int) -> None:
    """At any angle, load and lean, by all states, inputs and parameters."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.2, 0.2, len(STATES))
    x[6:10] *= 0.1
    x[10:] = rng.uniform(-0.5, 0.5, 2)
    w = np.array([*rng.uniform(-0.5, 0.5, 3), *rng.uniform(-0.01, 0.01, 2), 4.5, rng.uniform(-0.5, 0.5)])
    p = parameters(TABLE_5_1._replace(front_drive=0.3), camber=0.2, slip_dependence=0.5, parallel=0.4)
    p[: len(PARAMETERS)] *= rng.uniform(0.8, 1.25, len(PARAMETERS))

    def at(z: Array) -> Array:
        out = np.zeros(len(STATES))
        here = np.append(z[:BY_INPUT], x[11]), np.append(z[BY_INPUT:N_COLUMNS], w[6:])
        _rates(*here, np.append(z[N_COLUMNS:], p[len(PARAMETERS) :]), empty_motion(), out)
        return out[[0, 1, 2, 3, 4, 5, 8, 9]]

    motion, out = empty_motion(), np.zeros(len(STATES))
    for _ in range(2):  # the second time the arrays are not empty
        _rates(x, w, p, motion, out)
        _slopes(x, w, p, motion)
        _by_parameter(x, w, p, motion)
    right = np.hstack([motion.right_by_state, motion.right_by_parameter])
    slip = np.hstack([motion.slip_by_state, motion.slip_by_parameter])
    found = np.vstack([right[1:4], slip, right[4:6]])
    z = np.concatenate([x[:BY_INPUT], w[:6], p[: len(PARAMETERS)]])
    for j, value in enumerate(z):
        step = 1e-5 * max(abs(value), 0.01) * np.eye(len(z))[j]
        wanted = (at(z + step) - at(z - step)) / (2.0 * step[j])
        scale = np.abs(wanted).max() + 1e-12
        np.testing.assert_allclose(found[:, j] / scale, wanted / scale, atol=1e-5, err_msg=str(j))
