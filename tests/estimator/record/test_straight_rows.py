"""Which driving is a straight row, and when rows are fitted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilth.estimator.record.record import PSI, TICK_NS, WHEEL_ANGLE, Record, Segment
from tilth.estimator.record.straight_rows import (
    ROWS,
    SHORTEST,
    Block,
    is_due,
    observe,
    rows_to_fit,
    seconds,
)
from tilth.schemas.reasons import Code

TICKS = 10


def segment(
    number: int, *, wheel: float = 0.0, heading: float = 0.3, folded: float = 0.0,
    follows: bool = True, reason: Code | None = None,
) -> Segment:  # fmt: skip
    ticks = np.zeros((TICKS, 8))
    ticks[:, WHEEL_ANGLE], ticks[:, PSI], ticks[:, PSI + 1] = wheel, heading, heading - folded
    return Segment(Record(number * TICKS * TICK_NS, ticks, np.zeros((0, 6))), follows, reason)


def drive(block: Block, first: int, count: int) -> int:
    for number in range(first, first + count):
        observe(block, segment(number))
    return first + count


def test_a_block_is_fitted_as_it_grows_and_then_begins_anew() -> None:
    block, at, fitted = Block(), 0, []
    for _ in range(round(2.1 * ROWS.fitted_at_s[-1] / 0.2)):
        at = drive(block, at, 1)
        if is_due(block):
            records, full = rows_to_fit(block)
            fitted.append((sum(len(r.ticks) for r in records) * 0.02, full, records[0].t_ns))
    once = [(limit, limit == ROWS.fitted_at_s[-1]) for limit in ROWS.fitted_at_s]
    assert [(round(s, 6), full) for s, full, _ in fitted] == [*once, *once]
    assert fitted[3][2] == round(ROWS.fitted_at_s[-1] * 1e9)  # where the first ended


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        ({"wheel": 1.1 * ROWS.straight}, Code.NOT_STRAIGHT),
        ({"folded": 1.1 * ROWS.folded}, Code.NOT_STRAIGHT),
        ({"reason": Code.NO_RTK, "follows": False}, Code.NO_RTK),
        ({"follows": False}, None),
        ({"heading": 0.3 + 1.1 * ROWS.largest_turn}, None),
    ],
)
def test_what_ends_a_row(other: dict[str, object], reason: Code | None) -> None:
    block = Block()
    at = drive(block, 0, SHORTEST)
    observe(block, segment(at, **other))  # type: ignore[arg-type]
    assert len(block.complete) == 1 and block.reason is reason
    assert len(block.row) == (0 if reason else 1)
    assert seconds(block) == pytest.approx(ROWS.shortest_s)


@pytest.mark.parametrize("zero", [-0.2, 0.07, 0.2])
def test_what_wheels_read_when_straight_is_as_the_row_says(zero: float) -> None:
    """A zero that the file has 4 degrees wrong and more; the first second still is of the way in."""
    block, at = Block(), 0
    for lasting in (0.05, 0.02, 0.01):
        observe(block, segment(at, wheel=zero + lasting))
        at += 1
    for wiggle in np.resize([-0.03, 0.03], SHORTEST):
        observe(block, segment(at, wheel=zero + float(wiggle)))
        at += 1
    assert block.reason is None and seconds(block) == pytest.approx((SHORTEST + 3) * 0.2)
    observe(block, segment(at, wheel=zero + 1.1 * ROWS.straight))
    assert block.reason is Code.NOT_STRAIGHT and len(block.complete) == 1


def test_a_row_begins_though_the_wheels_still_turn_back() -> None:
    block = Block()
    observe(block, segment(0, wheel=0.15))
    assert drive(block, 1, SHORTEST + 1) and block.refused == {Code.TOO_SHORT: 1, Code.NOT_STRAIGHT: 1}
    assert block.reason is None and len(block.row) == SHORTEST


def test_a_short_row_is_counted_and_not_used() -> None:
    block = Block()
    at = drive(block, 0, SHORTEST - 1)
    observe(block, segment(at, wheel=0.2))
    assert not block.complete and block.refused == {Code.NOT_STRAIGHT: 1, Code.TOO_SHORT: 1}


@given(st.lists(st.tuples(st.integers(1, 2 * SHORTEST), st.booleans()), max_size=12))
@settings(max_examples=25)
def test_each_second_is_in_one_block_at_most(driven: list[tuple[int, bool]]) -> None:
    block, at, seen = Block(), 0, set[int]()
    for count, turned in driven:
        for _ in range(count):
            at = drive(block, at, 1)
            if is_due(block):
                records, full = rows_to_fit(block)
                starts = {r.t_ns + k * TICK_NS for r in records for k in range(len(r.ticks))}
                assert not starts & seen
                seen |= starts if full else set()
        observe(block, segment(at, wheel=0.2 if turned else 0.0))
        at += 1
