"""What a window of steering tells with a noise model of its own: free_noise.py behind the filter of
predictor.py, as row_fit.py has it behind that of rows.

One rut meets the axles one after the other, while the filter's disturbances are independent and of one
colour. So what the filter leaves is regressed on its own past, all outputs together, and compared with slopes
along the path of the steering alone, or of the filter.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import likelihood
from tilth.estimator.filters.free_noise import gradient_and_information, regress
from tilth.estimator.filters.likelihood import Search
from tilth.estimator.filters.row_fit import OUTPUTS, ROW_FIT, epochs_of
from tilth.estimator.filters.states import DT
from tilth.estimator.filters.unknowns import NAMES, NOISES
from tilth.estimator.record.record import EAST, KIND, NORTH, OFFSET, PLACE, PSI, TICK, Record, U

Array = NDArray[np.float64]

SETTLED: Final = 5  # epochs at the beginning, in which the filter only finds its state


class TurnTold(NamedTuple):
    """What a window tells of the k unknowns of the motion at a point, without the prior."""

    gradient: Array  # (k,), of the cost in nats
    information: Array  # (k, k)


def of_motion(search: Search) -> NDArray[np.int64]:
    """Indices, (k,), of the active unknowns that are no noise levels."""
    return np.array([k for k in search.active if NAMES[k] not in NOISES])


def told_by(search: Search, point: Array, *, steered: bool = True, past: bool = True) -> TurnTold:
    """At a point, (n,), with the noise levels there. steered: slopes along the path that the steering alone
    gives, else along the filter's. past: whether innovations are regressed on it."""
    places = of_motion(search)
    if steered:
        e, slopes = likelihood.whitened_by_steering(search, point, places)
    else:
        weights, at = search.scored, likelihood.evaluate(search, point)
        weights = weights / np.sqrt(at.S)
        e, slopes = at.e * weights, (at.de[search.of_motion] * weights).T
    columns = across_bodies(search.record, np.column_stack([e, slopes]))
    outputs, others = in_epochs(search, columns)
    gradient, information = others[:, 1:].T @ others[:, 0], others[:, 1:].T @ others[:, 1:]
    if past:
        noise = regress([outputs[:, :, 0]], order_of(search))
        of_outputs, told = gradient_and_information(noise, [outputs[:, :, 1:]])
        return TurnTold(gradient + of_outputs, information + told)
    flat = outputs.reshape(-1, outputs.shape[2])
    return TurnTold(gradient + flat[:, 1:].T @ flat[:, 0], information + flat[:, 1:].T @ flat[:, 1:])


def across_bodies(record: Record, columns: Array) -> Array:
    """Of columns, (m, k), of whitened innovations: those of positions along and across their bodies, in place
    of north and east. A rotation leaves white what is white."""
    rows = record.rows
    parts = (np.flatnonzero(rows[:, KIND] == kind) for kind in (NORTH, EAST))
    north, east = (at[np.lexsort((rows[at, PLACE], rows[at, OFFSET], rows[at, TICK]))] for at in parts)
    psi = record.ticks[rows[east, TICK].astype(np.int64), PSI + (rows[east, PLACE] >= 2)][:, None]
    turned = columns.copy()
    turned[north] = np.cos(psi) * columns[north] + np.sin(psi) * columns[east]
    turned[east] = np.cos(psi) * columns[east] - np.sin(psi) * columns[north]
    return turned


def in_epochs(search: Search, columns: Array) -> tuple[Array, Array]:
    """Columns, (m, k), as (OUTPUTS of each settled epoch (n, 8, k), what is in none of them (r, k))."""
    rows = search.record.rows
    epoch = epochs_of(rows[:, TICK] * DT + rows[:, OFFSET])
    epoch -= epoch.min()
    output = np.full(len(rows), -1)
    for k, (kind, places) in enumerate(OUTPUTS):
        output[(rows[:, KIND] == kind) & np.isin(rows[:, PLACE], places)] = k
    chosen = (output >= 0) & (search.scored > 0.0)
    slots = epoch[chosen] * len(OUTPUTS) + output[chosen]
    count = (int(epoch.max()) + 1) * len(OUTPUTS)
    rows_in = np.bincount(slots, minlength=count)
    made = np.zeros((count, columns.shape[1]))
    np.add.at(made, slots, columns[chosen] / np.sqrt(rows_in[slots])[:, None])
    whole = made.reshape(-1, len(OUTPUTS), columns.shape[1])
    return whole[SETTLED:], columns[(output < 0) & (search.scored > 0.0)]


def order_of(search: Search) -> int:
    """Epochs of the past: until the last axle has come to where the first one was."""
    a, _, c, d, e = search.setup.geometry[:5]
    speed = float(np.mean(search.record.ticks[:, U]))
    wanted = math.ceil(ROW_FIT.past_lengths * (a + c + d + e) / speed / ROW_FIT.epoch_s)
    return int(np.clip(wanted, ROW_FIT.least_order, 20))
