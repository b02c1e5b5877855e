"""The loop of the filters: each row once, in order, after the tick that it came after."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tilth.estimator.filters.record_loop import over_ticks
from tilth.estimator.record.record import TICK

Calls = list[tuple[str, float, float]]


def begin_tick(k: int, on: Calls) -> float:
    on.append(("begin", k, k))
    return 0.5 + k


def take_row(row: int, k: int, at: float, on: Calls) -> None:
    on.append(("row", row, at - 0.5))


def end_tick(at: float, on: Calls) -> None:
    on.append(("end", at - 0.5, at - 0.5))


loop = over_ticks.with_steps(begin_tick=begin_tick, take_row=take_row, end_tick=end_tick).interpreted()


@given(st.lists(st.integers(-1, 12), max_size=20).map(sorted), st.integers(0, 10))
def test_each_row_is_taken_once_after_its_tick(ticks: list[int], size: int) -> None:
    rows, made = np.zeros((len(ticks), 6)), Calls()
    rows[:, TICK] = ticks
    loop(size, rows, made)
    told = Calls()
    for k in range(size):
        due = [("row", i, k) for i, tick in enumerate(ticks) if max(tick, 0) == k]
        told += [("begin", k, k), *due, ("end", k, k)]
    assert made == told
