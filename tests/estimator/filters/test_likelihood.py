"""What a stage behind the filter gets: innovations that are white, and slopes by the steering alone."""

from functools import cache

import numpy as np
import pytest
from circle import demo_machine
from linear_drive import LINEAR, simulated
from numpy.typing import NDArray

from tilth.estimator.filters import likelihood, unknowns
from tilth.estimator.filters.likelihood import Search, search_of, whitened_by_steering
from tilth.estimator.filters.predictor import Innovations
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.states import N_STATES
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.record.record import KIND, PLACE, TICK, VALUE, Record
from tilth.estimator.results.advice import Candidate

Array = NDArray[np.float64]

MACHINE = demo_machine()
SETUP = rig_setup(MACHINE, linear=True)
SD = unknowns.prior(MACHINE)[1]
NAMES = ("C_af", "C_ar", "C_ai", "sigma_f", "sigma_r", "sigma_i", "wheel_zero", "pair_t", "a", "rate_late_i")
PLACES = np.array([AT[name] for name in NAMES])
SMALL = 1e-5  # of an unknown: headings are not linear


@cache
def search(seed: int = 0) -> Search:
    record = simulated(seed, MACHINE, Candidate("chirp", 5.0))
    found = search_of(record, SETUP, LINEAR, np.diag(SD**2))
    found.start = np.zeros(N_STATES)
    return found


def by_tick(e: Array, rows: Array) -> Array:
    """(ticks, sensors): one column for each kind and place."""
    sensors = sorted({(row[KIND], row[PLACE]) for row in rows.tolist()})
    ticks = np.unique(rows[:, TICK])
    out = np.zeros((len(ticks), len(sensors)))
    columns = [sensors.index((row[KIND], row[PLACE])) for row in rows.tolist()]
    out[np.searchsorted(ticks, rows[:, TICK]), columns] = e
    return out


def test_innovations_of_the_right_model_are_white_over_ticks_and_between_sensors() -> None:
    e = np.concatenate([
        by_tick(whitened_by_steering(search(seed), LINEAR, PLACES[:1])[0], search(seed).record.rows)[11:]
        for seed in range(3)
    ])  # fmt: skip
    n = len(e)
    assert n > 130
    for lag in range(4):
        found = e[lag:].T @ e[: n - lag] / n
        expected = np.eye(e.shape[1]) if lag == 0 else np.zeros((e.shape[1],) * 2)
        off = np.sqrt(n) * (found - expected)[~np.eye(len(found), dtype=bool)]  # each of sd 1
        assert 0.8 < np.mean(off**2) < 1.2 and np.abs(off).max() < 4.5, lag
        assert np.abs(np.diag(found - expected)).max() < 4.5 * np.sqrt(2.0 / n)


@pytest.mark.parametrize("k", range(len(NAMES)), ids=NAMES)
def test_slopes_are_those_of_differences_along_the_path_by_steering_alone(k: int) -> None:
    """What the open loop does, as a change of the readings, in the innovations."""
    one, nudge = search(), 1e-4 * np.eye(len(LINEAR))[PLACES[k]]

    def run(point: Array, record: Record, closed: bool) -> Innovations:
        return likelihood.innovations(record, SETUP, one.start, point, used=one.used, closed=closed)

    ahead, behind = (run(LINEAR + by, one.record, False).e for by in (nudge, -nudge))
    rows = one.record.rows.copy()
    rows[:, VALUE] += SMALL * (ahead - behind) / 2e-4
    here = run(LINEAR, one.record, True)
    changed = run(LINEAR, Record(0, one.record.ticks, rows), True)
    expected = one.scored * (changed.e - here.e) / SMALL / np.sqrt(here.S)
    slopes = whitened_by_steering(one, LINEAR, PLACES[k : k + 1])[1][:, 0]
    assert np.linalg.norm(slopes - expected) < 0.02 * np.linalg.norm(expected) > 0.01


def test_what_is_left_out_and_what_only_settles_the_state_is_nothing() -> None:
    one = search()
    rows, used = one.record.rows, np.ones(len(one.used))
    used[300] = 0.0
    without = search_of(one.record, SETUP, LINEAR, np.diag(SD**2))
    without.used = used
    e, slopes = whitened_by_steering(without, LINEAR, PLACES)
    none = (used == 0.0) | (rows[:, TICK] < likelihood.LIKELIHOOD.settling_ticks)
    assert not e[none].any() and not slopes[none].any() and e[~none].all()
