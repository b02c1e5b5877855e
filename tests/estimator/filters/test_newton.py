"""Newton's step on quadratic costs, whose minimum is known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.estimator.filters.newton import newton_step, share_of_step

Array = NDArray[np.float64]


def quadratic(seed: int) -> tuple[Array, Array, Array]:
    """(minimum, gradient at zero, information)."""
    rng = np.random.default_rng(seed)
    root, minimum = rng.normal(size=(5, 5)), rng.normal(size=5)
    information = root @ root.T + np.eye(5)
    return minimum, -information @ minimum, information


@pytest.mark.parametrize("seed", range(5))
def test_a_step_ends_where_the_cost_is_least(seed: int) -> None:
    minimum, gradient, information = quadratic(seed)
    step = newton_step(gradient, information)
    np.testing.assert_allclose(step.change, minimum, rtol=1e-9)
    np.testing.assert_allclose(step.sds**2, np.diag(np.linalg.inv(information)), rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_what_may_not_move_stays_and_the_others_go_to_the_least_beside_it(seed: int) -> None:
    _, gradient, information = quadratic(seed)
    moving = np.array([True, False, True, True, False])
    change = newton_step(gradient, information, moving=moving).change
    left = gradient + information @ change
    assert not change[~moving].any()
    np.testing.assert_allclose(left[moving], 0.0, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_long_step_is_shortened_in_its_direction_and_damping_shortens_it_too(seed: int) -> None:
    minimum, gradient, information = quadratic(seed)
    limits = np.array([0.1, 0.2, 0.3, 0.1, 0.2])
    change = newton_step(gradient, information, limits=limits).change
    assert np.max(np.abs(change) / limits) == pytest.approx(1.0)
    np.testing.assert_allclose(change / np.linalg.norm(change), minimum / np.linalg.norm(minimum), rtol=1e-9)
    damped = newton_step(gradient, information, damping=1e6).change
    assert np.linalg.norm(damped) < 1e-3 and damped @ gradient < 0.0


def test_later_steps_are_halved() -> None:
    assert [share_of_step(k, 4) for k in range(4)] == [1.0, 1.0, 0.5, 0.5]
