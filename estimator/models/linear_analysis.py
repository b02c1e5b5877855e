"""Analysis of the linear models of a rig at a speed: simulation, poles, frequency response, observability.

All are functions of a `System`; each model, with or without the steering actuator, can be made one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.models import actuator as steering
from tilth.estimator.models.actuator import Actuator
from tilth.estimator.models.family import Model
from tilth.estimator.models.parameters import Rig, static_loads
from tilth.estimator.models.steady_turn import steady_turn
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class LinearAnalysisTuning:
    """Numerics of linear models."""

    speed_grid: float = tuned(
        0.02, "m/s", "transition matrices are exact at its multiples, else interpolated"
    )
    at_origin: float = tuned(1e-6, "1/s", "smaller eigenvalues are integrators: the error of a double one")
    rank_tolerance: float = tuned(1e-9, "1", "singular values below this share of the largest are 0")


LINEAR_ANALYSIS: Final = LinearAnalysisTuning()


class System(NamedTuple):
    """x' = A x + B w, y = C x + D w, at one speed."""

    speed: float
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    a: Array
    b: Array
    c: Array
    d: Array


def system(
    model: Model,
    rig: Rig,
    speed: float,
    *,
    outputs: Sequence[str] = ("r_t", "r_i"),
    position: bool = True,
    actuator: Actuator | None = None,
) -> System:
    """A model of a rig at a speed (m/s).

    outputs: names of states, or of OUTPUTS. position: False leaves the lateral position out. With an actuator
    the first input is its command and its two states come last. Raises ValueError for an unknown output.
    """
    a, b = model.matrices(rig, speed)
    states, inputs = model.states, model.inputs
    table = _output_rows(states, a, b, rig, speed)
    rows = [_row_of(name, table, len(states), b.shape[1]) for name in outputs]
    c, d = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    if actuator is not None:
        a, b = steering.with_actuator(a, b, actuator)
        c = np.hstack([c, d[:, :1], np.zeros((len(rows), 1))])
        d = np.hstack([np.zeros((len(rows), 1)), d[:, 1:]])
        states, inputs = states + steering.STATES, (steering.INPUT, *inputs[1:])
    whole = System(speed, states, inputs, tuple(outputs), a, b, c, d)
    return whole if position else without(whole, "y_t")


OUTPUTS = {
    "v": "lateral velocity of the tractor's CG, m/s",
    "r_t": "yaw rate of the tractor, rad/s",
    "r_i": "yaw rate of the implement, rad/s",
    "articulation": "psi_t - psi_i, rad",
    "y_t": "lateral position of the tractor's CG, m",
    "y_i": "lateral position of the implement's CG, m",
    "y_axle": "lateral position of the implement's axle, m",
    "v_i": "lateral velocity of the implement's CG along its own right side, m/s",
}


def output_row(
    name: str, states: Sequence[str], a: Array, b: Array, rig: Rig, speed: float
) -> tuple[Array, Array]:
    """(row of C, row of D) for one output of OUTPUTS or one state. Raises ValueError."""
    return _row_of(name, _output_rows(states, a, b, rig, speed), *b.shape)


def _row_of(name: str, table: dict[str, Array], n: int, m: int) -> tuple[Array, Array]:
    if name not in table:
        raise ValueError(f"{name} is no output of this model; there are {', '.join(sorted(table))}")
    row = table[name]
    return row[:n], row[n : n + m]


def _output_rows(states: Sequence[str], a: Array, b: Array, rig: Rig, speed: float) -> dict[str, Array]:
    """Output or state -> its row of C, followed by that of D."""
    n, m = b.shape
    table = {name: np.concatenate([row, np.zeros(m)]) for name, row in zip(states, np.eye(n), strict=True)}
    psi_t, psi_i = table["psi_t"], table["psi_i"]
    r_t, r_i = (np.concatenate([a[k], b[k]]) for k in map(list(states).index, ("psi_t", "psi_i")))
    # The kinematic model's y_t is that of the rear axle: its CG is b psi further right and moves b r faster.
    slipless = "v" not in states
    v = rig.b * r_t if slipless else table["v"]
    articulation = psi_t - psi_i
    if "y_t" in states:
        y = table["y_t"] + rig.b * psi_t if slipless else table["y_t"]
        table["y_t"] = y
        table["y_i"] = y - rig.c * psi_t - rig.d * psi_i
        table["y_axle"] = y - rig.c * psi_t - rig.towed_length * psi_i
    table |= {"v": v, "r_t": r_t, "r_i": r_i, "articulation": articulation}
    table["v_i"] = v - rig.c * r_t - rig.d * r_i + speed * articulation
    return table


def without(whole: System, name: str) -> System:
    """The system without one state that no other state depends on."""
    keep = [i for i, state in enumerate(whole.states) if state != name]
    dropped = whole.states.index(name)
    if np.any(whole.a[keep, dropped]) or np.any(whole.c[:, dropped]):
        raise ValueError(f"{name} cannot be left out: another state or an output depends on it")
    return whole._replace(
        states=tuple(whole.states[i] for i in keep),
        a=whole.a[np.ix_(keep, keep)],
        b=whole.b[keep],
        c=whole.c[:, keep],
    )


def discretise(a: Array, b: Array, dt: float) -> tuple[Array, Array, Array]:
    """(F, G0, G1) of x+ = F x + G0 w + G1 w+, exact for inputs that are linear between samples.

    a: (..., n, n), b: (..., n, m). Returns (..., n, n), (..., n, m), (..., n, m). For inputs that are held,
    G0 + G1 stands before w.
    """
    n, m = b.shape[-2:]
    block = np.zeros((*a.shape[:-2], n + 2 * m, n + 2 * m))
    block[..., :n, :n], block[..., :n, n : n + m] = a * dt, b * dt
    block[..., n : n + m, n + m :] = np.eye(m)  # the input's slope, per step
    from scipy.linalg import expm  # importing it takes half a second, so only where it is needed

    whole = np.asarray(expm(block), dtype=np.float64)
    slope = whole[..., :n, n + m :]
    return whole[..., :n, :n], whole[..., :n, n : n + m] - slope, slope


@kernel
def scan(f: Array, g: Array, which: NDArray[np.int64], share: Array, forcing: Array, states: Array) -> None:
    """Fill states[1:], shape (n+1, s): x+ = F x + G w, with F and G interpolated between two nodes of speed.

    f: (q, s, s), g: (q, s, m), at the nodes. which: (n,), lower node of each step; share: (n,), weight of the
    upper one. forcing: (n, m), w.
    """
    for k in range(len(which)):
        j, upper = which[k], share[k]
        for row in range(f.shape[1]):
            low = 0.0
            high = 0.0
            for col in range(f.shape[2]):
                low += f[j, row, col] * states[k, col]
                high += f[j + 1, row, col] * states[k, col]
            for col in range(g.shape[2]):
                low += g[j, row, col] * forcing[k, col]
                high += g[j + 1, row, col] * forcing[k, col]
            states[k + 1, row] = low + upper * (high - low)


def simulate(
    model: Model,
    rig: Rig,
    speed: float | Array,
    inputs: Array,
    x0: Array,
    dt: float,
    *,
    actuator: Actuator | None = None,
    linear: bool = False,
) -> Array:
    """States at each sample, shape (n+1, s), from x0, shape (s,), exact at a constant speed.

    speed: m/s, or shape (n,), that of each step. inputs: (n, m), each row held for dt; with linear=True
    (n+1, m), linear between samples. States and inputs as of `system`. Between speeds `speed_grid` apart the
    transition is interpolated.
    """
    n = len(inputs) - 1 if linear else len(inputs)
    low, share, nodes = _speed_nodes(speed, n)
    a, b = _matrices(model, rig, nodes, actuator)
    f, g0, g1 = discretise(a, b, dt)
    states = np.zeros((n + 1, a.shape[-1]))
    states[0] = x0
    if linear:
        g, forcing = np.concatenate([g0, g1], axis=2), np.hstack([inputs[:-1], inputs[1:]])
    else:
        g, forcing = g0 + g1, inputs
    driven = np.ascontiguousarray(forcing, np.float64)
    scan(np.ascontiguousarray(f), np.ascontiguousarray(g), low, share, driven, states)
    return states


def _speed_nodes(speed: float | Array, n: int) -> tuple[NDArray[np.int64], Array, Array]:
    """(lower node of each step, share of the upper one, speeds of the nodes)."""
    if np.ndim(speed) == 0:
        return np.zeros(n, np.int64), np.zeros(n), np.full(2, float(speed))
    scaled: Array = np.asarray(np.broadcast_to(speed, (n,)), np.float64) / LINEAR_ANALYSIS.speed_grid
    first = int(np.floor(scaled.min()))
    low = np.floor(scaled).astype(np.int64)
    nodes: Array = np.arange(first, int(low.max()) + 2, dtype=np.float64) * LINEAR_ANALYSIS.speed_grid
    return low - first, np.asarray(scaled - low), nodes


def _matrices(model: Model, rig: Rig, nodes: Array, actuator: Actuator | None) -> tuple[Array, Array]:
    pairs = []
    for u in nodes.tolist():
        a, b = model.matrices(rig, u)
        pairs.append((a, b) if actuator is None else steering.with_actuator(a, b, actuator))
    return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])


def outputs_of(sys: System, states: Array, inputs: Array) -> Array:
    """y at each sample, shape (n, p), from states (n, s) and inputs (n, m) at the same samples."""
    return states @ sys.c.T + inputs @ sys.d.T


def eigenvalues(a: Array) -> Complex:
    """Eigenvalues of a square matrix, (n,), sorted by real, then by imaginary part; integrators exactly
    zero."""
    found = np.linalg.eigvals(a).astype(np.complex128)
    found[np.abs(found) < LINEAR_ANALYSIS.at_origin] = 0.0
    order = sorted(found, key=lambda z: (round(z.real, 6), z.imag))
    return np.array(order)


def damping(poles: Complex) -> Array:
    """Damping ratio of each pole, shape (n,); nan for an integrator."""
    size = np.abs(poles)
    return np.asarray(np.divide(-poles.real, size, out=np.full(len(poles), np.nan), where=size > 0))


def dominant(poles: Complex) -> complex:
    """The pole with the largest real part that is no integrator; of a pair, the one above the real axis.

    Raises ValueError where there is none.
    """
    moving = [pole for pole in poles if abs(pole) > LINEAR_ANALYSIS.at_origin]
    if not moving:
        raise ValueError("this system has integrators only: nothing in it settles")
    slowest = max(moving, key=lambda z: (round(z.real, 9), z.imag))
    return complex(slowest)


def settling_time(poles: Complex) -> float:
    """Seconds until the dominant pole's part is within 2 % (four time constants); infinite if it grows."""
    real = dominant(poles).real
    return 4.0 / -real if real < 0 else float("inf")


def settling_distance(poles: Complex, speed: float) -> float:
    """Metres driven during `settling_time`."""
    return abs(speed) * settling_time(poles)


def frequency_response(sys: System, omega: Array) -> Complex:
    """C (jω − A)⁻¹ B + D, shape (len(omega), p, m), for omega in rad/s, not zero where A has integrators."""
    n = len(sys.a)
    matrix = 1j * np.asarray(omega)[:, None, None] * np.eye(n) - sys.a
    return np.asarray(sys.c @ np.linalg.solve(matrix, sys.b[None]) + sys.d)


def decibel(response: Complex) -> Array:
    """20 log10 of the size; minus infinity where there is no response."""
    size = np.abs(response)
    return 20 * np.log10(size, out=np.full(size.shape, -np.inf), where=size > 0)


def controllability(a: Array, b: Array) -> tuple[int, float]:
    """(rank, condition) of [B, AB, …], states and time scaled to be comparable.

    a: (n, n), b: (n, m). The condition is infinite where the rank is not full.
    """
    scale = max(float(np.abs(np.linalg.eigvals(a)).max()), 1e-12)
    step = a / scale
    blocks = [b / max(float(np.abs(b).max()), 1e-12)]
    for _ in range(len(a) - 1):
        blocks.append(step @ blocks[-1])
    return _rank(np.hstack(blocks))


def observability(a: Array, c: Array) -> tuple[int, float]:
    """(rank, condition) of [C; CA; …]; as `controllability`. c: (p, n)."""
    return controllability(a.T, c.T)


def _rank(matrix: Array) -> tuple[int, float]:
    rows = np.linalg.norm(matrix, axis=1, keepdims=True)
    sizes = np.linalg.svd(matrix / np.where(rows > 0, rows, 1.0), compute_uv=False)
    rank = int(np.sum(sizes > LINEAR_ANALYSIS.rank_tolerance * max(float(sizes[0]), 1e-12)))
    return rank, float(sizes[0] / sizes[-1]) if rank == len(matrix) else float("inf")


def steady_gains(rig: Rig, speed: float) -> Array:
    """Steady turning per rad of wheel angle: lateral velocity (m/s), yaw rate (rad/s), articulation (rad)."""
    row = np.array([[rig.C_af, rig.C_ar, rig.C_ai, rig.m_t, rig.m_i, speed, 1.0, 0.0, 0.0]])
    return np.asarray(steady_turn(row, *rig.geometry[:5].tolist())[0])


def understeer_gradient(rig: Rig) -> float:
    """K in δ = (L^t + K u²) r / u, rad s²/m: positive where more speed needs more wheel angle.

    In a steady turn the hitch pulls sideways as if the tongue's load were mass of the tractor, so that each
    axle carries the side force of its own static load (from 3.122-3.124).
    """
    front, rear, _ = static_loads(rig)
    return (front / rig.C_af - rear / rig.C_ar) / rig.g


def characteristic_speed(rig: Rig) -> float:
    """Speed at which the yaw rate per wheel angle is largest, m/s; infinite for a neutral rig; for one that
    oversteers minus the speed at which it turns by itself."""
    gradient = understeer_gradient(rig)
    if gradient == 0.0:
        return float("inf")
    return float(np.copysign(np.sqrt(rig.wheelbase / abs(gradient)), gradient))
