"""Tyres: C and sigma are what they are at zero slip; forces end at the grip; slip lags by its length."""

import math

import numpy as np
import pytest

from tilth.simulator.spatial import tyre

C, LIMIT = 100e3, 20e3
force = tyre.side_force.interpreted()
lagged = tyre.lagged.interpreted()
lag_length = tyre.lag_length.interpreted()
ALL = range(len(tyre.CURVES))


@pytest.mark.parametrize("curve", ALL, ids=tyre.CURVES)
def test_the_slope_at_zero_slip_is_the_stiffness(curve: int) -> None:
    for alpha in (1e-6, -1e-6):
        assert -force(curve, alpha, C, LIMIT) / alpha == pytest.approx(C, rel=2e-5)


@pytest.mark.parametrize("curve", ALL, ids=tyre.CURVES)
def test_the_force_opposes_slip_is_odd_and_ends_at_the_grip(curve: int) -> None:
    alphas = np.linspace(0.01, 1.2, 60)
    forces = np.array([force(curve, a, C, LIMIT) for a in alphas])
    assert np.all(forces < 0.0) and np.all(forces >= -LIMIT * 1.001)
    assert forces.min() == pytest.approx(-LIMIT, rel=0.01)
    np.testing.assert_allclose([force(curve, -a, C, LIMIT) for a in alphas], -forces)
    assert np.all(-forces <= C * alphas)
    assert force(curve, 0.1, C, 0.0) == 0.0


def test_the_curves_differ_where_tyres_do() -> None:
    bent = [force(curve, 0.3, C, LIMIT) for curve in ALL]
    assert np.abs(np.diff(sorted(bent))).min() > 0.01 * LIMIT


def test_exponential_brush_and_tanh_are_their_published_forms() -> None:
    """By their own letters: 5.34; brush with theta = C / (3 mu N); A N tanh."""
    alpha, s = 0.08, C * 0.08 / LIMIT
    assert -force(0, alpha, C, LIMIT) == pytest.approx(LIMIT * (1 - math.exp(-s)))
    assert -force(1, alpha, C, LIMIT) == pytest.approx(LIMIT * math.tanh(s))
    slide = C * alpha / (3 * LIMIT)
    assert -force(2, alpha, C, LIMIT) == pytest.approx(LIMIT * (3 * slide - 3 * slide**2 + slide**3))
    assert force(2, 0.7, C, LIMIT) == -LIMIT  # sliding all over


def test_stiffness_grows_with_load() -> None:
    at = tyre.stiffness_at.interpreted()
    assert at(C, 20e3, 20e3, 0.8) == C
    assert at(C, 40e3, 20e3, 0.8) == pytest.approx(C * 2**0.8)
    assert at(C, 0.0, 20e3, 0.8) == 0.0


def test_drive_takes_side_force_by_an_ellipse() -> None:
    left = tyre.side_share.interpreted()
    assert [left(f, LIMIT) for f in (0.0, 0.6 * LIMIT, -0.6 * LIMIT, 2 * LIMIT)] == pytest.approx(
        [1, 0.8, 0.8, 0]
    )


@pytest.mark.parametrize("speed", [0.5, 4.5, -4.5])
@pytest.mark.parametrize("sigma", [0.7, 1.5])
def test_a_step_of_slip_shows_the_relaxation_length(speed: float, sigma: float) -> None:
    """63.2 % of the way after sigma of travel, whatever the speed, forward and in reverse."""
    wanted, step = 0.02, 1e-3
    slip, way = 0.0, 0.0
    while slip < (1 - math.exp(-1)) * wanted:
        slip = lagged(slip, speed, wanted * abs(speed), sigma, step)
        way += abs(speed) * step
    assert way == pytest.approx(sigma, abs=2 * abs(speed) * step)


def test_a_standing_tyre_is_a_spring() -> None:
    slip = 0.0
    for _ in range(100):
        slip = lagged(slip, 0.0, 0.01, 0.8, 1e-2)
    assert slip == pytest.approx(0.01 / 0.8)
    assert lagged(0.0, 0.0, 1e3, 0.8, 1.0) == tyre.MOST_SLIP


@pytest.mark.parametrize("curve", ALL, ids=tyre.CURVES)
def test_a_string_is_shorter_when_it_slips(curve: int) -> None:
    still, little, more, much = (lag_length(True, 1.5, curve, a, C, LIMIT) for a in (0.0, 1e-4, 0.2, 1.5))
    assert still == 1.5
    assert little == pytest.approx(1.5, rel=1e-3)
    assert 1.5 * tyre.SHORTEST <= much < more < little
    assert lag_length(False, 1.5, curve, 0.2, C, LIMIT) == 1.5
