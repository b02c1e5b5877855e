"""Windows of driving, collected segment by segment, for estimators that fit a whole window at once.

Driving decides where they begin and end. A window opens `lead` before the wheels turn, so that a filter's
state has settled by then. It closes `quiet` after they are straight again, if it has enough steering; if
not, it waits for the next steering, up to `longest`, and both are fitted together with the straight driving
between them. A segment that is refused ends it at once.
"""

import math
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.record.record import TICK_NS, WHEEL_ANGLE, Record, Segment, concatenate
from tilth.estimator.ties import exceeds, within
from tilth.estimator.tuning import tuned
from tilth.schemas.reasons import Code, Reason

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WindowTuning:
    """Where a window of a fit begins and ends."""

    longest: int = tuned(150, "segments", "of the longest window, 30 s")
    shortest: int = tuned(30, "segments", "a window shorter than 6 s is not fitted")
    lead: int = tuned(10, "segments", "of straight driving, 2 s, that are kept before the wheels turn")
    quiet: int = tuned(15, "segments", "of straight driving, 3 s, that close a window with enough steering")
    enough_s: float = tuned(8.0, "s", "with turned wheels: with less, a window waits for the next steering")
    turned: float = tuned(
        math.radians(1.5), "rad", "beyond it wheels are turned: most corrections in rows are less"
    )


WINDOWS: Final = WindowTuning()

TAKEN, DROPPED, AWAITED, OPEN = 1, -1, 2, 0
"""State of a requested fit: will be used, will not be used, late and waited for, not decided yet."""


class Refusing(Protocol):
    """State that counts what nothing may be learned from."""

    refused: dict[Code, int]  # reason -> number of poses, segments, windows or fits


class Collecting(Refusing, Protocol):
    """State of a method that fits windows. Times ns."""

    window: list[Segment]  # the present window
    closed: Record | None  # a complete window whose fit is not requested yet
    reason: Code | None  # why nothing is collected now
    published_ns: int


def collect(
    state: Collecting,
    t_ns: int,
    segment: Segment | None,
    every_ns: int,
    least_steering: float = 0.0,
    zero: float = 0.0,
    soon: bool = False,
) -> bool:
    """Take the segment that ends at the pose before that of t_ns. Returns whether an estimate is due.

    every_ns: interval of estimates. least_steering: smallest sd of the wheel angle, rad, of a window to fit.
    zero: reading of the wheel angle when straight, rad. soon: whether a window is closed as soon as it has
    enough steering, also in a turn.
    """
    if segment is not None:
        _add_segment(state, segment, least_steering, zero, soon)
    due = t_ns - state.published_ns >= every_ns
    if due:
        state.published_ns = t_ns
    return due


def _add_segment(state: Collecting, segment: Segment, least_steering: float, zero: float, soon: bool) -> None:
    state.reason = segment.reason
    if segment.reason:
        refuse(state, segment.reason)
    if segment.reason or not segment.follows:
        close_window(state, least_steering, zero)
    if segment.reason:
        return
    window = state.window
    window.append(segment)
    if len(window) <= WINDOWS.lead + 1 and not _turned(window, zero):
        state.reason = Code.TOO_LITTLE_STEERING
        if len(window) > WINDOWS.lead:
            del window[0]
            refuse(state, Code.TOO_LITTLE_STEERING)
    elif len(window) >= WINDOWS.longest:
        _close_full_window(state, least_steering, zero)
    elif _is_complete(window, least_steering, zero, soon):
        close_window(state, least_steering, zero)
    elif not _has_steering(window, least_steering):
        state.reason = _lacking(window, zero)


def _close_full_window(state: Collecting, least_steering: float, zero: float) -> None:
    """Close a window of the greatest length, but keep what follows the last straight driving in it: a turn
    that has begun is not cut, unless steering goes on without end."""
    window = list(state.window)
    begin = _last_straight(window, zero)
    if 2 * begin >= WINDOWS.longest:
        del state.window[begin:]
        close_window(state, least_steering, zero)
        state.window.extend(window[begin:])
    elif not close_window(state, least_steering, zero) and begin > 0:
        state.window.extend(window[begin:])


def _last_straight(window: list[Segment], zero: float) -> int:
    """Where the last `lead` of straight driving begins; 0 without any."""
    turned = [_turned([segment], zero) for segment in window]
    return next(
        (k for k in range(len(window) - WINDOWS.lead, 0, -1) if not any(turned[k : k + WINDOWS.lead])), 0
    )


def close_window(state: Collecting, least_steering: float, zero: float) -> bool:
    """End the present window. Returns whether there is enough in it to be fitted; what is not is counted.

    Arguments as of `collect`.
    """
    window, why_not = list(state.window), None
    state.window.clear()
    if not _turned(window, zero):
        return False  # its segments were not begun to be used
    if len(window) < WINDOWS.shortest:
        why_not = Code.TOO_SHORT
    elif not _has_steering(window, least_steering):
        why_not = state.reason = _lacking(window, zero)
    if why_not:
        refuse(state, why_not)
        return False
    if state.closed is not None:  # its fit could not be requested, since the one before is late
        refuse(state, Code.FIT_OVERTAKEN)
    state.closed = concatenate(window)
    return True


def _wheel_angles(window: list[Segment]) -> Array:
    """Wheel angle at each tick of a window, rad, (n,)."""
    return np.concatenate([np.empty(0), *(segment.record.ticks[:, WHEEL_ANGLE] for segment in window)])


def _turned(window: list[Segment], zero: float) -> bool:
    """Whether the wheels are turned anywhere in these segments."""
    return exceeds(float(np.max(np.abs(_wheel_angles(window) - zero), initial=0.0)), WINDOWS.turned)


def _is_complete(window: list[Segment], least_steering: float, zero: float, soon: bool) -> bool:
    """Whether there is so much steering that the window need not wait for more, and, but for `soon`, the
    wheels are straight again."""
    straight = len(window) >= WINDOWS.quiet + WINDOWS.lead and not _turned(window[-WINDOWS.quiet :], zero)
    if not straight and not (soon and len(window) >= WINDOWS.shortest):
        return False
    turned_s = float(np.sum(np.abs(_wheel_angles(window) - zero) > WINDOWS.turned)) * TICK_NS * 1e-9
    return turned_s >= WINDOWS.enough_s and _has_steering(window, least_steering)


def _has_steering(window: list[Segment], least_steering: float) -> bool:
    """Whether a window, however short, has as much steering as one of `longest` needs: the sum of squares
    counts, so that a short piece of a row with large corrections does not pass where the row does not.

    least_steering: as of `collect`.
    """
    return within(least_steering**2 * WINDOWS.longest, float(np.var(_wheel_angles(window))) * len(window))


def _lacking(window: list[Segment], zero: float) -> Code:
    """Why a window has not enough steering."""
    held = bool(np.all(np.abs(_wheel_angles(window) - zero) > WINDOWS.turned))
    return Code.HELD if held else Code.TOO_LITTLE_STEERING


def late_reason(late_ns: int, used: bool) -> Reason:
    """What became of a fit that was late. late_ns: 0 if it was given up at once."""
    if not used and not late_ns:
        return Reason(Code.FIT_DROPPED)
    return Reason(Code.FIT_LATE if used else Code.FIT_GIVEN_UP, numbers=(late_ns * 1e-9,))


def refuse(state: Refusing, reason: Code) -> None:
    """Count something from which nothing may be learned."""
    state.refused[reason] = state.refused.get(reason, 0) + 1
