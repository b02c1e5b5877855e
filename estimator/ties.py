"""Decisions that rounding could turn.

On another kind of processor a statistic differs by up to the tolerance of what it is made of
(schemas/tolerances.py). Within that of its threshold a decision is a tie: the log tells how it fell, and a
replay on another kind of processor goes on from there. Decisions by times and counts fall alike everywhere.

As the context of `decimal`, ties are those of the thread that runs the fold. Where none does, as in a fit, a
decision is a plain comparison.
"""

import math
from collections.abc import Iterable
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Final

from tilth.schemas.flow import Tie
from tilth.schemas.tolerances import LEARNED


@dataclass(slots=True)
class Ties:
    """Of a fold."""

    logged: dict[int, list[Tie]] = field(default_factory=dict)
    """t_ns -> those of a log that is verified on another kind of processor."""
    turned: int = 0  # decisions that were taken from there, and would have fallen otherwise here
    t_ns: int = 0  # of the frame that is taken
    found: list[Tie] = field(default_factory=list)  # with it


_TIES: Final[ContextVar[Ties]] = ContextVar("ties")


def use(logged: Iterable[Tie] = ()) -> Ties:
    """Of a fold that begins or goes on in this thread. logged: what it is to go on from."""
    ties = Ties()
    for tie in logged:
        ties.logged.setdefault(tie.t_ns, []).append(tie)
    _TIES.set(ties)
    return ties


def begin(t_ns: int) -> None:
    """What follows is decided with the frame of t_ns. What a fold before this one left is none of its own."""
    ties = _TIES.get(None) or use()
    ties.t_ns = t_ns
    ties.found.clear()


def found() -> list[Tie]:
    """Those since the last call, in order."""
    ties = _TIES.get(None)
    if ties is None or not ties.found:
        return []
    told, ties.found = ties.found, []
    return told


def exceeds(statistic: float, threshold: float, tolerance: float = LEARNED) -> bool:
    """Whether statistic > threshold; of a tie, as the log tells. tolerance: by which share the statistic may
    differ elsewhere. What is no number exceeds nothing."""
    above = bool(statistic > threshold)
    near = tolerance * max(abs(statistic), abs(threshold))
    far = abs(statistic - threshold)
    ties = _TIES.get(None) if far < 2.0 * near else None  # as far as what was a tie may be from it here
    if ties is None:
        return above
    for tie in ties.logged.get(ties.t_ns, ()):
        if max(abs(statistic - tie.statistic), abs(threshold - tie.threshold)) < near:
            ties.turned += tie.above is not above
            above = tie.above
    if far < near:
        ties.found.append(Tie(ties.t_ns, float(statistic), float(threshold), above))
    return above


def within(statistic: float, threshold: float, tolerance: float = LEARNED) -> bool:
    """Whether statistic <= threshold, likewise. What is no number is within nothing, so supports none."""
    known = not (math.isnan(statistic) or math.isnan(threshold))
    return known and not exceeds(statistic, threshold, tolerance)
