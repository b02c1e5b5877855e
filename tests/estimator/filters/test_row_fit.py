"""A fit of straight rows: its slopes, its epochs, and what it finds on ground that no filter assumes."""

from dataclasses import replace

import numpy as np
import pytest
from circle import demo_machine
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from straight_row import on_a_rut, weaving

from tilth.estimator.filters import row_fit, unknowns
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.row_fit import (
    OUTPUTS,
    RowFit,
    RowPosterior,
    across_row,
    along_north,
    epochs_of,
    fitted,
    plain_row,
)
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.record.record import (
    EAST,
    KIND,
    NORTH,
    PSI,
    VALUE,
    VELOCITY,
    WHEEL_ANGLE,
    YAW_RATE,
    Record,
)

Array = NDArray[np.float64]

MACHINE = demo_machine()
MEAN, SD_PRIOR = unknowns.prior(MACHINE)
SETUP = rig_setup(MACHINE)
COVARIANCE = np.diag(SD_PRIOR**2)


def driven(seconds: float, seed: int, point: Array, slower: int = 1) -> Record:
    return on_a_rut(seconds, seed, point, SETUP, slower)


def other_tyres(seed: int) -> Array:
    point = MEAN.copy()
    point[:6] += 0.3 * np.random.default_rng(seed).standard_normal(6)
    return point


def test_a_row_is_turned_along_north() -> None:
    straight = driven(20.0, 0, MEAN)
    turned, angle = Record(0, straight.ticks.copy(), straight.rows.copy()), 0.7
    turned.ticks[:, PSI : PSI + 2] += angle
    north, east = (np.flatnonzero(turned.rows[:, KIND] == kind) for kind in (NORTH, EAST))
    x, y = (turned.rows[at, VALUE].copy() for at in (north, east))
    turned.rows[north, VALUE] = np.cos(angle) * x - np.sin(angle) * y + 500.0
    turned.rows[east, VALUE] = np.sin(angle) * x + np.cos(angle) * y - 300.0
    again, before = along_north(turned).rows, along_north(straight).rows
    np.testing.assert_allclose(again[:, VALUE], before[:, VALUE], atol=1e-9)


def test_velocities_are_across_the_row() -> None:
    record = weaving(4.0)
    record.ticks[:, PSI], record.ticks[:, PSI + 1] = 0.02, -0.01
    readings, moving = across_row(record), record.rows[:, KIND] == VELOCITY
    of_tractor = record.rows[:, 3] < 2
    np.testing.assert_allclose(readings[moving & of_tractor], 4.2 * 0.02)
    np.testing.assert_allclose(readings[moving & ~of_tractor], 4.2 * -0.01)
    assert not readings[~moving].any()


@given(st.floats(0.0, 0.2), st.floats(0.0, 0.04), st.integers(0, 1000))
def test_what_is_measured_together_is_of_one_epoch(phase: float, jitter: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    instants = np.arange(50)[:, None] * 0.2 + phase + jitter * rng.random((50, 4))
    epochs = epochs_of(instants.ravel()).reshape(50, 4)
    assert np.all(epochs == epochs[:, :1]) and np.all(np.diff(epochs[:, 0]) == 1)


OF_ROWS_NAMES = ("play", "rate_scale_t", "rate_scale_i")


@pytest.mark.parametrize(
    "name", ["C_af", "C_ai", "sigma_r", "wheel_gain", "roll_k_t", "d", "lever_t", *OF_ROWS_NAMES]
)
def test_slopes_are_those_of_differences(name: str) -> None:
    fit = RowFit([plain_row(driven(30.0, 1, MEAN))], SETUP, MEAN, COVARIANCE)
    if name in OF_ROWS_NAMES:
        column = OF_ROWS_NAMES.index(name) - len(OF_ROWS_NAMES)
        step, own_step = np.zeros(len(MEAN)), 1e-4 * np.eye(len(fit.none))[column]
    else:
        column = int(np.flatnonzero(fit.active == AT[name])[0])
        step, own_step = 1e-4 * np.eye(len(MEAN))[AT[name]], fit.none
    here, ahead, behind = (fit.at(MEAN + way * step, way * own_step) for way in (0.0, 1.0, -1.0))
    assert here is not None and ahead is not None and behind is not None
    slopes = fit.slopes(here)[0][fit.order :, :, column]

    def left(point: object) -> Array:
        noise = point.noise  # type: ignore[attr-defined]
        return np.asarray(noise.rest + noise.past @ noise.coefficients)

    differences = (left(ahead) - left(behind)) / 2e-4
    np.testing.assert_allclose(slopes, differences, atol=3e-3 * np.abs(differences).max())


def with_play(angle: Array, half: float) -> Array:
    """What a linkage passes on that turns freely within twice as much."""
    passed, value = np.empty(len(angle)), angle[0]
    for k, there in enumerate(angle):
        passed[k] = value = min(max(value, there - half), there + half)
    return passed


def test_play_of_the_wheel_sensor_is_found_and_moves_no_stiffness(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.2 degrees from flank to flank, and noise."""
    half, row = np.radians(0.1), driven(60.0, 6, MEAN, slower=51)
    ticks, rng = row.ticks.copy(), np.random.default_rng(1)
    ticks[:, WHEEL_ANGLE] = with_play(ticks[:, WHEEL_ANGLE], half)
    ticks[:, WHEEL_ANGLE] += np.radians(0.02) * rng.standard_normal(len(ticks))

    def found(angles: Array) -> RowPosterior:
        return RowFit([plain_row(Record(0, angles, row.rows))], SETUP, MEAN, COVARIANCE).maximise()

    even, played = found(row.ticks), found(ticks)
    assert abs(even.play) < 0.4 * half and 0.5 * half < played.play < 1.3 * half
    assert abs(played.mean[0] - even.mean[0]) < 0.15
    monkeypatch.setattr(row_fit, "ROW_FIT", replace(row_fit.ROW_FIT, play_sd=1e-9))
    assert found(ticks).mean[0] - even.mean[0] > 0.3  # where it is no unknown


@pytest.mark.long
def test_intervals_hold_on_ground_that_no_filter_assumes() -> None:
    """Of tyres that are far from the prior's; two rows together."""
    ratios = []
    for seed in range(3):
        true = other_tyres(seed)
        rows = [driven(70.0, 10 * seed + k, true) for k in range(2)]
        found = fitted(rows, SETUP, MEAN, COVARIANCE)
        assert found and found.converged and found.own_share > 0.9
        sds = np.sqrt(np.diag(found.covariance))[:6]
        assert np.all(sds[:2] < 0.35) and np.all(np.isfinite(found.covariance))
        assert np.linalg.eigvalsh(found.covariance).min() > -1e-12
        ratios.append((found.mean - true)[:6] / sds)
    assert np.sum(np.abs(ratios) < 2.0) >= 16 and np.abs(ratios).max() < 3.5


def test_a_wrong_zero_of_the_wheel_angle_changes_nothing() -> None:
    """Of a row, in which it is what the wheels read on average."""
    row = driven(45.0, 3, MEAN)
    off = Record(0, row.ticks.copy(), row.rows)
    off.ticks[:, WHEEL_ANGLE] += np.radians(4.0)
    right, wrong = (fitted([one], SETUP, MEAN, COVARIANCE) for one in (row, off))
    assert right and wrong
    np.testing.assert_allclose(wrong.mean[:6], right.mean[:6], atol=0.01)


def test_no_number_is_surer_than_the_rows_make_it_at_the_priors_point() -> None:
    """Of soft tyres and long lengths, where slopes are large; a short row with much noise."""
    true = MEAN.copy()
    true[:6] += (0.0, 0.0, -0.6, 0.3, 0.3, 0.7)
    row = driven(45.0, 5, true)
    problem = RowFit([plain_row(row)], SETUP, MEAN, COVARIANCE)
    alone, found = problem.maximise(), fitted([row], SETUP, MEAN, COVARIANCE)
    assert found
    first, at_end, said = (
        np.diag(of)[:6] for of in (problem.first_covariance, alone.covariance, found.covariance)
    )
    assert np.any(at_end < 0.9 * first)
    assert np.all(said >= (1.0 - 1e-9) * first) and np.all(said < SD_PRIOR[:6] ** 2 * 1.01)
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-12


def test_without_receivers_on_a_body_it_says_so() -> None:
    record = driven(30.0, 0, MEAN)
    body = record.rows[
        (record.rows[:, 3] < 2) & ~((record.rows[:, KIND] == YAW_RATE) & (record.rows[:, 3] == 1))
    ]
    fit = RowFit([plain_row(Record(0, record.ticks, body))], SETUP, MEAN, COVARIANCE)
    assert not fit.measured and len(fit.outputs) < len(OUTPUTS)
