"""Steady turning of a tractor with a towed single-axle implement, in closed form.

Source: Karkee (2009), section 3.6, eqs. 3.122 to 3.128, with gravity along the slope added.
Unknowns: lateral velocity v of the tractor's CG (m/s), yaw rate r of both bodies (rad/s), articulation
λ = ψ_t − ψ_i (rad). Small angles, linear tyres F = −C α; relaxation lengths drop out.
Valid above about 1 m/s and below about 10° of slip. In reverse it is the turn in which the rig would balance;
it folds up from there. Not at standstill.
"""

import numpy as np
from numpy.typing import NDArray

from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]

INPUTS = ("C_af", "C_ar", "C_ai", "m_t", "m_i", "u", "delta", "roll_t", "roll_i")
"""Columns of the input of `steady_turn`: N/rad, kg, m/s, rad."""


def steady_turn(
    inputs: Array,
    a: Array | float,
    b: Array | float,
    c: Array | float,
    d: Array | float,
    e: Array | float,
    rolling: Array | float = 0.0,
    heights: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """[v, r, λ] for each row of inputs.

    inputs: [n, 9] in the order of INPUTS. Returns [n, 3]. Geometry in m as in docs/notation.md, and
    rolling, resistance over load: [n] each or one for all; heights: of tractor's and implement's CG, m.
    Rolling resistance is small beside the cornering forces, but it points along the steered wheels and along
    the implement, and is larger on the outer wheels: together 2 % of the yaw rate, which passes for 15 % of
    C_af.
    Raises numpy.linalg.LinAlgError where there is no steady turn (an oversteering rig's critical speed).
    """
    c_f, c_r, c_i, m_t, m_i, u, delta, roll_t, roll_i = inputs.T
    weight_t = m_t * GRAVITY * np.sin(roll_t)
    weight_i = m_i * GRAVITY * np.sin(roll_i)
    # Axle forces are linear in the unknowns: F = F_v v + F_r r + F_λ λ + F_0.
    zero, pace, way = np.zeros_like(u), np.abs(u), np.sign(u)
    front = np.stack([-c_f / pace, -c_f * a / pace, zero, way * c_f * delta])
    rear = np.stack([-c_r / pace, c_r * b / pace, zero, zero])
    cart = np.stack([-c_i / pace, c_i * (c + d + e) / pace, -way * c_i, zero])
    inertia_t = np.stack([zero, -m_t * u, zero, weight_t])
    inertia_i = np.stack([zero, -m_i * u, zero, weight_i])
    tongue = m_i * GRAVITY * e / (d + e)
    drag_f = way * rolling * (m_t * GRAVITY * b - tongue * (c - b)) / (a + b)
    pull = way * rolling * (m_i * GRAVITY - tongue)
    front = front + np.stack([zero, zero, zero, -drag_f * delta])
    hitch = cart + inertia_i  # across the implement; its drag pulls along it, so across the tractor with λ
    towed = hitch + np.stack([zero, zero, pull, zero])
    skew_t, skew_i = (
        way * rolling * h * side for h, side in zip(heights, (inertia_t, inertia_i), strict=True)
    )
    balance = np.stack(
        [
            front + rear + inertia_t + towed,  # 3.122: lateral forces
            a * front - b * rear - c * towed + skew_t,  # 3.123: moments about the tractor's CG
            -e * cart - d * hitch + skew_i,  # 3.124: moments about the implement's CG
        ]
    )  # [3 equations, 4 coefficients, n]
    matrix = np.moveaxis(balance[:, :3, :], -1, 0)
    right = -balance[:, 3, :].T[..., None]
    return np.asarray(np.linalg.solve(matrix, right)[..., 0], np.float64)
