"""The nonlinear model: limits, balances and symmetries that hold whatever its equations look like."""

import math

import numpy as np
import pytest
from linear_tyres import linear_tyres
from loaded_rig import loaded
from numpy.typing import NDArray
from scipy.integrate import quad

from tilth.estimator.models import nonlinear, relaxation
from tilth.estimator.models.actuator import BOSSERD
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import simulate as simulate_linear
from tilth.estimator.models.linear_analysis import steady_gains
from tilth.estimator.models.nonlinear import STATES, derivative, inputs_of, running, simulate, wheels
from tilth.estimator.models.parameters import TABLE_5_1, TABLE_7_2, Rig, static_loads

Array = NDArray[np.float64]


FREE = TABLE_5_1._replace(roll_f=0.0, roll_r=0.0, roll_i=0.0)  # nothing brakes but slip
COASTING = linear_tyres(FREE)._replace(
    drive_gain=0.0, w_f=9.0, w_r=9.0, w_i=9.0
)  # no wheel leaves the ground
LATERAL = [STATES.index(name) for name in relaxation.STATES]


def _state(**values: float) -> Array:
    return running(0.0, **values)


def _random(rng: np.random.Generator, speed: float = 5.0) -> tuple[Array, Array]:
    x = np.zeros(13)
    x[:4] = rng.uniform(-1.6, 1.6, 4)
    x[4:8] = rng.uniform(-1.0, 1.0, 4) * [speed, 1.0, 0.6, 0.6]
    x[8:11] = rng.uniform(-0.3, 0.3, 3)
    w = inputs_of(1, delta=rng.uniform(-0.6, 0.6), speed=x[4] + 0.1)[0]
    w[1:3] = rng.uniform(-0.9, 0.9, 2)
    w[5:9] = rng.uniform(-3e3, 3e3, 4)
    return x, w


# The small-angle limit


@pytest.mark.parametrize("speed", [-4.5, -1.0, 0.0, 0.5, 4.5, 9.0])
@pytest.mark.parametrize("tyres", [FREE, linear_tyres(FREE), loaded(FREE, 9000.0, ahead=0.4)])
def test_small_angles_give_the_relaxation_model(speed: float, tyres: Rig) -> None:
    a, b = model_named("nonlinear").matrices(tyres, speed)
    theirs_a, theirs_b = model_named("relaxation").matrices(tyres, speed)
    np.testing.assert_allclose(a, theirs_a, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(b, theirs_b, rtol=1e-6, atol=1e-6)


def test_small_motions_stay_with_the_relaxation_model() -> None:
    """Over a whole run: the difference falls with the cube of the angle."""
    off = []
    for angle in (0.01, 0.02):
        delta = angle * np.sin(np.arange(251) * 0.1)
        there = simulate(
            linear_tyres(FREE), inputs_of(251, delta=delta, speed=4.5), running(4.5), 0.02, linear=True
        )
        linear_inputs = np.column_stack([delta, np.zeros((251, 2))])
        model = model_named("relaxation")
        here = simulate_linear(model, FREE, 4.5, linear_inputs, np.zeros(9), 0.02, linear=True)
        off.append(np.abs(there[:, LATERAL] - here)[:, :6].max())
    assert off[0] < 1e-4 * 0.01 * 4.5
    assert off[1] / off[0] == pytest.approx(8.0, rel=0.1)


@pytest.mark.parametrize("speed", [1.0, 4.5, 7.5])
def test_a_long_turn_ends_in_the_closed_form(speed: float) -> None:
    angle = 1e-3
    states = simulate(linear_tyres(FREE), inputs_of(3000, delta=angle, speed=speed), running(speed), 0.02)
    v, r, lam = steady_gains(FREE, speed) * angle
    last = states[-1]
    found = [last[5], last[6], last[7], last[2] - last[3]]
    np.testing.assert_allclose(found, [v, r, r, lam], rtol=1e-4)


@pytest.mark.parametrize(("speed", "less"), [(1.0, 0.018), (4.5, 0.025)])
def test_rolling_resistance_widens_the_turn(speed: float, less: float) -> None:
    """By hand: the drag of front wheels, cart and loaded outer wheels asks for more wheel angle."""
    states = simulate(linear_tyres(TABLE_5_1), inputs_of(3000, delta=1e-3, speed=speed), running(speed), 0.02)
    rig = TABLE_5_1
    front, _, implement = static_loads(rig)
    _, r, lam = steady_gains(rig, speed)
    pull = rig.roll_i * implement * lam  # of the hitch, outwards
    hold = (rig.c - rig.b) / rig.C_af + (rig.c + rig.a) / rig.C_ar
    skew = rig.roll_r * rig.m_t * rig.h_t * speed * r * (1 / rig.C_af + 1 / rig.C_ar)
    expected = rig.roll_f * front / rig.C_af + (pull * hold + skew) / rig.wheelbase
    assert expected == pytest.approx(less, rel=0.1)
    assert 1 - states[-1, 6] / (r * 1e-3) == pytest.approx(expected, rel=0.1)


# Beyond the small angle


@pytest.mark.parametrize("degrees", [10.0, -35.0])
def test_creeping_in_a_circle_is_geometry(degrees: float) -> None:
    """Without speed nothing slips but what rolling resistance makes: a closed form without small angles."""
    speed, delta = 0.3, math.radians(degrees)
    states = simulate(FREE, inputs_of(4000, delta=delta, speed=speed), running(speed), 0.05)
    radius = FREE.wheelbase / math.tan(delta)  # of the rear axle
    hitch = math.hypot(radius, FREE.c - FREE.b)
    articulation = math.copysign(math.asin(FREE.towed_length / hitch), delta)
    articulation += math.atan((FREE.c - FREE.b) / radius)
    assert states[-1, 6] == pytest.approx(speed / radius, rel=0.005)
    assert states[-1, 2] - states[-1, 3] == pytest.approx(articulation, rel=0.01)
    assert abs(articulation) < math.radians(90)


def test_a_headland_turn_comes_back_on_the_next_row() -> None:
    """Half a circle at 35 degrees with a loaded cart: everything stays finite, and the hitch stays whole."""
    rig = loaded(TABLE_7_2, 6000.0)
    angle = np.radians(np.interp(np.arange(1500) * 0.02, [2, 4, 9.4, 11.4], [0, 35, 35, 0]))
    states = simulate(rig, inputs_of(1500, delta=angle, speed=2.0), running(2.0), 0.02)
    assert np.isfinite(states).all()
    assert math.degrees(np.abs(states[:, 2] - states[:, 3]).max()) > 55
    assert math.degrees(states[-1, 2]) == pytest.approx(180, abs=10)
    assert abs(states[-1, 2] - states[-1, 3]) < 0.1
    assert states[-1, 4] == pytest.approx(2.0, abs=0.05)


def test_a_saturating_tyre_turns_less_and_slips_more() -> None:
    inputs = inputs_of(1500, delta=0.2, speed=7.5)
    soft = simulate(FREE._replace(grip_f=0.5, grip_r=0.5, grip_i=0.5), inputs, running(7.5), 0.02)[-1]
    stiff = simulate(linear_tyres(FREE), inputs, running(7.5), 0.02)[-1]
    assert soft[6] < 0.95 * stiff[6]
    assert np.abs(soft[8:11]).max() > np.abs(stiff[8:11]).max()


@pytest.mark.parametrize("alpha", [-0.4, -0.02, 0.0, 0.1, 1.2])
def test_tyre_curve(alpha: float) -> None:
    load, stiffness, grip = 20e3, 150e3, 0.7
    force = nonlinear.tyre_force.function(alpha, stiffness, grip * load)
    big_b = stiffness / (grip * load)  # A B N = C
    assert force == pytest.approx(-math.copysign(load * grip * (1 - math.exp(-big_b * abs(alpha))), alpha))
    assert abs(force) <= grip * load
    assert nonlinear.tyre_force.function(alpha, stiffness, math.inf) == -stiffness * alpha
    slope = nonlinear.tyre_force.function(1e-9, stiffness, grip * load) / 1e-9
    assert slope == pytest.approx(-stiffness, rel=1e-6)


@pytest.mark.parametrize("exponent", [0.0, 0.8, 1.0])
def test_stiffness_grows_with_load_to_its_power(exponent: float) -> None:
    force = [nonlinear.wheel.interpreted()(1e-6, load, 20e3, 300e3, 0.7, exponent) for load in (20e3, 40e3)]
    assert force[0] == pytest.approx(-150e3 * 1e-6, rel=1e-4)
    assert force[1] / force[0] == pytest.approx(2.0**exponent, rel=1e-4)


# Loads


@pytest.mark.parametrize("seed", range(6))
def test_loads_sum_to_the_weight_across_the_slope(seed: int) -> None:
    x, w = _random(np.random.default_rng(seed), speed=9.0)
    load = wheels(TABLE_5_1, x, w)[:, 0].reshape(3, 2)
    level = np.sqrt(1 - (w[[1, 1, 2]] / TABLE_5_1.g) ** 2)
    np.testing.assert_allclose(load.sum(axis=1), np.array(static_loads(TABLE_5_1)) * level)
    assert load.min() >= 0.0


def test_roll_moments_balance() -> None:
    """Moments about the ground below each body's middle: what tilts it is what its wheels hold."""
    rig = TABLE_5_1._replace(e=0.6)
    for seed in range(6):
        x, w = _random(np.random.default_rng(seed), speed=3.0)
        forces = wheels(rig, x, w)
        load, across = forces[:, 0].reshape(3, 2), forces[:, 2]
        rate = derivative(rig, x, w)
        force_t = across[:2].sum() * math.cos(w[0]) + forces[:2, 1].sum() * math.sin(w[0]) + across[2:4].sum()
        inertia = rig.m_t * (rate[5] + x[4] * x[6] - w[1]) - w[5]
        hitch = inertia - force_t  # across the tractor
        shifts = (load[:, 0] - load[:, 1]) / 2 * [rig.w_f, rig.w_r, rig.w_i]
        # Accelerations under static loads stand in for the final ones: hence not to the last digit.
        shift_on_tractor = shifts[0] + shifts[1]
        assert shift_on_tractor == pytest.approx(rig.h_t * inertia - rig.h_h * hitch, rel=0.05, abs=300)
        assert shifts[0] == pytest.approx(rig.roll_share_f * shift_on_tractor)
        lam = x[2] - x[3]
        u_i, v_i = (float(value) for value in nonlinear.implement(rig, x[None])[0, 2:])
        towed = (nonlinear.implement(rig, (x + 1e-6 * rate)[None])[0, 3] - v_i) / 1e-6 + u_i * x[7]
        inertia = rig.m_i * (towed - w[2]) - w[7]
        hitch = across[4:].sum() - inertia  # across the implement, on the tractor
        assert shifts[2] == pytest.approx(rig.h_i * inertia + rig.h_h * hitch, rel=0.05, abs=300), lam


def test_a_turn_loads_the_outer_and_a_slope_the_lower_wheels() -> None:
    turning = simulate(TABLE_5_1, inputs_of(500, delta=0.15, speed=6.0), running(6.0), 0.02)[-1]
    load = wheels(TABLE_5_1, turning, inputs_of(1, delta=0.15, speed=6.0)[0])[:, 0]
    assert (load[::2] > load[1::2]).all()  # to the right: the left wheels
    slope = inputs_of(500, speed=3.0, gravity_t=0.85, gravity_i=0.85)
    load = wheels(TABLE_5_1, simulate(TABLE_5_1, slope, running(3.0), 0.02)[-1], slope[0])[:, 0]
    assert (load[::2] < load[1::2]).all()  # right side down: the right wheels


def test_load_transfer_costs_side_force() -> None:
    """A degressive tyre gains less on the loaded side than it loses on the other."""
    slip = _state(u=5.0, alpha_r=0.1)
    shift_on_tractor = abs(wheels(TABLE_5_1, slip, inputs_of(1, speed=5.0)[0])[2:4, 2].sum())
    slope = inputs_of(1, speed=5.0, gravity_t=4.0, gravity_i=4.0)[0]
    level = math.sqrt(1 - (4.0 / TABLE_5_1.g) ** 2)
    assert (
        abs(wheels(TABLE_5_1, slip, slope)[2:4, 2].sum())
        < 0.995 * shift_on_tractor * level**TABLE_5_1.load_exponent
    )
    tall = TABLE_5_1._replace(h_t=2.8, roll_share_f=0.0)
    load = wheels(tall, _state(u=5.0, alpha_f=0.3, alpha_r=0.3), inputs_of(1, speed=5.0)[0])
    assert load[2, 0] == pytest.approx(static_loads(tall)[1]) or load[3, 0] == pytest.approx(
        static_loads(tall)[1]
    )
    air = 2 if load[2, 0] < load[3, 0] else 3
    assert load[air, 0] == 0.0 and load[air, 2] == 0.0  # a wheel in the air holds nothing


# Energy


def _contact_points(rig: Rig, q: Array, delta: float) -> tuple[Array, Array]:
    """(places (6, 2) in W, facing (6,)) of the wheels for q = x, y, psi_t, psi_i."""
    places, facing = [], []
    cart = np.array(q[:2]) - rig.c * _ahead(q[2]) - rig.d * _ahead(q[3])
    for centre, psi, along, width, steer in (
        (q[:2], q[2], rig.a, rig.w_f, delta),
        (q[:2], q[2], -rig.b, rig.w_r, 0.0),
        (cart, q[3], -rig.e, rig.w_i, 0.0),
    ):
        for side in (-0.5, 0.5):
            places.append(centre + along * _ahead(psi) + side * width * _ahead(psi + np.pi / 2))
            facing.append(psi + steer)
    return np.array(places), np.array(facing)


def _ahead(psi: float) -> Array:
    return np.array([np.cos(psi), np.sin(psi)])


def _kinetic(rig: Rig, x: Array) -> float:
    towed = nonlinear.implement(rig, x[None])[0]
    linear = rig.m_t * (x[4] ** 2 + x[5] ** 2) + rig.m_i * (towed[2] ** 2 + towed[3] ** 2)
    return float(linear + rig.I_t * x[6] ** 2 + rig.I_i * x[7] ** 2) / 2


@pytest.mark.parametrize("seed", range(12))
def test_power_of_all_forces_is_the_growth_of_kinetic_energy(seed: int) -> None:
    """Places of the wheels and CGs by trigonometry, their velocities by differences."""
    rig, h = TABLE_5_1._replace(front_drive=0.3, e=0.4), 1e-6
    x, w = _random(np.random.default_rng(seed))
    rate, forces = derivative(rig, x, w), wheels(rig, x, w)
    growth = (_kinetic(rig, x + h * rate) - _kinetic(rig, x - h * rate)) / (2 * h)
    before, facing = _contact_points(rig, x[:4] - h * rate[:4], w[0])
    after, _ = _contact_points(rig, x[:4] + h * rate[:4], w[0])
    _, facing = _contact_points(rig, x[:4], w[0])
    velocity = (after - before) / (2 * h)
    power = sum(
        f[1] * _ahead(face) @ u + f[2] * _ahead(face + np.pi / 2) @ u
        for f, face, u in zip(forces, facing, velocity, strict=True)
    )
    towed = nonlinear.implement(rig, x[None])[0]
    power += (rig.m_t * w[1] + w[5]) * x[5] + w[6] * x[6]
    power += (rig.m_i * w[2] + w[7]) * towed[3] + w[8] * x[7]
    assert growth == pytest.approx(power, rel=1e-6, abs=1e-3 * abs(growth) + 1.0)


def _stored(rig: Rig, x: Array) -> float:
    """In the tyres: integral of C alpha over sigma d(tan alpha)."""
    alpha = x[8:11]
    work = alpha * np.tan(alpha) + np.log(np.cos(alpha))
    return float(rig.theta[:3] * rig.theta[3:] @ work)


@pytest.mark.parametrize("speed", [5.0, 0.3, -3.0])
def test_a_coasting_rig_never_gains_energy(speed: float) -> None:
    rng = np.random.default_rng(8)
    x0 = running(speed, v=0.6, r_t=0.4, r_i=-0.3, psi_i=0.5, alpha_f=0.05, alpha_r=-0.1, alpha_i=0.1)
    delta = np.repeat(rng.uniform(-0.5, 0.5, 20), 25)
    states = simulate(COASTING, inputs_of(500, delta=delta), x0, 0.01)
    energy = np.array([_kinetic(COASTING, x) + _stored(COASTING, x) for x in states])
    assert np.diff(energy).max() <= 1e-6 * energy[0]
    assert energy[-1] < 0.8 * energy[0]


def test_stored_energy_is_that_of_the_relaxation_equation() -> None:
    x = _state(alpha_f=0.3)
    work, _ = quad(lambda p: TABLE_5_1.C_af * math.atan(p) * TABLE_5_1.sigma_f, 0.0, math.tan(0.3))
    assert _stored(TABLE_5_1, x) == pytest.approx(work)


# Symmetry, standstill, reverse


def test_left_and_right_are_alike() -> None:
    rng = np.random.default_rng(2)
    sideways = [STATES.index(n) for n in STATES if n not in ("x_t", "u")]
    inputs = inputs_of(400, speed=5.0)
    inputs[:, [0, 1, 2, 5, 6, 7, 8]] = rng.normal(0, 1, (400, 7)) * [0.2, 0.3, 0.3, 2e3, 2e3, 1e3, 1e3]
    mirrored = inputs.copy()
    mirrored[:, [0, 1, 2, 5, 6, 7, 8]] *= -1
    one, other = (simulate(TABLE_5_1, w, running(5.0), 0.02) for w in (inputs, mirrored))
    other[:, sideways] *= -1
    np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_at_standstill_tyres_hold_like_springs() -> None:
    """On a slope a rig that stands swings about a place a little below, for want of damping."""
    shift_on_tractor = simulate(FREE, inputs_of(2000, gravity_t=0.5, gravity_i=0.5), running(0.0), 0.02)
    assert np.isfinite(shift_on_tractor).all()
    assert np.abs(shift_on_tractor[:, 1]).max() < 0.1
    sway = shift_on_tractor[:, 8:11].mean(axis=0) @ (FREE.theta[:3])
    assert sway == pytest.approx(0.5 * (FREE.m_t + FREE.m_i), rel=0.1)  # all of the weight along the slope


@pytest.mark.parametrize("name", ["kinematic", "dynamic", "relaxation", "nonlinear"])
def test_in_reverse_the_implement_folds_up(name: str) -> None:
    """Every model says so, at nearly the same rate: that of a trailer pushed by its hitch."""
    a, _ = model_named(name).matrices(FREE, -0.5)
    assert np.linalg.eigvals(a).real.max() == pytest.approx(0.5 / FREE.towed_length, rel=0.02)


def test_reversing_in_the_nonlinear_model_follows_the_rolling_wheels() -> None:
    """Slowly backwards, the articulation grows as geometry has it, far beyond small angles."""
    x = simulate(FREE, inputs_of(500, speed=-0.3), running(-0.3, psi_i=-0.2), 0.05)
    lam = x[:, 2] - x[:, 3]
    # lam' = -(u / L) sin lam: tan(lam / 2) grows exponentially.
    expected = 2 * np.arctan(np.tan(0.1) * np.exp(0.3 / FREE.towed_length * np.arange(501) * 0.05))
    np.testing.assert_allclose(lam[:501], expected, atol=0.03)
    assert lam[-1] > 1.2


# Speed, actuator, soil


def test_speed_is_held_against_rolling_resistance_and_within_the_limit() -> None:
    states = simulate(TABLE_5_1, inputs_of(1500, speed=4.5), running(0.0), 0.02)
    assert states[-1, 4] == pytest.approx(4.5, abs=1e-3)
    most = TABLE_5_1.drive_limit / (TABLE_5_1.m_t + TABLE_5_1.m_i)
    assert np.diff(states[:, 4]).max() / 0.02 <= most
    free = simulate(TABLE_5_1._replace(drive_gain=0.0), inputs_of(250), running(4.5), 0.02)
    assert np.diff(free[:, 4]).mean() / 0.02 == pytest.approx(-0.058 * TABLE_5_1.g, rel=1e-3)


def test_the_actuator_integrates_its_command() -> None:
    states = simulate(
        TABLE_5_1, inputs_of(200, command=0.05, speed=3.0), running(3.0), 0.02, actuator=BOSSERD
    )
    t = np.arange(201) * 0.02
    np.testing.assert_allclose(states[:, 11], 0.05 * (t - 0.1 * (1 - np.exp(-10 * t))), atol=1e-6)
    np.testing.assert_allclose(states[:, 12], 0.05 * (1 - np.exp(-10 * t)), atol=1e-5)


def test_without_an_actuator_the_wheel_angle_is_the_input() -> None:
    delta = np.linspace(0.0, 0.1, 51)
    shift_on_tractor = simulate(TABLE_5_1, inputs_of(50, delta=delta[:-1], speed=3.0), running(3.0), 0.02)
    np.testing.assert_array_equal(shift_on_tractor[1:, 11], delta[:-1])
    linear = simulate(TABLE_5_1, inputs_of(51, delta=delta, speed=3.0), running(3.0), 0.02, linear=True)
    np.testing.assert_array_equal(linear[1:, 11], delta[1:])
    assert not linear[:, 12].any()


def test_soil_may_change_on_the_way() -> None:
    inputs = inputs_of(600, delta=0.1, speed=4.5)
    soil = np.tile(TABLE_5_1.theta, (600, 1))
    same = simulate(TABLE_5_1, inputs, running(4.5), 0.02, soil=soil)
    np.testing.assert_array_equal(same, simulate(TABLE_5_1, inputs, running(4.5), 0.02))
    soil[300:, :3] *= 0.6
    changed = simulate(TABLE_5_1, inputs, running(4.5), 0.02, soil=soil)
    np.testing.assert_array_equal(changed[:301], same[:301])
    softer = TABLE_5_1._replace(C_af=0.6 * 220e3, C_ar=0.6 * 486e3, C_ai=0.6 * 167e3)
    there = simulate(softer, inputs, running(4.5), 0.02)
    assert changed[-1, 6] == pytest.approx(there[-1, 6], rel=1e-3)
    assert abs(changed[-1, 6] - same[-1, 6]) > 0.002


def test_shorter_steps_change_nothing() -> None:
    delta = 0.3 * np.sin(np.arange(301) * 0.04)
    coarse = simulate(TABLE_5_1, inputs_of(301, delta=delta, speed=5.0), running(5.0), 0.02, linear=True)
    fine_delta = np.interp(np.arange(3001) * 0.002, np.arange(301) * 0.02, delta)
    fine = simulate(TABLE_5_1, inputs_of(3001, delta=fine_delta, speed=5.0), running(5.0), 0.002, linear=True)
    np.testing.assert_allclose(coarse, fine[::10], atol=1e-6)


def test_wrong_names_are_named() -> None:
    with pytest.raises(ValueError, match="steering is no input"):
        inputs_of(3, steering=0.1)
