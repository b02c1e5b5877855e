"""The virtual tractor's steering ECU: guidance commands in (ISO 11783, PGN 44288), the valve's command out.

The command asks for a curvature; the ECU turns it into a wheel angle, and a position loop round its own
sensor follows that. It obeys the first who intends to steer until he lets go or falls silent, refuses what
the machine cannot or should not do, and counts every refusal by its reason.
"""

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from tilth.schemas.can_id import BROADCAST, split
from tilth.schemas.pgn_table import row
from tilth.simulator.pilots import SERVO

COMMAND: Final = 44288
ADDRESS: Final = 0xF0  # of the tractor ECU
TIMEOUT_S: Final = 0.5  # five commands missed: the wheels stay, nobody is obeyed
INTERVAL_S: Final = 0.1  # of commands, nominal
SLACK: Final = math.radians(1.0)  # of a step between two commands: their resolution and their jitter
ENGAGE: Final = math.radians(10.0)  # first command's farthest from where the wheels are

REFUSALS: Final = {
    "another_controller": "from an address that is not the one obeyed",
    "not_available": "an intention to steer without a curvature",
    "short_frame": "shorter than its layout",
    "beyond_limit": "a curvature beyond the steering's stop",
    "too_fast": "a step that the wheels could not follow",
    "too_far": "a first command far from where the wheels are",
}
"""Every reason in `Steering.refused`, in a person's words."""


@dataclass(slots=True)
class Steering:
    """limit (rad) and rate (rad/s): of the wheels. Times in s on the caller's clock."""

    wheelbase: float
    limit: float
    rate: float
    refused: Counter[str] = field(default_factory=Counter)
    obeyed: int | None = None  # source address
    taken: int = 0  # commands
    let_go: int = 0  # times that a controller fell silent while it steered
    _wanted: float = 0.0  # rad
    _at: float = -math.inf  # of the last command taken

    def hear(self, can_id: int, data: bytes, now: float, reading: float) -> None:
        """Take a frame of the bus; only commands to this ECU matter. reading: rad, of its own sensor."""
        at = split(can_id)
        if at.pgn != COMMAND or at.destination not in (ADDRESS, BROADCAST):
            return
        faults: dict[str, int] = {}
        command = row(COMMAND).layout.decode(data, faults)
        status = command.get("command_status")
        if status != "intended":
            if faults:
                self.refused.update(faults)
            elif at.source == self.obeyed:
                self.obeyed = None
            return
        self._watch(now)
        reason = self._refusal(at.source, command.get("commanded_curvature_per_m"), now, reading)
        if reason:
            self.refused[reason] += 1
            return
        self._wanted = math.atan(self.wheelbase * float(command["commanded_curvature_per_m"]))
        self._at, self.obeyed = now, at.source
        self.taken += 1

    def valve(self, now: float, reading: float) -> float:
        """The actuator's command, rad of rate per s: none where nobody is obeyed, none into the stop."""
        self._watch(now)
        if self.obeyed is None:
            return 0.0
        low = -self.rate if reading > -self.limit else 0.0
        high = self.rate if reading < self.limit else 0.0
        return min(max(SERVO * (self._wanted - reading), low), high)

    def _watch(self, now: float) -> None:
        if self.obeyed is not None and now - self._at > TIMEOUT_S:
            self.obeyed = None
            self.let_go += 1

    def _refusal(self, source: int, curvature: object, now: float, reading: float) -> str:
        """Why this command is not taken, "" where it is."""
        if self.obeyed not in (None, source):
            return "another_controller"
        if not isinstance(curvature, float):
            return "not_available"
        angle = math.atan(self.wheelbase * curvature)
        if abs(angle) > self.limit:
            return "beyond_limit"
        if self.obeyed is None:
            return "too_far" if abs(angle - reading) > ENGAGE else ""
        most = self.rate * min(max(now - self._at, INTERVAL_S), TIMEOUT_S) + SLACK
        return "too_fast" if abs(angle - self._wanted) > most else ""
