"""The equations of estimator/models/rolling.py in symbols, and the kernels that are written from them.

Two rigid bodies by Kane's method: generalised speeds u, v, r_t, r_i, p_t, p_i; lean is small. `python -m
tilth.deploy.generate` writes estimator/models/generated/rolling_kernels.py: the equations and their exact
derivatives by states, inputs and parameters, with common subexpressions found once. For development only.
"""

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, Final

import sympy as sp

from tilth.deploy.kernel_text import kernel, slope_lines, value_lines
from tilth.estimator.models.rolling_terms import CONSTANTS, INPUTS, PARAMETERS, SPEEDS, STATES
from tilth.schemas.axle_loads import axle_loads

LOADS: Final = ("a", "b", "c", "d", "e", "m_t", "m_i", "g")  # what axle_loads takes
TARGET: Final = "estimator/models/generated/rolling_kernels.py"
RESISTANCE_SPEED: Final = sp.Rational(1, 10)  # m/s: rolling resistance turns round over this range of speed
X: Final = {name: sp.Symbol(name, real=True) for name in STATES}
W: Final = {name: sp.Symbol(name, real=True) for name in INPUTS}
P: Final = {name: sp.Symbol(name, real=True) for name in (*PARAMETERS, *CONSTANTS)}
FOUND: Final = sp.symbols(" ".join(f"found_{k}" for k in range(SPEEDS)), real=True)  # what M is solved for


def _named(name: str, *slopes: Callable[..., Any]) -> Any:
    """A function of rolling_terms.py that kernels call by name. slopes: its derivatives by each argument."""

    def fdiff(self: Any, argindex: int = 1) -> Any:
        return sp.sympify(slopes[argindex - 1](*self.args))

    return type(name, (sp.Function,), {"fdiff": fdiff})


signum = _named("signum", lambda value: 0)
size = _named("size", signum)
is_within = _named("is_within", lambda value, limit: 0, lambda value, limit: 0)
within = _named("within", is_within, lambda value, limit: (1 - is_within(value, limit)) * signum(value))
kept_length = _named(
    "kept_length", *map(sp.Function, ("kept_length_by_slip", "kept_length_by_slip_dependence"))
)
both_wheels = _named("both_wheels", *map(sp.Function, ("both_wheels_by_speed", "both_wheels_by_difference")))


ZERO: Final = sp.Integer(0)
Wheel = tuple[Any, Any, Any]  # load, force along, force across


def tyre(alpha: Any, stiffness: Any, limit: Any) -> Any:
    """Lateral force of a wheel, 5.34 made odd."""
    return signum(alpha) * limit * (sp.exp(-stiffness * size(alpha) / limit) - 1)


def axle(
    loads: tuple[Any, Any], level: Any, shift: Any, alpha: Any, stiffness: Any, along: Any, apart: Any = ZERO
) -> list[Wheel]:
    """The left and the right wheel of an axle. loads: static one, and that when driving. shift: load that
    goes to the left one. apart: by how much the right one slips more than their mean, and the left one less.
    """
    static, half = loads[0], loads[1] * level / 2
    moved = within(shift, sp.Float(0.999) * half)  # no wheel loses all of its load
    wheels = []
    for load, slip in ((half + moved, alpha - apart), (half - moved, alpha + apart)):
        grown = stiffness / 2 * (load / (static / 2)) ** P["exponent"]
        resistance = -P["rolling"] * load * sp.tanh(along / RESISTANCE_SPEED)
        wheels.append((load, resistance, tyre(slip, grown, load / P["curvature"])))
    return wheels


def velocities() -> dict[str, tuple[Any, Any]]:
    """Velocity along and across the wheels of each axle; pin and drawbar move with the lean."""
    delta, lam = W["delta"], X["psi_t"] - X["psi_i"]
    u, v, r_t, r_i, p_t, p_i = W["u"], X["v"], X["r_t"], X["r_i"], X["p_t"], X["p_i"]
    front, hitch = v + P["a"] * r_t + P["pivot_height"] * p_t, v - P["c"] * r_t + P["h_h"] * p_t
    side = u * sp.sin(lam) + hitch * sp.cos(lam) - (P["d"] + P["e"]) * r_i - P["h_h"] * p_i
    return {
        "f": (u * sp.cos(delta) + front * sp.sin(delta), front * sp.cos(delta) - u * sp.sin(delta)),
        "r": (u, v - P["b"] * r_t),
        "i": (u * sp.cos(lam) - hitch * sp.sin(lam), side),
    }


def front_wheels_apart() -> tuple[Any, Any]:
    """(slip of the right front wheel less the mean of both, rad; what that mean has more than the slip amid
    the axle, rad), of wheels that do not turn towards the point about which the tractor turns: where they go,
    less where they point, for which cot(left, right) = cot(mean) plus and minus w_f / 2 (a + b) by Ackermann.
    """
    u, side = W["u"], X["v"] + P["a"] * X["r_t"]
    squared, faster = u**2 + side**2, P["w_f"] * X["r_t"] / 2
    kept, sine = (1 - P["parallel"]) * P["w_f"] / 2 / (P["a"] + P["b"]), sp.sin(W["delta"])
    mean = faster**2 * u * side / squared**2 - kept**2 * sine**3 * sp.cos(W["delta"])
    return P["two_track"] * (faster * side / squared - kept * sine**2), P["two_track"] * mean


def springs() -> tuple[Any, Any]:
    """Of the wheels about the roll axis, N m/rad: k is what is left when gravity has taken its part off."""
    return P["k_t"] + P["g"] * P["m_t"] * P["h_t"], P["k_i"] + P["g"] * P["m_i"] * P["h_i"]


def roll_moments() -> tuple[Any, Any]:
    """What springs and dampers of the wheels hold, N m: by the lean relative to the ground below them."""
    spring_t, spring_i = springs()
    return (
        -spring_t * (X["phi_t"] - W["uneven_t"]) - P["d_t"] * X["p_t"],
        -spring_i * (X["phi_i"] - W["uneven_i"]) - P["d_i"] * X["p_i"],
    )


def front_side(wheels: Iterable[Wheel]) -> Any:
    """The front axle's force across the tractor."""
    delta = W["delta"]
    return sum(along * sp.sin(delta) + across * sp.cos(delta) for _, along, across in wheels)


def axle_loads_when_driving() -> dict[str, tuple[Any, Any]]:
    """Of each axle: (static load, load when driving forward), N. The tractor pulls the implement, against its
    rolling resistance on the ground, at the height of the drawbar: that tips the implement onto the drawbar
    and takes load off the front wheels, 3 % with one of 8 t on soft ground. What the rear wheels gain by it
    is left out, as is what driving takes of their side force: about the same."""
    front, rear, cart = axle_loads(*(P[n] for n in LOADS))
    tipping = P["rolling"] * cart * P["h_h"]  # N m, of either body
    on_drawbar = tipping / (P["d"] + P["e"])
    off_front = (tipping + on_drawbar * (P["c"] - P["b"])) / (P["a"] + P["b"])
    driving = (front - off_front, rear, cart - on_drawbar)
    return dict(zip("fri", zip((front, rear, cart), driving, strict=True), strict=True))


def wheels() -> dict[str, list[Wheel]]:
    """Of each axle. Loads go from side to side as pin and lean press the wheels."""
    loads = axle_loads_when_driving()
    level_t, level_i = (sp.sqrt(1 - (W[n] / P["g"]) ** 2) for n in ("gravity_t", "gravity_i"))
    speed = {name: along for name, (along, _) in velocities().items()}
    moment_t, moment_i = roll_moments()
    front = (loads["f"], level_t, X["alpha_f"], P["C_f"], speed["f"], front_wheels_apart()[0])
    even = axle(front[0], front[1], ZERO, *front[2:])
    found = {
        "f": axle(front[0], front[1], P["pivot_height"] * front_side(even) / P["w_f"], *front[2:]),
        "r": axle(loads["r"], level_t, moment_t / P["w_r"], X["alpha_r"], P["C_r"], speed["r"]),
        "i": axle(loads["i"], level_i, moment_i / P["w_i"], X["alpha_i"], P["C_i"], speed["i"]),
    }
    tipped = -P["pivot_height"] * front_side(even) / P["k_f"]  # the front axle, as it is pushed below its pin
    for name, lean in (
        ("f", tipped), ("r", X["phi_t"] - W["uneven_t"]), ("i", X["phi_i"] - W["uneven_i"])
    ):  # fmt: skip
        thrust = [P["camber"] * load * lean for load, _, _ in found[name]]
        found[name] = [
            (load, along, across + more)
            for (load, along, across), more in zip(found[name], thrust, strict=True)
        ]
    return found


def dynamics() -> tuple[sp.Matrix, sp.Matrix]:
    """M (6, 6) and its right side: M (drive's force, v', r_t', r_i', p_t', p_i') = right side.

    The speed is held: u' is known, and the force of the driven wheels is what that takes.
    """
    u, v, r_t, r_i = W["u"], X["v"], X["r_t"], X["r_i"]
    m_t, m_i, z = P["m_t"], P["m_i"], P["h_h"]
    s, c = sp.sin(X["psi_t"] - X["psi_i"]), sp.cos(X["psi_t"] - X["psi_i"])
    # Velocities of both CGs along and across the tractor; what they change by when speeds do not.
    tractor = sp.Matrix([[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, P["h_t"], 0]])
    implement = sp.Matrix([
        [1, 0, 0, -P["d"] * s, 0, (P["h_i"] - z) * s],
        [0, 1, -P["c"], -P["d"] * c, z, (P["h_i"] - z) * c],
    ])  # fmt: skip
    turned_t = sp.Matrix([-v * r_t, u * r_t])
    turned_i = sp.Matrix([
        -v * r_t + P["c"] * r_t**2 + P["d"] * r_i**2 * c, u * r_t - P["d"] * r_i**2 * s,
    ])  # fmt: skip
    M = m_t * tractor.T * tractor + m_i * implement.T * implement
    M += sp.diag(0, 0, P["I_t"], P["I_i"], P["j_t"], P["j_i"])
    on = wheels()
    along, across = ({n: sum(w[k] for w in on[n]) for n in "fri"} for k in (1, 2))
    front_y = front_side(on["f"])
    front_x = along["f"] * sp.cos(W["delta"]) - across["f"] * sp.sin(W["delta"])
    skew_f = (on["f"][0][1] - on["f"][1][1]) * sp.cos(W["delta"])
    skew_f -= (on["f"][0][2] - on["f"][1][2]) * sp.sin(W["delta"])
    skew = (P["w_f"] * skew_f + P["w_r"] * (on["r"][0][1] - on["r"][1][1])) / 2
    skew_i = P["w_i"] * (on["i"][0][1] - on["i"][1][1]) / 2
    pull_t, pull_i = m_t * W["gravity_t"], m_i * W["gravity_i"]
    cart_y = across["i"] + pull_i
    cart_tx, cart_ty = along["i"] * c + cart_y * s, cart_y * c - along["i"] * s
    moment_t, moment_i = roll_moments()
    held_t = moment_t + P["g"] * m_t * P["h_t"] * X["phi_t"]
    held_i = moment_i + P["g"] * m_i * P["h_i"] * X["phi_i"]
    right = sp.Matrix([
        front_x + along["r"] + cart_tx,
        front_y + across["r"] + pull_t + cart_ty,
        P["a"] * front_y - P["b"] * across["r"] + skew - P["c"] * cart_ty,
        -P["e"] * across["i"] + skew_i - P["d"] * cart_y,
        z * cart_ty + P["pivot_height"] * front_y + P["h_t"] * pull_t + held_t,
        -z * cart_y + P["h_i"] * pull_i + held_i,
    ])  # fmt: skip
    right -= m_t * tractor.T * turned_t + m_i * implement.T * turned_i + M[:, 0] * W["u_rate"]
    share, sine = P["front_drive"], sp.sin(W["delta"])
    drive_x, drive_y = share * (sp.cos(W["delta"]) - 1), share * sine
    M[:, 0] = sp.Matrix([-1 - drive_x, -drive_y, -P["a"] * drive_y, 0, -P["pivot_height"] * drive_y, 0])
    return M, right


def slip_rates() -> sp.Matrix:
    """alpha' of the three axles, 3.107 for tan alpha, in terms that stay finite."""
    static = axle_loads(*(P[n] for n in LOADS))
    rows = []
    for name, load, yaw in zip("fri", static, (X["r_t"], X["r_t"], X["r_i"]), strict=True):
        along, across = velocities()[name]
        alpha, stiffness = X[f"alpha_{name}"], P[f"C_{name}"]
        length = P[f"sigma_{name}"] * kept_length(
            stiffness * size(alpha) * P["curvature"] / load, P["slip_dependence"]
        )
        if name == "f":  # the axle turns about its pin as it is pushed: one more spring in a row
            length += stiffness * P["pivot_height"] ** 2 / P["k_f"]
            across += along * front_wheels_apart()[1]
        both = both_wheels(along, yaw * P[f"w_{name}"])
        speed = size(along + P["two_track"] * (both - along))
        rows.append((across * sp.cos(alpha) - speed * sp.sin(alpha)) * sp.cos(alpha) / length)
    return sp.Matrix(rows)


# The kernels.

HEAD: Final = '''"""Kernels of rolling.py with exact derivatives, written by `deploy.generate`.

Change deploy/motion_equations.py instead.
"""

from math import cos, exp, sin, sqrt, tanh

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.models.rolling_terms import (
    both_wheels,
    both_wheels_by_difference,
    both_wheels_by_speed,
    is_within,
    kept_length,
    kept_length_by_slip_dependence,
    kept_length_by_slip,
    signum,
    size,
    within,
)

Array = NDArray[np.float64]
'''


VALUE: Final = "Fill M (6, 6), right (6, 1) and slip (3,), alpha'. p: PARAMETERS and CONSTANTS."
SLOPE: Final = "Fill right (6, n), derivatives of right - M found by states and inputs, and slip (3, n)."
PARAMETER_SLOPE: Final = "Fill right (6, n), derivatives of right - M found by PARAMETERS, and slip (3, n)."


@cache  # seconds of algebra
def source() -> str:
    """The text of rolling_kernels.py."""
    M, right = dynamics()
    slips = slip_rates()
    given = {name: f"x[{k}]" for k, name in enumerate(STATES)}
    given |= {name: f"w[{k}]" for k, name in enumerate(INPUTS)}
    given |= {name: f"p[{k}]" for k, name in enumerate((*PARAMETERS, *CONSTANTS))}
    values = {f"M[{i}, {j}]": M[i, j] for i in range(SPEEDS) for j in range(SPEEDS)}
    values |= {f"right[{i}, 0]": right[i] for i in range(SPEEDS)}
    values |= {f"slip[{i}]": slips[i] for i in range(3)}
    residual = right - M * sp.Matrix(FOUND)
    rows = {f"right[{i}]": residual[i] for i in range(SPEEDS)} | {f"slip[{i}]": slips[i] for i in range(3)}
    moving = [X[name] for name in STATES if name != "psi_i"] + [W[name] for name in INPUTS[:6]]
    constant = [P[name] for name in PARAMETERS]
    found = {str(symbol): f"found[{k}]" for k, symbol in enumerate(FOUND)}
    arrays = "x: Array, w: Array, p: Array"
    value = f"{arrays}, M: Array, right: Array, slip: Array"
    slope = f"{arrays}, found: Array, right: Array, slip: Array"
    return "\n\n".join([
        HEAD,
        kernel("motion", VALUE, value, value_lines(given, values)),
        kernel("motion_by_state", SLOPE, slope, slope_lines(given | found, rows, moving)),
        kernel("motion_by_parameter", PARAMETER_SLOPE, slope, slope_lines(given | found, rows, constant)),
    ])  # fmt: skip
