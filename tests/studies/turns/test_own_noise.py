"""What a window tells with a noise model of its own: of white innovations, and of a body that heads
elsewhere."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from circle import demo_machine
from linear_drive import LINEAR, simulated
from numpy.typing import NDArray

from studies.turns.own_noise import across_bodies, in_epochs, of_motion, told_by
from tilth.estimator.filters import likelihood, unknowns
from tilth.estimator.filters.likelihood import Search
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.row_fit import OUTPUTS
from tilth.estimator.filters.states import N_STATES
from tilth.estimator.filters.unknowns import NAMES
from tilth.estimator.record.record import EAST, KIND, NORTH, PSI, VELOCITY
from tilth.estimator.results.advice import Candidate

Array = NDArray[np.float64]

MACHINE = demo_machine()


@cache
def search() -> Search:
    setup, sd = rig_setup(MACHINE, linear=True), unknowns.prior(MACHINE)[1]
    record = simulated(0, MACHINE, Candidate("chirp", 5.0))
    found = likelihood.search_of(record, setup, LINEAR, np.diag(sd**2))
    found.start = np.zeros(N_STATES)
    return found


@pytest.mark.parametrize("steered", [True, False])
def test_the_past_of_white_innovations_takes_some_information_and_moves_little(steered: bool) -> None:
    """The model of this drive is the filter's own."""
    plain, own = (told_by(search(), LINEAR, steered=steered, past=past) for past in (False, True))
    six = np.isin(of_motion(search()), np.arange(6))
    sds = [1.0 / np.sqrt(np.diag(one.information)[six]) for one in (plain, own)]
    assert np.all(np.abs(np.log(sds[1] / sds[0])) < 0.5)
    assert np.all(np.abs((own.gradient - plain.gradient)[six]) * sds[0] < 1.5)


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
    assert outputs.shape[1:] == (len(OUTPUTS), 3)
    present = np.any(outputs != 0.0, axis=(0, 2))
    assert np.std(outputs[:, present]) == pytest.approx(1.0, abs=0.06)
    assert len(others) + np.count_nonzero(outputs[:, :, 0]) <= len(ones)


def test_noise_levels_are_given() -> None:
    assert not {NAMES[k] for k in of_motion(search())} & set(unknowns.NOISES)
