"""The control law: LQR on the relaxation-length model behind the steering servo, with preview of the plan.

All in deviations from the plan (plan.py): x' = A x + B delta_c + E w, with the relaxation model's states,
wheel angle and its rate, and w the pushes of DISTURBANCES. The regulator sets the *rate* of the commanded
wheel angle, so a change of gains never makes the command jump, and no steady push leaves an offset that it
knows of. What the plan will ask of the tyres is known in advance and enters by preview (the linear quadratic
tracker's backward equation). An observer of the same model estimates slip angles, a steering offset and a
side force that nobody measures, and bridges the time from a pose's instant to now.

Source of model and regulator: Karkee (2009), eqs. 3.108 to 3.121, 5.31 to 5.33. The six soil-tyre parameters
enter A, B, E, and so every gain.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm, solve_discrete_are

from tilth.estimator.models.actuator import BOSSERD
from tilth.estimator.models.dynamic import inertia
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import System, discretise, output_row, system
from tilth.estimator.models.parameters import Rig
from tilth.estimator.models.regulator import regulator

Array = NDArray[np.float64]

SERVO: Final = 3.0  # rad/s for each rad that is missing: the steering ECU's position loop
TICK_S: Final = 0.02  # of the observer's steps
POSE_S: Final = 0.2  # between two poses
PREVIEW_S: Final = 4.0
PREVIEW_STEP_S: Final = 0.1
KNOWN: Final = ("plan_v", "plan_r_t", "plan_r_i", "gravity_t", "gravity_i")
HIDDEN: Final = ("steering_offset", "implement_push")
DISTURBANCES: Final = (*KNOWN, *HIDDEN)
"""Generalised forces of the plan (N, N m, N m); g sin(roll) of both bodies, m/s^2; rad; m/s^2."""
MEASURED: Final = ("y_t", "y_i", "psi_t", "psi_i", "v", "r_t", "r_i", "delta")

WEIGHT_Y: Final = 1.0  # per m^2 of the implement's cross-track error
WEIGHT_RATE: Final = 4.0  # per (rad/s)^2 of the commanded wheel angle's rate
SD: Final = np.array([0.02, 0.02, 0.012, 0.012, 0.07, 0.05, 0.02, 0.002])
"""Of MEASURED, SI: what a pose's noise is like. Its turn rates are those of the last message before its
instant, up to 0.2 s old, and count for less than the receivers' own noise would let them."""
DISTURBANCE_SD: Final = np.array([0.05, 0.15])  # m/s^2 sqrt(s): white pushes on tractor and implement
WALK_SD: Final = np.array([0.002, 0.06])  # of HIDDEN per sqrt(s)


class Design(NamedTuple):
    """The law at one speed and one set of parameters; n = 11 states, m = len(DISTURBANCES)."""

    speed: float
    theta: Array  # (6,)
    f: Array  # (n, n) over TICK_S
    g: Array  # (n,) of the commanded wheel angle, held
    e: Array  # (n, m) of the disturbances, held
    outputs: Array  # (len(MEASURED), n)
    gain: Array  # (n + 1,): on the states and the commanded wheel angle, rad/s
    preview: Array  # (PREVIEW_S / PREVIEW_STEP_S + 1, 3): on the plan's forces ahead
    steady: Array  # (m,): on pushes that stay as they are
    observer: Array  # (n + len(HIDDEN), len(MEASURED))


def design(rig: Rig, speed: float) -> Design:
    """Raises ValueError where no gain steadies the rig."""
    a, b, e = _model(rig, speed)
    n = len(a)
    y_i = _outputs(rig, speed, a, b)[MEASURED.index("y_i")]
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n] = a, b
    rate = np.eye(n + 1)[:, n:]
    weights = WEIGHT_Y * np.outer(np.append(y_i, 0.0), np.append(y_i, 0.0))
    sys = System(speed, ("",) * (n + 1), ("",), (), whole, rate, np.zeros((0, n + 1)), np.zeros((0, 1)))
    made = regulator(sys, weights, WEIGHT_RATE)
    preview, steady = _ahead(whole - rate * made.gain, made.cost, np.vstack([e, np.zeros(e.shape[1])]))
    f, g0, g1 = discretise(a, np.column_stack([b, e]), TICK_S)
    held = g0 + g1
    outputs = _outputs(rig, speed, a, b)
    return Design(
        speed, rig.theta, f, held[:, 0], held[:, 1:], outputs, made.gain, preview, steady,
        _observer(f, held[:, 1:], outputs),
    )  # fmt: skip


def _model(rig: Rig, speed: float) -> tuple[Array, Array, Array]:
    """A, column of the commanded wheel angle, columns of DISTURBANCES."""
    sys = system(model_named("relaxation"), rig, speed, actuator=BOSSERD)
    a, b = sys.a.copy(), SERVO * sys.b[:, 0]
    at = sys.states.index("delta")
    a[:, at] -= b
    forces = np.zeros((len(a), 3))
    forces[:3] = np.linalg.inv(inertia(rig.geometry))
    gravity = sys.b[:, 1:]
    offset = sys.a[:, [at]] * np.array(
        [[1.0 if s not in ("delta", "delta_rate") else 0.0] for s in sys.states]
    )
    return a, b, np.column_stack([forces, gravity, offset, gravity[:, 1]])


def _outputs(rig: Rig, speed: float, a: Array, b: Array) -> Array:
    states = system(model_named("relaxation"), rig, speed, actuator=BOSSERD).states
    rows = []
    for name in MEASURED:
        direct = name in states
        rows.append(
            np.eye(len(a))[states.index(name)]
            if direct
            else output_row(name, states, a, b[:, None], rig, speed)[0]
        )
    return np.array(rows)


def _ahead(closed: Array, cost: Array, e: Array) -> tuple[Array, Array]:
    """(preview, steady) of Design from the closed loop's matrix, the regulator's cost matrix, and E."""
    # g' = -closed' g - cost E w, and the rate's share is -b' g / r: b picks the last row.
    steps = round(PREVIEW_S / PREVIEW_STEP_S)
    over = expm(closed.T * PREVIEW_STEP_S)
    row = np.linalg.solve(closed.T, over - np.eye(len(over)))  # integral of expm over one step
    later, rows = np.eye(len(over)), []
    for _ in range(steps):
        rows.append(-(later @ row @ cost @ e[:, :3])[-1] / WEIGHT_RATE)
        later = later @ over
    rest = -np.linalg.solve(closed.T, later)
    rows.append(-(rest @ cost @ e[:, :3])[-1] / WEIGHT_RATE)
    steady = (np.linalg.solve(closed.T, cost @ e))[-1] / WEIGHT_RATE
    return np.array(rows), steady


def _observer(f: Array, e: Array, outputs: Array) -> Array:
    """The steady Kalman gain at poses POSE_S apart."""
    n, k = len(f), len(HIDDEN)
    one = np.block([[f, e[:, -k:]], [np.zeros((k, n)), np.eye(k)]])
    disturbance = e[:, 3:5] * DISTURBANCE_SD / np.sqrt(TICK_S)
    noise: Array = np.asarray(
        block_diag(disturbance @ disturbance.T, np.diag(WALK_SD**2 * TICK_S)), np.float64
    )
    noise = noise + 1e-12 * np.eye(n + k)
    over: Array = np.eye(n + k)
    spread: Array = np.zeros((n + k, n + k))
    for _ in range(round(POSE_S / TICK_S)):
        over, spread = one @ over, np.asarray(one @ spread @ one.T) + noise
    c = np.hstack([outputs, np.zeros((len(outputs), k))])
    p = solve_discrete_are(over.T, c.T, spread, np.diag(SD**2))
    return np.asarray(np.linalg.solve(c @ p @ c.T + np.diag(SD**2), c @ p).T)
