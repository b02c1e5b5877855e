"""Windows of driving, collected stretch by stretch until they are fitted whole."""

from typing import Final, Protocol

import numpy as np

from tilth.estimator.record.record import Record, Stretch, concatenate

WINDOW: Final = 150  # stretches, 30 s
SHORTEST: Final = 50  # stretches: what is shorter is not fitted
TAKEN, DROPPED, AWAITED, OPEN = 1, -1, 2, 0
"""What is known of a fit that was asked for: to be used, not to be used, late and waited for; nothing yet."""


class Collecting(Protocol):
    """State of a method that fits windows. Times ns."""

    window: list[Stretch]  # being driven
    closed: Record | None  # waits to be asked for
    refused: dict[str, int]  # reason -> stretches, or windows
    reason: str  # why nothing is collected now, or ""
    published_ns: int


def collect(
    state: Collecting, t_ns: int, stretch: Stretch | None, every_ns: int, least_steering: float = 0.0
) -> bool:
    """Take what ends at the pose of t_ns; whether an estimate is due, one each every_ns.

    least_steering: sd of the wheel angle, rad, below which a window is not worth a fit.
    """
    if stretch is not None:
        _keep(state, stretch, least_steering)
    due = t_ns - state.published_ns >= every_ns
    if due:
        state.published_ns = t_ns
    return due


def _keep(state: Collecting, stretch: Stretch, least_steering: float) -> None:
    state.reason = stretch.reason
    if stretch.reason:
        refuse(state, stretch.reason)
    if stretch.reason or not stretch.follows:
        _close(state, least_steering)
    if stretch.reason:
        return
    state.window.append(stretch)
    if len(state.window) >= WINDOW:
        _close(state, least_steering)


def _close(state: Collecting, least_steering: float) -> None:
    if len(state.window) >= SHORTEST:
        record = concatenate(state.window)
        if np.std(record.ticks[:, 0]) < least_steering:
            state.reason = "too little steering"
            refuse(state, state.reason)
        else:
            if state.closed is not None:  # nothing could be asked for: a fit is late
                refuse(state, "the fit of the window before was late")
            state.closed = record
    state.window.clear()


def describe_late(late_ns: int, used: bool) -> str:
    """What a person should know of a fit that was late by so much, or of one that was lost at once."""
    if used:
        return (
            f"a fit was ready {late_ns * 1e-9:.1f} s late, since this computer is busy; it is used from here"
        )
    if late_ns:
        return f"a fit was not ready {late_ns * 1e-9:.0f} s after it was due and is given up"
    return "a fit was not ready in time and was dropped"


def refuse(state: Collecting, reason: str) -> None:
    """Count what may not teach."""
    state.refused[reason] = state.refused.get(reason, 0) + 1
