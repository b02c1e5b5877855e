"""At which flank of its play a wheel sensor's linkage is, by its readings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tilth.estimator.filters.sensors.wheel_play import flanks
from tilth.estimator.filters.states import DT


def test_where_the_wheels_go_to_and_fro_the_flank_follows_the_way_of_the_last_motion() -> None:
    at = DT * np.arange(1500)
    found = flanks(np.radians(0.5) * np.sin(2.0 * np.pi * 0.2 * at))
    way = np.cos(2.0 * np.pi * 0.2 * at)
    fast = np.abs(way) > 0.7
    np.testing.assert_array_equal(np.sign(found[fast][50:-50]), np.sign(way[fast][50:-50]))
    assert np.abs(found).max() <= 1.0


@pytest.mark.parametrize("rest_s", [1.0, 5.0])
def test_a_linkage_that_rests_crosses_just_before_it_moves_again(rest_s: float) -> None:
    """Up, a rest, down: the wheels rested too, at the flank of the way up."""
    n = round(rest_s / DT)
    up = np.linspace(0.0, np.radians(1.0), 50)
    found = flanks(np.concatenate([up, np.full(n, up[-1]), up[::-1]]))
    assert np.all(found[60 : 50 + n - 20] == 1.0) and np.all(found[50 + n + 15 :] == -1.0)


@given(st.lists(st.floats(-0.1, 0.1), min_size=1, max_size=300), st.floats(-0.5, 0.5))
def test_any_readings_have_flanks_that_no_zero_changes(values: list[float], zero: float) -> None:
    readings: NDArray[np.float64] = np.rint(1e4 * np.array(values, np.float64)) / 1e4
    found = flanks(readings)
    assert found.shape == readings.shape and np.all(np.abs(found) <= 1.0)
    np.testing.assert_allclose(flanks(-readings), -found, atol=1e-12)
    assert not flanks(np.full(len(values), zero, np.float64)).any()
