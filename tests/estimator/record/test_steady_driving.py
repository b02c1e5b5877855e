"""Which driving is steady."""

import math

import numpy as np
import pytest
from linear_tyres import linear_tyres
from settled import MACHINE, ROLLING, point_of

from tilth.estimator.filters.steady_outputs import (
    outputs,
)
from tilth.estimator.models import nonlinear
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.record.steady_driving import STEADY_DRIVING


@pytest.mark.parametrize(("degrees", "speed"), [(6.0, 2.0), (-18.0, 2.0), (25.0, 2.2), (32.0, 2.0)])
def test_a_rig_that_still_folds_is_understood(degrees: float, speed: float) -> None:
    """In a slow turn an eighth of the way or more is left when the first block may begin; by the rate of
    folding all but two fifths of it are foreseen."""
    rig = linear_tyres(rig_of(MACHINE))._replace(**ROLLING)
    driven = nonlinear.inputs_of(3000, delta=math.radians(degrees), speed=speed)
    run = nonlinear.simulate(rig, driven, nonlinear.running(speed), 0.01)
    at = {name: run[:, k] for k, name in enumerate(nonlinear.STATES)}
    k = round(max(STEADY_DRIVING.settling * rig.towed_length / speed, STEADY_DRIVING.settling_s) / 0.01)
    articulation = at["psi_t"] - at["psi_i"]
    point = point_of(rolling=0.06, curvature=0.0, parallel=0.0)
    known = [at["u"][k], math.radians(degrees), 0.0, 0.0]
    left, foreseen = (
        outputs(point[None], np.array([[*known, folding]]), MACHINE)[0, 1] - articulation[k]
        for folding in (0.0, at["r_t"][k] - at["r_i"][k])
    )
    assert abs(left) > 0.12 * abs(articulation[k])
    assert abs(foreseen) < 0.4 * abs(left)
