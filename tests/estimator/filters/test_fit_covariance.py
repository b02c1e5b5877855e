"""The room that a fit leaves for errors of the model."""

import math
from dataclasses import replace

import linear_plant
import numpy as np
import pytest
from logs import MACHINE
from numpy.typing import NDArray

from tilth.estimator.filters import fit_covariance, likelihood, unknowns
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.scoring import maximise_posterior
from tilth.estimator.filters.states import DT
from tilth.estimator.filters.unknowns import AT, SIX
from tilth.estimator.methods import pem
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.record.record import WHEEL_ANGLE, Record

Array = NDArray[np.float64]


def test_where_the_open_loop_runs_away_little_is_told_but_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    record = linear_plant.record_of(linear_plant.plant(rig_of(MACHINE), 3, "random", 15.0, 4.0))
    mean, sd = unknowns.prior(MACHINE)
    fits = []
    for limit in (likelihood.LIKELIHOOD.run_away, 1e-3):
        monkeypatch.setattr(likelihood, "LIKELIHOOD", replace(likelihood.LIKELIHOOD, run_away=limit))
        fits.append(maximise_posterior(record, rig_setup(MACHINE), mean, np.diag(sd**2)))
    steered, away = (np.sqrt(np.diag(found.covariance)) for found in fits)
    assert np.all(np.isfinite(away)) and np.all(away[SIX] > 1.3 * steered[SIX])
    assert np.all(away[SIX] < 1.05 * np.hypot(sd[SIX], fit_covariance.model_sd(False, 0.0, 0.0, mean[SIX])))


def test_the_room_for_errors_of_the_model_is_that_of_the_window() -> None:
    """Wide where the wheels were turned far, and for stiffnesses where the ground is rough."""
    record = linear_plant.record_of(linear_plant.plant(rig_of(MACHINE), 1, "random", 2.0, 4.0))
    tight = replace(record, ticks=record.ticks * np.array([10.0, *[1.0] * 7]))
    mean, _ = unknowns.prior(MACHINE)
    rough = mean + np.eye(len(mean))[AT["uneven"]] * (math.log(0.02) - mean[AT["uneven"]])
    plain, far, uneven = (
        fit_covariance.model_sd_of(of, point)
        for of, point in ((record, mean), (tight, mean), (record, rough))
    )
    assert np.all(far > plain) and np.all(far >= fit_covariance.FIT_COVARIANCE.tight_sd)
    assert np.all(uneven[:3] > 0.35) and np.array_equal(uneven[3:], plain[3:])


def _spread(rng: np.random.Generator, size: int) -> Array:
    root = rng.normal(size=(size, size)) * np.exp(rng.normal(size=size))
    return np.asarray(root @ root.T, np.float64)


@pytest.mark.parametrize("varies", [0.3, 1.0, 2.0, 30.0])
@pytest.mark.parametrize("colour", [1.0, 1.5])
def test_shift_and_information_of_a_window_are_weighed_alike(varies: float, colour: float) -> None:
    """Scores that vary by one factor more than the information says: a posterior with so much less of it."""
    rng = np.random.default_rng(64)
    for _ in range(20):
        prior, information, likeliest = _spread(rng, 7), _spread(rng, 7), rng.normal(size=7)
        found = likelihood.inverse(np.linalg.inv(prior) + information)
        change, covariance = fit_covariance.tempered(
            found @ information @ likeliest, found, prior, varies * information, colour
        )
        told = information / (max(varies, 1.0) * colour)
        expected = np.linalg.inv(np.linalg.inv(prior) + told)
        assert np.allclose(covariance, expected, rtol=1e-6, atol=1e-8 * np.trace(expected))
        assert np.allclose(change, expected @ told @ likeliest, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("size", [1, 3, 30])
def test_scores_of_any_colour_make_nothing_less_known_than_before(size: int) -> None:
    rng = np.random.default_rng(size)
    for _ in range(20):
        prior, information, scores = (_spread(rng, size) for _ in range(3))
        found = likelihood.inverse(np.linalg.inv(prior) + information)
        change = found @ information @ rng.normal(size=size)
        less, covariance = fit_covariance.tempered(change, found, prior, 100.0 * scores, 1.2)
        root = np.linalg.inv(np.linalg.cholesky(prior))
        assert np.linalg.eigvalsh(root @ covariance @ root.T)[-1] < 1.0 + 1e-9
        assert np.linalg.norm(root @ less) <= np.linalg.norm(root @ change) * (1.0 + 1e-9)


@pytest.mark.parametrize("seconds", [1, 2, 8, 1000])
def test_steering_that_is_held_leaves_more_room(seconds: int) -> None:
    """Wheels that go to and fro every so many seconds, 30 s of them: the share that is held for 4 s."""
    record = linear_plant.record_of(linear_plant.plant(rig_of(MACHINE), 1, "random", 2.0, 4.0))
    ticks = np.repeat(record.ticks[:1], round(30.0 / DT), axis=0)
    whole_s = np.arange(len(ticks)) // round(1.0 / DT)
    ticks[:, WHEEL_ANGLE] = math.radians(4.0) * np.where(whole_s // seconds % 2 == 0, 1.0, -1.0)
    there = replace(record, ticks=ticks)
    share = 1.0 if seconds > fit_covariance.FIT_COVARIANCE.held_s else 0.0
    assert fit_covariance.held_share(there) == pytest.approx(share, abs=1e-9)
    ticks[:, WHEEL_ANGLE] = 0.0
    assert fit_covariance.held_share(there) == 0.0
    logs = np.zeros(6)
    room = fit_covariance.model_sd(False, 0.0, 0.0, logs, held=share)
    assert np.all(room[:2] >= 0.06 * share)
    assert np.array_equal(room[2:], fit_covariance.model_sd(False, 0.0, 0.0, logs)[2:])


@pytest.mark.parametrize("tight", [False, True])
def test_the_room_for_errors_of_a_short_length_is_a_distance(tight: bool) -> None:
    lengths = np.array([0.1, 0.3, 1.0, 3.0])
    rooms = np.array([
        fit_covariance.model_sd(tight, 0.0, 0.0, np.array([12.0] * 3 + [math.log(x)] * 3)) for x in lengths
    ])  # fmt: skip
    assert np.all(np.ptp(rooms[:, :3], axis=0) == 0.0)
    assert np.all(np.diff(rooms[:, 3:], axis=0) <= 0.0)
    meters = rooms[:, 3:] * lengths[:, None]
    assert np.all(meters[0] < 1.05 * fit_covariance.FIT_COVARIANCE.length_sd) and np.all(
        meters >= fit_covariance.FIT_COVARIANCE.length_sd
    )
    least = fit_covariance.FIT_COVARIANCE.tight_sd[3:] if tight else fit_covariance.FIT_COVARIANCE.model_sd
    assert np.all(rooms[:, 3:] >= least) and np.all(rooms[3, 3:] < 1.3 * least)


def window(tight: bool) -> Record:
    record = linear_plant.record_of(linear_plant.plant(rig_of(MACHINE), 1, "random", 2.0, 4.0))
    return replace(record, ticks=record.ticks * np.array([10.0 if tight else 1.0, *[1.0] * 7]))


def one_more(state: pem.PemState, tight: bool, sd: float, changed: bool = False) -> Array:
    """Adopt the fit of a window that knows each of the six to that sd, and return the sds then published."""
    turned = window(tight)
    state.closed = turned
    job = pem.request_fit(state, 0)
    assert job is not None
    mean, covariance = job.mean, job.covariance.copy()
    masses = pem.of_masses(covariance)[SIX, SIX]
    known = np.linalg.inv(np.linalg.inv(covariance[SIX, SIX] - masses) + sd**-2 * np.eye(6))
    errors = fit_covariance.model_sd_of(turned, mean)
    covariance[SIX, SIX] = known + masses + np.diag(errors**2)
    made = pem.Fit(mean, covariance, None, 0.0, 0.0, 0.0, 5, 100, changed, False, None)
    pem.adopt(state, MACHINE, made, 0)
    return np.asarray(np.sqrt(np.diag(state.covariance)[SIX] - np.diag(masses)))


WINDOWS = {
    "ten alike": ([(True, 0.2)] * 10, 0.2 / math.sqrt(10.0), True),
    "gentle, then tight": ([(False, 0.05), (True, 0.5)], 0.05, False),
    "tight, then gentle": ([(True, 0.1), (False, 0.05)], 0.05, False),
}


@pytest.mark.parametrize("case", WINDOWS)
def test_errors_of_the_model_neither_add_up_nor_average_out(case: str) -> None:
    """Windows of one kind tell more and more, beside what the model has wrong; a window that tells little
    brings little of its errors; errors that a window does not share count as what it corrects."""
    windows, data, tight = WINDOWS[case]
    errors = fit_covariance.model_sd_of(window(tight), unknowns.prior(MACHINE)[0])
    state = pem.initial(MACHINE)
    published = [one_more(state, tight, sd) for tight, sd in windows][-1]
    expected = np.hypot(data, errors)
    assert np.all(published < 1.25 * expected) and np.all(published > 0.9 * expected)
    assert np.all(np.linalg.eigvalsh(state.covariance[SIX, SIX]) > 0.0)


def test_after_a_change_of_soil_errors_of_the_model_are_those_of_the_new_window() -> None:
    state = pem.initial(MACHINE)
    one_more(state, True, 0.1)
    one_more(state, False, 0.1, changed=True)
    assert state.model_sd == pytest.approx(fit_covariance.model_sd_of(window(False), state.mean))
