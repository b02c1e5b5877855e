"""How soil differed along the way of one window, by the pieces of its fit."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.estimator.filters import soil_within
from tilth.estimator.filters.soil_field import SOIL_FIELD, VARIOGRAMS, SoilMemory, SoilWindow, Told
from tilth.estimator.filters.soil_within import SOIL_WITHIN, Pieces, SoilWithinTuning, likelihoods

Array = NDArray[np.float64]
PRIOR_SD = np.full(6, 0.5)
COUNT = 10
PIECE_SD = np.array([0.1, 0.1, 0.2, 0.4, 0.4, 0.5])
NO_WIDER = np.ones(6)


def pieces(logs: Array, piece_sd: Array = PIECE_SD) -> Pieces:
    """Of 10 m each to the north. logs: (COUNT, 6), what each asks for beside the fit."""
    information = np.tile(np.diag(piece_sd**-2.0), (COUNT, 1, 1))
    behind = np.array([2.0, 0.0, -7.0])
    north = (
        10.0 * np.arange(COUNT)[:, None, None] + np.linspace(0.0, 10.0, SOIL_FIELD.points)[:, None] + behind
    )
    ways = np.stack([north, np.zeros_like(north)], axis=-1)
    return Pieces(np.einsum("pij,pj->pi", information, logs), information, ways)


def patchy(within: Array) -> float:
    """Probability that soil differs by more than the least of the sds, after this window alone."""
    told = Told(np.zeros((6, 6)), np.zeros(6), np.zeros(6), within)
    path = np.zeros((SOIL_FIELD.points, 3, 2))
    return SoilMemory([SoilWindow("pem", 0, 0, path, told)], PRIOR_SD).patchy


def by_chance(seed: int, scatter: float = 1.0) -> Array:
    return scatter * PIECE_SD * np.random.default_rng(seed).standard_normal((COUNT, 6))


@pytest.mark.parametrize("seed", range(5))
def test_one_window_on_one_soil_tells_that_it_is_one(seed: int) -> None:
    """Before, nothing was known of it until there was a second window."""
    told = likelihoods(pieces(by_chance(seed)), NO_WIDER, PRIOR_SD)
    assert patchy(np.zeros(len(VARIOGRAMS))) == pytest.approx(0.5)
    assert patchy(told) < 0.25
    # It may lie in one zone of a field that differs from zone to zone.
    assert told.min() > math.log(SOIL_WITHIN.zones / 3.0)
    assert told.max() == 0.0 and told.shape == (len(VARIOGRAMS),)


@pytest.mark.parametrize("seed", range(5))
def test_one_window_over_patches_tells_of_patches(seed: int) -> None:
    softer = np.zeros((COUNT, 6))
    softer[:, :3] = 0.4 * np.sin(2.0 * math.pi * (np.arange(COUNT) / 5.0 + 0.1 * seed))[:, None]
    told = likelihoods(pieces(by_chance(seed) + softer), NO_WIDER, PRIOR_SD)
    assert patchy(told) > 0.95


def test_noise_that_is_larger_than_thought_is_no_soil(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lengths scatter as far as stiffnesses, and axles each by itself."""

    def told() -> float:
        drawn = (pieces(by_chance(seed, 2.5)) for seed in range(10))
        return float(np.mean([patchy(likelihoods(each, NO_WIDER, PRIOR_SD)) for each in drawn]))

    assert told() < 0.6
    monkeypatch.setattr(soil_within, "SOIL_WITHIN", SoilWithinTuning(noise=(1.0,)))
    assert told() > 0.95


def test_a_window_that_tells_little_leaves_it_open() -> None:
    told = likelihoods(pieces(by_chance(0) * 10.0, 10.0 * PIECE_SD), NO_WIDER, PRIOR_SD)
    assert patchy(told) == pytest.approx(0.5, abs=0.05)


def test_where_all_pieces_are_together_is_told_by_the_window_as_a_whole() -> None:
    logs = by_chance(1)
    one, other = (likelihoods(pieces(logs + shift), NO_WIDER, PRIOR_SD) for shift in (0.0, 0.1))
    assert one == pytest.approx(other, abs=0.3)


def test_a_way_may_lie_anywhere_and_head_anywhere() -> None:
    made, turn = pieces(by_chance(2)), np.array([[0.6, 0.8], [-0.8, 0.6]])
    moved = made._replace(ways=made.ways @ turn + 40.0)
    one, other = (likelihoods(each, NO_WIDER, PRIOR_SD) for each in (made, moved))
    assert one == pytest.approx(other, abs=0.3)  # but for what turns with the heading
