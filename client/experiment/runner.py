"""Runs a prompter beside a daemon: what came goes through `prompter.step`, what follows goes out."""

import math
import time
from collections.abc import Callable
from typing import Final

from tilth.client.experiment.prompter import FINISHED, Anew, Course, Input, Order, Prompt, Tick, step
from tilth.client.experiment.shown import shown
from tilth.client.experiment.wires import PrompterWires
from tilth.schemas.proto import tilth_pb2 as pb

TURN_S: Final = 0.1
JUMP_S: Final = 60.0  # poses that jump so far are of another clock
RESTARTED: Final = "the daemon has begun anew and writes another log"
JUMPED: Final = "the clock of the poses jumped"


class PlanRunner:
    """`turn` it ten times a second."""

    def __init__(
        self, wires: PrompterWires, course: Course, now_s: Callable[[], float] = time.monotonic, at: int = 0
    ) -> None:
        """at: the run to begin with, from 0, where those before were driven by another prompter."""
        self._wires, self._course, self._now_s = wires, course, now_s
        self._ahead_s = -math.inf  # of the poses' clock before this one: that of the pose that came fastest
        said = f"The plan goes on with run {at + 1} of {len(course.drives)}: arm it when you are ready."
        self.prompt = Prompt(at=at, said=said if at else "")
        self.learned: tuple[str, ...] = ()
        self.commands: tuple[str, ...] = ()

    @property
    def finished(self) -> bool:
        return self.prompt.phase == FINISHED

    def order(self, kind: str) -> None:
        """The driver's, from the terminal."""
        self._take(Order(kind))

    def turn(self) -> pb.ExperimentState:
        """Take all that came; say how it stands."""
        for answer in self._wires.answers():
            self._take(answer)
        if self._wires.restarted():
            self._begin_anew(RESTARTED)
        for came_s, seen in self._wires.poses():
            ahead_s = seen.t_s - came_s
            if math.isfinite(self._ahead_s) and abs(ahead_s - self._ahead_s) > JUMP_S:
                self._begin_anew(JUMPED)
            self._ahead_s = max(self._ahead_s, ahead_s)
            self._take(seen)
        for order in self._wires.orders():
            self._take(order)
        if math.isfinite(self._ahead_s):
            self._take(Tick(self._now_s() + self._ahead_s))
        state = shown(self.prompt, self._course)
        state.learned.extend(self.learned)
        state.commands.extend(self.commands)
        self._wires.show(state)
        return state

    def _begin_anew(self, why: str) -> None:
        self._ahead_s = -math.inf
        self._take(Anew(why))

    def _take(self, came: Input) -> None:
        self.prompt, marks = step(self.prompt, self._course, came)
        for mark in marks:
            self._wires.mark(mark.text)
