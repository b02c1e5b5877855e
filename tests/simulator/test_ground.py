"""The ground under the virtual tractor: slopes, waves and soil in space."""

import numpy as np
import pytest

from tilth.estimator.models import nonlinear
from tilth.estimator.models.parameters import TABLE_5_1, Rig, static_loads
from tilth.schemas.flow import PARAMETERS
from tilth.simulator.ground import Terrain, Waves, axles_of, crossings, field, share, terrain, waves
from tilth.simulator.scenario import Ground, Soil, SoilChange

RIG = TABLE_5_1
THETA: dict[str, float] = {name: getattr(RIG, name) for name in PARAMETERS}
LEVEL = (0.0, 0.0)


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def standing(north: float, east: float = 0.0, heading: float = 0.0) -> np.ndarray:
    """State of the rig with its CG there, straight."""
    return nonlinear.running(0.0, x_t=north, y_t=east, psi_t=heading, psi_i=heading)


# What is uneven.


@pytest.mark.parametrize("band", [(3.0, 30.0), (1.0, 4.0)])
def test_waves_have_their_size_and_keep_to_their_band(band: tuple[float, float]) -> None:
    made, s = waves(rng(), 0.02, band), np.arange(0.0, 20_000.0, 0.2)
    along = made.at(s)
    assert along.std() == pytest.approx(0.02, rel=0.05)
    power = np.abs(np.fft.rfft(along * np.hanning(len(s)))) ** 2
    length = 1.0 / np.maximum(np.fft.rfftfreq(len(s), 0.2), 1e-9)
    inside = (length > 0.98 * band[0]) & (length < 1.02 * band[1])
    assert power[~inside].sum() < 1e-3 * power.sum()


def test_waves_can_be_asked_for_anywhere() -> None:
    made = waves(rng(), 0.02, (3.0, 30.0))
    s = np.array([[1.0, 2.0], [7.5, -3.0]])
    assert made.at(s).shape == (2, 2)
    assert made.at(s)[1, 0] == pytest.approx(float(made.at(7.5)))
    assert Waves(0.0, made.wavenumber, made.phase).at(s).tolist() == [[0.0, 0.0], [0.0, 0.0]]


def test_waves_of_roll_are_five_times_as_long_as_those_of_forces() -> None:
    land = terrain(Ground(roll_sd_deg=1.0, force_sd=0.02, band=(2.0, 8.0)), LEVEL, RIG, rng())
    for made, shortest, longest in ((land.rolling, 10.0, 40.0), (land.lateral_force, 2.0, 8.0)):
        length = 2.0 * np.pi / made.wavenumber
        assert length.min() == pytest.approx(shortest, rel=0.1)
        assert length.max() == pytest.approx(longest, rel=0.1)


def test_the_implement_comes_over_the_same_ground_later() -> None:
    land = terrain(Ground(roll_sd_deg=1.0, force_sd=0.02), LEVEL, RIG, rng())
    lag = RIG.c - RIG.b + RIG.d + RIG.e
    s = np.linspace(0.0, 60.0, 200)
    tractor, _ = land.rolls(s, 0.0, 0.0)
    _, implement = land.rolls(s + lag, 0.0, 0.0)
    np.testing.assert_allclose(implement, tractor, atol=1e-12)
    force_t = land.inputs(5.0, standing(0.0), RIG)[3]
    force_i = land.inputs(5.0 + lag, standing(0.0), RIG)[5]
    assert force_i / RIG.m_i == pytest.approx(force_t / RIG.m_t)


def pushes(land: Terrain, s: np.ndarray, rig: Rig = RIG) -> np.ndarray:
    """Force on front, rear and implement's axle over its load, shape (n, 3)."""
    force_t, moment_t, force_i, moment_i = np.array(
        [land.inputs(at, standing(0.0), rig)[3:] for at in s.tolist()]
    ).T
    front = (moment_t + rig.b * force_t) / rig.wheelbase
    assert moment_i == pytest.approx(-rig.e * force_i)
    return np.column_stack([front, force_t - front, force_i]) / static_loads(rig)


@pytest.mark.parametrize("rig", [RIG, RIG._replace(a=2.0, b=0.8, d=5.1, e=0.4, m_i=9000.0)])
def test_a_rut_meets_the_three_axles_one_after_the_other(rig: Rig) -> None:
    land = terrain(Ground(force_sd=0.02, rut=True), LEVEL, rig, rng())
    step, n = 0.05, 20_000
    along = pushes(land, step * np.arange(n), rig)
    assert along.std(axis=0) == pytest.approx([0.02] * 3, rel=0.05)
    behind_front = np.array([rig.wheelbase, rig.a + rig.c + rig.towed_length])
    for axle, distance in zip((1, 2), behind_front, strict=True):
        lags = np.arange(round(2 * distance / step))
        alike = [np.mean(along[: n - k, 0] * along[k:, axle]) for k in lags]
        assert step * np.argmax(alike) == pytest.approx(distance, abs=step)
        assert max(alike) == pytest.approx(0.02**2, rel=0.1)


def test_a_rut_has_a_continuous_spectrum() -> None:
    step, n = 0.5, 4096
    land = terrain(Ground(force_sd=0.02, rut=True), LEVEL, RIG, rng())
    front = pushes(land, step * np.arange(n))[:, 0]
    power = np.abs(np.fft.rfft(front * np.hanning(n))) ** 2
    number = np.fft.rfftfreq(n, step)
    inside = (number > 1 / 25) & (number < 1 / 3.5)
    whitened = np.sort(power[inside] * number[inside])[::-1]
    assert whitened[: len(whitened) // 20].sum() < 0.3 * whitened.sum()


def test_pushes_at_the_cgs_do_not_turn_the_bodies() -> None:
    land = terrain(Ground(force_sd=0.02), LEVEL, RIG, rng())
    force_t, moment_t, force_i, moment_i = land.inputs(5.0, standing(0.0), RIG)[3:]
    assert (moment_t, moment_i) == (0.0, 0.0) and force_t and force_i


@pytest.mark.parametrize(
    ("heading_deg", "roll_deg", "pitch_deg"),
    [(0.0, 5.0, 0.0), (90.0, 0.0, -5.0), (180.0, -5.0, 0.0), (270.0, 0.0, 5.0)],
)
def test_a_plane_that_falls_to_the_east(heading_deg: float, roll_deg: float, pitch_deg: float) -> None:
    land = terrain(Ground(slope_deg=5.0, downhill_deg=90.0), LEVEL, RIG, rng())
    heading = np.radians(heading_deg)
    rolls = land.rolls(0.0, heading, heading)
    np.testing.assert_allclose(np.degrees(rolls), roll_deg, atol=1e-9)
    assert np.degrees(land.pitch(heading)) == pytest.approx(pitch_deg, abs=1e-9)
    gravity_t, gravity_i, along, *forces = land.inputs(0.0, standing(0.0, heading=heading), RIG)
    assert (gravity_t, gravity_i) == pytest.approx((RIG.g * np.sin(np.radians(roll_deg)),) * 2, abs=1e-9)
    weight = RIG.g * (RIG.m_t + RIG.m_i)
    assert along == pytest.approx(-weight * np.sin(np.radians(pitch_deg)), abs=1e-6)
    assert forces == [0.0] * 4


# Soil.


def test_soil_without_changes_is_the_same_everywhere() -> None:
    soil = field(Soil(), THETA, RIG, rng())
    assert soil.uniform
    np.testing.assert_array_equal(soil.at(3.0, standing(50.0)), RIG.theta)


def test_axles_are_where_the_geometry_says() -> None:
    front, rear, cart = axles_of(RIG, standing(10.0, 20.0, np.pi / 2))
    assert front == pytest.approx([10.0, 20.0 + RIG.a])
    assert rear == pytest.approx([10.0, 20.0 - RIG.b])
    assert cart == pytest.approx([10.0, 20.0 - RIG.c - RIG.d - RIG.e])


def test_each_axle_crosses_a_line_when_it_gets_there() -> None:
    change = SoilChange(north=50.0, east=0.0, towards_deg=0.0, C_af=0.5, C_ar=0.6, C_ai=0.7, sigma_i=2.0)
    soil = field(Soil(changes=(change,)), THETA, RIG, rng())

    def factors(north: float) -> list[float]:
        return list((soil.at(0.0, standing(north)) / RIG.theta).round(9))

    assert factors(50.0 - RIG.a - 0.01) == [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    assert factors(50.0) == [0.5, 1.0, 1.0, 1.0, 1.0, 1.0]
    assert factors(50.0 + RIG.b + 0.01) == [0.5, 0.6, 1.0, 1.0, 1.0, 1.0]
    assert factors(60.0) == [0.5, 0.6, 0.7, 1.0, 1.0, 2.0]


@pytest.mark.parametrize("towards_deg", [0.0, 37.0, 180.0, -90.0])
def test_a_line_runs_across_its_direction(towards_deg: float) -> None:
    towards = np.radians(towards_deg)
    change = SoilChange(north=5.0, east=7.0, towards_deg=towards_deg, over=10.0)
    ahead, along = np.array([np.cos(towards), np.sin(towards)]), np.array([-np.sin(towards), np.cos(towards)])
    for beyond, wanted in ((-1.0, 0.0), (2.5, 0.25), (11.0, 1.0)):
        place = np.array([5.0, 7.0]) + beyond * ahead + 123.0 * along
        assert share(change, 0.0, np.tile(place, (3, 1))) == pytest.approx([wanted] * 3)


def test_a_change_in_time_holds_everywhere_and_takes_its_time() -> None:
    soil = field(Soil(changes=(SoilChange(at_s=10.0, over=4.0, C_ar=0.25),)), THETA, RIG, rng())
    states = np.tile(standing(0.0), (4, 1))
    factors = soil.at(np.array([9.9, 10.0, 12.0, 14.5]), states)[:, 1] / RIG.C_ar
    assert factors == pytest.approx([1.0, 1.0, 0.5, 0.25])  # half way of the logarithm


def test_patches_change_stiffness_with_the_place_only() -> None:
    soil = field(Soil(patch_log_sd=0.1, patch_length=30.0), THETA, RIG, rng(3))
    places = np.stack([standing(*at) for at in rng(4).uniform(-3000.0, 3000.0, (3000, 2))])
    logs = np.log(soil.at(0.0, places) / RIG.theta)
    assert logs[:, :3].std(axis=0) == pytest.approx([0.1] * 3, rel=0.08)
    assert np.abs(logs[:, 3:]).max() < 1e-12
    near = np.log(soil.at(0.0, standing(100.0)) / soil.at(99.0, standing(101.0)))
    assert np.abs(near).max() < 0.05  # a metre further, at another time
    two = np.log(soil.at(0.0, standing(0.0)) / RIG.theta)
    again = np.log(soil.at(0.0, standing(RIG.a + RIG.b)) / RIG.theta)
    assert again[1] == pytest.approx(two[0])  # the rear axle where the front one was


@pytest.mark.parametrize(("common", "expected"), [(1.0, 1.0), (0.4, 0.4), (0.0, 0.0)])
def test_axles_feel_patches_as_much_alike_as_asked_for(common: float, expected: float) -> None:
    asked = Soil(patch_log_sd=0.2, patch_length=30.0, patch_common=common)
    # As all three stand at one place, of many.
    logs = np.array([
        [np.log(soil.at(0.0, standing(-ahead)) / RIG.theta)[axle] for axle, ahead in
         enumerate((RIG.a, -RIG.b, -RIG.c - RIG.d - RIG.e))]
        for soil in (field(asked, THETA, RIG, rng(k)) for k in range(600))
    ])  # fmt: skip
    assert logs.std(axis=0) == pytest.approx([0.2] * 3, rel=0.1)
    assert np.corrcoef(logs.T)[np.triu_indices(3, 1)] == pytest.approx([expected] * 3, abs=0.12)


def test_patches_may_be_longer_across_than_along() -> None:
    soil = field(Soil(patch_log_sd=0.2, patch_length=30.0, patch_across=4.0), THETA, RIG, rng(5))
    places = rng(6).uniform(-3000.0, 3000.0, (1500, 2))
    logs = [
        np.log(soil.at(0.0, np.stack([standing(*at) for at in places + step])) / RIG.theta)[:, 0]
        for step in ([0.0, 0.0], [15.0, 0.0], [0.0, 15.0])
    ]
    along, across = (np.std(other - logs[0]) for other in logs[1:])
    assert across < 0.5 * along


def test_crossings_are_told_with_their_axles() -> None:
    changes = (
        SoilChange(north=20.0, east=0.0, over=5.0),
        SoilChange(at_s=4.0),
        SoilChange(north=900.0, east=0.0),
    )
    time = np.arange(0.0, 10.01, 0.01)
    states = np.stack([standing(5.0 * t) for t in time])
    result = {
        (number, axle): (start, end) for number, axle, start, end in crossings(changes, RIG, time, states)
    }
    assert result[1, "front"] == pytest.approx(((20.0 - RIG.a) / 5.0, (25.0 - RIG.a) / 5.0), abs=0.02)
    behind = RIG.c + RIG.d + RIG.e
    assert result[1, "implement"] == pytest.approx(((20.0 + behind) / 5.0, (25.0 + behind) / 5.0), abs=0.02)
    assert result[2, "rear"] == pytest.approx((4.0, 4.0), abs=0.02)
    assert {number for number, _ in result} == {1, 2}
