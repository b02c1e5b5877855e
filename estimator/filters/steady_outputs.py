"""Predicted measurements in a steady turn, as a function of all that is not known exactly, and their
Jacobians.

The closed form of models/steady_turn.py assumes small angles and linear tyres. Here it is corrected for the
tyre curve, by the secant of F = A N (1 − exp(−C α/(A N))) (Karkee 2009, 5.34) at the slip of the turn, and
for the squares of wheel angle and articulation where they matter: 0.6 % of the yaw rate at 8°, which has the
effect of 5 % of C_af.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.steady_turn import steady_turn
from tilth.estimator.record.steady_driving import SteadySample
from tilth.schemas.machine import Machine
from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]

CONSTANTS: Final = (
    "C_af", "C_ar", "C_ai", "wheel_zero", "wheel_gain", "pair_t", "pair_i", "lever_t", "cg_t", "cg_i",
    "rolling", "curvature", "a", "b", "c", "d", "e", "m_t", "m_i",
)  # fmt: skip
"""The constants that a steady turn depends on. They are defined in unknowns.NAMES, except that the first
three are given as logarithms here. A lever of the implement's antennas has no effect on OUTPUTS."""
OUTPUTS: Final = ("yaw_rate", "articulation", "lateral_velocity")
STEP: Final = 1e-4  # of the central differences
PASSES: Final = 4  # iterations of the secant; each reduces the error to a tenth


def outputs(points: Array, inputs: Array, machine: Machine) -> Array:
    """OUTPUTS, shape [n, 3].

    points: [n, 19], CONSTANTS. inputs: [n, 4]: u (m/s), wheel angle as the sensor reads it, rolls of tractor
    and implement (rad). The lateral velocity is that of the point where the machine file has the CG, computed
    from where it has the antennas, without the errors of the pairs. Raises numpy.linalg.LinAlgError if there
    is no steady turn.
    """
    at = dict(zip(CONSTANTS, points.T, strict=True))
    t, i = machine.tractor, machine.implement
    a = t.a.value * np.exp(at["a"]) - at["cg_t"]
    b = t.b.value * np.exp(at["b"]) + at["cg_t"]
    c = t.c.value * np.exp(at["c"]) + at["cg_t"]
    d = i.d.value * np.exp(at["d"]) - at["cg_i"]
    e = i.e.value + at["e"] + at["cg_i"]
    m_t, m_i = t.mass.value * np.exp(at["m_t"]), i.mass.value * np.exp(at["m_i"])
    u, reading, roll_t, roll_i = inputs.T
    delta = (reading - at["wheel_zero"]) * np.exp(-at["wheel_gain"])
    tongue = m_i * e / (d + e)
    front = (b * m_t - (c - b) * tongue) / (a + b)
    loads = GRAVITY * np.column_stack([front, m_t + tongue - front, m_i - tongue])
    stiffness: Array = np.exp(points[:, :3])
    softness = np.maximum(at["curvature"], 0.0)[:, None] * stiffness / loads
    heights = (t.cg_height.value, i.cg_height.value)
    tan_delta, cos_delta = np.tan(delta), np.cos(delta)
    # Front slip angle ((v + a r)/u − tan δ) cos² δ; the force across the tractor has one more factor cos δ.
    force_factors = np.column_stack([cos_delta**3, np.ones_like(u), np.ones_like(u)])
    secant, turn = stiffness, np.zeros_like(stiffness)
    for _ in range(PASSES):
        turn_inputs = np.column_stack([secant * force_factors, m_t, m_i, u, tan_delta, roll_t, roll_i])
        turn = steady_turn(turn_inputs, a, b, c, d, e, at["rolling"], heights)
        v, r, articulation = turn.T
        slip = np.column_stack(
            [
                ((v + a * r) / u - tan_delta) * cos_delta**2,
                (v - b * r) / u,
                (v - (c + d + e) * r) / u + articulation,
            ]
        )
        saturation = np.maximum(softness * np.abs(slip), 1e-9)
        secant = stiffness * -np.expm1(-saturation) / saturation
    v, r, articulation = turn.T
    # The hitch's velocity across the implement is u sin λ + (v − c r) cos λ, not u λ + v − c r.
    hitch_angle = articulation + (d + e) * r / u * (1.0 / np.cos(articulation) - 1.0)
    at_antennas = v + r * (at["lever_t"] - at["cg_t"])
    return np.column_stack([r, np.arctan(hitch_angle), at_antennas])


def linearised(point: Array, sample: SteadySample, machine: Machine) -> tuple[Array, Array, Array]:
    """(OUTPUTS [3], their Jacobian over CONSTANTS [3, 19], and over the inputs of `outputs` [3, 4]).

    point: [19], CONSTANTS. Raises as `outputs`.
    """
    inputs = np.array([sample.u, sample.wheel_angle, sample.roll_t, sample.roll_i])
    point_and_inputs = np.concatenate([point, inputs])
    nudges = STEP * np.eye(len(point_and_inputs))
    rows = np.vstack([point_and_inputs, point_and_inputs + nudges, point_and_inputs - nudges])
    z = outputs(rows[:, : len(point)], rows[:, len(point) :], machine)
    n = len(point_and_inputs)
    slope = (z[1 : n + 1] - z[n + 1 :]).T / (2 * STEP)
    return z[0], slope[:, : len(point)], slope[:, len(point) :]


def largest_slip(sample: SteadySample, zero: float, machine: Machine) -> float:
    """Largest measured slip angle of the three axles, rad; 0 without a lateral velocity.

    zero: reading of the wheel angle when straight, rad.
    """
    if sample.v is None:
        return 0.0
    t, i = machine.tractor, machine.implement
    back = t.c.value + i.d.value + i.e.value
    front = (sample.v + t.a.value * sample.yaw_rate) / sample.u - (sample.wheel_angle - zero)
    rear = (sample.v - t.b.value * sample.yaw_rate) / sample.u
    cart = (sample.v - back * sample.yaw_rate) / sample.u + sample.articulation
    return max(abs(front), abs(rear), abs(cart))
