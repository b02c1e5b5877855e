"""Soil's drift over distance, of some unknowns among others."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.estimator.filters.drift import drift


@pytest.mark.parametrize("places", [slice(0, 6), np.array([1, 4, 8])])
def test_the_drift_is_that_of_a_linear_process_whose_stationary_covariance_is_the_priors(
    places: NDArray[np.int64] | slice,
) -> None:
    rng = np.random.default_rng(2)
    root, sd, share = rng.normal(size=(9, 9)), rng.uniform(0.1, 2.0, 9), 0.7
    before = root @ root.T
    F, Q = np.ones(9), np.zeros(9)
    F[places], Q[places] = share, (1.0 - share**2) * sd[places] ** 2
    after = before.copy()
    drift(after, places, share, sd)
    np.testing.assert_allclose(after, np.diag(F) @ before @ np.diag(F) + np.diag(Q), rtol=1e-14)
    for _ in range(200):
        drift(after, places, share, sd)
    assert np.diag(after)[places] == pytest.approx(sd[places] ** 2)
