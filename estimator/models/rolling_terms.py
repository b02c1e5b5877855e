"""Names of the quantities of rolling.py, and functions that its kernels call, with their derivatives."""

import math
from dataclasses import dataclass
from typing import Final

from tilth.estimator.compiled import kernel
from tilth.estimator.tuning import tuned

STATES: Final = (
    "v", "r_t", "r_i", "alpha_f", "alpha_r", "alpha_i", "phi_t", "phi_i", "p_t", "p_i", "psi_t", "psi_i",
)  # fmt: skip
"""Velocity of the tractor's CG across the tractor (m/s), yaw rates (rad/s), slip angles (rad), lean of both
bodies (rad) and its rates (rad/s), headings (rad)."""

INPUTS: Final = ("delta", "gravity_t", "gravity_i", "uneven_t", "uneven_i", "u", "u_rate")
"""Angle of the front wheels (rad); gravity along the cross slope at either body (m/s^2); how far uneven
ground turns the wheels of either body about its long axis (rad); the tractor's speed (m/s) and its rate
(m/s^2)."""

PARAMETERS: Final = (
    "C_f", "C_r", "C_i", "sigma_f", "sigma_r", "sigma_i", "a", "b", "c", "d", "e", "m_t", "m_i", "I_t", "I_i",
    "h_t", "h_i", "h_h", "rolling", "curvature", "k_t", "k_i", "d_t", "d_i", "j_t", "j_i", "pivot_height",
    "k_f", "camber", "slip_dependence", "parallel", "two_track",
)  # fmt: skip
"""Cornering stiffnesses (N/rad), relaxation lengths (m); parameters.GEOMETRY; heights of the CGs and of the
drawbar (m); rolling resistance over load; 1 over the largest side force over load. Of the roll modes:
stiffness (N m/rad, less what gravity takes off), damping (N m s/rad) and inertia about a line through the CG
(kg m^2); height of the front axle's pivot (m), stiffness of the axle about it (N m/rad); camber thrust of a
leaning wheel over its load and its camber angle; how far relaxation lengths fall with slip: `kept_length`;
how far the front wheels turn by the same angle: 0 towards one centre (Ackermann), 1 in parallel; how far the
wheels of an axle slip each by itself in a turn: 1 as two a track apart, 0 as one amid the axle."""

CONSTANTS: Final = ("w_f", "w_r", "w_i", "exponent", "front_drive", "g")
"""As parameters.RIG_PARAMETERS; not differentiated by."""

SPEEDS: Final = 6


@dataclass(frozen=True, slots=True)
class RollingTuning:
    """Of the tyres' curve."""

    shortest: float = tuned(0.2, "1", "of its relaxation length, that a tyre keeps at any slip")


ROLLING: Final = RollingTuning()
# Kernels read globals; a record is none for them.
SHORTEST: Final = ROLLING.shortest


@kernel
def signum(value: float) -> float:
    """1 or -1, never 0."""
    return math.copysign(1.0, value)


@kernel
def size(value: float) -> float:
    """Absolute value."""
    return abs(value)


@kernel
def within(value: float, limit: float) -> float:
    """The value, kept within plus and minus the limit."""
    return min(max(value, -limit), limit)


@kernel
def is_within(value: float, limit: float) -> float:
    """1.0 if the value is within plus and minus the limit, else 0.0."""
    return 1.0 if abs(value) <= limit else 0.0


@kernel
def kept_length(slip: float, slip_dependence: float) -> float:
    """Share of its relaxation length that a tyre keeps: that of a stretched string falls as the secant of the
    tyre curve.

    slip: cornering stiffness times slip angle over the largest force, 0 or more.
    """
    lost = 0.5 * slip if slip < 1e-6 else 1.0 + math.expm1(-slip) / slip
    return max(1.0 - slip_dependence * lost, SHORTEST)


@kernel
def kept_length_by_slip(slip: float, slip_dependence: float) -> float:
    """Derivative of `kept_length` by the slip."""
    if slip < 1e-6:
        return -0.5 * slip_dependence
    lost = 1.0 + math.expm1(-slip) / slip
    if 1.0 - slip_dependence * lost < SHORTEST:
        return 0.0
    return slip_dependence * (math.exp(-slip) + math.expm1(-slip) / slip) / slip


@kernel
def kept_length_by_slip_dependence(slip: float, slip_dependence: float) -> float:
    """Derivative of `kept_length` by slip_dependence."""
    lost = 0.5 * slip if slip < 1e-6 else 1.0 + math.expm1(-slip) / slip
    return -lost if 1.0 - slip_dependence * lost >= SHORTEST else 0.0


@kernel
def both_wheels(along: float, difference: float) -> float:
    """Speed along an axle's wheels that gives the mean of their two slip angles, m/s.

    In a turn the inner wheel is slower and slips at a larger angle: the mean of across / (along -+
    difference / 2) is more than across / along. difference: of the wheels' speeds, yaw rate times track, m/s.
    """
    if abs(along) < abs(difference):  # the inner wheel hardly rolls
        return 0.75 * along
    return along - 0.25 * difference * difference / along


@kernel
def both_wheels_by_speed(along: float, difference: float) -> float:
    """Derivative of `both_wheels` by the speed."""
    if abs(along) < abs(difference):
        return 0.75
    return 1.0 + 0.25 * difference * difference / (along * along)


@kernel
def both_wheels_by_difference(along: float, difference: float) -> float:
    """Derivative of `both_wheels` by the difference."""
    if abs(along) < abs(difference):
        return 0.0
    return -0.5 * difference / along
