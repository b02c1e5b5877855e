"""Tractor and towed implement in the plane with both bodies' roll on their tyres.

The planar model of nonlinear.py and two more degrees of freedom. Each body leans about the line on the ground
below its CG: lean phi, relative to the ground's cross slope, positive right side down, and its rate p. The
line is what tyres and hitch hold; the CG at height h sways above it, so that the side forces move
m (a_y + h p'). The front axle hangs on a pin at height z_pin, the drawbar is at h_h.

Source: Kane's equations for two rigid bodies with generalised speeds u, v, r_t, r_i, p_t, p_i; small lean.
States: those of nonlinear.STATES before the actuator's, then phi_t, phi_i (rad), p_t, p_i (rad/s). Inputs:
nonlinear.INPUTS, of which the drive is not used; then how far uneven ground turns the wheels of either body
about its long axis (rad), and u' (m/s^2): the speed is held, by whatever force of the driven wheels it takes.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.models.nonlinear import Pair, Six, applied, slip_rate, wheel_forces
from tilth.estimator.models.parameters import Rig, static_loads

Array = NDArray[np.float64]

N_ROLLING: Final = 15
LEAN: Final = 11  # of the tractor; of the implement, and their rates, next to it
SPEEDS: Final = 6
SHORTEST: Final = 0.2  # of its relaxation length that a tyre keeps at any slip
UNEVEN, HELD = 9, 11  # inputs: of the tractor, with the implement's next to it; u'
N_INPUTS: Final = 12


class RollModes(NamedTuple):
    """How the bodies roll on their tyres."""

    stiffness_t: float  # N m/rad, less what gravity takes off
    stiffness_i: float
    damping_t: float  # N m s/rad
    damping_i: float
    inertia_t: float  # kg m^2, about a line through the CG
    inertia_i: float
    pin: float  # m, height of the front axle's pin
    stiffness_f: float  # N m/rad, of the front axle about its pin
    camber: float = 0.0  # thrust of a leaning wheel over its load and its camber angle
    shrink: float = 0.0  # how far relaxation lengths fall with slip: see `lag_length`


class RollWork(NamedTuple):
    """Arrays that the accelerations are found in."""

    M: Array  # (6, 7), the mass matrix with the right side
    V: Array  # (2, 2, 6), partial velocities of both CGs along and across the tractor
    planar: Array  # (13,), a state of the planar model
    shifts: Array  # (3,)


@kernel
def solve(M: Array) -> None:
    """Gauss's elimination of (n, n + 1) without a search for pivots; the last column is the answer."""
    n = M.shape[0]
    for k in range(n):
        for i in range(k + 1, n):
            factor = M[i, k] / M[k, k]
            for j in range(k, n + 1):
                M[i, j] -= factor * M[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            M[k, n] -= M[k, j] * M[j, n]
        M[k, n] /= M[k, k]


@kernel
def axle_velocities_rolling(x: Array, delta: float, rig: Rig, pin: float) -> Six:
    """As nonlinear.axle_velocities: pin and drawbar move with the lean."""
    lam = x[2] - x[3]
    u, v, r_t, r_i, p_t, p_i = x[4], x[5], x[6], x[7], x[LEAN + 2], x[LEAN + 3]
    front, hitch = v + rig.a * r_t + pin * p_t, v - rig.c * r_t + rig.h_h * p_t
    return (
        u * math.cos(delta) + front * math.sin(delta),
        front * math.cos(delta) - u * math.sin(delta),
        u,
        v - rig.b * r_t,
        u * math.cos(lam) - hitch * math.sin(lam),
        u * math.sin(lam) + hitch * math.cos(lam) - (rig.d + rig.e) * r_i - rig.h_h * p_i,
    )


@kernel
def accelerations_rolling(
    x: Array, w: Array, on: Six, front_y: float, push: Pair, rig: Rig, roll: RollModes, work: RollWork
) -> None:
    """Fill the last column of work.M: the drive's force (N), v', r_t', r_i', p_t', p_i'.

    The speed is held: u' is known and the force of the driven wheels is what that takes, so that the
    implement hangs on the drawbar with all that it drags. on: as nonlinear.applied, without a drive; front_y:
    the front axle's force across the tractor, N; push: along and across the tractor, of the front wheels'
    share of a drive of 1 N, N.
    """
    force_x, force_y, moment_t, cart_x, cart_y, moment_i = on
    u, v, r_t, r_i = x[4], x[5], x[6], x[7]
    s, c = math.sin(x[2] - x[3]), math.cos(x[2] - x[3])
    M, V, z = work.M, work.V, rig.h_h
    V[:] = 0.0
    V[0, 0, 0] = V[0, 1, 1] = V[1, 0, 0] = V[1, 1, 1] = 1.0
    V[0, 1, 4] = rig.h_t
    V[1, 1, 2] = -rig.c
    V[1, 0, 3], V[1, 1, 3] = -rig.d * s, -rig.d * c
    V[1, 1, 4] = z
    V[1, 0, 5], V[1, 1, 5] = (rig.h_i - z) * s, (rig.h_i - z) * c
    # Both CGs are accelerated by the six derivatives and, without them, by these (tractor's axes).
    still_x = -v * r_t + rig.c * r_t**2 + rig.d * r_i**2 * c
    still_y = u * r_t - rig.d * r_i**2 * s
    cart_tx, cart_ty = cart_x * c + cart_y * s, cart_y * c - cart_x * s
    for j in range(SPEEDS):
        for k in range(j, SPEEDS):
            M[j, k] = rig.m_t * V[0, 1, j] * V[0, 1, k] + rig.m_i * (
                V[1, 0, j] * V[1, 0, k] + V[1, 1, j] * V[1, 1, k]
            )
            M[k, j] = M[j, k]
        M[j, SPEEDS] = -rig.m_t * u * r_t * V[0, 1, j] - rig.m_i * (
            still_x * V[1, 0, j] + still_y * V[1, 1, j]
        )
    M[0, 0] += rig.m_t
    M[0, SPEEDS] += rig.m_t * v * r_t
    M[2, 2] += rig.I_t
    M[3, 3] += rig.I_i
    M[4, 4] += roll.inertia_t
    M[5, 5] += roll.inertia_i
    M[0, SPEEDS] += force_x + cart_tx
    M[1, SPEEDS] += force_y + cart_ty
    M[2, SPEEDS] += moment_t - rig.c * cart_ty
    M[3, SPEEDS] += moment_i - rig.d * cart_y
    # The springs hold the lean against the ground under the wheels; gravity takes a part of that off.
    spring_t = roll.stiffness_t + rig.g * rig.m_t * rig.h_t
    spring_i = roll.stiffness_i + rig.g * rig.m_i * rig.h_i
    M[4, SPEEDS] += z * cart_ty + roll.pin * front_y + rig.h_t * rig.m_t * w[1]
    M[4, SPEEDS] += spring_t * w[UNEVEN] - roll.stiffness_t * x[LEAN] - roll.damping_t * x[LEAN + 2]
    M[5, SPEEDS] += -z * cart_y + rig.h_i * rig.m_i * w[2]
    M[5, SPEEDS] += spring_i * w[UNEVEN + 1] - roll.stiffness_i * x[LEAN + 1] - roll.damping_i * x[LEAN + 3]
    for j in range(SPEEDS):
        M[j, SPEEDS] -= M[j, 0] * w[HELD]
        M[j, 0] = 0.0
    M[0, 0], M[1, 0], M[2, 0] = -1.0 - push[0], -push[1], -rig.a * push[1]
    M[4, 0] = -roll.pin * push[1]
    solve(M)


@kernel
def lag_length(length: float, alpha: float, stiffness: float, limit: float, shrink: float) -> float:
    """Relaxation length at a slip angle, m: that of a stretched string falls as the secant of the tyre curve.

    length: m, without slip. stiffness: N/rad, and limit: largest force, N, of the axle.
    """
    s = stiffness * abs(alpha) / limit
    if s < 1e-6:
        return length
    return length * max(1.0 - shrink * (1.0 + math.expm1(-s) / s), SHORTEST)


@kernel
def both_wheels(along: float, difference: float) -> float:
    """Speed along an axle's wheels that gives the mean of their two slip angles, m/s.

    In a turn the inner wheel is slower and slips at a larger angle: the mean of across / (along -+ difference / 2)
    is more than across / along. difference: of the wheels' speeds, yaw rate times track, m/s.
    """
    if abs(along) < abs(difference):
        return along
    return along - 0.25 * difference * difference / along


@kernel
def across_front(forces: Array, delta: float) -> float:
    """The front axle's force across the tractor, N. forces: as nonlinear.wheel_forces."""
    along, across = forces[0, 1] + forces[1, 1], forces[0, 2] + forces[1, 2]
    return float(along * math.sin(delta) + across * math.cos(delta))


@kernel
def rates_rolling(
    x: Array, w: Array, theta: Array, rig: Rig, roll: RollModes, forces: Array, work: RollWork, out: Array
) -> None:
    """Fill out (15,) with x', and forces, as nonlinear.rates."""
    delta = w[0]
    planar, shifts = work.planar, work.shifts
    planar[:LEAN] = x[:LEAN]
    shifts[:] = 0.0
    wheel_forces(planar, w, delta, theta, rig, shifts, forces)
    # Loads go from side to side as the lean presses the tyres: what springs and dampers hold.
    moment_t = -(roll.stiffness_t + rig.g * rig.m_t * rig.h_t) * x[LEAN] - roll.damping_t * x[LEAN + 2]
    moment_i = -(roll.stiffness_i + rig.g * rig.m_i * rig.h_i) * x[LEAN + 1] - roll.damping_i * x[LEAN + 3]
    front_y = across_front(forces, delta)
    shifts[0] = roll.pin * front_y / rig.w_f
    shifts[1] = moment_t / rig.w_r
    shifts[2] = moment_i / rig.w_i
    wheel_forces(planar, w, delta, theta, rig, shifts, forces)
    for k in range(2, 6):  # the front axle does not lean with its body
        forces[k, 2] += roll.camber * forces[k, 0] * (x[LEAN + k // 4] - w[UNEVEN + k // 4])
    front_y = across_front(forces, delta)
    share = rig.front_drive
    push = (share * (math.cos(delta) - 1.0), share * math.sin(delta))
    accelerations_rolling(x, w, applied(planar, w, delta, forces, rig), front_y, push, rig, roll, work)
    sine, cosine = math.sin(x[2]), math.cos(x[2])
    out[0] = x[4] * cosine - x[5] * sine
    out[1] = x[4] * sine + x[5] * cosine
    out[2], out[3], out[4] = x[6], x[7], w[HELD]
    for i in range(1, 4):
        out[4 + i] = work.M[i, SPEEDS]
    along_f, across_f, along_r, across_r, along_i, across_i = axle_velocities_rolling(x, delta, rig, roll.pin)
    # The front axle turns about its pin as its side force pushes: one more spring in a row with the tyres.
    static_f, static_r, static_i = static_loads(rig)
    length_f = lag_length(theta[3], x[8], theta[0], rig.grip_f * static_f, roll.shrink)
    length_r = lag_length(theta[4], x[9], theta[1], rig.grip_r * static_r, roll.shrink)
    length_i = lag_length(theta[5], x[10], theta[2], rig.grip_i * static_i, roll.shrink)
    length_f += theta[0] * roll.pin * roll.pin / roll.stiffness_f
    out[8] = slip_rate(x[8], both_wheels(along_f, x[6] * rig.w_f), across_f, length_f)
    out[9] = slip_rate(x[9], both_wheels(along_r, x[6] * rig.w_r), across_r, length_r)
    out[10] = slip_rate(x[10], both_wheels(along_i, x[7] * rig.w_i), across_i, length_i)
    out[LEAN], out[LEAN + 1] = x[LEAN + 2], x[LEAN + 3]
    out[LEAN + 2], out[LEAN + 3] = work.M[4, SPEEDS], work.M[5, SPEEDS]


@kernel
def roll_work() -> RollWork:
    """Empty arrays."""
    return RollWork(np.zeros((SPEEDS, SPEEDS + 1)), np.zeros((2, 2, SPEEDS)), np.zeros(13), np.zeros(3))
