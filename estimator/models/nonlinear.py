"""Tractor and towed single-axle implement in the plane, without small angles.

Source: two rigid bodies joined by a hitch that is an exact constraint, Newton and Euler for both with the
hitch's force eliminated (the equations behind Karkee 2009, 3.28-3.83, before they are made linear); slip
angles of 3.84-3.92 with full trigonometry; relaxation 3.107; tyre curve 5.34 made odd and written for each
wheel; positions 5.35, 5.36. Small angles without rolling resistance give the relaxation model; on firm soil
rolling resistance, whose default is not zero, lowers the yaw rate per wheel angle by 2 to 3 %.
States: STATES, SI and radians; with an actuator the last two are its states, without one they repeat the
input. Inputs: INPUTS. Form: x' = f(x, w), integrated by Runge-Kutta steps of at most `max_step_s`.

Slip: sigma (tan alpha)' = v_y - |v_x| tan alpha, with the axle's velocity along and across its wheels. At
speed alpha becomes the angle between travel and facing; at standstill the tyre is a spring without damping;
in reverse the angle counts from the wheel's backward direction. The force only spends or stores work.
Tyre: each wheel F = -sign(alpha) A N (1 - exp(-C_w |alpha| / (A N))) with the wheel's load N and stiffness
C_w = (C/2) (N/N_0)^n, N_0 its load on level ground at rest; so both wheels together have the axle's stiffness
C there, and n = 1 is 5.34 with A B N = C.
Loads: static on each axle, times the cosine of the roll; from side to side by the roll moment of
acceleration, slope, disturbance and hitch force; a wheel that has lost all its load stays at nothing. The
accelerations for this are those under the static loads.

Valid to 35° of steering and 90° of articulation, forward, standing and in reverse (where it folds up, as in
truth; it knows no stop). It leaves out load transfer along the rig, roll and pitch motion, the loss of side
force by drive slip, and differences of slip between the two wheels of an axle.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.models.actuator import Actuator
from tilth.estimator.models.parameters import Rig, static_loads
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]
Pair = tuple[float, float]
Six = tuple[float, float, float, float, float, float]

STATES: Final = (
    "x_t", "y_t", "psi_t", "psi_i", "u", "v", "r_t", "r_i", "alpha_f", "alpha_r", "alpha_i",
    "delta", "delta_rate",
)  # fmt: skip
"""Position of the tractor's CG in W (m), headings (rad), its velocity along and across the tractor (m/s), yaw
rates (rad/s), slip angles (rad), wheel angle (rad) and its rate (rad/s)."""

INPUTS: Final = (
    "delta", "gravity_t", "gravity_i", "speed", "drive", "force_t", "moment_t", "force_i", "moment_i",
)  # fmt: skip
"""Front wheel angle (rad) or, with an actuator, its command; g sin(roll) of tractor and implement (m/s^2);
the speed to hold (m/s), where rig.drive_gain is not zero; further drive force (N); lateral forces at both CGs
(N) and yaw moments (N m) from uneven ground."""


@dataclass(frozen=True, slots=True)
class NonlinearTuning:
    """Numerics of the nonlinear models."""

    max_step_s: float = tuned(0.01, "s", "longest step of the integration")
    rolling_speed: float = tuned(0.1, "m/s", "over this range of speed rolling resistance changes its sign")
    step: float = tuned(1e-5, "1", "of the differences in `linearise`, in the state's own unit")


NONLINEAR: Final = NonlinearTuning()
# Kernels read globals; a record is none for them.
ROLLING_SPEED: Final = NONLINEAR.rolling_speed

DYNAMIC: Final = 11  # states that are not the actuator's


@kernel
def tyre_force(alpha: float, stiffness: float, limit: float) -> float:
    """Lateral force of one wheel, N: 5.34 made odd. limit: A N, N; infinite for a linear tyre."""
    if math.isinf(limit):
        return -stiffness * alpha
    if limit <= 0.0:
        return 0.0
    return math.copysign(limit, alpha) * math.expm1(-stiffness * abs(alpha) / limit)


@kernel
def wheel(alpha: float, load: float, still: float, stiffness: float, grip: float, exponent: float) -> float:
    """Lateral force of one of an axle's wheels, N. load: N; still: its load at rest on level ground, N."""
    if load <= 0.0:
        return 0.0
    return tyre_force(alpha, 0.5 * stiffness * (load / still) ** exponent, grip * load)


@kernel
def side_loads(static: float, level: float, shift: float) -> tuple[float, float]:
    """Loads of an axle's left and right wheel, N. level: cosine of the roll. shift: N moved to the left."""
    half = 0.5 * static * level
    limited = min(max(shift, -half), half)
    return half + limited, half - limited


@kernel
def axle_velocities(x: Array, delta: float, rig: Rig) -> Six:
    """Velocity along and across the wheels of front, rear and implement's axle, m/s."""
    lam = x[2] - x[3]
    u, v, r_t, r_i = x[4], x[5], x[6], x[7]
    front, hitch = v + rig.a * r_t, v - rig.c * r_t
    return (
        u * math.cos(delta) + front * math.sin(delta),
        front * math.cos(delta) - u * math.sin(delta),
        u,
        v - rig.b * r_t,
        u * math.cos(lam) - hitch * math.sin(lam),  # 3.54
        u * math.sin(lam) + hitch * math.cos(lam) - (rig.d + rig.e) * r_i,  # 3.55, moved to the axle
    )


@kernel
def drive_force(x: Array, w: Array, rig: Rig) -> float:
    """Force of the driven wheels, N: the input `drive` plus that of the speed control, within the limit."""
    force: float = w[4]
    if rig.drive_gain > 0.0:
        front, rear, implement = static_loads(rig)
        resistance = rig.roll_f * front + rig.roll_r * rear + rig.roll_i * implement
        force += rig.drive_gain * (w[3] - x[4]) + resistance * math.tanh(x[4] / ROLLING_SPEED)
    return min(max(force, -rig.drive_limit), rig.drive_limit)


@kernel
def wheel_forces(x: Array, w: Array, delta: float, theta: Array, rig: Rig, shifts: Array, out: Array) -> None:
    """Fill out, shape (6, 3): load, force along and force across each wheel, N.

    Wheels: left and right of front, rear, implement. shifts: shape (3,), load moved to each axle's left, N.
    """
    static_f, static_r, static_i = static_loads(rig)
    level_t = math.sqrt(1.0 - (w[1] / rig.g) ** 2)
    level_i = math.sqrt(1.0 - (w[2] / rig.g) ** 2)
    along_f, _, along_r, _, along_i, _ = axle_velocities(x, delta, rig)
    drive = drive_force(x, w, rig)
    axles = (
        (static_f, level_t, rig.grip_f, rig.roll_f, along_f, rig.front_drive * drive),
        (static_r, level_t, rig.grip_r, rig.roll_r, along_r, (1.0 - rig.front_drive) * drive),
        (static_i, level_i, rig.grip_i, rig.roll_i, along_i, 0.0),
    )
    for k in range(3):
        static, level, grip, roll, along, driven = axles[k]
        loads = side_loads(static, level, shifts[k])
        for side in range(2):
            load = loads[side]
            out[2 * k + side, 0] = load
            out[2 * k + side, 1] = 0.5 * driven - roll * load * math.tanh(along / ROLLING_SPEED)
            out[2 * k + side, 2] = wheel(x[8 + k], load, 0.5 * static, theta[k], grip, rig.load_exponent)


@kernel
def applied(x: Array, w: Array, delta: float, forces: Array, rig: Rig) -> Six:
    """Forces and yaw moments on each body about its CG without the hitch's: tractor along, across (its own
    axes, N), moment (N m); the same of the implement. forces: as `wheel_forces`."""
    sine, cosine = math.sin(delta), math.cos(delta)
    along_f, across_f = forces[0, 1] + forces[1, 1], forces[0, 2] + forces[1, 2]
    front_x = along_f * cosine - across_f * sine  # 3.22
    front_y = along_f * sine + across_f * cosine  # 3.23
    rear_x, rear_y = forces[2, 1] + forces[3, 1], forces[2, 2] + forces[3, 2]
    cart_x, cart_y = forces[4, 1] + forces[5, 1], forces[4, 2] + forces[5, 2]
    # A left wheel that is pushed back turns the body to the left: its arm is half the track.
    skew_f = (forces[0, 1] - forces[1, 1]) * cosine - (forces[0, 2] - forces[1, 2]) * sine
    skew = 0.5 * (rig.w_f * skew_f + rig.w_r * (forces[2, 1] - forces[3, 1]))
    return (
        front_x + rear_x,
        front_y + rear_y + rig.m_t * w[1] + w[5],
        rig.a * front_y - rig.b * rear_y + skew + w[6],  # 3.44
        cart_x,
        cart_y + rig.m_i * w[2] + w[7],
        -rig.e * cart_y + 0.5 * rig.w_i * (forces[4, 1] - forces[5, 1]) + w[8],  # 3.71
    )


@kernel
def accelerations(x: Array, on: Six, rig: Rig) -> Six:
    """(u', v', r_t', r_i') and the hitch's force on the tractor across the tractor and across the implement:
    m/s^2, rad/s^2, N. on: as `applied` gives it."""
    force_x, force_y, moment_t, cart_x, cart_y, moment_i = on
    u, v, r_t, r_i = x[4], x[5], x[6], x[7]
    sine, cosine = math.sin(x[2] - x[3]), math.cos(x[2] - x[3])
    # The implement's CG is accelerated by the four derivatives and, without them, by this (tractor's axes).
    still_x = -v * r_t + rig.c * r_t**2 + rig.d * r_i**2 * cosine
    still_y = u * r_t - rig.d * r_i**2 * sine
    pull_x = cart_x * cosine + cart_y * sine - rig.m_i * still_x  # 3.24, 3.25
    pull_y = cart_y * cosine - cart_x * sine - rig.m_i * still_y
    right_u = force_x + rig.m_t * v * r_t + pull_x
    right_v = force_y - rig.m_t * u * r_t + pull_y
    right_t = moment_t - rig.c * pull_y
    right_i = moment_i - rig.d * (pull_x * sine + pull_y * cosine)
    # The mass matrix of the four is symmetric; u' and v' eliminated, two by two are left.
    mass, arm_t, arm_i = rig.m_t + rig.m_i, rig.m_i * rig.c, rig.m_i * rig.d
    share_t, share_x, share_y = arm_t / mass, arm_i * sine / mass, arm_i * cosine / mass
    tt = rig.I_t + arm_t * (rig.c - share_t)
    ti = arm_i * cosine * (rig.c - share_t)
    ii = rig.I_i + arm_i * (rig.d - share_x * sine - share_y * cosine)
    right_t += share_t * right_v
    right_i += share_x * right_u + share_y * right_v
    dr_t = (ii * right_t - ti * right_i) / (tt * ii - ti * ti)
    dr_i = (tt * right_i - ti * right_t) / (tt * ii - ti * ti)
    du = right_u / mass + share_x * dr_i
    dv = right_v / mass + share_t * dr_t + share_y * dr_i
    hitch_x = pull_x - rig.m_i * (du - rig.d * dr_i * sine)
    hitch_y = pull_y - rig.m_i * (dv - rig.c * dr_t - rig.d * dr_i * cosine)
    return du, dv, dr_t, dr_i, hitch_y, hitch_x * sine + hitch_y * cosine


@kernel
def load_shifts(x: Array, w: Array, on: Six, got: Six, rig: Rig, out: Array) -> None:
    """Fill out, shape (3,): load moved to the left wheel of each axle, N, by the moments that roll the bodies
    to the left about the ground: of inertia at the CG, less what pushes there, and of the hitch's force."""
    dv, hitch_t, hitch_i = got[1], got[4], got[5]
    roll_t = rig.h_t * (rig.m_t * (dv + x[4] * x[6] - w[1]) - w[5]) - rig.h_h * hitch_t
    across_i = on[4] - hitch_i  # mass times acceleration of the implement
    roll_i = rig.h_i * (across_i - rig.m_i * w[2] - w[7]) + rig.h_h * hitch_i
    out[0] = rig.roll_share_f * roll_t / rig.w_f
    out[1] = (1.0 - rig.roll_share_f) * roll_t / rig.w_r
    out[2] = roll_i / rig.w_i


@kernel
def slip_rate(alpha: float, along: float, across: float, length: float) -> float:
    """alpha', rad/s: 3.107 for tan alpha, in terms that stay finite at any speed and angle."""
    cosine = math.cos(alpha)
    return (across * cosine - abs(along) * math.sin(alpha)) * cosine / length


@kernel
def rates(x: Array, w: Array, theta: Array, rig: Rig, act: Pair, forces: Array, out: Array) -> None:
    """Fill out, shape (13,), with x', and forces, shape (6, 3), as `wheel_forces`.

    theta: (6,), as schemas.flow.PARAMETERS, of the soil at this place, instead of the rig's. act: K/I and d/I
    of the actuator, or zeros.
    """
    delta = x[11] if act[0] > 0.0 else w[0]
    shifts = np.zeros(3)
    wheel_forces(x, w, delta, theta, rig, shifts, forces)
    on = applied(x, w, delta, forces, rig)
    load_shifts(x, w, on, accelerations(x, on, rig), rig, shifts)
    wheel_forces(x, w, delta, theta, rig, shifts, forces)
    on = applied(x, w, delta, forces, rig)
    sine, cosine = math.sin(x[2]), math.cos(x[2])
    out[0] = x[4] * cosine - x[5] * sine  # 5.35
    out[1] = x[4] * sine + x[5] * cosine  # 5.36
    out[2], out[3] = x[6], x[7]
    out[4], out[5], out[6], out[7], _, _ = accelerations(x, on, rig)
    along_f, across_f, along_r, across_r, along_i, across_i = axle_velocities(x, delta, rig)
    out[8] = slip_rate(x[8], along_f, across_f, theta[3])
    out[9] = slip_rate(x[9], along_r, across_r, theta[4])
    out[10] = slip_rate(x[10], along_i, across_i, theta[5])
    out[11] = x[12] if act[0] > 0.0 else 0.0
    out[12] = act[0] * w[0] - act[1] * x[12]  # 5.33


@kernel
def integrate(
    states: Array, inputs: Array, soil: Array, rig: Rig, act: Pair, step: float, substeps: int, linear: bool
) -> None:
    """Fill states[1:], shape (n+1, 13), from states[0] by Runge-Kutta steps of the fourth order.

    `substeps` of them, of `step` seconds each, lie between two rows. inputs: (n, 9), held, or (n+1, 9),
    linear between rows. soil: (1 or n, 6).
    """
    rate, sum_, forces = np.zeros(13), np.zeros(13), np.zeros((6, 3))
    w = np.zeros(inputs.shape[1])
    for k in range(states.shape[0] - 1):
        theta = soil[min(k, soil.shape[0] - 1)]
        last = inputs[k + 1] if linear else inputs[k]
        x = states[k + 1]
        x[:] = states[k]
        for s in range(substeps):
            start = x.copy()
            sum_[:] = 0.0
            for stage in range(4):
                within = (0.0, 0.5, 0.5, 1.0)[stage]
                w[:] = inputs[k] + (last - inputs[k]) * ((s + within) / substeps)
                if stage > 0:
                    x[:] = start + within * step * rate
                rates(x, w, theta, rig, act, forces, rate)
                sum_ += (1.0, 2.0, 2.0, 1.0)[stage] * rate
            x[:] = start + (step / 6.0) * sum_
        if act[0] <= 0.0:
            x[11] = last[0]


def inputs_of(n: int, **columns: float | Array) -> Array:
    """Inputs, shape (n, 9): the named columns, each a number or shape (n,), the others zero.

    Raises ValueError for a name that is not in INPUTS or "command".
    """
    inputs = np.zeros((n, len(INPUTS)))
    for name, value in columns.items():
        if name not in (*INPUTS, "command"):
            raise ValueError(f"{name} is no input of the nonlinear model; there are {', '.join(INPUTS)}")
        inputs[:, INPUTS.index("delta" if name == "command" else name)] = value
    return inputs


def running(speed: float, **states: float) -> Array:
    """State of straight running at that speed with the named states changed, shape (13,)."""
    x = np.zeros(len(STATES))
    for name, value in {"u": speed, **states}.items():
        x[STATES.index(name)] = value
    return x


def simulate(
    rig: Rig,
    inputs: Array,
    x0: Array,
    dt: float,
    *,
    actuator: Actuator | None = None,
    soil: Array | None = None,
    linear: bool = False,
) -> Array:
    """States at each sample, shape (n+1, 13), from x0, shape (13,).

    inputs: shape (n, 9), each row held for dt; with linear=True shape (n+1, 9), linear between samples. soil:
    the six soil-tyre parameters, shape (6,) or (n, 6), instead of the rig's. With an actuator the first input
    is its command.
    """
    n = len(inputs) - 1 if linear else len(inputs)
    states = np.zeros((n + 1, len(STATES)))
    states[0] = x0
    theta = np.atleast_2d(rig.theta if soil is None else soil)
    substeps = max(1, math.ceil(dt / NONLINEAR.max_step_s - 1e-9))
    act = (0.0, 0.0)
    if actuator is not None:
        act = (actuator.gain / actuator.inertia, actuator.damping / actuator.inertia)
    floats = Rig(*map(float, rig))
    contiguous = (np.ascontiguousarray(inputs, np.float64), np.ascontiguousarray(theta, np.float64))
    integrate(states, *contiguous, floats, act, dt / substeps, substeps, linear)
    return states


_interpreted = rates.interpreted()


def derivative(rig: Rig, x: Array, w: Array) -> Array:
    """x', shape (13,), of state x, shape (13,), under inputs w, shape (9,), without an actuator."""
    return _evaluate(rig, x, w)[0]


def wheels(rig: Rig, x: Array, w: Array) -> Array:
    """Load, force along and force across each wheel, N, shape (6, 3).

    Left and right of front, rear, implement. Arguments as of `derivative`.
    """
    return _evaluate(rig, x, w)[1]


def _evaluate(rig: Rig, x: Array, w: Array) -> tuple[Array, Array]:
    out, forces = np.zeros(len(STATES)), np.zeros((6, 3))
    _interpreted(x, w, rig.theta, rig, (0.0, 0.0), forces, out)  # nothing is gained by compiling for one call
    return out, forces


def linearise(rig: Rig, x: Array, w: Array) -> tuple[Array, Array]:
    """(A, B), shapes (11, 11) and (11, 9), about state x and inputs w: columns as STATES and INPUTS.

    Central differences at h and 2 h, put together so that the kink in the tyre curve's second derivative at
    zero slip leaves no error of first order.
    """

    def slope(column: int, at: Array, of_state: bool, h: float) -> Array:
        nudge = np.zeros(len(at))
        nudge[column] = h * max(1.0, abs(at[column]))
        after = derivative(rig, at + nudge, w) if of_state else derivative(rig, x, at + nudge)
        before = derivative(rig, at - nudge, w) if of_state else derivative(rig, x, at - nudge)
        return np.asarray((after - before)[:DYNAMIC] / (2 * nudge[column]))

    def column(k: int, at: Array, of_state: bool) -> Array:
        return 2 * slope(k, at, of_state, NONLINEAR.step) - slope(k, at, of_state, 2 * NONLINEAR.step)

    a = np.column_stack([column(k, x, True) for k in range(DYNAMIC)])
    return a, np.column_stack([column(k, w, False) for k in range(len(INPUTS))])


def implement(rig: Rig, states: Array) -> Array:
    """x, y (m), velocity along and across the implement (m/s) of its CG, shape (n, 4). states: (n, 13)."""
    psi_t, psi_i, u, v, r_t, r_i = states[:, 2:8].T
    sine, cosine = np.sin(psi_t - psi_i), np.cos(psi_t - psi_i)
    hitch = v - rig.c * r_t
    return np.column_stack(
        [
            states[:, 0] - rig.c * np.cos(psi_t) - rig.d * np.cos(psi_i),
            states[:, 1] - rig.c * np.sin(psi_t) - rig.d * np.sin(psi_i),
            u * cosine - hitch * sine,  # 3.54
            u * sine + hitch * cosine - rig.d * r_i,  # 3.55
        ]
    )
