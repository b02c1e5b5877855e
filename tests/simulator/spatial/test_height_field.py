"""The ground: its rms, its slopes, its bumps, and that it is the same for whoever comes later."""

import math

import numpy as np
import pytest

from tilth.simulator.scenario import Bump, Ground
from tilth.simulator.spatial import height_field as hf

height = hf.height.interpreted()


def made(ground: Ground, rms: float = 0.0, seed: int = 1) -> hf.HeightField:
    return hf.height_field(ground, rms, np.random.default_rng(seed))


def test_even_ground_is_a_plane_that_falls_where_it_is_told_to() -> None:
    field = made(Ground(slope_deg=4.0, downhill_deg=90.0))
    up, north, east = height(field, 3.0, 10.0)
    assert (up, east) == pytest.approx((-10 * math.tan(math.radians(4)), -math.tan(math.radians(4))))
    assert north == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("rms", [0.01, 0.03])
def test_waves_have_their_rms_and_lengths(rms: float) -> None:
    field = made(Ground(waves=(2.0, 15.0)), rms)
    rng = np.random.default_rng(0)
    places = rng.uniform(-1000, 1000, (2000, 2))
    heights = [height(field, x, y)[0] for x, y in places]
    assert np.std(heights) == pytest.approx(rms, rel=0.06)
    lengths = 2 * np.pi / np.hypot(field.wave[:, 1], field.wave[:, 2])
    assert lengths.min() >= 2.0 and lengths.max() <= 15.0
    left, right = ([height(field, x, y + w)[0] for x, y in places[:500]] for w in (-1.0, 1.0))
    assert np.std(np.subtract(left, right)) > 0.5 * rms  # each wheel its own


def test_seeds_are_other_grounds_and_rms_is_only_a_factor() -> None:
    one, other, small = made(Ground(), 0.02), made(Ground(), 0.02, seed=2), made(Ground(), 0.01)
    at = (7.0, -3.0)
    assert height(one, *at)[0] != height(other, *at)[0]
    assert height(one, *at)[0] == pytest.approx(2 * height(small, *at)[0])
    assert len(made(Ground()).wave) == 0


def test_a_bump_is_flat_on_top_and_level_around() -> None:
    bump = Bump(north=10.0, east=1.0, height=0.1, length=2.0, width=1.0, ramp=0.3)
    field = made(Ground(bumps=(bump,)))
    assert height(field, 10.0, 1.0) == (0.1, 0.0, 0.0)
    assert height(field, 10.6, 1.15) == pytest.approx((0.1, 0.0, 0.0))
    for away in ((11.01, 1.0), (10.0, 1.51), (8.9, 1.0), (10.0, 0.4)):
        assert height(field, *away) == (0.0, 0.0, 0.0)
    assert height(field, 10.85, 1.0)[0] == pytest.approx(0.05)


def test_slopes_are_those_of_the_heights() -> None:
    ground = Ground(slope_deg=3.0, downhill_deg=40.0, bumps=(Bump(1.0, 1.0, -0.1, 2.0, 2.0, 0.5),))
    field, d = made(ground, 0.03), 1e-6
    for x, y in np.random.default_rng(3).uniform(-1, 3, (50, 2)):
        _, north, east = height(field, x, y)
        assert north == pytest.approx(
            (height(field, x + d, y)[0] - height(field, x - d, y)[0]) / 2 / d, abs=1e-6
        )
        assert east == pytest.approx(
            (height(field, x, y + d)[0] - height(field, x, y - d)[0]) / 2 / d, abs=1e-6
        )
