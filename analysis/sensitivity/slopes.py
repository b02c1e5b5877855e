"""Derivatives of a model's matrices by the logarithm of each parameter.

The matrices are rational functions of the parameters. A difference of eighth order with steps of 1 % of the
value has an error of about 1e-13 of the derivative: what is left is the rounding of the matrices themselves.
Those of the nonlinear model are differences on their own, so that its derivatives hold to about 1e-7. Nothing
here differentiates a simulated response; responses are derived exactly from these (local.py, frequency.py).
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.actuator import Actuator
from tilth.estimator.models.family import Model
from tilth.estimator.models.linear_analysis import System, system
from tilth.estimator.models.parameters import GEOMETRY, Rig
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]

MACHINE_PARAMETERS: Final = (*PARAMETERS, *GEOMETRY, "h_t", "h_i")
"""Fields of Rig that a machine file gives: soil and tyres, distances, masses, yaw inertias, CG heights."""
VARIED: Final = (*PARAMETERS, "m_i", "I_i")
"""The eight that the dissertation varies (table 6.2)."""
STEP: Final = 0.01  # share of the value
WEIGHTS: Final = (4 / 5, -1 / 5, 4 / 105, -1 / 280)  # of the differences at 1, 2, 3 and 4 steps


def scaled(rig: Rig, factors: dict[str, float]) -> Rig:
    """The rig with some fields multiplied."""
    return rig._replace(**{name: getattr(rig, name) * factor for name, factor in factors.items()})


def known(names: Sequence[str]) -> tuple[str, ...]:
    """The same names. Raises ValueError for one that is no parameter of a machine file."""
    for name in names:
        if name not in MACHINE_PARAMETERS:
            raise ValueError(f"{name} is no parameter; there are {', '.join(MACHINE_PARAMETERS)}")
    return tuple(names)


def by_logarithm(of: Callable[[Rig], Array], rig: Rig, name: str) -> Array:
    """Derivative of a smooth function of a rig by the logarithm of one of its fields, of the same shape.

    A field that is zero has the derivative zero: a share of nothing is nothing.
    """
    found = [
        weight * (of(scaled(rig, {name: 1 + k * STEP})) - of(scaled(rig, {name: 1 - k * STEP})))
        for k, weight in enumerate(WEIGHTS, 1)
    ]
    return np.asarray(sum(found) / STEP, dtype=np.float64)


def system_slope(
    model: Model,
    rig: Rig,
    speed: float,
    outputs: Sequence[str],
    name: str,
    actuator: Actuator | None = None,
) -> System:
    """The derivatives of A, B, C and D of `linear_analysis.system` in their places."""

    def flat(at: Rig) -> Array:
        sys = system(model, at, speed, outputs=outputs, actuator=actuator)
        return np.concatenate([part.ravel() for part in (sys.a, sys.b, sys.c, sys.d)])

    sys = system(model, rig, speed, outputs=outputs, actuator=actuator)
    parts = (sys.a, sys.b, sys.c, sys.d)
    ends = np.cumsum([part.size for part in parts])[:-1]
    shaped = [
        piece.reshape(part.shape)
        for piece, part in zip(np.split(by_logarithm(flat, rig, name), ends), parts, strict=True)
    ]
    return sys._replace(a=shaped[0], b=shaped[1], c=shaped[2], d=shaped[3])
