"""Degrees and metres: beside PROJ, and without the rounding of a distance from the equator."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilth.estimator.pose.geometry import to_degrees, to_plane


@given(
    st.floats(-80.0, 80.0), st.floats(-180.0, 180.0), st.floats(-3500.0, 3500.0), st.floats(-3500.0, 3500.0)
)
def test_metres_are_those_of_proj(latitude: float, longitude: float, x: float, y: float) -> None:
    origin = latitude, longitude
    assert math.dist(to_plane(origin, *to_degrees(origin, x, y)), (x, y)) < 1e-4


@pytest.mark.parametrize("latitude", [-75.0, -33.5, 0.0, 52.5])
def test_steps_of_a_millimetre_are_even(latitude: float) -> None:
    """A step is a fraction of a degree that is exact in binary; PROJ's differ by 1e-9 m."""
    step = 2.0**-27
    at = [to_plane((latitude, 5.0), latitude + k * step, 5.0 + k * step) for k in range(1000)]
    assert np.abs(np.diff(at, n=2, axis=0)).max() < 1e-12


def test_the_date_line_is_no_distance() -> None:
    north, east = to_plane((-17.0, 179.9999), -17.0, -179.9999)
    assert (north, east) == pytest.approx((0.0, 21.3), abs=0.05)


def test_what_is_no_number_is_nowhere() -> None:
    assert all(math.isnan(value) for value in to_plane((52.5, 5.0), math.nan, 5.0))
