"""Sensitivities in the frequency domain: how gain and phase of a transfer function change with a parameter.

Karkee (2009) names them as future work (8.2). With the resolvent R = (jω − A)⁻¹ and G = C R B + D,

    dG = dC R B + C R dA R B + C R dB + dD,    ∂ln G/∂ln p = dG / G = ∂ln|G|/∂ln p + j ∂∠G/∂ln p,

in closed form; only dA, dB, dC and dD come from slopes.py.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.sensitivity.slopes import MACHINE_PARAMETERS, known, system_slope
from tilth.estimator.models.family import Model
from tilth.estimator.models.linear_analysis import System, frequency_response, system
from tilth.estimator.models.parameters import Rig

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

TRANSFERS: Final = ("r_t", "r_i", "v", "articulation")
"""Outputs over the wheel angle."""
OMEGA: Final[Array] = np.geomspace(0.1, 30.0, 100)
"""rad/s."""


class FrequencySensitivities(NamedTuple):
    """At one speed; arrays are (len(omega), outputs, parameters).

    gain: per cent of |G| per per cent of the parameter. phase: rad for each unit of its logarithm, so that a
    hundredth of it is the change for 1 %.
    """

    speed: float
    omega: Array  # rad/s
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    response: Complex  # (len(omega), outputs), G
    gain: Array
    phase: Array


def frequency_sensitivities(
    model: Model,
    rig: Rig,
    speed: float,
    *,
    omega: Array = OMEGA,
    outputs: Sequence[str] = TRANSFERS,
    parameters: Sequence[str] = MACHINE_PARAMETERS,
) -> FrequencySensitivities:
    """omega: rad/s, above zero. NaN where a response is zero. Raises ValueError for an unknown name."""
    names = known(parameters)
    sys = system(model, rig, speed, outputs=outputs)
    response = frequency_response(sys, omega)[:, :, 0]
    relative = np.stack(
        [
            relative_slope(sys, system_slope(model, rig, speed, outputs, name), omega, response)
            for name in names
        ],
        axis=-1,
    )
    return FrequencySensitivities(
        speed, omega, tuple(outputs), names, response, np.array(relative.real), np.array(relative.imag)
    )


def relative_slope(sys: System, by: System, omega: Array, response: Complex) -> Complex:
    """dG / G of the first input, shape (len(omega), p). by: the derivatives of sys. response: G."""
    matrix = 1j * omega[:, None, None] * np.eye(len(sys.a)) - sys.a
    states = np.linalg.solve(matrix, np.broadcast_to(sys.b[:, :1], (len(omega), len(sys.a), 1)))  # R B
    inner = np.linalg.solve(matrix, by.a @ states + by.b[:, :1])
    slope = (by.c @ states + sys.c @ inner + by.d[:, :1])[:, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(response == 0.0, complex(math.nan, math.nan), slope / response))
