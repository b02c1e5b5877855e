"""Commands of an automatic steering in the frames of a log, as wheel angles.

PGN 44288 asks for a curvature and says whether it is meant to steer; the wheels that drive it are at
atan(wheelbase * curvature). PGN 127245 may ask for an angle: while it does, it steers.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from tilth.estimator.calibration.steering_response import SteeringOrders
from tilth.schemas.can_id import split
from tilth.schemas.flow import Frame, Word
from tilth.schemas.pgn_table import row
from tilth.schemas.wheel_angle import RUDDER

GUIDANCE: Final = 44288
NONE: Final = SteeringOrders(np.zeros(0), np.zeros(0), np.zeros(0, np.bool_))


_Sender = tuple[str, int, int]
"""Bus, PGN and source address."""


@dataclass(slots=True)
class SteeringCommands:
    """`take` every frame, then ask for the `orders`."""

    heard: dict[_Sender, list[tuple[int, float, bool]]] = field(default_factory=dict)  # ns, word, steers

    def take(self, frame: Frame) -> None:
        """Keep what a command says."""
        if not frame.extended or frame.error:
            return
        at = split(frame.can_id)
        if at.pgn not in (GUIDANCE, RUDDER):
            return
        said = _said(at.pgn, row(at.pgn).layout.decode(frame.data, {}))
        if said is not None:
            self.heard.setdefault((frame.bus, at.pgn, at.source), []).append((frame.rx_ns, *said))

    def orders(self, wheelbase: float, first_ns: int) -> SteeringOrders:
        """Of who steered longest, by 44288 if that was heard; none of nobody. Times count from first_ns.
        wheelbase: m."""
        if not self.heard:
            return NONE
        longest = max(self.heard, key=lambda sender: (sender[1] == GUIDANCE, self._steered(sender)))
        rows = sorted(self.heard[longest], key=lambda one: one[0])
        word = np.array([one[1] for one in rows])
        angle = np.arctan(wheelbase * word) if longest[1] == GUIDANCE else word
        t = np.array([(one[0] - first_ns) * 1e-9 for one in rows])
        return SteeringOrders(t, angle, np.array([one[2] for one in rows], np.bool_))

    def _steered(self, sender: _Sender) -> int:
        return sum(steers for *_, steers in self.heard[sender])


def _said(pgn: int, words: Mapping[str, Word]) -> tuple[float, bool] | None:
    """(curvature in 1/m or angle in rad, whether it steers); None of a message that asks for nothing."""
    if pgn == RUDDER:
        angle = words.get("angle_order_rad")
        return (angle, True) if isinstance(angle, float) and abs(angle) < math.pi / 2 else None
    curvature = words.get("commanded_curvature_per_m")
    if words.get("command_status") == "intended" and isinstance(curvature, float):
        return curvature, True
    return 0.0, False
