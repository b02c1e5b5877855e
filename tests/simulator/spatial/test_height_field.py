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


@pytest.mark.parametrize(("rms", "band"), [(0.01, (2.0, 15.0)), (0.03, (2.0, 15.0)), (0.01, (0.5, 40.0))])
def test_roughness_has_its_rms_and_each_wheel_its_own(rms: float, band: tuple[float, float]) -> None:
    field = made(Ground(waves=band), rms)
    places = np.random.default_rng(0).uniform(-1000, 1000, (2000, 2))
    heights = [height(field, x, y)[0] for x, y in places]
    assert np.std(heights) == pytest.approx(rms, rel=0.06)
    left, right = ([height(field, x, y + w)[0] for x, y in places[:500]] for w in (-1.0, 1.0))
    across = np.std(np.subtract(left, right))
    assert 0.3 * rms < across < 1.5 * rms  # unlike, yet of one ground: cross slope


def profile(field: hf.HeightField, heading_deg: float, n: int, step: float) -> np.ndarray:
    """Heights along a line, m."""
    ahead = np.array([math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))])
    return np.array([height(field, *(s * ahead))[0] for s in step * np.arange(n)])


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 37.0])
def test_the_spectrum_is_continuous_with_a_waviness_of_2(heading_deg: float) -> None:
    step, n = 0.25, 8192
    along = profile(made(Ground(), 0.01), heading_deg, n, step)
    power = np.abs(np.fft.rfft(along * np.hanning(n))) ** 2
    number = np.fft.rfftfreq(n, step)
    assert power[number > 1.05].sum() < 1e-4 * power.sum()  # nothing shorter than 1 m
    inside = (number > 1 / 15) & (number < 1 / 2)
    slope, _ = np.polyfit(np.log(number[inside]), np.log(power[inside]), 1)
    assert slope == pytest.approx(-2.0, abs=0.25)
    # Of Gaussian noise the strongest twentieth of all lines has a fifth of the power; of 96 waves nearly all.
    whitened = np.sort(power[inside] * number[inside] ** 2)[::-1]
    assert whitened[: len(whitened) // 20].sum() < 0.27 * whitened.sum()


def test_no_row_meets_its_own_ground_again() -> None:
    along = profile(made(Ground(), 0.01), 0.0, 8192, 0.25)
    spectrum = np.abs(np.fft.rfft(along - along.mean(), 2 * len(along))) ** 2
    alike = np.fft.irfft(spectrum)[: len(along) // 2]
    assert np.abs(alike[round(25.0 / 0.25) :]).max() < 0.3 * alike[0]


def test_a_band_of_any_width_keeps_its_rms_and_both_its_ends() -> None:
    wide = made(Ground(waves=(0.5, 400.0)), 0.02)
    places = np.random.default_rng(0).uniform(-1e5, 1e5, (4000, 2))
    assert np.std([height(wide, x, y)[0] for x, y in places]) == pytest.approx(0.02, rel=0.1)
    along = profile(wide, 0.0, 16384, 0.2)
    power = np.abs(np.fft.rfft(along * np.hanning(len(along)))) ** 2
    number = np.fft.rfftfreq(len(along), 0.2)
    level = [np.mean((power * number**2)[(number > low) & (number < 2 * low)]) for low in (0.005, 0.05, 0.5)]
    assert np.log(level) == pytest.approx([np.log(level[1])] * 3, abs=0.7)  # one law over both squares


def test_seeds_are_other_grounds_and_rms_is_only_a_factor() -> None:
    one, other, small = made(Ground(), 0.02), made(Ground(), 0.02, seed=2), made(Ground(), 0.01)
    at = (7.0, -3.0)
    assert height(one, *at)[0] != height(other, *at)[0]
    assert height(one, *at) == height(made(Ground(), 0.02), *at)
    assert height(one, *at)[0] == pytest.approx(2 * height(small, *at)[0])
    assert len(made(Ground()).rough) == 0


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
