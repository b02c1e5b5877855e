"""The filter with gains that stay: it whitens what it is the right model of, and it is one linear map."""

import numpy as np
from circle import demo_machine
from numpy.typing import NDArray
from straight_row import raw_response, weaving

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.likelihood import NOTHING
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.row_filter import KeptGains, Whitened, respond, set_gains, stops_of
from tilth.estimator.filters.straight_driving import (
    KEPT,
    N_STRAIGHT,
    RESPONDING,
    FilterModel,
    filter_model,
    straight_model,
    tabulated,
)
from tilth.estimator.record.record import EAST, KIND, NORTH, SD, TICK, Record

Array = NDArray[np.float64]

MACHINE = demo_machine()
MEAN, _ = unknowns.prior(MACHINE)
SETUP = rig_setup(MACHINE)


def gains_for(record: Record, readings: Array, model: FilterModel, settling: int = 10**6) -> KeptGains:
    m, n = len(record.rows), len(KEPT)
    used = (record.rows[:, KIND] != NORTH).astype(np.float64)
    stops = stops_of(record.rows, len(record.ticks))
    of_stops = np.empty((len(stops.ticks) - 1, n, n))
    out = KeptGains(np.empty(m), np.empty(m), np.empty((m, n)), np.empty((m, n)), of_stops, used)
    set_gains(record.ticks, record.rows, readings, MEAN, model, settling, stops, out)
    return out


def own_disturbances(record: Record, model: FilterModel, seed: int) -> Array:
    """Readings, (m,), of a rig that does what the filter expects."""
    rng, n, k = np.random.default_rng(seed), len(KEPT), 0
    root = np.linalg.cholesky(model.Q[0, 0] + 1e-18 * np.eye(n))
    x = np.linalg.cholesky(model.start + 1e-18 * np.eye(n)) @ rng.standard_normal(n)
    readings = np.zeros(len(record.rows))
    for i, row in enumerate(record.rows):
        while k < row[TICK]:
            x, k = model.F[0, 0] @ x + root @ rng.standard_normal(n), k + 1
        later = row[1] / 0.02
        if row[KIND] == 0:
            later -= MEAN[unknowns.AT_YAW_RATE_DELAY + int(row[3])] / 0.02
        at = x + later * (model.F[0, 0] @ x - x)
        readings[i] = model.H[0, int(4 * row[KIND] + row[3])] @ at + row[SD] * rng.standard_normal()
    return readings


def test_innovations_of_its_own_model_are_white_and_of_their_variance() -> None:
    record = weaving(60.0)
    model = filter_model(tabulated(record.ticks), MEAN, SETUP)
    made = gains_for(record, own_disturbances(record, model, 1), model)
    e = (made.e / np.sqrt(made.S))[made.used > 0.0]
    assert abs(np.mean(e**2) - 1.0) < 0.06
    assert abs(np.corrcoef(e[1:], e[:-1])[0, 1]) < 0.05


def test_a_response_passes_through_it_as_readings_do() -> None:
    record = weaving(20.0, speeds=(3.6, 4.6))
    speeds, m = tabulated(record.ticks), len(record.rows)
    model = filter_model(speeds, MEAN, SETUP)
    noise = 0.01 * np.random.default_rng(2).standard_normal(m)
    steered = raw_response(record, MEAN, SETUP)[:, 0]
    without, with_it = gains_for(record, noise, model), gains_for(record, noise + steered, model)
    row = Whitened(
        record.ticks, record.rows, without, model, np.arange(m), np.ones(m),
        np.array([record.ticks[:, 0].mean()]), np.zeros(len(record.ticks)),
        stops_of(record.rows, len(record.ticks)),
    )  # fmt: skip
    out = np.empty((m, 1))
    respond(row, straight_model(speeds, MEAN, SETUP, NOTHING), np.append(MEAN, [0.0] * 3), NOTHING, out)
    np.testing.assert_allclose(out[:, 0], with_it.e - without.e, atol=1e-9)
    assert np.abs(out).max() > 0.01


def test_an_outlier_is_left_out_and_moves_nothing() -> None:
    record = weaving(20.0)
    model = filter_model(tabulated(record.ticks), MEAN, SETUP)
    clean = 1e-3 * np.random.default_rng(3).standard_normal(len(record.rows))
    spoilt, at = clean.copy(), int(np.flatnonzero(record.rows[:, KIND] == EAST)[200])
    spoilt[at] += 50.0
    before, after = gains_for(record, clean, model, 50), gains_for(record, spoilt, model, 50)
    assert before.used[at] == 1.0 and after.used[at] == 0.0
    assert np.sum(before.used != after.used) == 1
    assert np.abs(after.e).max() < 0.1


def test_what_steers_is_among_what_is_kept() -> None:
    assert set(RESPONDING) <= set(KEPT) and len(RESPONDING) == N_STRAIGHT
