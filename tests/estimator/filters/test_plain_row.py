"""A straight row as it was measured: along north, across it, and which epoch each reading is of."""

import numpy as np
from circle import demo_machine
from hypothesis import given
from hypothesis import strategies as st
from straight_row import on_a_rut, weaving

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.plain_row import across_row, along_north, epochs_of
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.record.record import EAST, KIND, NORTH, PSI, VALUE, VELOCITY, Record

MACHINE = demo_machine()


def test_a_row_is_turned_along_north() -> None:
    straight = on_a_rut(20.0, 0, unknowns.prior(MACHINE)[0], rig_setup(MACHINE))
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
