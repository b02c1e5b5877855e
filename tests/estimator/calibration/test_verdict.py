"""What a calibration says of itself."""

import math

import numpy as np
import pytest
from logs import MACHINE

from tilth.estimator.calibration import priors
from tilth.estimator.calibration.initial_guess import DrivingCoverage
from tilth.estimator.calibration.verdict import IDENTIFIED, NumberVerdict, _not_covered, soil_cost
from tilth.estimator.filters.unknowns import AT, NAMES, SIX
from tilth.schemas.flow import PARAMETERS


@pytest.mark.parametrize("published", [0.002, 0.008, 0.03])
def test_what_numbers_cost_goes_with_the_sds_that_are_published(published: float) -> None:
    """A fit that knows the scale to 0.2 %, and C_af by 10 times the scale beside 1 % of its own."""
    covariance = np.diag(np.full(len(NAMES), 1e-12))
    gain, c_af = AT["wheel_gain"], SIX.start
    covariance[gain, gain] = 0.002**2
    covariance[c_af, gain] = covariance[gain, c_af] = 10.0 * 0.002**2
    covariance[c_af, c_af] = 0.01**2 + (10.0 * 0.002) ** 2
    numbers = [NumberVerdict(priors.NUMBER["wheel_gain"], 0.0, published, None, None, IDENTIFIED)]
    whole, share = soil_cost(covariance, MACHINE, numbers)[PARAMETERS[0]]
    assert share == pytest.approx(10.0 * published, rel=1e-3)
    assert whole == pytest.approx(math.hypot(0.01, 10.0 * published), rel=1e-3)


@pytest.mark.parametrize(
    ("there", "back", "one_way"), [(0, 4, False), (0, 3, False), (7, 2, False), (0, 0, True), (0, 2, True)]
)
def test_there_and_back_need_not_be_on_one_line(there: int, back: int, one_way: bool) -> None:
    """Eighths of all directions; where only one way was driven a slope is taken for yaw of the pairs."""
    eighths = np.zeros(8)
    eighths[there] += 40.0
    eighths[back] += 30.0
    said = list(_not_covered(DrivingCoverage(eighths, 60.0, 60.0, 60.0, 60.0), np.zeros(3)))
    assert [one.startswith("Straight driving in one direction") for one in said] == [True] * one_way
