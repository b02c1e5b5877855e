"""A fit of a straight row: its slopes, on the measurements of a simulated drive."""

from functools import cache

import numpy as np
import pytest
from circle import demo_machine
from linear_drive import simulated
from numpy.typing import NDArray

from studies.rows.row_fit import RowFit, along_north
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.record.record import EAST, KIND, PSI, VALUE, Record
from tilth.estimator.results.advice import Candidate

Array = NDArray[np.float64]

MACHINE = demo_machine()
MEAN, SD = unknowns.prior(MACHINE)


@cache
def record() -> Record:
    """Weaving by 0.5 degrees."""
    return simulated(0, MACHINE, Candidate("chirp", 0.5))


@cache
def fit() -> RowFit:
    return RowFit([record()], rig_setup(MACHINE), MEAN, np.diag(SD**2))


def test_a_row_is_turned_along_north() -> None:
    turned = along_north(record())
    assert abs(np.median(turned.ticks[:, PSI])) < 1e-12
    assert np.abs(turned.rows[turned.rows[:, KIND] == EAST, VALUE]).max() < 3.0


@pytest.mark.parametrize("name", ["C_af", "C_ai", "sigma_r", "wheel_gain", "roll_k_t", "d"])
def test_slopes_are_those_of_differences(name: str) -> None:
    """But for what an unknown changes of the integrator's step, which the product's derivatives leave out."""
    one, step = fit(), 1e-4 * np.eye(len(MEAN))[AT[name]]
    column = int(np.flatnonzero(one.active == AT[name])[0])
    slopes = one.slopes(MEAN)[0][:, :, column]
    ahead, behind = one.innovations_at(np.stack([MEAN + step, MEAN - step]))
    differences = (ahead[0] - behind[0]) / 2e-4
    np.testing.assert_allclose(slopes, differences, atol=0.15 * np.abs(differences).max())
    assert np.corrcoef(slopes.ravel(), differences.ravel())[0, 1] > 0.99
