"""Newton's step on quadratic costs, whose minimum is known, and searches of a bent valley."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.estimator.filters.newton import (
    End,
    Minimum,
    Rule,
    are_two,
    beside,
    flattest,
    minimise,
    newton_step,
    share_of_step,
)

Array = NDArray[np.float64]


def quadratic(seed: int) -> tuple[Array, Array, Array]:
    """(minimum, gradient at zero, information)."""
    rng = np.random.default_rng(seed)
    root, minimum = rng.normal(size=(5, 5)), rng.normal(size=5)
    information = root @ root.T + np.eye(5)
    return minimum, -information @ minimum, information


def half_square(information: Array, by: Array) -> float:
    return float(by @ information @ by) / 2.0


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


@dataclass(frozen=True)
class Valley:
    """Rosenbrock's, as a sum of squares with Gauss's information; its minimum is at (1, 1). wall: no point
    beyond it in the first unknown counts as lower."""

    wall: float = 9.0

    def residuals(self, at: Array) -> Array:
        return np.array([1.0 - at[0], 10.0 * (at[1] - at[0] ** 2)])

    def terms(self, at: Array) -> tuple[Array, Array, Array]:
        slopes = np.array([[-1.0, 0.0], [-20.0 * at[0], 10.0]])
        return at, slopes.T @ self.residuals(at), slopes.T @ slopes

    def after(self, at: Array, change: Array) -> Array | None:
        then = at + change
        before, after = (float(np.sum(self.residuals(here) ** 2)) for here in (at, then))
        return then if after < before and then[0] < self.wall else None

    def taken(self, step: int, at: Array) -> Array:
        return at

    def settled(self, step: int, before: Array, at: Array, sizes: Array) -> bool:
        return bool(np.max(sizes) < 1e-6)


def searched(valley: Valley, most: int = 100, tries: int = 12) -> Minimum[Array]:
    rule = Rule(np.full(2, 0.5), False, 0.2, 1e-9, tries=tries)
    return minimise(valley, np.array([-1.2, 1.0]), rule, most)


def test_a_search_that_settles_has_found_the_minimum_and_never_goes_up() -> None:
    found = searched(Valley())
    assert found.end is End.SETTLED and found.promised < 1e-9
    np.testing.assert_allclose(found.at, 1.0, atol=1e-6)


def test_a_search_that_ends_otherwise_says_so_and_how_far_it_would_go() -> None:
    short, walled = searched(Valley(), 3), searched(Valley(wall=0.3), tries=2)
    assert (short.end, short.steps) == (End.OUT_OF_STEPS, 3)
    assert walled.end is End.STUCK and walled.at[0] < 0.3 and np.max(walled.sizes) > 0.1


@pytest.mark.parametrize("each", [False, True])
def test_no_step_of_a_search_is_longer_than_its_limits(each: bool) -> None:
    rule = Rule(np.array([0.1, 0.02]), each, 0.2, 1e-9, tries=12)
    ends = [minimise(Valley(), np.array([-1.2, 1.0]), rule, most).at for most in range(1, 6)]
    assert (np.abs(np.diff(ends, axis=0)) <= rule.limits + 1e-12).all()


def test_the_flattest_direction_is_one_sd_long_and_the_others_follow() -> None:
    """Along no other change of the same length, in sds, have data narrowed the prior less."""
    root = np.random.default_rng(3).normal(size=(4, 4))
    covariance, prior_sd = root @ root.T + 0.1 * np.eye(4), np.full(4, 5.0)
    told = np.array([True, True, True, False])
    found = flattest(covariance, prior_sd, told)
    assert found @ np.linalg.solve(covariance, found) == pytest.approx(1.0)
    widest = float(np.linalg.eigvalsh(covariance[:3, :3])[-1])
    assert float(np.sum(found[:3] ** 2)) == pytest.approx(widest)


@dataclass(frozen=True)
class TwoHollows:
    """(x^2 - 1)^2 + tilt x, depth nats, beside a parabola: two minima where the tilt is small."""

    tilt: float = 0.0
    depth: float = 4.0
    overshoot: float = 1.0  # of the curvature that Gauss's information has, over the true one

    def cost(self, at: Array) -> float:
        x, y = at
        return float(self.depth * ((x * x - 1.0) ** 2 + self.tilt * x) + 2.0 * (y - 0.3 * x) ** 2)

    def rise(self, at: Array, by: Array) -> float:
        return self.cost(at + by) - self.cost(at)

    def terms(self, at: Array) -> tuple[Array, Array, Array]:
        x, y = at
        of_y = 4.0 * (y - 0.3 * x)
        gradient = np.array([self.depth * (4.0 * x * (x * x - 1.0) + self.tilt) - 0.3 * of_y, of_y])
        bend = max(8.0 * self.depth * self.overshoot, 1.0)
        return at, gradient, np.array([[bend + 0.36, -1.2], [-1.2, 4.0]])

    def after(self, at: Array, change: Array) -> Array | None:
        return at + change if self.cost(at + change) <= self.cost(at) + 0.2 else None

    def taken(self, step: int, at: Array) -> Array:
        return at

    def settled(self, step: int, before: Array, at: Array, sizes: Array) -> bool:
        return bool(np.max(sizes) < 1e-4)


def hollow(problem: TwoHollows, start: Array, secant: bool = False) -> Minimum[Array]:
    return minimise(problem, start, Rule(np.full(2, 0.5), False, 0.2, 1e-9, tries=12, secant=secant), 200)


@pytest.mark.parametrize(
    ("tilt", "two"), [(0.0, True), (0.1, True), (0.25, True), (-0.3, True), (0.6, False)]
)
def test_two_minima_of_a_made_up_cost_are_told(tilt: float, two: bool) -> None:
    """Only where either may be: with a tilt of 0.6 the other is 4.8 nats above."""
    problem = TwoHollows(tilt, depth=1.0 if two else 4.0)
    places = []
    for start in (-1.5, 1.5):
        found = hollow(problem, np.array([start, 0.0])).at
        covariance = np.asarray(np.linalg.inv(problem.terms(found)[2]), np.float64)
        direction = flattest(covariance, np.full(2, 3.0), np.array([True, False]))
        change = beside(partial(problem.rise, found), direction)
        if change is None:
            continue
        other = hollow(problem, found + change).at
        worse = abs(problem.cost(other) - problem.cost(found))
        places.append(are_two((other - found) / np.sqrt(np.diag(covariance)), worse))
    assert any(places) == two


def test_one_minimum_has_no_sign_of_another() -> None:
    for seed in range(20):
        _, _, information = quadratic(seed)
        covariance = np.asarray(np.linalg.inv(information), np.float64)
        direction = flattest(covariance, np.full(5, 3.0), np.arange(5) < 3)
        assert beside(partial(half_square, information), direction) is None


def test_a_search_that_goes_to_and_fro_is_ended_by_a_secant() -> None:
    """Gauss's information has half of the curvature, so that each step goes as far beyond as it came."""
    problem = TwoHollows(overshoot=0.5)
    start = np.array([1.04, 0.3])
    plain, secant = hollow(problem, start), hollow(problem, start, secant=True)
    assert secant.end is End.SETTLED and secant.steps < 12
    assert plain.steps > 5 * secant.steps


@dataclass(frozen=True)
class NoiseLevel:
    """Of 100 residuals of variance 1 the sd, whose logarithm is 0 at the minimum."""

    def terms(self, at: Array) -> tuple[Array, Array, Array]:
        return at, 100.0 * (1.0 - np.exp(-2.0 * at)), np.full((1, 1), 200.0)

    def after(self, at: Array, change: Array) -> Array | None:
        return at + change

    def taken(self, step: int, at: Array) -> Array:
        return at

    def settled(self, step: int, before: Array, at: Array, sizes: Array) -> bool:
        return bool(np.max(sizes) < 1e-6)


@pytest.mark.parametrize(("start", "fewer"), [(1.0, 3), (0.6, 2), (-0.4, 1)])
def test_the_logarithm_of_an_sd_is_found_in_fewer_steps(start: float, fewer: int) -> None:
    plain = Rule(np.full(1, 2.0), False, 0.2, 1e-9)
    found = [
        minimise(NoiseLevel(), np.array([start]), rule, 30)
        for rule in (plain, plain._replace(scales=np.full(1, 10.0)))
    ]
    assert [abs(one.at[0]) < 1e-5 for one in found] == [True, True]
    assert found[1].steps <= found[0].steps - fewer
    known = minimise(NoiseLevel(), np.array([start]), plain._replace(scales=np.zeros(1)), 30)
    assert known.at == found[0].at and known.steps == found[0].steps


def test_a_search_ends_before_a_step_that_it_spares() -> None:
    rule = Rule(np.full(2, 0.5), False, 0.2, 1e-9, tries=12)
    spared = rule._replace(is_spared=lambda promised, sizes: bool(promised < 0.01))
    found = minimise(Valley(), np.array([-1.2, 1.0]), spared, 100)
    assert found.end is End.SETTLED and found.promised < 0.01
    assert found.steps < searched(Valley()).steps
    assert minimise(Valley(), np.array([-1.2, 1.0]), rule, found.steps).at == pytest.approx(found.at)
    at_once = rule._replace(is_spared=lambda promised, sizes: True)
    assert minimise(Valley(), np.array([-1.2, 1.0]), at_once, 100).steps == 1
