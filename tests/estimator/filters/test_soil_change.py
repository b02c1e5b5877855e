"""A change of soil is told from chance, and from what has learned next to nothing."""

import numpy as np
import pytest

from tilth.estimator.filters import soil_change
from tilth.estimator.filters.soil_change import Checkpoint


@pytest.mark.parametrize("change", [0.0, -0.6])
def test_the_statistic_tells_a_change_from_chance(change: float) -> None:
    """A filter of six constants, of which one sample in each step shows a sum with random weights."""
    rng = np.random.default_rng(4)
    largest = []
    for _ in range(20):
        truth, mean, covariance = np.zeros(6), 0.7 * rng.normal(size=6), 0.49 * np.eye(6)
        checkpoints: list[Checkpoint] = []
        found = 0.0
        for k in range(120):
            if k == 100:
                truth = truth + change * np.array([1, 1, 1, 0, 0, 0])
            h = rng.normal(size=6)
            gain = covariance @ h / (h @ covariance @ h + 0.3**2)
            mean = mean + gain * (h @ (truth - mean) + 0.3 * rng.normal())
            covariance = covariance - np.outer(gain, h @ covariance)
            likeliest = soil_change.likeliest_change(checkpoints, mean, covariance)
            found = max(found, likeliest.ratio if likeliest and k >= 100 else 0.0)
            checkpoints = [*checkpoints, Checkpoint(mean, covariance)][
                -soil_change.SOIL_CHANGE.most_checkpoints :
            ]
        largest.append(found)
    assert np.mean(np.array(largest) > soil_change.SOIL_CHANGE.changed) == (1.0 if change else 0.0)


def test_what_has_moved_by_more_than_it_has_learned_is_no_change_of_soil() -> None:
    """A stiffness that moved by its sd while it learned next to nothing: no soil explains it, be it a
    hundredth of the stiffness."""
    before, after = 0.01 * np.eye(6), 0.01 * np.eye(6)
    after[0, 0] *= 0.995
    checkpoints = [Checkpoint(np.zeros(6), before)]
    change = soil_change.likeliest_change(checkpoints, np.array([-0.1, *[0.0] * 5]), after)
    assert change is not None
    assert change.ratio < soil_change.SOIL_CHANGE.changed
    assert np.abs(change.logs).max() == soil_change.SOIL_CHANGE.most_change
