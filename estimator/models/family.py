"""The models, one row each, for analysis, estimators, reports and the command line."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models import dynamic, kinematic, nonlinear, relaxation
from tilth.estimator.models.parameters import Rig

Array = NDArray[np.float64]

LATERAL = relaxation.STATES
"""The states of the nonlinear model that change in small motions about straight running, in this order."""


class Model(NamedTuple):
    """One model. `matrices(rig, u)` gives A (n, n) and B (n, 3) for small motions about straight running at
    speed u (m/s, negative in reverse), columns as `states` and `inputs`."""

    name: str
    meaning: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    matrices: Callable[[Rig, float], tuple[Array, Array]]
    parameters: tuple[str, ...]  # of schemas.flow.PARAMETERS, those that it depends on
    at_rest: bool  # whether it holds at standstill


def _kinematic(rig: Rig, u: float) -> tuple[Array, Array]:
    args = (u, rig.geometry, rig.theta)
    return kinematic.system_matrix(*args), kinematic.input_matrix(*args)


def _dynamic(rig: Rig, u: float) -> tuple[Array, Array]:
    args = (u, rig.geometry, rig.theta)
    return dynamic.system_matrix(*args), dynamic.input_matrix(*args)


def _relaxation(rig: Rig, u: float) -> tuple[Array, Array]:
    args = (u, rig.geometry, rig.theta)
    return relaxation.system_matrix(*args), relaxation.input_matrix(*args)


def _nonlinear(rig: Rig, u: float) -> tuple[Array, Array]:
    a, b = nonlinear.linearise(rig, nonlinear.running(u), nonlinear.inputs_of(1, speed=u)[0])
    rows = [nonlinear.STATES.index(name) for name in LATERAL]
    columns = [nonlinear.INPUTS.index(name) for name in relaxation.INPUTS]
    return a[np.ix_(rows, rows)], b[np.ix_(rows, columns)]


_STIFFNESS = ("C_af", "C_ar", "C_ai")
_ALL = (*_STIFFNESS, "sigma_f", "sigma_r", "sigma_i")

MODELS = (
    Model("kinematic", "wheels that roll where they point", kinematic.STATES, kinematic.INPUTS, _kinematic,
          (), True),
    Model("dynamic", "tyres whose force follows the slip at once", dynamic.STATES, dynamic.INPUTS, _dynamic,
          _STIFFNESS, False),
    Model("relaxation", "tyres whose slip builds up over a distance", relaxation.STATES, relaxation.INPUTS,
          _relaxation, _ALL, True),
    Model("nonlinear", "the planar model, for small motions about straight running", LATERAL,
          relaxation.INPUTS, _nonlinear, _ALL, True),
)  # fmt: skip


def model_named(name: str) -> Model:
    """The row of that name. Raises ValueError that lists the names."""
    for model in MODELS:
        if model.name == name:
            return model
    raise ValueError(f'there is no model "{name}"; there are {", ".join(m.name for m in MODELS)}')
