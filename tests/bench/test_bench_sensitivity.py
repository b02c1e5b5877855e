"""The compiled loop beside matrix exponentials and a numpy loop, on few points of what the bench checks."""

import numpy as np
import pytest
import sensitivity as bench
from sensitivity_plain import by_salib


@pytest.mark.parametrize("speed", bench.SECONDS)
def test_points_of_the_grid_by_another_integrator(speed: float) -> None:
    """Of the largest change of each output at a point; unstable points too."""
    assert np.max(bench.differences(speed, 40, seed=2)) < 1e-7


def test_what_one_would_write_runs() -> None:
    count, found = by_salib(2, 7.5, 50, "lsim")
    assert count == 18 and len(found) == 6
    assert all(np.isfinite(one["dgsm"]).all() for one in found)
