"""Steering that reacts to the rig raises the warning, planned steering does not."""

from collections.abc import Callable

import numpy as np
import pytest
from steered_drives import TRUE, guided, open_loop

from tilth.analysis.response.feedback import SHARE, check_loop, predicted_by
from tilth.analysis.response.response import DriveSamples, measured_response
from tilth.estimator.models.parameters import TABLE_7_2, Rig

SEEDS = 15


def warnings(drive: Callable[[int], DriveSamples], rig: Rig) -> int:
    return sum(measured_response(drive(seed), {"rig": rig}).loop.closed for seed in range(SEEDS))


@pytest.mark.parametrize("rig", [TRUE, TABLE_7_2], ids=["right", "wrong"])
def test_planned_steering_raises_none(rig: Rig) -> None:
    assert warnings(lambda seed: open_loop(seed, seconds=120.0, wheel_noise=np.radians(0.1)), rig) == 0


def test_guidance_raises_it() -> None:
    assert warnings(guided, TRUE) == SEEDS
    assert measured_response(guided(1), {"rig": TABLE_7_2}).loop.closed  # with a wrong model as well


def test_the_p_value_of_the_test_is_uniform() -> None:
    """Of white input and autocorrelated, independent residuals."""
    low = 0
    for seed in range(300):
        rng = np.random.default_rng(seed)
        e = np.cumsum(rng.normal(size=(400, 2)), axis=0)
        found = predicted_by(rng.normal(size=(400, 1)), e)
        assert found is not None
        low += found[0] < 0.1
    assert 0.06 < low / 300 < 0.14


def test_the_share_is_what_residuals_predict() -> None:
    rng = np.random.default_rng(1)
    e = rng.normal(size=(4000, 1))
    u = np.zeros((4000, 1))
    u[2:] = e[:-2]  # two blocks later
    found = predicted_by(u + rng.normal(size=u.shape), e)
    assert found is not None and found[1] == pytest.approx(0.5, abs=0.03) and found[0] < 1e-9
    ahead = predicted_by(
        np.roll(e, -2, axis=0) + rng.normal(size=u.shape), e
    )  # what residuals follow is no feedback
    assert ahead is not None and ahead[1] < SHARE


def test_too_little_says_so_and_a_known_guidance_needs_no_test() -> None:
    short = check_loop(np.zeros(100), np.zeros((100, 1)), 0.05)
    assert not short.closed and short.p_value is None and "too short" in short.sentence
    still = check_loop(np.zeros(40000), np.zeros((40000, 1)), 0.05)
    assert not still.closed and still.p_value is None
    known = check_loop(np.zeros(100), np.zeros((100, 1)), 0.05, automatic=True)
    assert known.closed and "guidance" in known.sentence
