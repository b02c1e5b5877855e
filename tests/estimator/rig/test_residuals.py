"""Residuals are zero where the numbers are right, their slopes are those of differences, one is as many."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.estimator.rig import residuals
from tilth.estimator.rig.geometry import rotate

Array = NDArray[np.float64]

RIGS = 40
STEP = 1e-6


class Drawn(NamedTuple):
    """Rigs of any kind in any motion, and one that creeps: RIGS of each."""

    levers: Array  # (n, 2 bodies, 2, 2): front and rear, forward and right
    places: Array  # (n, 2): of the hitch
    headings: Array  # (n, 2)
    velocity: Array  # (n, 2, 2, 2): of the antennas, in the axes of their body
    hitch: Array  # (n, 2): north and east
    late: Array  # (n, 2, 2): s, by which the data are later than taken for


def _drawn(seed: int = 1) -> Drawn:
    rng = np.random.default_rng(seed)
    levers = np.empty((RIGS, 2, 2, 2))
    levers[:, :, 0, 0], levers[:, :, 1, 0] = rng.uniform(0.3, 3.0, (2, RIGS, 2)) * [[[1.0]], [[-1.0]]]
    levers[..., 1] = rng.uniform(-0.8, 0.8, (RIGS, 2, 2))
    places = np.column_stack([rng.uniform(-4.0, -0.5, RIGS), rng.uniform(1.0, 8.0, RIGS)])
    velocity = (
        rng.uniform(-4.0, 4.0, (RIGS, 2, 2, 2))
        * np.where(rng.random(RIGS) < 0.2, 0.01, 1.0)[:, None, None, None]
    )
    return Drawn(
        levers, places, rng.uniform(-math.pi, math.pi, (RIGS, 2)), velocity,
        rng.uniform(-500.0, 500.0, (RIGS, 2)), rng.uniform(-0.2, 0.2, (RIGS, 2, 2)),
    )  # fmt: skip


def _points(drawn: Drawn) -> Array:
    """(n, 2, 2, 2): body, front and rear, north and east: what receivers report that are late."""
    points = np.empty((RIGS, 2, 2, 2))
    for body in (0, 1):
        for k in (0, 1):
            arm = drawn.levers[:, body, k] - np.stack([drawn.places[:, body], np.zeros(RIGS)], axis=-1)
            arm = arm - drawn.late[:, body, k, None] * drawn.velocity[:, body, k]
            north, east = rotate((arm[:, 0], arm[:, 1]), drawn.headings[:, body])
            points[:, body, k] = drawn.hitch + np.stack([north, east], axis=-1)
    return points


def _residuals(points: Array, levers: Array, places: Array) -> Array:
    """(n, 4): both excesses, the gap ahead and to the right."""
    found, hitches, heading = [], [], np.zeros(len(points))
    for body in (0, 1):
        (front, rear), arms = points[:, body].swapaxes(0, 1), levers[:, body].swapaxes(0, 1)
        ends = (front[:, 0], front[:, 1]), (rear[:, 0], rear[:, 1])
        levers_of = (arms[0][:, 0], arms[0][:, 1]), (arms[1][:, 0], arms[1][:, 1])
        pair = residuals.pair_of(*ends, *levers_of)
        found.append(pair.excess)
        hitches.append(residuals.seen_hitch(*ends, *levers_of, pair.heading, places[:, body]))
        heading = pair.heading
    return np.column_stack([*found, *residuals.hitch_gap(hitches[0], hitches[1], heading)])


def test_nothing_is_left_over_where_the_numbers_are_right() -> None:
    drawn = _drawn()._replace(late=np.zeros((RIGS, 2, 2)))
    assert _residuals(_points(drawn), drawn.levers, drawn.places) == pytest.approx(
        np.zeros((RIGS, 4)), abs=1e-12
    )


def test_slopes_of_length_and_gap_are_those_of_differences() -> None:
    """Over every lever, latency and place of the hitch, also where the numbers are wrong."""
    drawn = _drawn()
    wrong = np.random.default_rng(2).normal(0.0, 0.1, (RIGS, 2, 2, 2))
    levers, points = drawn.levers + wrong, _points(drawn)
    excess, gap = np.split(_residuals(points, levers, drawn.places), 2, axis=1)
    pairs = [
        residuals.pair_of(*((points[:, b, k, 0], points[:, b, k, 1]) for k in (0, 1)),
                          *((levers[:, b, k, 0], levers[:, b, k, 1]) for k in (0, 1)))
        for b in (0, 1)
    ]  # fmt: skip
    slopes = []
    worlds = np.empty_like(points)  # velocities, north and east
    for body, pair in enumerate(pairs):
        moved = drawn.velocity[:, body]
        turned = drawn.headings[:, body] - pair.heading  # a wrong pair has other axes
        axes = np.stack([np.stack(rotate((moved[:, k, 0], moved[:, k, 1]), turned), -1) for k in (0, 1)], 1)
        worlds[:, body] = np.stack(
            [np.stack(rotate((axes[:, k, 0], axes[:, k, 1]), pair.heading), -1) for k in (0, 1)], 1
        )
        slopes.append(
            residuals.pair_slopes(
                residuals.pair_geometry(levers[:, body], drawn.places[:, body]), axes, excess[:, body]
            )
        )
    expected = np.zeros((RIGS, 4, 14))
    for body in (0, 1):
        for k in range(7):
            for sign in (1.0, -1.0):
                at, arms, places = points.copy(), levers.copy(), drawn.places.copy()
                if k < 4:
                    arms[:, body, k // 2, k % 2] += sign * STEP
                elif k < 6:
                    at[:, body, k - 4] += sign * STEP * worlds[:, body, k - 4]
                else:
                    places[:, body] += sign * STEP
                expected[:, :, 7 * body + k] += sign * _residuals(at, arms, places) / (2.0 * STEP)
    for body, found in enumerate(slopes):
        own = expected[:, body, 7 * body : 7 * body + 7]
        assert found.excess == pytest.approx(own, abs=1e-6)
    articulation = pairs[0].heading - pairs[1].heading
    by_place = residuals.gap_by_place(articulation, np.zeros(RIGS))
    of_gap = residuals.gap_slopes(slopes[0], slopes[1], by_place, gap)
    assert of_gap == pytest.approx(expected[:, 2:], abs=1e-6)


def test_shares_are_how_far_the_hitch_goes_across_with_each_antenna() -> None:
    drawn = _drawn()
    for one in range(RIGS):
        (front, rear), place = drawn.levers[one, 0], float(drawn.places[one, 0])
        arm = front - rear
        across = np.array([-arm[1], arm[0]]) / np.hypot(*arm)
        slopes = residuals.pair_slopes(
            residuals.pair_geometry(drawn.levers[one, 0], np.array(place)), np.zeros((2, 2)), np.array(0.0)
        )
        shares = residuals.hitch_shares(tuple(front.tolist()), tuple(rear.tolist()), place)
        assert -across @ slopes.hitch[:, 0:2] @ across == pytest.approx(shares[0])
        assert -across @ slopes.hitch[:, 2:4] @ across == pytest.approx(shares[1])


def test_a_pair_that_is_turned_changes_its_heading_and_not_its_length() -> None:
    drawn = _drawn()
    levers = drawn.levers[:, 0]
    slopes = residuals.pair_slopes(
        residuals.pair_geometry(levers, drawn.places[:, 0]), drawn.velocity[:, 0], np.zeros(RIGS)
    )
    turn = residuals.pair_turn(levers)
    assert (slopes.heading[:, residuals.LEVERS] * turn).sum(axis=1) == pytest.approx(-np.ones(RIGS))
    assert (slopes.excess[:, residuals.LEVERS] * turn).sum(axis=1) == pytest.approx(np.zeros(RIGS), abs=1e-12)


VALUES: list[tuple[Callable[..., object], int]] = [
    (residuals.sideways, 3),
    (residuals.path_angle, 3),
    (residuals.wheel_off, 6),
    (lambda a, b, c, d, e, f, g, h: residuals.pair_of((a, b), (c, d), (e, f), (g, h)), 8),
    (lambda a, b, c, d, e, f, g, h, i, k: residuals.seen_hitch((a, b), (c, d), (e, f), (g, h), i, k), 10),
    (lambda a, b, c, d, e: residuals.hitch_gap((a, b), (c, d), e), 5),
    (lambda a, b, c, d, e: residuals.hitch_shares((a, b), (c, d), e), 5),
]


@pytest.mark.parametrize(("value", "count"), VALUES)
def test_many_are_as_one(value: Callable[..., object], count: int) -> None:
    given = np.random.default_rng(count).uniform(0.1, 4.0, (count, 3, 5))
    many = np.asarray(value(*given))
    for k in np.ndindex(3, 5):
        one = np.asarray(value(*given[(slice(None), *k)].tolist()))
        assert many[(..., *k)] == pytest.approx(one, rel=1e-13, abs=1e-15)


def test_slopes_of_the_wheel_angle_are_those_of_differences() -> None:
    rng = np.random.default_rng(3)
    path, lateral, zero, gain, under = rng.normal(0.0, 0.3, (5, RIGS))
    slopes = residuals.wheel_slopes(path, lateral)
    none = residuals.wheel_off(np.zeros(RIGS), path, lateral, zero, gain, under)
    assert none == pytest.approx(-np.einsum("nk,kn->n", slopes, np.stack([zero, gain, under])))


def test_slopes_of_an_axle_are_those_of_differences() -> None:
    """A pair whose file has it turned clockwise shows the body turned the other way."""
    rng = np.random.default_rng(4)
    u, v, r, ahead = rng.uniform(0.5, 4.0, (4, RIGS))

    def off(turned: float, further: float) -> Array:
        _, across = rotate((u, v), np.full(RIGS, turned))
        return residuals.sideways(across, r, ahead + further)

    slopes = residuals.sideways_slopes(u, r)
    assert (off(STEP, 0.0) - off(-STEP, 0.0)) / (2.0 * STEP) == pytest.approx(slopes[:, 0], abs=1e-6)
    assert (off(0.0, STEP) - off(0.0, -STEP)) / (2.0 * STEP) == pytest.approx(slopes[:, 1], abs=1e-6)


def test_wheels_that_are_known_to_turn_faster_leave_nothing_over() -> None:
    assert residuals.speed_off(2.06, 2.0, 1.03) == pytest.approx(0.0, abs=1e-12)
    near = (residuals.speed_off(2.0, 2.0, 1.03 + STEP) - residuals.speed_off(2.0, 2.0, 1.03 - STEP)) / 2e-6
    assert near == pytest.approx(-1.0 / 1.03)
