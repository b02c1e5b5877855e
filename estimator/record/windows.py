"""Windows of driving, collected segment by segment, for estimators that fit a whole window at once."""

from typing import Final, Protocol

import numpy as np

from tilth.estimator.record.record import Record, Segment, concatenate

WINDOW: Final = 150  # segments, 30 s
SHORTEST: Final = 50  # segments, 10 s: a shorter window is not fitted
TAKEN, DROPPED, AWAITED, OPEN = 1, -1, 2, 0
"""State of a requested fit: will be used, will not be used, late and waited for, not decided yet."""


class Collecting(Protocol):
    """State of a method that fits windows. Times ns."""

    window: list[Segment]  # the present window
    closed: Record | None  # a complete window whose fit is not requested yet
    refused: dict[str, int]  # reason -> number of segments, or of windows
    reason: str  # why nothing is collected now, or ""
    published_ns: int


def collect(
    state: Collecting, t_ns: int, segment: Segment | None, every_ns: int, least_steering: float = 0.0
) -> bool:
    """Take the segment that ends at the pose before that of t_ns. Returns whether an estimate is due.

    every_ns: interval of estimates. least_steering: smallest sd of the wheel angle, rad, of a window to fit.
    """
    if segment is not None:
        _add_segment(state, segment, least_steering)
    due = t_ns - state.published_ns >= every_ns
    if due:
        state.published_ns = t_ns
    return due


def _add_segment(state: Collecting, segment: Segment, least_steering: float) -> None:
    state.reason = segment.reason
    if segment.reason:
        refuse(state, segment.reason)
    if segment.reason or not segment.follows:
        _close_window(state, least_steering)
    if segment.reason:
        return
    state.window.append(segment)
    if len(state.window) >= WINDOW:
        _close_window(state, least_steering)


def _close_window(state: Collecting, least_steering: float) -> None:
    if len(state.window) >= SHORTEST:
        record = concatenate(state.window)
        if np.std(record.ticks[:, 0]) < least_steering:
            state.reason = "too little steering"
            refuse(state, state.reason)
        else:
            if state.closed is not None:  # its fit could not be requested, since the one before is late
                refuse(state, "the fit of the window before was late")
            state.closed = record
    state.window.clear()


def describe_late(late_ns: int, used: bool) -> str:
    """Text of the event for a fit that was late. late_ns: 0 if it was given up at once."""
    if used:
        return (
            f"a fit was ready {late_ns * 1e-9:.1f} s late, since this computer is busy; it is used from here"
        )
    if late_ns:
        return f"a fit was not ready {late_ns * 1e-9:.0f} s after it was due and is given up"
    return "a fit was not ready in time and was dropped"


def refuse(state: Collecting, reason: str) -> None:
    """Count a segment or window from which nothing may be learned."""
    state.refused[reason] = state.refused.get(reason, 0) + 1
