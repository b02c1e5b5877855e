"""Records of a straight row, without noise or with what a linear rig makes of steering and ground."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.likelihood import NOTHING
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.row_filter import KeptGains, Whitened, respond, stops_of
from tilth.estimator.filters.sensors.wheel_play import flanks
from tilth.estimator.filters.states import DT, Places
from tilth.estimator.filters.straight_driving import KEPT, filter_model, straight_model, tabulated
from tilth.estimator.record.record import (
    EAST,
    KIND,
    NORTH,
    ROLL_ANGLE,
    SD,
    VALUE,
    VELOCITY,
    WHEEL_ANGLE,
    YAW_RATE,
    Record,
)

Array = NDArray[np.float64]

RESPONDING: Final = (
    "C_af", "C_ar", "C_ai", "sigma_f", "sigma_r", "sigma_i", "wheel_zero", "wheel_gain", "latency", "pair_t",
    "lever_t", "lever_i", "cg_t", "cg_i", "rolling", "roll_k_t", "roll_j_i", "roll_cg_t", "rate_late_t",
    "a", "b", "c", "d", "e", "m_t", "I_t", "I_i",
)  # fmt: skip
"""Unknowns of all kinds."""


def weaving(seconds: float, speeds: tuple[float, float] = (4.2, 4.2), seed: int = 0) -> Record:
    """Steering of half a degree that nobody follows, at a speed that goes from one to the other; the readings
    are zero, of four receivers at 5 Hz that are a few ms apart."""
    n, rng = round(seconds / DT), np.random.default_rng(seed)
    ticks = np.zeros((n, 8))
    push, angle = rng.standard_normal(n), np.zeros(n)
    for k in range(1, n):
        angle[k] = 0.97 * angle[k - 1] + 0.24 * push[k]
    ticks[:, 0] = np.radians(0.5) * np.convolve(angle, np.ones(10) / 10, "same")
    ticks[:, 1] = np.linspace(*speeds, n)
    kinds = [
        *((kind, place, sd) for place in range(4)
          for kind, sd in ((NORTH, 0.01), (EAST, 0.01), (VELOCITY, 0.03), (ROLL_ANGLE, 0.005))),
        (YAW_RATE, 0, 0.003), (YAW_RATE, 1, 0.003),
    ]  # fmt: skip
    rows = [
        [10 * epoch + place // 2, 0.004 * place, kind, place, 0.0, sd]
        for epoch in range(n // 10)
        for kind, place, sd in kinds
    ]
    made = np.array(rows, dtype=np.float64)
    return Record(0, ticks, made[np.lexsort((made[:, 1], made[:, 0]))])


def raw_response(
    record: Record,
    point: Array,
    setup: RigSetup,
    places: Places = NOTHING,
    of_rows: Sequence[float] = (0.0,) * 3,
) -> Array:
    """What the rig that goes straight but for its steering would read, and its slopes, (m, 1 + a). of_rows:
    play of the wheel sensor and scales of turn rates."""
    m, speeds = len(record.rows), tabulated(record.ticks)
    zeros, stops = np.zeros((m, len(KEPT))), stops_of(record.rows, len(record.ticks))
    of_stops = np.zeros((len(stops.ticks) - 1, len(KEPT), len(KEPT)))
    gains = KeptGains(np.zeros(m), np.ones(m), zeros, zeros.copy(), of_stops, np.ones(m))
    whole = Whitened(
        record.ticks, record.rows, gains, filter_model(speeds, point, setup), np.arange(m), np.ones(m),
        np.array([record.ticks[:, 0].mean()]), flanks(record.ticks[:, 0]), stops,
    )  # fmt: skip
    out = np.empty((m, 1 + len(places)))
    respond(whole, straight_model(speeds, point, setup, places), np.append(point, of_rows), places, out)
    return out


def rut(record: Record, rng: np.random.Generator) -> Array:
    """One disturbance that meets the outputs one after the other: no filter's model."""
    profile = np.convolve(rng.standard_normal(len(record.ticks) + 400), np.hanning(60), "same")
    at, kinds = record.rows[:, 0].astype(int), record.rows[:, KIND]
    later = 60.0 * (record.rows[:, 3] >= 2) + 20.0 * (kinds == YAW_RATE)
    sizes = np.choose(kinds.astype(int), (0.002, 0.012, 0.0, 0.004, 0.0, 0.001))
    return np.asarray(sizes * profile[(at + 200 - later).astype(int)] / profile.std())


def on_a_rut(seconds: float, seed: int, point: Array, setup: RigSetup, slower: int = 1) -> Record:
    """A row of a rig at a point of the unknowns, on such ground, with white sensors. slower: an odd number of
    ticks, over which steering is a mean."""
    record, rng = weaving(seconds, seed=seed), np.random.default_rng(1000 + seed)
    angle = np.pad(record.ticks[:, WHEEL_ANGLE], slower // 2, "edge")
    record.ticks[:, WHEEL_ANGLE] = np.convolve(angle, np.ones(slower) / slower, "valid")
    rows = record.rows.copy()
    rows[:, VALUE] = raw_response(record, point, setup)[:, 0]
    rows[:, VALUE] += rut(record, rng) + rows[:, SD] * rng.standard_normal(len(rows))
    return Record(0, record.ticks, rows)
