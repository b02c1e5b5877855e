"""Points from indices: the same however the work is shared out."""

import numpy as np
import pytest

from tilth.analysis.sensitivity.designs import (
    DISSERTATION,
    ParameterBox,
    checked,
    grid,
    grid_levels,
    grid_size,
    log_normal,
    uniform,
)

TWO = ParameterBox(("C_af", "m_i"), (1.0, 10.0), (2.0, 30.0))


def test_the_grid_has_every_corner_once() -> None:
    assert grid_size(DISSERTATION) == 390_625
    points = grid(TWO, 0, 9, 3)
    assert len(np.unique(points, axis=0)) == 9
    assert points.min(axis=0).tolist() == [1.0, 10.0]
    assert points.max(axis=0).tolist() == [2.0, 30.0]
    assert grid_levels(TWO, 5, 6, 3).tolist() == [[1, 2]]


@pytest.mark.parametrize("cut", [1, 1000, 1024, 1500])
def test_points_do_not_depend_on_how_they_are_shared_out(cut: int) -> None:
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    whole, parts = uniform(TWO, 3, 0, 2000), [uniform(TWO, 3, 0, cut), uniform(TWO, 3, cut, 2000)]
    np.testing.assert_array_equal(whole, np.concatenate(parts))
    drawn = log_normal((1, 2), covariance, 3, 0, 2000)
    parts = [log_normal((1, 2), covariance, 3, *ends) for ends in ((0, cut), (cut, 2000))]
    np.testing.assert_allclose(drawn, np.concatenate(parts), rtol=1e-14)
    assert len(uniform(TWO, 3, 5, 5)) == 0


def test_log_normal_points_have_their_median_and_covariance() -> None:
    covariance = np.array([[0.04, 0.03], [0.03, 0.09]])
    logs = np.log(log_normal((1, 2), covariance, 1, 0, 40_000))
    np.testing.assert_allclose(np.exp(np.median(logs, axis=0)), (1, 2), rtol=0.01)
    np.testing.assert_allclose(np.cov(logs.T), covariance, rtol=0.04)


@pytest.mark.parametrize("wrong", [[[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.2, 1.0]]])
def test_a_covariance_that_is_none_is_refused(wrong: list[list[float]]) -> None:
    with pytest.raises(ValueError, match="not positive definite"):
        log_normal((1, 2), np.array(wrong), 1, 0, 1)


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (2.0, 1.0), (1.0, float("inf"))])
def test_a_box_that_is_none_is_refused(low: float, high: float) -> None:
    with pytest.raises(ValueError, match="C_af: from"):
        checked(ParameterBox(("C_af",), (low,), (high,)))
