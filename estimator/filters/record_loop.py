"""The loop over a record, of all filters: the state to the next tick, the rows that came before it, and on.

A filter says what its three steps are:

    run_ticks = over_ticks.with_steps(begin_tick=..., take_row=..., end_tick=...)

`on` is what it works with, a NamedTuple of its own. They are compiled as one.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.record.record import TICK


def begin_tick(k: int, on: Any) -> Any:
    """From tick k to the next, before the rows between them; what the other steps need of it."""
    raise NotImplementedError


def take_row(row: int | np.int64, k: int, at: Any, on: Any) -> None:
    """A row of the record, after tick k. at: what `begin_tick` gave."""
    raise NotImplementedError


def end_tick(at: Any, on: Any) -> None:
    """What is left to do when all rows are taken."""
    raise NotImplementedError


@inner_kernel
def over_ticks(size: int, rows: NDArray[np.float64], on: Any) -> None:
    """So many ticks. rows: (m, 6), as record.Record; those that come later are left."""
    row = np.int64(0)  # to numba 0 is a type of its own, for which `take_row` would be compiled once more
    for k in range(size):
        at = begin_tick(k, on)
        while row < rows.shape[0] and rows[row, TICK] <= k:
            take_row(row, k, at, on)
            row += 1
        end_tick(at, on)
