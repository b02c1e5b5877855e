"""What windows tell of soil at another place: how it differs in a field, and what holds of any windows."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tilth.estimator.filters.soil_field import (
    SOIL_FIELD,
    AskedGround,
    SoilMemory,
    SoilWindow,
    Told,
    merged,
    told,
)
from tilth.estimator.filters.unknowns import AT, NAMES, NOISE

Array = NDArray[np.float64]

PRIOR_SD = np.full(6, 0.7)
BEHIND = np.array([[1.7, 0.0], [-1.2, 0.0], [-5.8, 0.0]])  # axles of a rig that heads north at the origin


def rig_at(north: float, east: float) -> Array:
    return np.asarray(BEHIND + np.array([north, east]))


def window(
    logs: Array, north: float, east: float = 0.0, sd: float = 0.05, k: int = 0, model_sd: float = 0.0
) -> SoilWindow:
    """A window of 20 m that ends there."""
    path = np.array([rig_at(north - back, east) for back in np.linspace(20.0, 0.0, SOIL_FIELD.points)])
    information = np.eye(6) / sd**2
    return SoilWindow("pem", k, k, path, Told(information, information @ logs, np.full(6, model_sd)))


def sds(windows: list[SoilWindow], place: Array) -> Array:
    return np.asarray(np.sqrt(np.diag(SoilMemory(windows, PRIOR_SD).at(place).covariance)))


LOGS = st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6).map(np.array)
PLACES = st.lists(st.tuples(st.floats(-200, 200), st.floats(-60, 60)), min_size=1, max_size=5)


@settings(max_examples=20, deadline=None)
@given(LOGS, PLACES, st.randoms(use_true_random=False))
def test_the_order_of_windows_does_not_matter(logs: Array, places: list[tuple[float, float]], rng) -> None:  # type: ignore[no-untyped-def]
    windows = [window(logs + 0.1 * k, *place, k=k) for k, place in enumerate(places)]
    shuffled = rng.sample(windows, len(windows))
    one, other = (SoilMemory(each, PRIOR_SD).at(rig_at(30.0, 3.0)) for each in (windows, shuffled))
    assert one.mean == pytest.approx(other.mean, abs=1e-8)
    assert one.covariance == pytest.approx(other.covariance, abs=1e-8)


@settings(max_examples=20, deadline=None)
@given(LOGS, PLACES, st.floats(-200, 200))
def test_it_is_sure_of_nothing_that_it_was_not_told(
    logs: Array, places: list[tuple[float, float]], north: float
) -> None:
    """A covariance, no wider than before any window; shares are shares."""
    windows = [window(logs, *place, k=k) for k, place in enumerate(places)]
    field, place = SoilMemory(windows, PRIOR_SD), rig_at(north, 0.0)
    found = field.at(place).covariance
    assert np.linalg.eigvalsh(found).min() > 0.0
    shares = field.shares(place, [k == 0 for k in range(len(windows))])
    assert sum(shares) == pytest.approx(1.0) and min(shares) > -1e-9


def test_at_a_window_it_is_known_and_far_away_as_wide_as_soil_may_differ() -> None:
    at = [window(np.zeros(6), 0.0)]
    here, near, far, further = (sds(at, rig_at(north, 0.0)) for north in (-10.0, 30.0, 200.0, 2000.0))
    assert np.all(here[:3] < near[:3]) and np.all(near[:3] < far[:3])
    assert np.all(far[:3] > 0.15) and further[:3] == pytest.approx(far[:3], rel=0.1)
    assert further[3:] == pytest.approx(here[3:], rel=0.1)  # lengths are of the rig


def test_a_second_pass_beside_narrows_and_a_field_without_patches_is_learned_as_one() -> None:
    one = [window(np.zeros(6), 0.0, sd=0.2)]
    two = [*one, window(np.zeros(6), 0.0, 6.0, sd=0.2, k=1)]
    assert np.all(sds(two, rig_at(-10.0, 3.0)) < 0.9 * sds(one, rig_at(-10.0, 3.0)))
    rng, place = np.random.default_rng(1), rig_at(90.0, 33.0)
    same = [window(0.05 * rng.standard_normal(6), 180.0 * (k % 2), 6.0 * k, k=k) for k in range(12)]
    patchy = [window(w.told.vector * 0.05**2 + 0.3 * rng.choice([-1.0, 1.0]), 180.0 * (k % 2), 6.0 * k, k=k)
              for k, w in enumerate(same)]  # fmt: skip
    assert np.all(sds(same, place)[:3] < 0.08) and np.all(sds(patchy, place)[:3] > 0.2)


def test_errors_of_the_model_do_not_average_out() -> None:
    many = [window(np.zeros(6), 0.0, 6.0 * k, k=k, model_sd=0.15) for k in range(12)]
    assert np.all(sds(many, rig_at(-10.0, 30.0)) > 0.14)


def patchy(rng: np.random.Generator, end: float) -> Callable[[Array], Array]:
    """The logarithms of the six under axles, (…, 3, 2) to (…, 6): patches, partly of each axle, and a wet end
    beyond a line."""
    sd, common, longest, of_rig = rng.uniform(0.1, 0.3), rng.uniform(0.3, 1.0), 4.0, rng.normal(0.0, 0.4, 6)
    shortest, wet = rng.uniform(20.0, 60.0), math.log(1.0 - rng.uniform(0.3, 0.5))
    toward, phase = rng.uniform(0.0, 2 * np.pi, (2, 4, 24))
    number = 2 * np.pi / (shortest * longest ** rng.random((4, 24)))
    shares = sd * np.sqrt([common, *[1.0 - common] * 3])

    def soil(axles: Array) -> Array:
        angle = number * (
            axles[..., None, None, 0] * np.cos(toward) + axles[..., None, None, 1] * np.sin(toward)
        )
        felt = shares * np.sqrt(2 / 24) * np.cos(angle + phase).sum(axis=-1)  # (…, 3, 4)
        logs = np.broadcast_to(of_rig, (*axles.shape[:-2], 6)).copy()
        logs[..., :3] += felt[..., 0] + np.diagonal(felt[..., 1:], axis1=-2, axis2=-1)
        logs[..., :3] += wet * np.clip((axles[..., 0] - end) / 20.0, 0.0, 1.0)
        return logs

    return soil


def test_intervals_hold_in_fields_with_patches_and_a_wet_end() -> None:
    """Told of at both ends of some passes only; asked all along the row."""
    rng, z = np.random.default_rng(0), list[Array]()
    sd = np.array([0.1, 0.15, 0.15, 0.12, 0.18, 0.2])
    for _ in range(40):
        length, passes = rng.uniform(100.0, 180.0), int(rng.integers(2, 8))
        soil, windows = patchy(rng, rng.uniform(0.6, 0.8) * length), []
        for k in range(2 * passes):
            one = window(np.zeros(6), 10.0 + length * (k % 2), 12.2 * (k // 2), k=k)
            information = np.diag(sd**-2)
            said = soil(one.path).mean(axis=0) + sd * rng.standard_normal(6)
            windows.append(replace(one, told=Told(information, information @ said, np.zeros(6))))
        field = SoilMemory(windows, PRIOR_SD)
        for north in np.linspace(5.0, length - 5.0, 5):
            place = rig_at(north, 12.2 * passes)
            found = field.at(place)
            z.append((found.mean - soil(place)) / np.sqrt(np.diag(found.covariance)))
    held = np.mean(np.abs(z) < 1.96, axis=0)
    assert np.all(held >= 0.88) and held.mean() > 0.92, held


def test_two_as_one_tell_what_both_told() -> None:
    one, other = (window(np.full(6, log), 0.0, k=k) for k, log in enumerate((0.1, 0.3)))
    both = merged(one, other)
    assert both.told.information == pytest.approx(2.0 * one.told.information)
    assert np.linalg.solve(both.told.information, both.told.vector) == pytest.approx(np.full(6, 0.2))


@pytest.mark.parametrize("of_file", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_what_a_window_adds_does_not_depend_on_what_was_known_of_the_six(seed: int, of_file: bool) -> None:
    """Linear: its likelihood is a parabola, other unknowns are known as they were, or as the file has it."""
    rng, n = np.random.default_rng(seed), 9
    root = rng.standard_normal((n, n))
    information, best, prior_mean = root @ root.T, rng.standard_normal(n), rng.standard_normal(n)
    others, prior = np.cov(rng.standard_normal((3, 40))), (prior_mean, np.ones(n))
    found = []
    for sd in (0.1, 3.0):
        moved = 5.0 * rng.standard_normal(3) if of_file else 0.0
        before = np.concatenate([rng.standard_normal(6), prior_mean[6:] + moved])
        covariance = np.zeros((n, n))
        covariance[:6, :6], covariance[6:, 6:] = sd**2 * np.eye(6), others * (sd if of_file else 1.0)
        known = np.linalg.inv(covariance)
        after = np.asarray(np.linalg.solve(information + known, information @ best + known @ before), float)
        made = told(before, covariance, after, information, prior, np.ones(6), np.zeros(6), of_file=of_file)
        found.append(made)
    assert found[0].information == pytest.approx(found[1].information, abs=1e-6)
    assert found[0].vector == pytest.approx(found[1].vector, abs=1e-6)
    assert found[0].model_sd == pytest.approx(found[1].model_sd) and np.all(found[0].model_sd > 0.0)


def test_what_the_rig_leaves_open_is_common_to_windows_and_what_noise_does_is_not() -> None:
    """An unknown of the rig that looks like a stiffness: each window tells the six sharply if it is known."""
    n = len(NAMES)
    information, covariance = np.zeros((n, n)), np.zeros((n, n))
    k, zero = AT["C_af"], AT["wheel_zero"]
    covariance[np.arange(6), np.arange(6)] = 0.7**2
    covariance[zero, zero] = covariance[NOISE.start, NOISE.start] = 0.1**2
    information[:6, :6] = np.eye(6) / 0.02**2
    for other, log in ((zero, k), (NOISE.start, AT["C_ar"])):
        both = np.zeros(n)
        both[[other, log]] = 2.0, 1.0
        information += np.outer(both, both) / 0.02**2 - np.diag(np.eye(n)[log]) / 0.02**2
    flat = (np.zeros(n), np.full(n, 0.7))
    made = told(np.zeros(n), covariance, np.zeros(n), information, flat, np.ones(6), np.zeros(6))
    assert made.model_sd[k] == pytest.approx(0.2, rel=0.1) and made.information[k, k] == pytest.approx(2500.0)
    assert made.model_sd[AT["C_ar"]] == 0.0
    assert made.information[AT["C_ar"], AT["C_ar"]] == pytest.approx(1.0 / (0.02**2 + 0.2**2), rel=0.1)


def test_what_differs_between_passes_to_and_fro_is_not_taken_for_soil() -> None:
    """Fore-aft slope and pull turn with the heading: + 8 % one way and − 8 % the other, on the same soil."""
    windows = []
    for k in range(12):
        one, ahead = window(np.zeros(6), 60.0, 12.2 * k, k=k), (-1.0) ** k
        path = one.path.copy()
        path[..., 0] = 60.0 + ahead * (path[..., 0] - 60.0)  # the other way
        information = np.eye(6) / 0.03**2
        said = np.repeat([0.08 * ahead, 0.0], 3)
        windows.append(replace(one, path=path, told=Told(information, information @ said, np.zeros(6))))
    field = SoilMemory(windows, PRIOR_SD)
    there = rig_at(60.0, 12.2 * 12)
    back = there.copy()
    back[..., 0] = 120.0 - back[..., 0]
    to, fro = field.at(there), field.at(back)
    assert field.patchy < 0.2
    assert to.mean[:3] == pytest.approx(np.full(3, 0.08), abs=0.03)
    assert fro.mean[:3] == pytest.approx(np.full(3, -0.08), abs=0.03)


def test_what_rows_and_turns_differ_by_is_not_taken_for_soil() -> None:
    """Errors of each method are in common to its windows: a random effect, estimated with the soil."""
    windows = []
    for k in range(12):
        one, said = window(np.zeros(6), 60.0, 12.2 * k, k=k), np.repeat([0.1 * (-1.0) ** k, 0.0], 3)
        information = np.eye(6) / 0.03**2
        made = Told(information, information @ said, np.repeat([0.1, 0.0], 3))
        windows.append(replace(one, method=("pem", "rows")[k % 2], told=made))
    field = SoilMemory(windows, PRIOR_SD)
    found = field.at(rig_at(60.0, 12.2 * 12))
    assert field.patchy < 0.2 and found.mean[:3] == pytest.approx(np.zeros(3), abs=0.03)
    assert np.all(np.sqrt(np.diag(found.covariance)[:3]) > 0.06)


def test_worked_ground_has_an_effect_of_its_own_that_is_estimated() -> None:
    """Headlands are worked and softer by a quarter, rows beside them are not."""
    windows = []
    for k in range(12):
        logs = np.repeat([-0.25 * (k % 2), 0.0], 3)
        one = window(logs, 60.0, 12.2 * k, k=k)
        windows.append(replace(one, worked=np.full(3, float(k % 2))))
    field, there = SoilMemory(windows, PRIOR_SD), rig_at(60.0, 12.2 * 12)
    found = [field.at(there, AskedGround(worked=np.full(3, share))) for share in (0.0, 1.0)]
    for known, log in zip(found, (0.0, -0.25), strict=True):
        assert known.mean[:3] == pytest.approx(np.full(3, log), abs=0.04)
        assert np.all(np.sqrt(np.diag(known.covariance)[:3]) < 0.1)
    unworked = SoilMemory(windows[::2], PRIOR_SD)
    rows, headland = (unworked.at(there, AskedGround(worked=np.full(3, share))) for share in (0.0, 1.0))
    more = np.diag(headland.covariance - rows.covariance)
    assert np.sqrt(more[:3]) == pytest.approx(np.full(3, SOIL_FIELD.worked)) and not more[3:].any()


def test_what_was_told_ages_within_a_run_and_what_differs_from_place_to_place_stays() -> None:
    hour_ns = 3600 * 10**9
    windows = [window(np.repeat([-0.4 * (k % 2), 0.0], 3), 200.0 * (k % 2), 6.0 * k, k=k) for k in range(12)]
    field, wet, dry = SoilMemory(windows, PRIOR_SD), rig_at(190.0, 33.0), rig_at(-10.0, 33.0)
    now, later, long = (field.at(wet, AskedGround(hours * hour_ns)) for hours in (0, 1, 10))
    added = [np.sqrt(np.diag(one.covariance - now.covariance)[:3]) for one in (later, long)]
    assert added[0] == pytest.approx(np.full(3, 0.053), abs=0.005)
    assert added[1] == pytest.approx(np.full(3, 0.166), abs=0.01)
    assert np.all(np.diag(long.covariance)[3:] > np.diag(now.covariance)[3:])
    apart = [
        field.at(wet, AskedGround(t)).mean - field.at(dry, AskedGround(t)).mean for t in (0, 10 * hour_ns)
    ]
    assert apart[1] == pytest.approx(apart[0], abs=0.02)
    # A window of now says what the level has become; the difference to the other end is still known.
    fresh = replace(window(np.repeat([0.3, 0.0], 3), 0.0, 33.0), begin_ns=10 * hour_ns)
    moved = SoilMemory([*windows, fresh], PRIOR_SD).at(wet).mean[:3]
    assert moved == pytest.approx(np.full(3, -0.1), abs=0.15)


def test_many_places_at_once_are_as_each_alone() -> None:
    """Axles one above the other have no heading, as a cell of a map has none."""
    field = SoilMemory([window(np.full(6, 0.1 * k), 40.0 * k, 6.0 * k, k=k) for k in range(6)], PRIOR_SD)
    places = np.array([[0.0, 0.0], [55.0, 12.0], [3000.0, -20.0]])
    mean, covariance = field.around(places)
    for k, place in enumerate(places):
        alone = field.at(np.tile(place, (3, 1)))
        np.testing.assert_allclose(mean[k], alone.mean[:3], atol=1e-12)
        np.testing.assert_allclose(covariance[k], alone.covariance[:3, :3], atol=1e-12)


def test_what_was_asked_before_changes_no_answer() -> None:
    """Where the rig is, several things are asked in a row; its places may lie in the same array."""
    windows = [window(np.full(6, 0.1 * k), 40.0 * k, 6.0 * k, k=k) for k in range(6)]
    field, asked, place = SoilMemory(windows, PRIOR_SD), AskedGround(worked=np.ones(3)), rig_at(0.0, 0.0)
    for north in (0.0, 90.0, 0.0):
        place[:] = rig_at(north, 6.0)
        for ground in (AskedGround(), asked):
            fresh = SoilMemory(windows, PRIOR_SD).at(place, ground)
            found = field.at(place, ground)
            assert np.array_equal(found.mean, fresh.mean)
            assert np.array_equal(found.covariance, fresh.covariance)
        assert np.array_equal(field.elsewhere(place), SoilMemory(windows, PRIOR_SD).elsewhere(place))
