"""A person at the wheel who follows a bar: late, not exactly, and sometimes looking elsewhere.

Between runs he drives up and down a lane, turns round beyond its ends, and arms the next run when he is on
it. He knows what a prompter shows and where he is, nothing else.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from tilth.estimator.models.nonlinear import STATES
from tilth.schemas.experiment import Phase
from tilth.simulator.noise import generator

ARM, STOP = "arm", "stop"
AT: Final = {name: k for k, name in enumerate(STATES)}
TURN_ANGLE: Final = math.radians(14.0)  # of the wheels when he turns round
LOOK_AHEAD_M: Final = 16.0
ON_LANE_M: Final = 3.0
IN_LINE: Final = math.radians(2.0)
BEYOND_M: Final = 55.0  # past the lane's end, before he turns round: in line again when he is back
PATIENCE_S: Final = 4.0  # with too little room ahead he gives up and turns round
ERROR_S: Final = 1.0  # correlation time of his error
FREE: Final = ("", Phase.IDLE, Phase.FINISHED)  # phases in which he goes where he likes; "": nobody prompts
STANDING: Final = 0.1  # m/s


class Bar(NamedTuple):
    """What he sees. wanted: rad, of the wheels; speed: m/s."""

    phase: str  # idle, lining_up, countdown, running, noting or finished; "" where nobody prompts
    wanted: float
    speed: float
    room: bool  # whether there is room ahead


@dataclass(frozen=True, slots=True)
class Person:
    """How he drives."""

    lag_s: float = 0.5
    error: float = math.radians(1.0)  # sd
    rate: float = math.radians(25.0)  # rad/s, fastest that he turns the wheels
    looks_away: float = 0.0  # chance that he does, in each second of a run
    away_s: tuple[float, float] = (2.5, 4.0)  # for how long


@dataclass(slots=True)
class PromptedDriver:
    """lane: north and east of its near end, its heading (rad), its length (m). Times s."""

    person: Person
    lane: tuple[float, float, float, float]
    seed: int
    outward: bool = True  # along the lane's heading
    turning: bool = False
    looked_away: int = 0
    _seen: deque[tuple[float, float]] = field(default_factory=deque)  # when, what was wanted
    _target: float = 0.0
    _error: float = 0.0
    _away_until: float = -math.inf
    _no_room_s: float = 0.0
    _last: float = 0.0
    _armed: bool = False  # since he turned round: then there is room the other way, too
    _rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._rng = generator(self.seed, 77)

    def look(self, now: float, bar: Bar, x: np.ndarray) -> str:
        """What he presses, "" for nothing. x: (13,), where he is."""
        elapsed, self._last = now - self._last, now
        keep = math.exp(-max(elapsed, 0.0) / ERROR_S)
        self._error = keep * self._error + math.sqrt(1.0 - keep**2) * self.person.error * self._rng.normal()
        if bar.phase == Phase.RUNNING and now >= self._away_until:
            if self._rng.random() < self.person.looks_away * elapsed:
                self._away_until = now + self._rng.uniform(*self.person.away_s)
                self.looked_away += 1
            self._seen.append((now, bar.wanted))
        if bar.phase != Phase.RUNNING:
            self._seen.clear()
            self._away_until = -math.inf
        along, across, off = self._on_lane(x)
        self._no_room_s = self._no_room_s + elapsed if bar.phase == Phase.LINING_UP and not bar.room else 0.0
        if self._no_room_s > PATIENCE_S and not self.turning:
            self.turning = True
            return STOP
        on_lane = abs(across) < ON_LANE_M and abs(off) < IN_LINE and not self.turning
        if bar.phase == Phase.IDLE and on_lane and 0.0 < along < self.lane[3] and bar.room:
            self._armed = True
            return ARM
        return ""

    def hands(self, now: float, bar: Bar, x: np.ndarray) -> float:
        """Where he wants the wheels, rad."""
        if bar.phase != Phase.RUNNING:
            self._target = self._steering(x, bar)
            return self._target
        while len(self._seen) > 1 and self._seen[1][0] <= now - self.person.lag_s:
            self._seen.popleft()
        if self._seen and self._seen[0][0] <= now - self.person.lag_s:
            self._target = self._seen[0][1]
        return self._target + self._error

    def _on_lane(self, x: np.ndarray) -> tuple[float, float, float]:
        """(m along in his direction, m to the right of it, rad off it)."""
        north, east, heading, length = self.lane
        dx, dy = x[AT["x_t"]] - north, x[AT["y_t"]] - east
        along = dx * math.cos(heading) + dy * math.sin(heading)
        across = dy * math.cos(heading) - dx * math.sin(heading)
        if not self.outward:
            along, across, heading = length - along, -across, heading + math.pi
        return along, across, math.remainder(x[AT["psi_t"]] - heading, math.tau)

    def _steering(self, x: np.ndarray, bar: Bar) -> float:
        """Back to the lane, or round at its end."""
        along, across, off = self._on_lane(x)
        done_here = (along > self.lane[3] / 2 and not bar.room) or along > self.lane[3]
        if bar.phase in FREE and abs(off) < math.pi / 2 and done_here:
            self.turning = True
        has_room_back = self._armed or self.lane[3] / 2 < along < self.lane[3]
        if self.turning and (has_room_back or along > self.lane[3] + BEYOND_M):
            self.outward, self.turning, self._armed = not self.outward, False, False
            along, across, off = self._on_lane(x)
        bearing = math.atan2(-across, LOOK_AHEAD_M) - off
        wanted = math.atan2(2 * 2.9 * math.sin(math.remainder(bearing, math.tau)), LOOK_AHEAD_M)
        if abs(math.remainder(bearing, math.tau)) > math.pi / 2:  # it lies behind him: round
            wanted = math.copysign(TURN_ANGLE, math.remainder(bearing, math.tau))
        return min(max(wanted, -TURN_ANGLE), TURN_ANGLE)
