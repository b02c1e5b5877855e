"""Whether a fit stands without its model of the ground: it does where that is right, and is widened by what
it differs where not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from circle import demo_machine
from linear_drive import LINEAR, simulated
from numpy.typing import NDArray

from tilth.estimator.filters import likelihood, unknowns
from tilth.estimator.filters.contrast import (
    MOTION,
    Contrast,
    across_bodies,
    contrast_of,
    in_epochs,
    joined,
    told_beside,
)
from tilth.estimator.filters.likelihood import Search
from tilth.estimator.filters.plain_row import OUTPUTS
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.states import N_STATES
from tilth.estimator.filters.unknowns import NAMES, NOISES, SIX
from tilth.estimator.record.record import EAST, KIND, NORTH, PSI, VELOCITY
from tilth.estimator.results.advice import Candidate

Array = NDArray[np.float64]

MACHINE = demo_machine()


PRIOR = unknowns.prior(MACHINE)


@cache
def search(seed: int = 0) -> Search:
    record = simulated(seed, MACHINE, Candidate("chirp", 5.0))
    known = np.diag(PRIOR[1] ** 2)
    found = likelihood.search_of(record, rig_setup(MACHINE, linear=True), LINEAR, known)
    found.start = np.zeros(N_STATES)
    return found


def of_drive(seed: int) -> Contrast:
    """The model of this drive is the filter's own, at its true point."""
    there = search(seed)
    here = likelihood.evaluate(there, LINEAR, None, likelihood.response_to_steering(there, LINEAR))
    return contrast_of(there, *likelihood.apart_from_ground(there, here))


def test_the_past_of_white_innovations_takes_some_information_and_moves_little() -> None:
    places = search().active[search().of_motion]
    e, slopes = likelihood.whitened_by_steering(search(), LINEAR, places)
    plain, own = (told_beside(search(), e, slopes, past) for past in (False, True))
    six = places < 6
    sds = [1.0 / np.sqrt(np.diag(one.information)[six]) for one in (plain, own)]
    assert np.all(np.abs(np.log(sds[1] / sds[0])) < 0.5)
    assert np.all(np.abs((own.gradient - plain.gradient)[six]) * sds[0] < 1.5)


def test_a_right_model_of_the_ground_is_hardly_widened() -> None:
    """Over three drives that are one: what is added is a fraction of what the fit says."""
    known = np.diag(PRIOR[1] ** 2)
    found = Contrast()
    for seed in range(3):
        found = joined(found, of_drive(seed), (LINEAR, PRIOR[1]), (LINEAR, known))
    at = np.flatnonzero(PRIOR[1][MOTION] > 0.0)
    precision = found.information[0][np.ix_(at, at)] + np.diag(PRIOR[1][MOTION[at]] ** -2.0)
    sds = np.sqrt(np.diag(np.linalg.inv(precision))[:6])
    assert np.median(found.excess / sds) < 0.5 and np.max(found.excess / sds) < 2.0


def told(differ: float, times: float = 1.0) -> Contrast:
    """Of the six alone: the fit to 5 % at their prior's mean, the other one to 7 % that far from there."""
    contrast = Contrast()
    for k, (sd, off) in enumerate(((0.05, 0.0), (0.07, differ))):
        contrast.information[k][SIX, SIX] = times * sd**-2.0 * np.eye(6)
        contrast.vector[k, SIX] = times * sd**-2.0 * (PRIOR[0][SIX] + off)
    return contrast


@pytest.mark.parametrize(("differ", "excess"), [(0.0, 0.0), (0.04, 0.0), (-0.2, 0.193), (0.2, 0.193)])
def test_what_two_estimates_differ_by_beyond_chance_is_the_error(differ: float, excess: float) -> None:
    """Chance: the root of 0.07 squared less 0.05 squared."""
    found = joined(Contrast(), told(differ), PRIOR, (PRIOR[0], np.diag(PRIOR[1] ** 2)))
    assert found.excess == pytest.approx(excess, abs=0.005)


def test_more_driving_does_not_take_it_away_and_shows_what_one_window_does_not() -> None:
    fitted = PRIOR[0], np.diag(PRIOR[1] ** 2)
    once = joined(Contrast(), told(0.04), PRIOR, fitted)
    often = joined(told(0.04, 20.0), told(0.04), PRIOR, fitted)
    assert np.all(once.excess == 0.0) and np.all(often.excess > 0.03) and np.all(often.excess < 0.041)
    faded = joined(told(0.04, 20.0).faded(0.0), told(0.04), PRIOR, fitted)
    assert np.array_equal(faded.excess, once.excess)


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
def test_positions_are_taken_along_and_across_their_body(heading: float) -> None:
    """A rotation keeps what is white."""
    record = replace(search().record, ticks=search().record.ticks.copy())
    record.ticks[:, PSI : PSI + 2] = heading
    columns = np.random.default_rng(1).standard_normal((len(record.rows), 2))
    made, kinds = across_bodies(record, columns), record.rows[:, KIND]
    assert np.sum(made**2) == pytest.approx(np.sum(columns**2))
    assert np.array_equal(made[kinds == VELOCITY], columns[kinds == VELOCITY])
    if heading == 0.0:
        assert np.allclose(made[kinds == NORTH], columns[kinds == NORTH])
        assert np.allclose(made[kinds == EAST], columns[kinds == EAST])


def test_each_innovation_is_in_an_epoch_or_beside() -> None:
    """A mean over the rows of an output, with unit variance of what is white."""
    ones = np.random.default_rng(2).standard_normal((len(search().record.rows), 3))
    outputs, others = in_epochs(search(), ones)
    assert 0 < outputs.shape[1] <= len(OUTPUTS) and outputs.shape[2] == 3
    assert np.std(outputs) == pytest.approx(1.0, abs=0.06)
    assert len(others) + np.count_nonzero(outputs[:, :, 0]) <= len(ones)


def test_noise_levels_are_of_one_window_and_the_six_come_first() -> None:
    assert not {NAMES[k] for k in MOTION} & set(NOISES) and np.array_equal(MOTION[:6], np.arange(6))
