"""Output error with numpy and scipy: what one writes first. The model runs free of the measurements (K = 0).

States, outputs and record are those of bench/linear_plant.py: v, r_t, r_i, three slip angles and two
headings; both yaw rates and both headings are seen.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import least_squares

from tilth.estimator.models.relaxation import input_matrix, system_matrix

Array = NDArray[np.float64]

DT = 0.02
LATERAL_STATES = [0, 1, 2, 3, 4, 5, 7, 8]
OUTPUT_STATES = [1, 2, 6, 7]


def discrete(theta: Array, geometry: Array, speed: float) -> tuple[Array, Array]:
    """(F (8, 8), G (8,)) of one step with the wheel angle held."""
    whole = np.zeros((9, 9))
    whole[:8, :8] = system_matrix(speed, geometry, theta)[np.ix_(LATERAL_STATES, LATERAL_STATES)]
    whole[:8, 8] = input_matrix(speed, geometry, theta)[LATERAL_STATES, 0]
    exact: Array = np.asarray(expm(whole * DT), np.float64)
    return exact[:8, :8], exact[:8, 8]


def middles(wheel: Array) -> Array:
    """The wheel angle held over each step: the mean of its ends, (n,)."""
    return np.append((wheel[:-1] + wheel[1:]) / 2, wheel[-1])


def fit(
    y: Array, wheel: Array, geometry: Array, speed: float, mean: Array, sd: Array, sds: Array
) -> tuple[Array, Array]:
    """(logarithms (6,), their sds (6,)). y: (n, 4); wheel: (n,) rad; mean, sd: (7,) prior of the logarithms
    and the wheel's zero; sds: (4,) of the outputs."""

    def residuals(at: Array) -> Array:
        f, g = discrete(np.exp(at[:6]), geometry, speed)
        driven = np.outer(middles(wheel - at[6]), g)
        x, prediction = np.zeros(8), np.empty((len(y), 4))
        for k in range(len(y)):
            prediction[k] = x[OUTPUT_STATES]
            x = f @ x + driven[k]
        return np.concatenate([((y - prediction) / sds).ravel(), (at - mean) / sd])

    found = least_squares(residuals, mean, method="trf")
    scale = 2 * found.cost / (y.size - len(mean))  # the noise that the residuals show
    covariance = np.linalg.inv(found.jac.T @ found.jac) * max(scale, 1.0)
    return np.asarray(found.x[:6]), np.sqrt(np.diag(covariance)[:6])
