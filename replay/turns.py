"""Finds the turns of a drive, so that one can go from one to the next."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

LEAST_RADPS: Final = math.radians(
    3.5
)  # of the tractor's yaw rate; corrections along a row are less, or short
LEAST_RAD: Final = math.radians(45.0)  # of heading, from its begin to its end
PAUSE_NS: Final = 2_000_000_000  # straight for so long, or without a pose, ends a turn


@dataclass(frozen=True, slots=True)
class DrivenTurn:
    """Times ns; angle rad, to the right positive."""

    begin_ns: int
    end_ns: int
    angle: float

    @property
    def text(self) -> str:
        return f"{'right' if self.angle > 0 else 'left'}, {math.degrees(abs(self.angle)):.0f}°"


def turns(rows: Iterable[tuple[int, float]]) -> list[DrivenTurn]:
    """Of (time in ns, yaw rate in rad/s, to the right positive), in the order of time."""
    found: list[DrivenTurn] = []
    turn: DrivenTurn | None = None
    last_ns = 0
    for t_ns, yaw_rate in rows:
        turning = abs(yaw_rate) >= LEAST_RADPS
        if turn is not None and (t_ns - turn.end_ns > PAUSE_NS or (turning and yaw_rate * turn.angle < 0)):
            found.append(turn)
            turn = None
        if turning:
            step_ns = min(t_ns - last_ns, PAUSE_NS) if turn else 0
            begin_ns, angle = (turn.begin_ns, turn.angle) if turn else (t_ns, math.copysign(1e-9, yaw_rate))
            turn = DrivenTurn(begin_ns, t_ns, angle + yaw_rate * step_ns * 1e-9)
        last_ns = t_ns
    found += [turn] if turn else []
    return [turn for turn in found if abs(turn.angle) >= LEAST_RAD]
