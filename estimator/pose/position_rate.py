"""How often does a receiver give a new position? One that is slow, or sends each position again, is named.

It is looked at while the receiver moves: at standstill a position may well be the one before.
"""

from dataclasses import dataclass, field
from typing import Final

from tilth.estimator.tuning import tuned
from tilth.schemas.flow import EventKind


@dataclass(frozen=True, slots=True)
class PositionRateTuning:
    """When a receiver sends too few positions, or the same ones again."""

    looked_at: int = tuned(40, "positions", "before anything is said")
    least_per_s: float = tuned(2.0, "1/s", "new positions: with fewer, what happens between them is guessed")
    repeated_share: float = tuned(
        0.3, "1", "of positions that repeat the one before, from which on it is said"
    )
    silence_ns: int = tuned(5_000_000_000, "ns", "positions that are so far apart say nothing of the rate")


POSITION_RATE: Final = PositionRateTuning()


@dataclass(slots=True)
class PositionRate:
    """Of one receiver. Times in ns."""

    last_ns: int = 0  # arrival of the last position
    passed_ns: int = 0
    positions: int = 0
    repeats: int = 0  # of them
    told: list[str] = field(default_factory=list)  # kinds that have been reported
    news: list[tuple[str, float, float]] = field(default_factory=list)
    """Kind of an event; how often each position is sent; new ones per second."""


def observe(state: PositionRate, rx_ns: int, repeat: bool) -> None:
    """Take a position of a receiver that moves."""
    interval_ns, state.last_ns = rx_ns - state.last_ns, rx_ns
    if not 0 <= interval_ns < POSITION_RATE.silence_ns:
        state.passed_ns = state.positions = state.repeats = 0
        return
    state.passed_ns += interval_ns
    state.positions += 1
    state.repeats += repeat
    if state.positions >= POSITION_RATE.looked_at:
        _judge(state)
        state.passed_ns = state.positions = state.repeats = 0


def _judge(state: PositionRate) -> None:
    new = state.positions - state.repeats
    per_s = new / (state.passed_ns * 1e-9) if state.passed_ns else 0.0
    if new and state.repeats > POSITION_RATE.repeated_share * state.positions:
        _tell(state, EventKind.POSITIONS_REPEATED, state.positions / new, per_s)
    elif new and state.passed_ns and per_s < POSITION_RATE.least_per_s:
        _tell(state, EventKind.POSITIONS_SLOW, 1.0, per_s)


def _tell(state: PositionRate, kind: EventKind, times: float, per_s: float) -> None:
    if kind not in state.told:
        state.told.append(kind)
        state.news.append((kind, times, per_s))
