"""How one tyre's side force follows from slip and load, and how slip lags behind the motion.

Source: four usual curves of a side force that begins with the slope C and ends at the grip: exponential
(Karkee 2009, 5.34), hyperbolic tangent, brush with parabolic pressure, and Magic Formula (Pacejka, Tire and
Vehicle Dynamics, chapters 3 and 4), each written for s = C alpha / (A N). All have F = -C alpha at zero slip.
Lag: the carcass gives way sideways; sigma (tan alpha')' = v_y - |v_x| tan alpha' (ibidem, chapters 5, 7).
At standstill the tyre is a spring of stiffness C / sigma across its plane.
"""

import math
from typing import Final

from tilth.estimator.compiled import kernel

CURVES: Final = ("exponential", "tanh", "brush", "magic")
RELAXATIONS: Final = ("first_order", "string")
MAGIC_SHAPE: Final = 1.35  # C of the Magic Formula; its B is 1 / C, so that the slope at zero is one
MAGIC_CURVATURE: Final = -0.5  # E
SHORTEST: Final = 0.2  # of its length without slip, that a string keeps
MOST_SLIP: Final = 3.0  # tangent of the largest slip angle that a standing tyre can be pushed to
STANDING_MPS: Final = 0.3  # below this speed the carcass damps sideways motion
CARCASS_S: Final = 0.05  # damping of the carcass at standstill over its stiffness


@kernel
def shape(curve: int, s: float) -> float:
    """Side force over the grip for s = C alpha / (A N) >= 0: slope 1 at zero, about 1 for a large s."""
    if curve == 0:
        return -math.expm1(-s)
    if curve == 1:
        return math.tanh(s)
    if curve == 2:
        if s >= 3.0:
            return 1.0
        return s - s * s / 3.0 + s * s * s / 27.0
    b = s / MAGIC_SHAPE
    return math.sin(MAGIC_SHAPE * math.atan(b - MAGIC_CURVATURE * (b - math.atan(b))))


@kernel
def side_force(curve: int, alpha: float, stiffness: float, limit: float) -> float:
    """Side force, N, positive to the right. alpha: rad; stiffness: N/rad at this load; limit: A N, N."""
    if limit <= 0.0:
        return 0.0
    return -math.copysign(limit * shape(curve, stiffness * abs(alpha) / limit), alpha)


@kernel
def stiffness_at(stiffness: float, load: float, static: float, exponent: float) -> float:
    """Cornering stiffness of one tyre under `load`, N/rad. stiffness: under the load `static`, N."""
    return stiffness * (load / static) ** exponent if load > 0.0 else 0.0


@kernel
def side_share(along: float, limit: float) -> float:
    """Share of the side force that a drive or brake force leaves: friction ellipse. Both N."""
    if limit <= 0.0:
        return 0.0
    return math.sqrt(max(0.0, 1.0 - (along / limit) ** 2))


@kernel
def lag_length(
    string: bool, length: float, curve: int, alpha: float, stiffness: float, limit: float
) -> float:
    """Relaxation length at a slip angle, m: a string's falls as the secant of the curve does."""
    s = stiffness * abs(alpha) / limit if limit > 0.0 else 0.0
    if not string or s < 1e-6:
        return length
    return length * max(shape(curve, s) / s, SHORTEST)


@kernel
def lagged(slip: float, along: float, across: float, length: float, step: float) -> float:
    """tan alpha' after `step` s at constant velocities along and across the wheel, m/s."""
    speed = abs(along)
    decay = speed * step / length
    if decay < 1e-6:
        slip += across * step / length
    else:
        slip = across / speed + (slip - across / speed) * math.exp(-decay)
    return min(max(slip, -MOST_SLIP), MOST_SLIP)


@kernel
def carcass_damping(stiffness: float, length: float, along: float) -> float:
    """Of a tyre that stands or nearly stands, N s/m across it; nothing beyond STANDING_MPS."""
    return CARCASS_S * stiffness / length * max(0.0, 1.0 - abs(along) / STANDING_MPS)
