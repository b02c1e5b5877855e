"""What a steady turn is expected to show."""

import math
from dataclasses import replace
from typing import Final

import numpy as np
import pytest
from settled import MACHINE, driven_on, point_of, seen, settled_rolling

from tilth.estimator.filters import steady_outputs
from tilth.estimator.filters.states import X_DISTURBANCE, X_ROLL
from tilth.estimator.filters.steady_outputs import (
    INPUTS,
    OUTPUTS,
    largest_slip,
    linearised,
    outputs,
)
from tilth.estimator.record.steady_driving import SteadySample


@pytest.mark.parametrize(
    ("known", "inputs"),
    [
        ({"wheel_zero": 0.01, "rolling": 0.05, "curvature": 1.2}, (2.5, 0.45, 0.02, -0.03, 0.05)),
        ({"wheel_gain": 0.03, "camber": 0.3, "cg_t": 0.1, "lever_t": 0.2}, (1.6, -0.5, 0.07, 0.07, -0.08)),
        ({"d": 0.1, "e": 0.3, "curvature": 0.6, "parallel": 0.5}, (4.5, 0.12, -0.05, 0.0, 0.01)),
    ],
)
def test_its_jacobian_is_that_of_the_outputs(known: dict[str, float], inputs: tuple[float, ...]) -> None:
    point = point_of(**known)
    given = dict.fromkeys(SteadySample.__dataclass_fields__, 0.0)
    sample = SteadySample(**(given | dict(zip(INPUTS, inputs, strict=True))))
    z, over_constants, over_inputs = linearised(point, sample, MACHINE)
    assert z == pytest.approx(outputs(point[None], np.array([inputs]), MACHINE)[0], abs=1e-12)
    whole, n = np.concatenate([point, inputs]), len(point)
    for k, found in enumerate(np.hstack([over_constants, over_inputs]).T):
        nudge = 1e-4 * (np.arange(len(whole)) == k)
        rows = np.array([whole + nudge, whole - nudge])
        after, before = outputs(rows[:, :n], rows[:, n:], MACHINE)
        assert found == pytest.approx((after - before) / 2e-4, abs=1e-6)


TURNS_AT_ALL_ANGLES: Final = ((4.0, 4.5), (-14.0, 3.0), (22.0, 2.1), (-30.0, 1.6), (32.0, 2.1))
"""Degrees of the wheels and m/s."""


@pytest.mark.parametrize("slope", [0.0, math.radians(4.0)])
@pytest.mark.parametrize(("degrees", "speed"), TURNS_AT_ALL_ANGLES)
def test_what_it_expects_is_what_the_rolling_model_settles_to(
    degrees: float, speed: float, slope: float
) -> None:
    """Both bodies roll on their tyres until nothing changes; what is measured is slope and lean."""
    point, delta = point_of(rolling=0.06, camber=0.2, parallel=0.4), math.radians(degrees)
    at = settled_rolling(point, speed, delta, slope)
    measured = np.array([[speed, delta, slope + at["phi_t"], slope + at["phi_i"], 0.0]])
    assert outputs(point[None], measured, MACHINE)[0] == pytest.approx(seen(at), rel=1e-5)


@pytest.mark.parametrize(("degrees", "speed"), TURNS_AT_ALL_ANGLES)
def test_the_largest_slip_is_that_of_the_tyres(degrees: float, speed: float) -> None:
    zero, delta = 0.02, math.radians(degrees)
    at = settled_rolling(point_of(), speed, delta, 0.0)
    given: dict[str, float] = dict.fromkeys(SteadySample.__dataclass_fields__, 0.0)
    given |= dict(zip(OUTPUTS[:2], seen(at)[:2].tolist(), strict=True))
    sample = SteadySample(**(given | {"u": speed, "v": at["v"], "wheel_angle": delta + zero}))
    largest = max(abs(at[f"alpha_{axle}"]) for axle in "fri")
    assert largest_slip(sample, zero, MACHINE) == pytest.approx(largest, rel=1e-4)
    assert largest_slip(replace(sample, v=None), zero, MACHINE) == 0.0


@pytest.mark.parametrize("folding", [0.06, -0.06])
@pytest.mark.parametrize(("degrees", "speed"), TURNS_AT_ALL_ANGLES)
def test_a_rig_that_folds_goes_on_as_expected(degrees: float, speed: float, folding: float) -> None:
    """From the turn that is expected at some folding the rolling model drives on for half a second. What is
    expected there, at the folding that is left, is where it is: to a tenth of what folding makes out."""
    point, delta = point_of(rolling=0.06, camber=0.2), math.radians(degrees)
    turn = steady_outputs._solved(point, np.array([speed, delta, 0.0, 0.0, folding]), MACHINE)[0].x
    slopes = -turn[X_ROLL : X_ROLL + 2]  # measured roll is 0
    at = driven_on(point, turn[:X_DISTURBANCE], speed, delta, slopes, 0.5)
    measured = [speed, delta, slopes[0] + at["phi_t"], slopes[1] + at["phi_i"]]
    without, left = (
        outputs(point[None], np.array([[*measured, rate]]), MACHINE)[0] - seen(at)
        for rate in (0.0, at["r_t"] - at["r_i"])
    )
    assert abs(without[1]) > 0.02
    assert abs(left[1]) < 0.1 * abs(without[1])
    assert np.abs(left[[0, 2]]).max() < 5e-4
