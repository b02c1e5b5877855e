"""Chapter 6 of the dissertation as one would write it with SALib and scipy; and an integrator for a check.

`by_salib` samples a box as SALib's finite_diff does, a point and each parameter raised, integrates each row
and hands the outputs to its dgsm. `by_exponentials` is nobody's everyday way: scipy's matrix exponentials
and a loop of numpy over the samples, which share no code with the compiled loop but the model's matrices.
"""

from typing import Any, Final

import numpy as np
import SALib.analyze.dgsm
import SALib.sample.finite_diff
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import StateSpace, lsim

from tilth.analysis.sensitivity.designs import DISSERTATION
from tilth.analysis.sensitivity.outputs import STEP_S, WHEEL_ANGLE
from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import TABLE_7_2

Array = NDArray[np.float64]

RELAXATION: Final = model_named("relaxation")
V, R_T, R_I, PSI_T, PSI_I = (RELAXATION.states.index(name) for name in ("v", "r_t", "r_i", "psi_t", "psi_i"))
PROBLEM: Final = {
    "num_vars": len(DISSERTATION.names),
    "names": list(DISSERTATION.names),
    "bounds": [list(pair) for pair in zip(DISSERTATION.low, DISSERTATION.high, strict=True)],
}


def _matrices(row: Array, speed: float) -> tuple[Array, Array]:
    rig = TABLE_7_2._replace(**dict(zip(DISSERTATION.names, row.tolist(), strict=True)))
    return RELAXATION.matrices(rig, speed)


def _run(how: str, a: Array, b: Array, time: Array) -> Array:
    """States at each time, (samples, n)."""
    if how == "lsim":
        system = StateSpace(a, b[:, :1], np.eye(len(a)), np.zeros((len(a), 1)))
        return np.asarray(lsim(system, np.full(len(time), WHEEL_ANGLE), time)[1])
    input_gain = WHEEL_ANGLE * b[:, 0]
    return np.asarray(
        solve_ivp(lambda t, x: a @ x + input_gain, (0, time[-1]), np.zeros(len(a)), t_eval=time).y.T
    )


def _outputs(x: Array, speed: float) -> list[float]:
    """RMS of the velocities, the path's end and the headings."""
    north = speed * np.cos(x[:, PSI_T]) - x[:, V] * np.sin(x[:, PSI_T])
    east = speed * np.sin(x[:, PSI_T]) + x[:, V] * np.cos(x[:, PSI_T])
    end = float(np.hypot(north.sum(), east.sum()) * STEP_S)
    speeds = np.sqrt(np.mean(x[:, [V, R_T, R_I]] ** 2, axis=0)).tolist()
    return [*speeds, end, float(x[-1, PSI_T]), float(x[-1, PSI_I])]


def by_salib(points: int, speed: float, samples: int, how: str) -> tuple[int, Any]:
    """(simulations, SALib's answer for each output). how: scipy's "solve_ivp" or "lsim", as they are."""
    rows = SALib.sample.finite_diff.sample(PROBLEM, points, delta=0.01, seed=1)
    time: Array = STEP_S * np.arange(samples, dtype=np.float64)
    found = []
    for row in rows:
        found.append(_outputs(_run(how, *_matrices(row, speed), time), speed))
    outputs = np.array(found)
    return len(rows), [
        SALib.analyze.dgsm.analyze(PROBLEM, rows, column, num_resamples=10, seed=1) for column in outputs.T
    ]


def by_exponentials(points: Array, speed: float, samples: int, share: float = 0.01) -> Array:
    """Change of each of the six outputs as a share, (n, 8, 6), where each parameter in turn is raised by the
    share. points: (n, 8), as DISSERTATION.names."""
    count, k = points.shape
    raised = np.repeat(points[:, None], k + 1, axis=1)
    for j in range(k):
        raised[:, j + 1, j] *= 1 + share
    size = len(RELAXATION.states) + 1
    whole = np.zeros((count * (k + 1), size, size))
    for at, row in zip(whole, raised.reshape(-1, k), strict=True):
        a, b = _matrices(row, speed)
        at[:-1, :-1], at[:-1, -1] = a * STEP_S, WHEEL_ANGLE * b[:, 0] * STEP_S
    step = np.asarray(expm(whole))
    x = np.zeros((len(whole), size, 1))
    x[:, -1] = 1.0
    now = x[..., 0].reshape(count, k + 1, size)
    squares = np.zeros((3, count, k + 1))
    path = np.zeros((2, count, k + 1))
    for _ in range(samples):
        now = x[..., 0].reshape(count, k + 1, size)
        v, psi = now[..., V], now[..., PSI_T]
        path[0] += (speed * np.cos(psi) - v * np.sin(psi)) * STEP_S
        path[1] += (speed * np.sin(psi) + v * np.cos(psi)) * STEP_S
        for row, state in zip(squares, (V, R_T, R_I), strict=True):
            row[:, 0] += now[:, 0, state] ** 2
            row[:, 1:] += (now[:, 1:, state] - now[:, :1, state]) ** 2
        x = step @ x
    shares = np.empty((count, k, 6))
    shares[..., :3] = np.sqrt(squares[:, :, 1:] / squares[:, :, :1]).transpose(1, 2, 0)
    radius = speed / np.abs(now[:, :1, R_T])
    shares[..., 3] = np.hypot(*(path[:, :, 1:] - path[:, :, :1])) / radius
    for column, state in ((4, PSI_T), (5, PSI_I)):
        shares[..., column] = np.abs(now[:, 1:, state] / now[:, :1, state] - 1)
    return shares
