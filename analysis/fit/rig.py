"""A rig with the parameters that a fit found."""

import math

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import AT, SIX
from tilth.estimator.models.parameters import GEOMETRY, Rig, geometry_of, rig_of
from tilth.estimator.models.roll_stiffness import nominal_roll
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


def fitted_rig(machine: Machine, mean: Array) -> Rig:
    """The rig of a machine file with what a fit found, (n,) of unknowns.NAMES, for models that do not roll.

    There the front axle does not tip about its pin as it is pushed. That is one more spring in a row with its
    tyres', so sigma_f is longer by C_af pin^2 / k_f (deploy/motion_equations.py, slip_rates).
    """
    shape = dict(zip(GEOMETRY, unknowns.geometry(geometry_of(machine), mean).tolist(), strict=True))
    theta = dict(zip(PARAMETERS, np.exp(mean[SIX]).tolist(), strict=True))
    roll = nominal_roll(machine)
    pivot_height, k_f = (
        max(roll.pivot_height + float(mean[AT["roll_pin"]]), 0.0),
        roll.k_f * math.exp(mean[AT["roll_front"]]),
    )
    theta["sigma_f"] += theta["C_af"] * pivot_height**2 / k_f
    grip = 1.0 / max(float(mean[AT["curvature"]]), 1e-3)
    return rig_of(machine)._replace(
        **shape, **theta,
        **dict.fromkeys(("grip_f", "grip_r", "grip_i"), grip),
        **dict.fromkeys(("roll_f", "roll_r", "roll_i"), float(mean[AT["rolling"]])),
    )  # fmt: skip
