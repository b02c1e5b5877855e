"""Windows as driving makes them: when they open, when they close, and what is left out."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest

from tilth.estimator.record.record import TICK_NS, Record, Segment
from tilth.estimator.record.record_builder import TICKS
from tilth.estimator.record.windows import WINDOWS, close_window, collect
from tilth.schemas.reasons import Code

LEAST = math.radians(1.0)
SEGMENT_NS = TICKS * TICK_NS

Piece = tuple[float, float]  # s, degrees of the wheels


@dataclass
class Collected:
    """State, and the records of all windows that were closed."""

    window: list[Segment] = field(default_factory=list)
    closed: Record | None = None
    refused: dict[Code, int] = field(default_factory=dict)
    reason: Code | None = None
    published_ns: int = 0
    records: list[Record] = field(default_factory=list)


def driving(pieces: Iterable[Piece], gaps: Sequence[float] = ()) -> list[Segment]:
    """Segments of constant wheel angles, one after the other. gaps: s at which a segment is refused."""
    angles = np.concatenate([np.full(round(5 * seconds), degrees) for seconds, degrees in pieces])
    refused = {round(5 * s) for s in gaps}
    out = []
    for k, degrees in enumerate(angles):
        ticks = np.zeros((TICKS, 8))
        ticks[:, 0] = math.radians(degrees)
        reason = Code.REVERSE if k in refused else None
        follows = not (k == 0 or reason or k - 1 in refused)
        out.append(Segment(Record(k * SEGMENT_NS, ticks), follows, reason))
    return out


def collected(
    segments: Iterable[Segment], zero: float = 0.0, least: float = LEAST, soon: bool = False
) -> Collected:
    state = Collected()
    for segment in segments:
        collect(state, segment.record.end_ns, segment, 10**9, least, zero, soon)
        if state.closed is not None:
            state.records.append(state.closed)
            state.closed = None
    return state


def spans(state: Collected) -> list[tuple[float, float]]:
    """(begin, end) of each window, s."""
    return [(round(r.t_ns * 1e-9, 9), round(r.end_ns * 1e-9, 9)) for r in state.records]


def test_a_headland_turn_is_a_window_that_closes_when_it_is_over() -> None:
    state = collected(driving([(60.0, 0.0), (12.0, 18.0), (60.0, 0.0)]))
    assert spans(state) == [(58.0, 75.0)]
    assert state.refused.keys() == {Code.TOO_LITTLE_STEERING}
    assert state.reason == Code.TOO_LITTLE_STEERING and len(state.window) == WINDOWS.lead


def test_one_that_is_awaited_closes_as_soon_as_it_has_enough() -> None:
    state = collected(driving([(20.0, 0.0), (6.0, 18.0), (6.0, -18.0), (60.0, 0.0)]), soon=True)
    assert spans(state)[0] == (18.0, 28.0)


def test_steering_without_end_is_cut_into_windows_of_thirty_seconds() -> None:
    state = collected(driving([(1.0, 5.0), (1.0, -5.0)] * 50))
    assert np.array(spans(state)) == pytest.approx(np.array([(0, 30), (30, 60), (60, 90)]))
    assert state.refused == {}


def test_short_pieces_are_joined_with_the_straight_driving_between_them() -> None:
    state = collected(driving([(20.0, 0.0), (5.0, 12.0), (8.0, 0.0), (5.0, -12.0), (60.0, 0.0)]))
    assert spans(state) == [(18.0, 41.0)]


def test_a_short_piece_alone_is_fitted_when_thirty_seconds_are_over() -> None:
    state = collected(driving([(20.0, 0.0), (5.0, 12.0), (60.0, 0.0)]))
    assert spans(state) == [(18.0, 46.0)]


def test_a_turn_is_not_cut_by_a_small_correction_before_it() -> None:
    state = collected(driving([(20.0, 0.0), (0.6, 2.0), (26.0, 0.0), (12.0, 18.0), (20.0, 0.0)]))
    assert state.refused[Code.TOO_LITTLE_STEERING] > 0
    assert spans(state) == [(44.6, 61.6)]


def test_a_circle_says_that_the_wheels_are_held() -> None:
    """Its wheel angle is constant: not too little of it, but no change."""
    state = collected(driving([(29.0, 7.0)]))
    assert state.records == [] and state.reason == Code.HELD
    close_window(state, LEAST, 0.0)
    assert state.refused == {Code.HELD: 1}
    assert collected(driving([(2.0, 0.0), (20.0, 7.0)])).reason is None  # it has been turned


@pytest.mark.parametrize(("degrees", "fitted"), [(0.7, 0), (0.95, 0), (1.6, 3)])
def test_corrections_along_a_row_count_by_their_size(degrees: float, fitted: int) -> None:
    """A square wave has the sd of its amplitude; now and then a larger correction, which opens a window."""
    row = [(1.0, degrees), (1.0, -degrees)] * 10 + [(0.2, 2.5)]
    state = collected(driving(row * 5))
    assert len(state.records) == fitted
    if not fitted:
        assert state.refused[Code.TOO_LITTLE_STEERING] > 0


def test_a_burst_of_corrections_passes_no_more_than_the_row_it_is_part_of() -> None:
    burst = [(0.4, 1.7), (0.4, -1.7)] * 12
    state = collected(driving([(30.0, 0.0), *burst, (60.0, 0.0)]))
    assert state.records == []


def test_a_refused_segment_ends_a_window_which_is_fitted_if_it_is_long_enough() -> None:
    arc = (7.0, 20.0)
    state = collected(driving([(20.0, 0.0), arc, (4.0, 0.0)], gaps=[27.0]))
    assert spans(state) == [(18.0, 27.0)]
    state = collected(driving([(20.0, 0.0), (3.0, 20.0), (4.0, 0.0)], gaps=[23.0]))
    assert state.records == [] and state.refused[Code.TOO_SHORT] == 1


def test_what_is_left_at_the_end_is_closed_as_by_a_gap() -> None:
    state = collected(driving([(1.0, 5.0), (1.0, -5.0)] * 14))
    assert state.records == []
    assert close_window(state, LEAST, 0.0)
    assert state.closed is not None and state.closed.end_ns == 28 * 10**9
    assert not close_window(state, LEAST, 0.0)


def test_a_wheel_zero_that_is_known_is_no_steering() -> None:
    zero = math.radians(2.0)
    state = collected(driving([(60.0, 2.0), (12.0, 20.0), (60.0, 2.0)]), zero)
    assert spans(state) == [(58.0, 75.0)]
    unknown = collected(driving([(60.0, 2.0), (12.0, 20.0), (60.0, 2.0)]))
    covered = [span for span in spans(unknown) if span[0] <= 66.0 <= span[1]]
    assert covered and all(end - begin <= WINDOWS.longest * 0.2 + 1e-9 for begin, end in spans(unknown))


def test_the_quiet_end_is_as_long_as_it_says() -> None:
    state = collected(driving([(20.0, 0.0), (12.0, 18.0), (WINDOWS.quiet * 0.2, 0.0)]))
    assert len(state.records) == 1
