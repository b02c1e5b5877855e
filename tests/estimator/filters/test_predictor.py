"""Innovations, their derivatives over unknowns against differences of whole runs, and left against right."""

import math
from functools import cache

import numpy as np
import pytest
from logs import MACHINE
from numpy.typing import NDArray

from tilth.estimator.filters import likelihood, unknowns
from tilth.estimator.filters.predictor import Innovations
from tilth.estimator.filters.rig_setup import RigSetup, rig_setup
from tilth.estimator.filters.states import DT, N_STATES, X_LATERAL_OFFSET, X_PAIR, X_POSITION, X_SPEED, Places
from tilth.estimator.filters.unknowns import AT, NAMES, NOISES, ROLL_ZEROS
from tilth.estimator.record.record import (
    EAST,
    HEADING,
    KIND,
    NORTH,
    OFFSET,
    ROLL_ANGLE,
    SD,
    VALUE,
    VELOCITY,
    WHEEL_ANGLE,
    YAW_RATE,
    Record,
    U,
)
from tilth.estimator.results import advice

Array = NDArray[np.float64]

SETUP = rig_setup(MACHINE)
MEAN, PRIOR_SD = unknowns.prior(MACHINE)
SD_OF = np.where(PRIOR_SD > 0.0, PRIOR_SD, 0.1)  # what the machine file calls known is nudged too
START = np.zeros(N_STATES)
KINDS = (YAW_RATE, VELOCITY, NORTH, EAST, ROLL_ANGLE)
CONSTANT = [name for name in NAMES if name not in NOISES]
GAINLESS = [
    "wheel_zero", "wheel_gain", "latency", "pair_t", "pair_i", "lever_t", "lever_i", "aside_i", "rolling",
    *ROLL_ZEROS,
]  # fmt: skip
"""Unknowns that change no gain but by where the rig goes."""
ALL: Places = np.array([AT[name] for name in CONSTANT])


@cache
def turning(noise: float = 0.0) -> Record:
    """A sharp turn at a speed that changes, as the model at MEAN expects it."""
    count = 400
    time: Array = np.arange(count, dtype=np.float64) * DT
    ticks = np.zeros((count, 8))
    ticks[:, U] = 3.0 + 0.3 * np.sin(0.7 * time)
    ticks[:, WHEEL_ANGLE] = 0.49 * np.sin(np.minimum(time / 3.0, 0.5) * math.pi) ** 2
    ticks[:, WHEEL_ANGLE] += 0.03 * np.sin(3.0 * time)
    headings = np.array([(k, 0.0, HEADING, body, 0.0, 1.0) for k in range(count) for body in (0, 1)])
    ticks[:, 2:4] = -run(Record(0, ticks, headings), MEAN, closed=False).e.reshape(count, 2)
    rows = advice.planned_rows(MACHINE, count, (10.0,) * 4)
    rows[:, OFFSET] = 0.007
    rows[:, VALUE] = -run(Record(0, ticks, rows), MEAN, closed=False).e
    rows[:, VALUE] += noise * rows[:, SD] * np.random.default_rng(1).normal(size=len(rows))
    return Record(0, ticks, rows)


def run(
    record: Record,
    point: Array,
    *,
    places: Places = likelihood.NOTHING,
    closed: bool = True,
    instruments: Array = likelihood.NO_READINGS,
) -> Innovations:
    return likelihood.innovations(record, SETUP, START, point, places, closed=closed, instruments=instruments)


def difference(name: str, closed: bool) -> Array:
    """Derivative of the innovations by one unknown, from two runs."""
    nudge = 1e-4 * SD_OF[AT[name]] * np.eye(len(NAMES))[AT[name]]
    above, below = (run(turning(), MEAN + step, closed=closed).e for step in (nudge, -nudge))
    return np.asarray((above - below) / (2e-4 * SD_OF[AT[name]]), np.float64)


def assert_alike(name: str, found: Array, expected: Array) -> None:
    """Within 3 % of the largest of their kind, or a fiftieth of a measurement's sd per prior sd.

    One set of Jacobians serves three ticks."""
    rows = turning().rows
    in_sds = SD_OF[AT[name]] / rows[:, SD]
    for kind in KINDS:
        chosen = rows[:, KIND] == kind
        off = np.abs((found - expected) * in_sds)[chosen].max()
        assert off < 0.02 + 0.03 * np.abs(expected * in_sds)[chosen].max(), (name, kind)


def test_the_record_turns_as_sharply_as_a_headland_does() -> None:
    ticks = turning().ticks
    articulation = np.degrees(np.abs(ticks[:, 2] - ticks[:, 3]))
    assert 48.0 < articulation.max() < 52.0


def test_each_kind_of_measurement_is_in_the_record() -> None:
    assert set(turning().rows[:, KIND]) == set(KINDS)


@pytest.mark.parametrize("name", CONSTANT)
def test_derivatives_of_the_open_loop_are_differences_of_runs(name: str) -> None:
    found = run(turning(), MEAN, places=ALL, closed=False).de[:, CONSTANT.index(name)]
    expected = difference(name, closed=False)
    assert_alike(name, found, expected)
    weight = 1.0 / turning().rows[:, SD]
    size = float(np.linalg.norm(expected * weight))
    # How a roll's inertia acts follows the roll's acceleration, which changes within three ticks.
    most = 0.2 if name.startswith("roll_j") else 0.06
    assert size > 0.0
    assert float(np.linalg.norm((found - expected) * weight)) < most * size


@pytest.mark.parametrize("name", GAINLESS)
def test_derivatives_of_the_filter_are_differences_of_runs(name: str) -> None:
    found = run(turning(), MEAN, places=ALL).de[:, CONSTANT.index(name)]
    assert_alike(name, found, difference(name, closed=True))


def test_derivatives_pass_through_the_filter_as_changes_of_the_readings_do() -> None:
    """Where the readings are what is expected, the filter goes the same way with and without them: then its
    derivatives are its response to those of the open loop, at the same gains."""
    record = turning()
    found = run(record, MEAN, places=ALL).de
    response = run(record, MEAN, places=ALL, instruments=run(record, MEAN, places=ALL, closed=False).de).de
    scale = np.abs(found).max(axis=0)
    np.testing.assert_allclose(found / scale, response / scale, atol=1e-9)


def test_a_response_is_that_to_changed_readings() -> None:
    """With the gains held, as they are in a filter whose readings change by little."""
    record = turning()
    instruments = np.random.default_rng(2).normal(size=(len(record.rows), 1)) * record.rows[:, [SD]]
    rows = record.rows.copy()
    rows[:, VALUE] += 1e-4 * instruments[:, 0]
    changed = run(Record(0, record.ticks, rows), MEAN).e
    found = run(record, MEAN, places=ALL[:1], instruments=instruments).de[:, 0]
    sd = record.rows[:, SD]
    np.testing.assert_allclose(found / sd, (changed - run(record, MEAN).e) / 1e-4 / sd, atol=0.05)


# Left and right


ODD_KINDS = (YAW_RATE, VELOCITY, EAST, HEADING, ROLL_ANGLE)
ODD = ("wheel_zero", "pair_t", "pair_i", "aside_i", *ROLL_ZEROS)


def mirrored(record: Record) -> Record:
    ticks, rows = record.ticks.copy(), record.rows.copy()
    ticks[:, [WHEEL_ANGLE, *range(2, 8)]] *= -1.0
    rows[np.isin(rows[:, KIND], ODD_KINDS), VALUE] *= -1.0
    return Record(0, ticks, rows)


def mirrored_setup() -> RigSetup:
    return SETUP._replace(levers=SETUP.levers * [1.0, -1.0], middles=SETUP.middles * [1.0, -1.0])


def test_a_mirrored_record_gives_mirrored_innovations() -> None:
    record, rng = turning(noise=1.0), np.random.default_rng(3)
    start, point = 0.01 * rng.normal(size=N_STATES), MEAN + 0.3 * PRIOR_SD * rng.normal(size=len(NAMES))
    sign = np.where(np.isin(NAMES, ODD), -1.0, 1.0)
    of_rows = np.where(np.isin(record.rows[:, KIND], ODD_KINDS), -1.0, 1.0)
    of_states = np.full(N_STATES, -1.0)
    of_states[[X_POSITION, X_SPEED, X_PAIR, X_PAIR + 2, X_LATERAL_OFFSET]] = 1.0  # to north, forward
    there = likelihood.innovations(record, SETUP, start, point, ALL)
    back = likelihood.innovations(mirrored(record), mirrored_setup(), of_states * start, sign * point, ALL)
    sd = np.sqrt(there.S)
    np.testing.assert_allclose(back.e * of_rows / sd, there.e / sd, atol=2e-3)
    np.testing.assert_allclose(back.S, there.S, rtol=2e-3)
    expected = there.de * of_rows[:, None] * sign[ALL]
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(back.de / scale, expected / scale, atol=5e-3)


@pytest.mark.parametrize("name", NOISES)
def test_a_companion_is_the_filter_at_its_own_noise_level(name: str) -> None:
    """With a linear model, whose Jacobians are the same wherever the rig goes."""
    record, setup, step = turning(noise=1.0), rig_setup(MACHINE, linear=True), 1e-3
    nearby = MEAN + step * np.eye(len(NAMES))[AT[name]]
    here = likelihood.innovations(record, setup, START, MEAN, nearby=nearby[None])
    there = likelihood.innovations(record, setup, START, nearby)
    in_sds = 1.0 / np.sqrt(here.S)
    for found, expected, unit in (
        (here.e_nearby[:, 0] - here.e, there.e - here.e, in_sds),
        (here.S_nearby[:, 0] - here.S, there.S - here.S, in_sds**2),
    ):
        size = float(np.linalg.norm(expected * unit))
        assert float(np.linalg.norm((found - expected) * unit)) < 0.03 * size + 1e-9


def test_a_run_is_the_same_with_companions_and_without() -> None:
    nearby = np.tile(MEAN, (2, 1))
    nearby[:, AT["push_t"]] += (0.5, -0.5)
    alone = run(turning(1.0), MEAN, places=ALL)
    beside = likelihood.innovations(turning(1.0), SETUP, START, MEAN, ALL, nearby=nearby)
    for one, other in ((alone.e, beside.e), (alone.S, beside.S), (alone.de, beside.de)):
        np.testing.assert_array_equal(one, other)
