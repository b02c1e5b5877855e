"""Rows of straight driving, collected segment by segment, for a fit of several of them together.

A row is driving without a gap in which wheels, headings and articulation stay near those of straight driving.
What the wheels read when straight is the mean of the row so far, whatever the file says of the zero: where
headings stay within 6 degrees over 100 m, it is within 0.2 degrees of straight on. Rows are collected into a
block. A block is fitted when it is long enough for a first number, again when it is longer, and for the last
time when it is full; then the next one begins. So a second of driving is in one block only.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from tilth.estimator.pose.aligner import ALIGNMENT
from tilth.estimator.record.record import PSI, TICK_NS, WHEEL_ANGLE, Record, Segment, concatenate
from tilth.estimator.ties import exceeds, within
from tilth.estimator.tuning import tuned
from tilth.schemas.reasons import Code
from tilth.schemas.tolerances import MADE


@dataclass(frozen=True, slots=True)
class RowTuning:
    """What is a straight row, and when rows are fitted."""

    straight: float = tuned(math.radians(4.0), "rad", "by which a wheel angle may leave the row's mean")
    """Steering corrections are less than 2 degrees; at 4 the response is in proportion to 1 %."""
    largest_turn: float = tuned(math.radians(6.0), "rad", "by which headings may leave the row's first one")
    folded: float = tuned(math.radians(5.0), "rad", "largest articulation in a row")
    shortest_s: float = tuned(20.0, "s", "of a row; in the first 5 the filter finds its state")
    fitted_at_s: tuple[float, ...] = tuned((120.0, 300.0, 600.0), "s", "of rows in a block; the last ends it")


ROWS: Final = RowTuning()

_SEGMENT_S: Final = ALIGNMENT.pose_ns * 1e-9
SHORTEST: Final = round(ROWS.shortest_s / _SEGMENT_S)


@dataclass(slots=True)
class Block:
    """Rows of which each second is used in one block only."""

    row: list[Segment] = field(default_factory=list)  # the present one
    heading: float = 0.0  # rad, at its beginning
    wheel: float = 0.0  # rad, mean reading of the wheel angle in it
    complete: list[Record] = field(default_factory=list)
    fitted_s: float = 0.0  # so much of it has been fitted
    ended: bool = False  # it is fitted as it is now, for the last time
    refused: dict[Code, int] = field(default_factory=dict)  # reason -> segments
    reason: Code | None = None  # why nothing is collected now


def seconds(block: Block) -> float:
    """Of rows in a block, each long enough."""
    ticks = sum(len(record.ticks) for record in block.complete)
    present = len(block.row) * _SEGMENT_S if len(block.row) >= SHORTEST else 0.0
    return ticks * TICK_NS * 1e-9 + present


def observe(block: Block, segment: Segment | None) -> None:
    """Take the next segment."""
    if segment is None:
        return
    block.reason = segment.reason
    reading = float(np.mean(segment.record.ticks[:, WHEEL_ANGLE])) if segment.reason is None else 0.0
    begins = not block.row or not segment.follows
    if segment.reason is None and not _is_straight(segment, reading if begins else block.wheel):
        block.reason = Code.NOT_STRAIGHT
    if block.reason is not None:
        _count(block, block.reason)
    if block.reason is not None or not segment.follows:
        end_row(block)
    if block.reason is not None:
        return
    heading = float(segment.record.ticks[0, PSI])
    if block.row and exceeds(abs(heading - block.heading), ROWS.largest_turn, MADE):
        end_row(block)
    if not block.row:
        block.heading = heading
    block.row.append(segment)
    block.wheel += (reading - block.wheel) / len(block.row)


def end_row(block: Block) -> None:
    """The present row ends here."""
    if len(block.row) >= SHORTEST:
        block.complete.append(concatenate(block.row))
    elif block.row:
        _count(block, Code.TOO_SHORT)
    block.row = []


def is_due(block: Block) -> bool:
    """Whether a fit of it is due."""
    now = seconds(block)
    return block.ended or any(block.fitted_s < limit <= now for limit in ROWS.fitted_at_s)


def is_long(records: list[Record]) -> bool:
    """Whether these rows are enough for a fit where no stop ends them: with less any machine file agrees."""
    return sum(len(record.ticks) for record in records) * TICK_NS >= ROWS.fitted_at_s[0] * 1e9


def rows_to_fit(block: Block) -> tuple[list[Record], bool]:
    """(the rows of a block so far, whether it is full). A full one is begun anew."""
    records = list(block.complete)
    if len(block.row) >= SHORTEST:
        records.append(concatenate(block.row))
    block.fitted_s = seconds(block)
    full = block.ended or block.fitted_s >= ROWS.fitted_at_s[-1]
    if full:
        forget(block)
    return records, full


def end(block: Block) -> None:
    """What follows is of another block. With a row more than its last fit had, it is fitted for the last
    time; else it is begun anew."""
    end_row(block)
    block.ended = seconds(block) - block.fitted_s >= ROWS.shortest_s
    if not block.ended:
        forget(block)


def forget(block: Block) -> None:
    """Begin a block anew."""
    block.row, block.complete, block.fitted_s, block.ended = [], [], 0.0, False


def _count(block: Block, reason: Code) -> None:
    block.refused[reason] = block.refused.get(reason, 0) + 1


def _is_straight(segment: Segment, straight_on: float) -> bool:
    """straight_on: rad, what the wheels read when straight."""
    ticks = segment.record.ticks
    turned = float(np.max(np.abs(ticks[:, WHEEL_ANGLE] - straight_on)))
    folded = float(np.max(np.abs(ticks[:, PSI] - ticks[:, PSI + 1])))
    return within(turned, ROWS.straight) and within(folded, ROWS.folded, MADE)
