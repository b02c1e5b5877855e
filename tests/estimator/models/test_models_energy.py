"""The models derived a second time, from energy, by a program that knows nothing of the first derivation.

Two rigid bodies with three coordinates each, the hitch as a holonomic constraint with multipliers, and the
tyre forces as generalised forces; sympy writes the equations of motion, which are compared with the kernel at
random states. Linearised, the same gives the dynamic and the relaxation model; rolling without slip the
kinematic one.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy
from numpy.typing import NDArray
from sympy.physics import mechanics

from tilth.estimator.models import dynamic, kinematic, nonlinear, relaxation
from tilth.estimator.models.parameters import GEOMETRY, TABLE_5_1, Rig
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]
sp: Any = sympy  # its types say little
me: Any = mechanics

G = {name: sp.Symbol(name, positive=True) for name in (*GEOMETRY, *PARAMETERS, "w_f", "w_r", "w_i")}
DELTA = sp.Symbol("delta")
FORCES = sp.symarray("F", (6, 2))  # along and across each wheel: left, right of front, rear, implement
EXTRA = sp.symarray("E", 4)  # lateral force and moment on the tractor and on the implement


def _wheel_points(t: Any, i: Any) -> list[tuple[Any, Any, Any]]:
    """(place in W, direction that the wheel faces, body) of each of the six wheels."""
    points = []
    for body, ahead, width, steer in (
        (t, G["a"], G["w_f"], DELTA),
        (t, -G["b"], G["w_r"], 0),
        (i, -G["e"], G["w_i"], 0),
    ):
        x, y, psi = body
        forward, right = sp.Matrix([sp.cos(psi), sp.sin(psi)]), sp.Matrix([-sp.sin(psi), sp.cos(psi)])
        for side in (-1, 1):
            points.append((sp.Matrix([x, y]) + ahead * forward + side * width / 2 * right, psi + steer, body))
    return points


@cache
def _equations() -> tuple[Callable[..., Array], Callable[..., Array]]:
    """Numeric (mass matrix, forcing) of x, y, psi of tractor and implement and of two multipliers."""
    q = me.dynamicsymbols("x_t y_t psi_t x_i y_i psi_i")
    rates = [sp.Derivative(c, me.dynamicsymbols._t) for c in q]
    t, i = q[:3], q[3:]
    energy = sum(
        G[m] * (v[0] ** 2 + v[1] ** 2) / 2 + G[inertia] * v[2] ** 2 / 2
        for m, inertia, v in (("m_t", "I_t", rates[:3]), ("m_i", "I_i", rates[3:]))
    )
    hitch = [
        t[0] - G["c"] * sp.cos(t[2]) - i[0] - G["d"] * sp.cos(i[2]),
        t[1] - G["c"] * sp.sin(t[2]) - i[1] - G["d"] * sp.sin(i[2]),
    ]
    world, origin = me.ReferenceFrame("W"), me.Point("O")
    origin.set_vel(world, 0)
    acting: list[Any] = []
    for (place, facing, _), (along, across) in zip(_wheel_points(t, i), FORCES, strict=True):
        point = me.Point("P")
        point.set_vel(world, place[0].diff("t") * world.x + place[1].diff("t") * world.y)
        x_force = along * sp.cos(facing) - across * sp.sin(facing)
        y_force = along * sp.sin(facing) + across * sp.cos(facing)
        acting.append((point, x_force * world.x + y_force * world.y))
    for body, disturbance, moment in ((t, EXTRA[0], EXTRA[1]), (i, EXTRA[2], EXTRA[3])):
        centre, frame = me.Point("C"), me.ReferenceFrame("B")
        centre.set_vel(world, body[0].diff("t") * world.x + body[1].diff("t") * world.y)
        frame.set_ang_vel(world, body[2].diff("t") * world.z)
        acting.append((centre, disturbance * (sp.cos(body[2]) * world.y - sp.sin(body[2]) * world.x)))
        acting.append((frame, moment * world.z))
    method = me.LagrangesMethod(energy, q, hol_coneqs=hitch, forcelist=acting, frame=world)
    method.form_lagranges_equations()
    interpreted = dict(zip((*rates, *q), sp.symarray("s", 12), strict=True))
    arguments = [*interpreted.values(), DELTA, *FORCES.ravel(), *EXTRA, *G.values()]

    def numeric(matrix: Any) -> Callable[..., Array]:
        made: Callable[..., Array] = sp.lambdify(arguments, matrix.subs(interpreted), "numpy", cse=True)
        return made

    return numeric(method.mass_matrix_full), numeric(method.forcing_full)


def _random_case(rng: np.random.Generator) -> tuple[Rig, Array, Array]:
    rig = Rig(*(value * rng.uniform(0.6, 1.5) for value in TABLE_5_1))
    rig = rig._replace(front_drive=0.4, load_exponent=0.8, roll_share_f=0.3, g=9.81)
    x = np.zeros(13)
    x[:4] = rng.uniform(-1.6, 1.6, 4)  # any heading, articulation beyond 90 degrees
    x[4:8] = rng.uniform([-6.0, -1.5, -0.8, -0.8], [6.0, 1.5, 0.8, 0.8])
    x[8:11] = rng.uniform(-0.5, 0.5, 3)
    w = nonlinear.inputs_of(1, delta=rng.uniform(-0.61, 0.61), speed=rng.uniform(-6, 6))[0]
    w[1:3] = rng.uniform(-1.0, 1.0, 2)
    w[5:9] = rng.uniform(-5e3, 5e3, 4)
    return rig, x, w


def _by_energy(rig: Rig, x: Array, w: Array) -> Array:
    """(u', v', r_t', r_i') from the accelerations of the constrained bodies."""
    psi_t, psi_i, u, v, r_t, r_i = x[2:8]
    towed = nonlinear.implement(rig, x[None])[0]
    across = np.array([-np.sin(psi_t), np.cos(psi_t)])
    velocity_t = u * np.array([np.cos(psi_t), np.sin(psi_t)]) + v * across
    velocity_i = velocity_t - rig.c * r_t * across - rig.d * r_i * np.array([-np.sin(psi_i), np.cos(psi_i)])
    speeds = [*velocity_t, r_t, *velocity_i, r_i]
    places = [x[0], x[1], psi_t, towed[0], towed[1], psi_i]
    forces = nonlinear.wheels(rig, x, w)[:, 1:]
    disturbances = [rig.m_t * w[1] + w[5], w[6], rig.m_i * w[2] + w[7], w[8]]
    values = [*speeds, *places, w[0], *forces.ravel(), *disturbances, *(getattr(rig, name) for name in G)]
    mass, forcing = _equations()
    solution = np.linalg.solve(mass(*values), forcing(*values).ravel())
    ax, ay, dr_t, _, _, dr_i = solution[6:12]  # after the six q'
    forward = ax * np.cos(psi_t) + ay * np.sin(psi_t)
    right = ay * np.cos(psi_t) - ax * np.sin(psi_t)
    return np.array([forward + v * r_t, right - u * r_t, dr_t, dr_i])


def test_nonlinear_model_against_lagrange_with_a_constraint() -> None:
    rng = np.random.default_rng(3)
    for _ in range(40):
        rig, x, w = _random_case(rng)
        np.testing.assert_allclose(nonlinear.derivative(rig, x, w)[4:8], _by_energy(rig, x, w), rtol=1e-9)


def test_the_comparison_sees_a_wrong_arm() -> None:
    rig, x, w = _random_case(np.random.default_rng(3))
    wrong = _by_energy(rig._replace(c=rig.c + 1e-4), x, w)
    assert np.abs(nonlinear.derivative(rig, x, w)[4:8] - wrong).max() > 1e-7


@cache
def _small_motions() -> tuple[Any, Any, list[Any]]:
    """(equations of y, psi_t, psi_i for a rig that advances at speed U, unknown accelerations, symbols).

    Lagrange in the three coordinates that are left once the hitch is put in; slip angles are symbols.
    """
    time, speed = sp.Symbol("t"), sp.Symbol("U", positive=True)
    y, psi_t, psi_i = (sp.Function(n)(time) for n in ("y", "psi_t", "psi_i"))
    slips, slopes = sp.symbols("alpha_f alpha_r alpha_i"), sp.symbols("gravity_t gravity_i")
    x = speed * time
    ahead, behind = sp.Matrix([sp.cos(psi_t), sp.sin(psi_t)]), sp.Matrix([sp.cos(psi_i), sp.sin(psi_i)])
    tractor = sp.Matrix([x, y])
    towed = tractor - G["c"] * ahead - G["d"] * behind
    energy = (
        G["m_t"] * tractor.diff(time).dot(tractor.diff(time)) + G["I_t"] * psi_t.diff(time) ** 2
        + G["m_i"] * towed.diff(time).dot(towed.diff(time)) + G["I_i"] * psi_i.diff(time) ** 2
    ) / 2  # fmt: skip
    forces = [
        (tractor + G["a"] * ahead, psi_t + DELTA, -G["C_af"] * slips[0]),
        (tractor - G["b"] * ahead, psi_t, -G["C_ar"] * slips[1]),
        (towed - G["e"] * behind, psi_i, -G["C_ai"] * slips[2]),
        (tractor, psi_t, G["m_t"] * slopes[0]),
        (towed, psi_i, G["m_i"] * slopes[1]),
    ]
    rows = []
    for q in (y, psi_t, psi_i):
        work = sum(
            f * sp.Matrix([-sp.sin(face), sp.cos(face)]).dot(place.diff(q)) for place, face, f in forces
        )
        rows.append(energy.diff(q.diff(time)).diff(time) - energy.diff(q) - work)
    second = sp.symbols("ddy dr_t dr_i")
    names = [*sp.symbols("v r_t r_i"), *slips, *sp.symbols("y_t p_t p_i"), DELTA, *slopes]
    v, r_t, r_i = names[:3]
    interpreted = {}
    for q, value, rate, double in zip(
        (y, psi_t, psi_i), names[6:9], (v + speed * names[7], r_t, r_i), second, strict=True
    ):
        interpreted.update({q.diff(time, 2): double, q.diff(time): rate, q: value})
    small = sp.Matrix([row.subs(list(interpreted.items())) for row in rows])
    return small, sp.Matrix(second), [speed, *names]


def _linear(expressions: Any, symbols: list[Any]) -> Any:
    """Slopes about straight running."""
    return expressions.jacobian(symbols).subs(dict.fromkeys(symbols, 0))


@cache
def _relaxation_by_energy() -> Callable[..., Array]:
    """[A | B] of the relaxation model as a numeric function of u and G."""
    small, second, (speed, *names) = _small_motions()
    mass = small.jacobian(second).subs(dict.fromkeys(names, 0))
    by_state = -mass.LUsolve(_linear(small.subs(dict.fromkeys(second, 0)), names))
    v, r_t, r_i, *slips = names[:6]
    p_t, p_i = names[7:9]
    across = [v + G["a"] * r_t - speed * DELTA, v - G["b"] * r_t]
    across.append(v - G["c"] * r_t - (G["d"] + G["e"]) * r_i + speed * (p_t - p_i))
    lengths = [G[name] for name in PARAMETERS[3:]]
    rates = [(w - speed * s) / length for w, s, length in zip(across, slips, lengths, strict=True)]
    rest = _linear(sp.Matrix([*rates, v + speed * p_t, r_t, r_i]), names)
    by_state[0, :] -= _linear(sp.Matrix([speed * r_t]), names)  # v' = y'' - u psi_t'
    made: Callable[..., Array] = sp.lambdify([speed, *G.values()], by_state.col_join(rest), "numpy", cse=True)
    return made


@cache
def _dynamic_by_energy() -> Callable[..., Array]:
    small, second, (speed, *names) = _small_motions()
    v, r_t, r_i = names[:3]
    p_t, p_i = names[7:9]
    slip = {
        names[3]: (v + G["a"] * r_t) / speed - DELTA,
        names[4]: (v - G["b"] * r_t) / speed,
        names[5]: (v - G["c"] * r_t - (G["d"] + G["e"]) * r_i) / speed + p_t - p_i,
    }
    symbols = [*names[:3], *names[6:]]
    mass = small.jacobian(second).subs(dict.fromkeys(names, 0))
    forced = _linear(small.subs(slip).subs(dict.fromkeys(second, 0)), symbols)
    by_state = -mass.LUsolve(forced)
    by_state[0, :] -= _linear(sp.Matrix([speed * r_t]), symbols)
    rest = _linear(sp.Matrix([v + speed * p_t, r_t, r_i]), symbols)
    made: Callable[..., Array] = sp.lambdify([speed, *G.values()], by_state.col_join(rest), "numpy", cse=True)
    return made


def _kinematic_by_constraint() -> Callable[..., Array]:
    """Wheels that do not slip: the velocity of each axle has no part across its wheels."""
    time, speed = sp.Symbol("t"), sp.Symbol("U", positive=True)
    y, psi_t, psi_i = (sp.Function(n)(time) for n in ("y", "psi_t", "psi_i"))  # y: of the rear axle
    ahead, behind = sp.Matrix([sp.cos(psi_t), sp.sin(psi_t)]), sp.Matrix([sp.cos(psi_i), sp.sin(psi_i)])
    rear = sp.Matrix([speed * time, y])
    front = rear + (G["a"] + G["b"]) * ahead
    cart = rear - (G["c"] - G["b"]) * ahead - (G["d"] + G["e"]) * behind
    rows = [
        place.diff(time).dot(sp.Matrix([-sp.sin(face), sp.cos(face)]))
        for place, face in ((rear, psi_t), (front, psi_t + DELTA), (cart, psi_i))
    ]
    rates, names = sp.symbols("dy dp_t dp_i"), [*sp.symbols("y_t p_t p_i"), DELTA, *sp.symbols("g_t g_i")]
    interpreted = [(q.diff(time), rate) for q, rate in zip((y, psi_t, psi_i), rates, strict=True)]
    interpreted += list(zip((y, psi_t, psi_i), names, strict=False))
    small = sp.Matrix([row.subs(interpreted) for row in rows])
    zero = dict.fromkeys([*rates, *names], 0)
    by_state = -small.jacobian(rates).subs(zero).LUsolve(small.jacobian(names).subs(zero))
    made: Callable[..., Array] = sp.lambdify([speed, *G.values()], by_state, "numpy")
    return made


@pytest.mark.parametrize(
    ("model", "derive"),
    [
        (kinematic, _kinematic_by_constraint),
        (dynamic, _dynamic_by_energy),
        (relaxation, _relaxation_by_energy),
    ],
)
def test_linear_models_against_their_derivation_from_energy(model: Any, derive: Any) -> None:
    derived, rng = derive(), np.random.default_rng(5)
    for _ in range(20):
        rig = Rig(*(value * rng.uniform(0.6, 1.5) for value in TABLE_5_1))
        u = float(rng.uniform(0.3, 12.0))
        ours = np.hstack([f(u, rig.geometry, rig.theta) for f in (model.system_matrix, model.input_matrix)])
        theirs = derived(u, *(getattr(rig, name) for name in G))
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
