"""How often does a receiver give a new position? One that is slow, or sends each position again, is named.

It is looked at while the receiver moves: at standstill a position may well be the one before.
"""

from dataclasses import dataclass, field
from typing import Final

from tilth.schemas.flow import EventKind

LOOKED_AT: Final = 40  # positions before anything is said
LEAST_PER_S: Final = 2.0  # new positions: with fewer, what happens between them is guessed
REPEATED_SHARE: Final = 0.3  # of the positions
SILENCE_NS: Final = 5_000_000_000  # positions that are so far apart say nothing of the rate


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
    if not 0 <= interval_ns < SILENCE_NS:
        state.passed_ns = state.positions = state.repeats = 0
        return
    state.passed_ns += interval_ns
    state.positions += 1
    state.repeats += repeat
    if state.positions >= LOOKED_AT:
        _judge(state)
        state.passed_ns = state.positions = state.repeats = 0


def _judge(state: PositionRate) -> None:
    new = state.positions - state.repeats
    per_s = new / (state.passed_ns * 1e-9) if state.passed_ns else 0.0
    if new and state.repeats > REPEATED_SHARE * state.positions:
        _tell(state, EventKind.POSITIONS_REPEATED, state.positions / new, per_s)
    elif new and state.passed_ns and per_s < LEAST_PER_S:
        _tell(state, EventKind.POSITIONS_SLOW, 1.0, per_s)


def _tell(state: PositionRate, kind: EventKind, times: float, per_s: float) -> None:
    if kind not in state.told:
        state.told.append(kind)
        state.news.append((kind, times, per_s))
