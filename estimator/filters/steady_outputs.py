"""Predicted measurements in a steady turn, as a function of all that is not known exactly, and their
Jacobians.

The closed form of models/steady_turn.py assumes small angles and linear tyres. Here it is where Newton's
method starts. The equations that it solves are those of models/rolling.py with nothing changing any more but
the articulation, exact at any angle of wheels and hitch: 0.6 % of the yaw rate at 8° of the wheels has the
effect of 5 % of C_af, and at 25° the small angles are off by a tenth. Tyres follow F = A N (1 − exp(−C α/(A
N))) (Karkee 2009, 5.34). What moves load from one wheel of an axle to the other has no effect but on rolling
resistance.

A tractor is in its turn within a second or two; the implement behind it needs several times as long. So how
fast the rig folds is an input. It fades as that of a towed axle without slip, which is close enough for what
is left of it. Measured roll is cross slope and lean; the lean is solved for, and the rest is slope.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.rig_setup import nominal_roll
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.models.steady_turn import steady_turn
from tilth.estimator.record.steady_driving import SteadySample
from tilth.schemas.machine import Machine
from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]

CONSTANTS: Final = (
    "C_af", "C_ar", "C_ai", "wheel_zero", "wheel_gain", "pair_t", "pair_i", "lever_t", "cg_t", "cg_i",
    "rolling", "roll_k_t", "roll_k_i", "camber", "curvature", "parallel", "a", "b", "c", "d", "e", "m_t",
    "m_i",
)  # fmt: skip
"""The constants that a steady turn depends on, as in unknowns.NAMES. A lever of the implement's antennas has
no effect on OUTPUTS."""
INPUTS: Final = ("u", "wheel_angle", "roll_t", "roll_i", "folding")
"""m/s; rad, as the sensor reads it; measured rolls, rad; rate of the articulation, rad/s."""
OUTPUTS: Final = ("yaw_rate", "articulation", "lateral_velocity")
STEP: Final = 1e-4  # of the central differences
SETS: Final = 11  # of points that the Jacobian over a turn takes: itself, and five to either side
MOST_STEPS: Final = 20  # of Newton's method; it takes four or five
LONGEST_STEP: Final = 0.5  # m/s, rad/s or rad
EXACT: Final = 1e-9  # m/s, rad/s, rad: a step so small is the last


class _Rig(NamedTuple):
    """Lengths (m), masses (kg), loads (N) and inertias (kg m^2) at each of n points, (n,)."""

    a: Array
    b: Array
    c: Array
    d: Array
    e: Array
    m_t: Array
    m_i: Array
    loads: Array  # [n, 3]: front, rear, implement
    stiffness: Array  # [n, 3], N/rad
    curvature: Array
    rolling: Array
    camber: Array
    parallel: Array
    track: Array  # of the front wheels
    height_t: Array  # of the CGs above the ground
    height_i: Array
    I_i: Array
    k_t: Array  # of the roll modes, N m/rad, less what gravity takes off
    k_i: Array
    pin: Array  # height of the front axle's
    drawbar: Array  # its height


class _Driving(NamedTuple):
    """What is driven at each of n points, (n,): m/s, true wheel angle, measured rolls, rad, and rad/s."""

    u: Array
    delta: Array
    roll_t: Array
    roll_i: Array
    folding: Array


def _rig(points: Array, machine: Machine) -> _Rig:
    """points: [n, 23], CONSTANTS."""
    at = dict(zip(CONSTANTS, points.T, strict=True))
    t, i = machine.tractor, machine.implement
    a = t.a.value * np.exp(at["a"]) - at["cg_t"]
    b = t.b.value * np.exp(at["b"]) + at["cg_t"]
    c = t.c.value * np.exp(at["c"]) + at["cg_t"]
    d = i.d.value * np.exp(at["d"]) - at["cg_i"]
    e = i.e.value + at["e"] + at["cg_i"]
    m_t, m_i = t.mass.value * np.exp(at["m_t"]), i.mass.value * np.exp(at["m_i"])
    tongue = m_i * e / (d + e)
    front = (b * m_t - (c - b) * tongue) / (a + b)
    loads = GRAVITY * np.column_stack([front, m_t + tongue - front, m_i - tongue])
    modes, told = nominal_roll(machine), rig_of(machine)
    k_t, k_i = modes.k_t * np.exp(at["roll_k_t"]), modes.k_i * np.exp(at["roll_k_i"])
    known = (told.w_f, told.h_t, told.h_i, told.I_i, modes.pin, told.h_h)
    track, h_t, h_i, inertia, pin, drawbar = (np.full(len(points), value) for value in known)
    return _Rig(
        a, b, c, d, e, m_t, m_i, loads, np.exp(points[:, :3]), np.maximum(at["curvature"], 0.0),
        at["rolling"], at["camber"], at["parallel"], track, h_t, h_i, inertia, k_t, k_i, pin, drawbar,
    )  # fmt: skip


def _driving(points: Array, inputs: Array) -> _Driving:
    """points: [n, 23], CONSTANTS; inputs: [n, 5], INPUTS."""
    u, reading, roll_t, roll_i, folding = inputs.T
    zero, gain = points[:, CONSTANTS.index("wheel_zero")], points[:, CONSTANTS.index("wheel_gain")]
    return _Driving(u, (reading - zero) * np.exp(-gain), roll_t, roll_i, folding)


def _slips(turn: Array, rig: _Rig, driving: _Driving) -> Array:
    """Slip angles of the three axles, rad, [n, 3]. turn: [n, 5], as of `_solve`."""
    (v, r, articulation), u = turn.T[:3], driving.u
    hitch = v - rig.c * r
    sine, cosine = np.sin(articulation), np.cos(articulation)
    # 3.55, moved to the axle
    cart = u * sine + hitch * cosine - (rig.d + rig.e) * (r - driving.folding)
    return np.column_stack(
        [
            np.arctan2(v + rig.a * r, u) - driving.delta,
            np.arctan2(v - rig.b * r, u),
            np.arctan2(cart, u * cosine - hitch * sine),  # 3.54
        ]
    )


def _front_wheels_apart(turn: Array, rig: _Rig, driving: _Driving) -> tuple[Array, Array]:
    """As deploy.motion_equations.front_wheels_apart, rad, [n] each."""
    (v, r), u, delta = turn.T[:2], driving.u, driving.delta
    side, faster = v + rig.a * r, rig.track * r / 2
    squared, kept, sine = u**2 + side**2, (1 - rig.parallel) * rig.track / 2 / (rig.a + rig.b), np.sin(delta)
    mean = faster**2 * u * side / squared**2 - kept**2 * sine**3 * np.cos(delta)
    return faster * side / squared - kept * sine**2, mean


def _tyres(slips: Array, stiffness: Array, loads: Array, curvature: Array) -> Array:
    """Side forces, N, of the shape of the slips, rad."""
    saturation = np.maximum(curvature * stiffness / loads * np.abs(slips), 1e-9)
    forces: Array = stiffness * slips * np.expm1(-saturation) / saturation
    return forces


def _side_forces(turn: Array, rig: _Rig, driving: _Driving) -> tuple[Array, Array]:
    """(Of the axles, across their wheels, [n, 3]; the left front wheel's less the right one's, [n]), N. The
    front axle does not lean."""
    slips = _slips(turn, rig, driving)
    forces = _tyres(slips, rig.stiffness, rig.loads, rig.curvature[:, None])
    forces[:, 1:] += rig.camber[:, None] * rig.loads[:, 1:] * turn[:, 3:]
    apart, mean = _front_wheels_apart(turn, rig, driving)
    half, load = rig.stiffness[:, 0] / 2, rig.loads[:, 0] / 2
    left, right = (
        _tyres(slips[:, 0] + mean + sign * apart, half, load, rig.curvature) for sign in (-1.0, 1.0)
    )
    forces[:, 0] = left + right
    return forces, left - right


def _imbalance(turn: Array, rig: _Rig, driving: _Driving) -> Array:
    """What is left of lateral force on the tractor (N) and of the moments about both CGs (N m), over the
    tractor's weight, and of the leans (rad), [n, 5]. turn: [n, 5], as of `_solve`."""
    (v, r, articulation, lean_t, lean_i), (u, delta, roll_t, roll_i, folding) = turn.T, driving
    slope_t, slope_i = GRAVITY * np.sin(roll_t - lean_t), GRAVITY * np.sin(roll_i - lean_i)
    (forces, apart), drags = _side_forces(turn, rig, driving), -rig.rolling[:, None] * rig.loads
    front, rear = forces[:, 0] * np.cos(delta) + drags[:, 0] * np.sin(delta), forces[:, 1]  # 3.23
    sine, cosine = np.sin(articulation), np.cos(articulation)
    r_i = r - folding
    r_i_rate = folding * (u * cosine - (v - rig.c * r) * sine) / (rig.d + rig.e)
    # The implement's CG is accelerated by this, along and across the tractor; the hitch pulls with the rest.
    along = -v * r + rig.c * r**2 + rig.d * (r_i**2 * cosine - r_i_rate * sine)
    across = u * r - rig.d * (r_i**2 * sine + r_i_rate * cosine)
    cart = forces[:, 2] + rig.m_i * slope_i
    pull_x = drags[:, 2] * cosine + cart * sine - rig.m_i * along  # 3.24, 3.25
    pull_y = cart * cosine - drags[:, 2] * sine - rig.m_i * across
    inertia_t = rig.m_t * (slope_t - u * r)
    inertia_i = rig.m_i * (slope_i - along * sine - across * cosine)
    skew_t, skew_i = rig.rolling * rig.height_t * inertia_t, rig.rolling * rig.height_i * inertia_i
    skew_t = skew_t - apart * np.sin(delta) * rig.track / 2
    weight = GRAVITY * rig.m_t
    return np.column_stack(
        [
            (front + rear + inertia_t + pull_y) / weight,
            (rig.a * front - rig.b * rear + skew_t - rig.c * pull_y) / weight,
            (-rig.e * forces[:, 2] + skew_i - rig.d * (pull_x * sine + pull_y * cosine) - rig.I_i * r_i_rate)
            / weight,
            lean_t - (rig.height_t * inertia_t + rig.pin * front + rig.drawbar * pull_y) / rig.k_t,
            lean_i - (rig.height_i * inertia_i - rig.drawbar * (forces[:, 2] + inertia_i)) / rig.k_i,
        ]
    )


def _repeated(rig: _Rig, driving: _Driving, times: int) -> tuple[_Rig, _Driving]:
    """The same points so many times, one whole set after the other."""
    repeated = _Rig(*(np.concatenate([x] * times) for x in rig))
    return repeated, _Driving(*(np.concatenate([x] * times) for x in driving))


def _imbalance_and_slope(turn: Array, rig: _Rig, driving: _Driving) -> tuple[Array, Array]:
    """(`_imbalance` [n, 5], its Jacobian over the turn [n, 5, 5] by central differences).

    rig and driving: the points of turn, [n, 5], SETS times over.
    """
    nudges = STEP * np.vstack([np.zeros(5), np.eye(5), -np.eye(5)])
    left = _imbalance(np.concatenate([turn + nudge for nudge in nudges]), rig, driving)
    sets = left.reshape(SETS, len(turn), 5)
    return sets[0], np.moveaxis(sets[1:6] - sets[6:], 0, -1) / (2 * STEP)


def _solve(rig: _Rig, driving: _Driving) -> Array:
    """The steady turn, [n, 5]: v, r, articulation and the leans of both bodies. Raises
    numpy.linalg.LinAlgError if there is none."""
    lengths = rig.a, rig.b, rig.c, rig.d, rig.e
    linear = np.column_stack(
        [rig.stiffness, rig.m_t, rig.m_i, driving.u, np.tan(driving.delta), driving.roll_t, driving.roll_i]
    )
    turn = np.zeros((len(linear), 5))
    turn[:, :3] = steady_turn(linear, *lengths, rig.rolling)
    turn[:, 2] = np.clip(turn[:, 2] - (rig.d + rig.e) * driving.folding / driving.u, -1.5, 1.5)
    repeated = _repeated(rig, driving, SETS)
    for _ in range(MOST_STEPS):
        left, slope = _imbalance_and_slope(turn, *repeated)
        step = np.linalg.solve(slope, left[..., None])[..., 0]
        longest = np.max(np.abs(step), axis=1, keepdims=True)
        turn = turn - step * np.minimum(1.0, LONGEST_STEP / np.maximum(longest, EXACT))
        if not np.all(np.isfinite(turn)):
            break
        if float(longest.max()) < EXACT:
            return np.asarray(turn, np.float64)
    raise np.linalg.LinAlgError("no steady turn was found")


def _seen(turn: Array, points: Array) -> Array:
    """OUTPUTS, [n, 3], of a turn, [n, 5]. points: [n, 23], CONSTANTS."""
    v, r, articulation = turn.T[:3]
    lever, cg = points[:, CONSTANTS.index("lever_t")], points[:, CONSTANTS.index("cg_t")]
    return np.column_stack([r, articulation, v + r * (lever - cg)])


def outputs(points: Array, inputs: Array, machine: Machine) -> Array:
    """OUTPUTS, shape [n, 3].

    points: [n, 23], CONSTANTS. inputs: [n, 5], INPUTS. The lateral velocity is that of the point where the
    machine file has the CG, computed from where it has the antennas, without the errors of the pairs. Raises
    numpy.linalg.LinAlgError if there is no steady turn.
    """
    return _seen(_solve(_rig(points, machine), _driving(points, inputs)), points)


def inputs_of(sample: SteadySample) -> Array:
    """INPUTS, [5]."""
    return np.array([getattr(sample, name) for name in INPUTS])


def linearised(point: Array, sample: SteadySample, machine: Machine) -> tuple[Array, Array, Array]:
    """(OUTPUTS [3], their Jacobian over CONSTANTS [3, 22], and over INPUTS [3, 5]).

    point: [22], CONSTANTS. Raises as `outputs`.
    """
    point_and_inputs = np.concatenate([point, inputs_of(sample)])
    n = len(point_and_inputs)
    nudges = STEP * np.eye(n)
    rows = np.vstack([point_and_inputs, point_and_inputs + nudges, point_and_inputs - nudges])
    points, inputs = rows[:, : len(point)], rows[:, len(point) :]
    rig, driving = _rig(points[:1], machine), _driving(points[:1], inputs[:1])
    turn = _solve(rig, driving)
    _, over_turn = _imbalance_and_slope(turn, *_repeated(rig, driving, SETS))
    # The turn changes so that the balance holds: implicit differentiation, one solution instead of 55.
    left = _imbalance(np.repeat(turn, len(rows), axis=0), _rig(points, machine), _driving(points, inputs))
    moved = -np.linalg.solve(over_turn[0], (left[1 : n + 1] - left[n + 1 :]).T)
    z = _seen(np.vstack([turn, turn + moved.T / 2, turn - moved.T / 2]), points)
    slope = (z[1 : n + 1] - z[n + 1 :]).T / (2 * STEP)
    return z[0], slope[:, : len(point)], slope[:, len(point) :]


def largest_slip(sample: SteadySample, zero: float, machine: Machine) -> float:
    """Largest measured slip angle of the three axles, rad; 0 without a lateral velocity.

    zero: reading of the wheel angle when straight, rad.
    """
    if sample.v is None:
        return 0.0
    point = np.zeros((1, len(CONSTANTS)))
    point[0, CONSTANTS.index("wheel_zero")] = zero
    turn = np.array([[sample.v, sample.yaw_rate, sample.articulation, 0.0, 0.0]])
    driving = _driving(point, inputs_of(sample)[None])
    return float(np.max(np.abs(_slips(turn, _rig(point, machine), driving))))
