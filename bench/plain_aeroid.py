"""AeroID: a package for the same task, of aircraft, by output error on the equations of plain_least_squares.

It has no priors: what it says of a parameter is what the record says.
"""

from collections.abc import Mapping
from functools import lru_cache

import aeroid
import numpy as np
from numpy.typing import NDArray
from plain_least_squares import DT, LATERAL_STATES, OUTPUT_STATES

from tilth.estimator.models.relaxation import input_matrix, system_matrix
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]

STATES = ("v", "r_t", "r_i", "alpha_f", "alpha_r", "alpha_i", "psi_t", "psi_i")
OUTPUTS = ("yaw_rate_t", "yaw_rate_i", "heading_t", "heading_i")


def fit(
    y: Array, wheel: Array, geometry: Array, speed: float, mean: Array, sd: Array, sds: Array
) -> tuple[Array, Array]:
    """As plain_least_squares.fit; the prior is only where the search begins: for the zero at one sd, since
    AeroID counts in shares of where it begins."""

    @lru_cache(maxsize=4)
    def matrices(logs: tuple[float, ...]) -> tuple[Array, Array]:
        theta = np.exp(logs)
        a = system_matrix(speed, geometry, theta)[np.ix_(LATERAL_STATES, LATERAL_STATES)]
        return a, input_matrix(speed, geometry, theta)[LATERAL_STATES, 0]

    def dynamics(_t: float, x: Array, u: Array, at: Mapping[str, float]) -> Array:
        a, b = matrices(tuple(at[name] for name in PARAMETERS))
        return np.asarray(a @ x + b * (u[0] - at["zero"]))

    def measurement(_t: float, x: Array, _u: Array, _at: Mapping[str, float]) -> Array:
        return x[OUTPUT_STATES]

    names = (*PARAMETERS, "zero")
    begin: dict[str, float] = dict(zip(names, [*mean[:6].tolist(), float(sd[6])], strict=True))
    model = aeroid.Model(STATES, ("wheel",), begin, dynamics, OUTPUTS, measurement)
    channels = {"wheel": wheel, **dict(zip(OUTPUTS, y.T, strict=True))}
    data = aeroid.FlightData(np.arange(0.0, len(y)) * DT, channels)
    found = aeroid.identify(
        model, data, names, weights=dict(zip(OUTPUTS, 1.0 / sds, strict=True)), x0=np.zeros(len(STATES))
    )  # fmt: skip
    values = np.array([found.parameters[name] for name in PARAMETERS])
    return values, np.array([found.stderr[name] for name in PARAMETERS])
