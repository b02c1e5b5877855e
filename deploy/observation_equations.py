"""What the filters expect of each sensor, in symbols, and the kernels that are written from it.

`python -m tilth.deploy.generate` writes estimator/filters/generated/observation_kernels.py: each prediction
with its exact derivatives by states and unknowns. X are the states (filters/states.py), Q the unknowns
(filters/unknowns.py), K what is known. What both bodies or all receivers have goes by its name without the
body, too: that of the sensor's own. For development only.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any, Final

import sympy as sp

from tilth.deploy.kernel_text import kernel, value_lines
from tilth.estimator.filters.states import N_STATES, STATES
from tilth.estimator.filters.unknowns import AT, AT_ROLL_ZERO, NAMES, UNKNOWNS, ActsAs

TARGET: Final = "estimator/filters/generated/observation_kernels.py"
UNKNOWN: Final = "q_"

KNOWN: Final = {
    "u": "obs.u",  # m/s, measured
    "psi_ref": "obs.psi_ref",  # rad, the heading that a velocity is across
    "faster": "obs.faster",  # rad/s^2, how fast the yaw rate grows
    "taken_ago": f"q[{AT['rate_late_t']} + body]",  # s, how long ago the yaw rate was taken from the state
    "ahead": "setup.levers[obs.place, 0]",  # m, of the antenna by the machine file
    "right": "setup.levers[obs.place, 1]",
    "middle": "setup.middles[body, 0]",  # m, of the body's antennas
    "height": "setup.heights[obs.place]",  # m; 0 where the receiver corrects for roll
    "corrected": "setup.corrected[obs.place]",  # m, the height where it does
    "c": "setup.geometry[2]",  # m, nominal
    "d": "setup.geometry[3]",
    "h_h": "setup.rig.h_h",
    "g": "setup.rig.g",  # m/s^2
    "rolls": "1.0 if setup.scale == 1.0 else 0.0",
    "reading": "reading",  # rad, of the wheel angle, and its rate, as long ago as it was taken
    "reading_rate": "reading_rate",
    "reading_ago": f"q[{AT['latency']}]",
}
K: Final = {name: sp.Symbol(name, real=True) for name in KNOWN}


Index = tuple[int, str]  # a number, and what is added to it


def _indices(names: tuple[str, ...]) -> dict[str, Index]:
    """Where each one stands; that of the sensor's own body by the name without the body."""
    found = {name: (k, "") for k, name in enumerate(names)}
    for k, name in enumerate(names):
        parts = name.split("_")
        other = "_".join("i" if part == "t" else part for part in parts)
        if "t" in parts and other in names:
            own = "_".join(part for part in parts if part != "t")
            found.setdefault(own, (k, f" + {names.index(other) - k} * body"))
    return found


def _element(array: str, index: Index, first: int = 0) -> str:
    return f"{array}[{first + index[0]}{index[1]}]"


STATE_AT: Final = _indices(STATES)
UNKNOWN_AT: Final = _indices(NAMES) | {"roll_zero": (AT_ROLL_ZERO, " + obs.place")}
X: Final = {name: sp.Symbol(name, real=True) for name in STATE_AT}
Q: Final = {name: sp.Symbol(UNKNOWN + name, real=True) for name in UNKNOWN_AT}


def parameter(name: str) -> Any:
    """One of rolling_terms.PARAMETERS that is nominally K[name], as the rows of the unknowns have it."""
    found = K[name]
    for row in sorted(UNKNOWNS, key=lambda row: row.transform):  # sums come after factors
        for acted_on in row.acts_on.split():
            if acted_on.lstrip("-") != name:
                continue
            value = Q[row.name] * (1 if row.linear else K["rolls"])
            if row.transform is ActsAs.FACTOR:
                found *= sp.exp(value)
            else:
                found = found + (-value if acted_on.startswith("-") else value)
    return found


def roll(body: str) -> Any:
    """Of a body against the horizontal, rad: its lean on its tyres and the ground's slope."""
    return X[f"phi{body}"] + X[f"bank{body}"] / K["g"]


def roll_rate(body: str) -> Any:
    """rad/s."""
    return X[f"p{body}"] + X[f"bank_rate{body}"] / K["g"]


def lever(body: str) -> Any:
    """How far an antenna is ahead of its body's CG, m."""
    return K["ahead"] + Q[f"lever{body}"] - Q[f"cg{body}"]


# What each sensor reads.


def yaw_rate() -> Any:
    """That of its body, a little ago, rad/s."""
    return X["r"] + K["faster"] * (K["taken_ago"] - Q["rate_late"])


def heading() -> Any:
    """Of a receiver that measures it itself, rad."""
    return X["psi"]


def measured_roll() -> Any:
    """Lean and cross slope of its body, a little ago, with a zero error of its own, rad."""
    return roll("") - Q["roll_late"] * roll_rate("") + Q["roll_zero"]


def position(axis: str, body: str) -> Any:
    """North or east of an antenna, m: tractor's CG, the way from there over the hitch, slow errors."""

    def along(of: str, ahead: Any, right: Any) -> Any:
        sine, cosine = sp.sin(X[f"psi{of}"]), sp.cos(X[f"psi{of}"])
        return cosine * ahead - sine * right if axis == "north" else sine * ahead + cosine * right

    arm, height, drawbar = K["ahead"] - K["middle"], K["height"], parameter("h_h")
    lateral_offset, slow = K["right"] + Q[f"pair{body}"] * arm, X[f"pair{body}_{axis}"] * arm
    if body == "_t":
        return X[axis] + along("_t", lever("_t"), lateral_offset + height * roll("_t")) + slow
    hitch = along("_t", -parameter("c"), drawbar * roll("_t"))
    lateral_offset += Q["aside_i"] + (height - drawbar) * roll("_i")
    return (
        X[axis]
        + hitch
        + along("_i", lever("_i") - parameter("d"), lateral_offset)
        + X[f"offset_{axis}"]
        + slow
    )


def velocity(body: str) -> Any:
    """Of an antenna, which its body's roll sways, to the right of psi_ref, m/s."""
    u, angle = K["u"] + X["speed"], X["psi_t"] - K["psi_ref"]
    height, drawbar = K["height"] + Q["sway"] * K["corrected"], parameter("h_h")
    up, ahead = (height, lever("_t")) if body == "_t" else (drawbar, -parameter("c"))
    across = X["v"] + ahead * X["r_t"] + up * roll_rate("_t")
    value = u * sp.sin(angle) + across * sp.cos(angle)
    if body == "_i":
        value += (lever("_i") - parameter("d")) * X["r_i"] + (height - drawbar) * roll_rate("_i")
    return value


def wheel_angle() -> Any:
    """The true one, rad."""
    late = K["reading_ago"] - Q["latency"]
    return (K["reading"] + K["reading_rate"] * late - Q["wheel_zero"]) * sp.exp(-Q["wheel_gain"])


PREDICTIONS: Final = {
    "yaw_rate": yaw_rate(),
    "heading": heading(),
    "measured_roll": measured_roll(),
    **{f"{axis}{body}": position(axis, body) for axis in ("north", "east") for body in ("_t", "_i")},
    **{f"velocity{body}": velocity(body) for body in ("_t", "_i")},
}

# The kernels.

HEAD: Final = '''"""What the filters expect of each sensor with its slopes, written by `deploy.generate`.

Change deploy/observation_equations.py instead.
"""

from math import cos, exp, sin

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.sensors.observation import Observation

Array = NDArray[np.float64]
'''
VALUE: Final = "Its value; fills the slopes (30 + n,) by states and unknowns that are not zero."
WHEEL: Final = "Value of the true wheel angle, rad."
WHEEL_SLOPES: Final = "Fill the slopes (n,) of it by unknowns that are not zero."
GIVEN: Final = {
    **{str(X[name]): _element("x", at) for name, at in STATE_AT.items()},
    **{str(Q[name]): _element("q", at) for name, at in UNKNOWN_AT.items()},
    **KNOWN,
}


def slopes_of(expression: Any, first: int) -> Iterator[tuple[str, Any]]:
    """(element of `slopes`, derivative) by each state and unknown of an expression. first: place of the
    unknowns in `slopes`."""
    rows = [(X[name], _element("slopes", at)) for name, at in STATE_AT.items()]
    rows += [(Q[name], _element("slopes", at, first)) for name, at in UNKNOWN_AT.items()]
    for symbol, element in rows:
        if symbol in expression.free_symbols:
            yield element, sp.diff(expression, symbol)


def _prediction(name: str, expression: Any) -> str:
    outputs = {"value": expression, **dict(slopes_of(expression, N_STATES))}
    parameters = "x: Array, q: Array, body: int, obs: Observation, setup: RigSetup, slopes: Array"
    lines = [*value_lines(GIVEN, outputs), "    return float(value)"]
    return kernel(name, VALUE, parameters, lines, "inner_kernel", "float")


@cache  # seconds of algebra
def source() -> str:
    """The text of observation_kernels.py."""
    wheel, parameters = wheel_angle(), "reading: float, reading_rate: float, q: Array"
    acting = tuple(k for name, k in AT.items() if Q[name] in wheel.free_symbols)
    value = [*value_lines(GIVEN, {"value": wheel}), "    return float(value)"]
    slopes = value_lines(GIVEN, dict(slopes_of(wheel, 0)))
    return "\n\n".join([
        f"{HEAD}\nWHEEL_ANGLE_UNKNOWNS = {acting}  # that act on the true wheel angle\n",
        *(_prediction(name, expression) for name, expression in PREDICTIONS.items()),
        kernel("wheel_angle", WHEEL, parameters, value, "inner_kernel", "float"),
        kernel("wheel_angle_slopes", WHEEL_SLOPES, f"{parameters}, slopes: Array", slopes, "inner_kernel"),
    ])  # fmt: skip
