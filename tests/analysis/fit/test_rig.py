"""The rig of a fit for models that do not roll."""

import math

import numpy as np
import pytest
from logs import MACHINE

from tilth.analysis.fit.rig import fitted_rig
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import AT, NAMES


@pytest.mark.parametrize("pivot_height", [-1.0, 0.0, 0.15])
def test_a_front_axle_that_tips_about_its_pin_makes_the_front_lag_longer(pivot_height: float) -> None:
    """By the square of the pin's height, with the stiffness of the tyres; a pin on the ground by nothing."""
    mean, _ = unknowns.prior(MACHINE)

    def longer(**logs: float) -> float:
        shift = np.array([logs.get(name, 0.0) for name in NAMES])
        shift[AT["roll_pin"]] = pivot_height
        return fitted_rig(MACHINE, mean + shift).sigma_f - math.exp(mean[AT["sigma_f"]])

    height = max(0.7 + pivot_height, 0.0)
    assert longer(roll_front=25.0) == pytest.approx(0.0, abs=1e-9)
    assert longer() == pytest.approx(longer(roll_front=math.log(2.0)) * 2.0)
    assert longer(C_af=math.log(2.0)) == pytest.approx(2.0 * longer())
    assert longer() == pytest.approx(0.17 * (height / 0.7) ** 2, rel=0.3)
