"""A straight row as it was measured, turned along north: what a fit takes of it, whatever the unknowns."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.row_filter import Stops, stops_of
from tilth.estimator.filters.sensors.wheel_play import flanks
from tilth.estimator.filters.states import DT
from tilth.estimator.record.record import (
    EAST,
    HEADING,
    KIND,
    NORTH,
    OFFSET,
    PLACE,
    PSI,
    TICK,
    VALUE,
    VELOCITY,
    WHEEL_ANGLE,
    YAW_RATE,
    Record,
    U,
)
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]

OUTPUTS: Final = (  # kind, places
    (EAST, (0,)), (EAST, (1,)), (EAST, (2,)), (EAST, (3,)),
    (VELOCITY, (0, 1)), (VELOCITY, (2, 3)), (YAW_RATE, (0,)), (YAW_RATE, (1,)),
)  # fmt: skip
"""In the row's frame, where north is along it: each antenna's position across, each body's velocities and
yaw rates."""


@dataclass(frozen=True, slots=True)
class PlainRowTuning:
    """How readings are put together."""

    epoch_s: float = tuned(0.2, "s", "for which what an output measured is one value")


PLAIN_ROW: Final = PlainRowTuning()


@dataclass(frozen=True, slots=True)
class PlainRow:
    """One row as it was measured, along north."""

    ticks: Array  # (n, 8)
    rows: Array  # (m, 6)
    across: Array  # (m,), readings across the row
    used: Array  # (m,), 0.0 of what is not across the row, or no number
    flanks: Array  # (n,), of the wheel sensor's play
    stops: Stops
    outputs: NDArray[np.int64]  # (m,), of OUTPUTS
    epoch: NDArray[np.int64]  # (m,), from 0 on
    wheel_angle: Array  # (epochs,), rad


def positions_of(rows: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which rows are positions: to the north, to the east; (p,) each, those of one position side by side."""
    parts = (np.flatnonzero(rows[:, KIND] == kind) for kind in (NORTH, EAST))
    north, east = (at[np.lexsort((rows[at, PLACE], rows[at, OFFSET], rows[at, TICK]))] for at in parts)
    return north, east


def output_of(rows: Array) -> NDArray[np.int64]:
    """Which of OUTPUTS each row is of, (m,); -1: of none."""
    output = np.full(len(rows), -1)
    for k, (kind, places) in enumerate(OUTPUTS):
        output[(rows[:, KIND] == kind) & np.isin(rows[:, PLACE], places)] = k
    return output


def along_north(record: Record) -> Record:
    """The record with its row along north and its first position as the origin."""
    ticks, rows = record.ticks.copy(), record.rows.copy()
    psi = float(np.median(ticks[:, PSI]))
    ticks[:, PSI : PSI + 2] -= psi
    rows[rows[:, KIND] == HEADING, VALUE] -= psi
    north, east = positions_of(rows)
    across, along = (rows[at, VALUE] - rows[at[0], VALUE] for at in (east, north))
    rows[north, VALUE] = np.cos(psi) * along + np.sin(psi) * across
    rows[east, VALUE] = np.cos(psi) * across - np.sin(psi) * along
    return Record(record.t_ns, ticks, rows)


def across_row(record: Record) -> Array:
    """Readings, (m,), of a record along north, with velocities to the east of the row."""
    rows, n = record.rows, len(record.ticks)
    readings, moving = rows[:, VALUE].copy(), np.flatnonzero(rows[:, KIND] == VELOCITY)
    instants, ticks = rows[moving, TICK] + rows[moving, OFFSET] / DT, np.arange(n)
    for body in (0, 1):
        of_body = (rows[moving, PLACE] >= 2) == bool(body)
        at = instants[of_body]
        psi = np.interp(at, ticks, record.ticks[:, PSI + body])
        readings[moving[of_body]] += np.interp(at, ticks, record.ticks[:, U]) * psi
    return readings


def epochs_of(instants: Array) -> NDArray[np.int64]:
    """Epoch of each instant, (m,), s; epochs begin in the widest gap between what is measured."""
    length = PLAIN_ROW.epoch_s
    within = np.sort(np.mod(instants, length))
    gaps = np.diff(within, append=within[0] + length)
    widest = int(np.argmax(gaps))
    begin = within[widest] + gaps[widest] / 2.0
    return np.asarray(np.floor((instants - begin) / length), np.int64)


def plain_row(record: Record) -> PlainRow:
    """Of a record without a gap."""
    record = along_north(record)
    rows, ticks = np.ascontiguousarray(record.rows), np.ascontiguousarray(record.ticks)
    wheel = ticks[:, WHEEL_ANGLE]
    used = np.all(np.isfinite(rows), axis=1) & (rows[:, KIND] != NORTH)
    instants = rows[:, TICK] * DT + rows[:, OFFSET]
    epoch = epochs_of(instants)
    epoch = epoch - epoch.min()
    middle = np.bincount(epoch, instants) / np.maximum(np.bincount(epoch), 1)
    at = np.clip(np.round(middle / DT), 0, len(ticks) - 1).astype(np.int64)
    return PlainRow(
        ticks, rows, across_row(record), used.astype(np.float64), flanks(wheel),
        stops_of(rows[used], len(ticks)), output_of(rows), epoch, wheel[at],
    )  # fmt: skip
