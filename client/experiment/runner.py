"""Runs a prompter beside a daemon: what came goes through `prompter.step`, what follows goes out."""

import math
import time
from collections import Counter
from collections.abc import Callable
from typing import Final

from tilth.client.experiment.prompter import (
    ARM,
    FINISHED,
    Anew,
    Course,
    Input,
    Leave,
    Marked,
    Order,
    Prompt,
    Tick,
    step,
)
from tilth.client.experiment.shown import shown
from tilth.client.experiment.wires import PrompterWires
from tilth.schemas.proto import tilth_pb2 as pb

TURN_S: Final = 0.1
LEAVE_S: Final = 3.0  # for the answers to marks, before a prompter ends
JUMP_S: Final = 60.0  # poses that jump so far are of another clock
RESTARTED: Final = "the daemon has begun anew and writes another log"
UNHEARD_S: Final = 5.0  # without a word of the daemon, which tells of itself once a second
JUMPED: Final = "the clock of the poses jumped"
FIELD_FORGOTTEN: Final = (
    "Where the field is, is not known: drive to where it begins, as before the first run, and arm there."
)


class PlanRunner:
    """`turn` it ten times a second."""

    def __init__(
        self, wires: PrompterWires, course: Course, now_s: Callable[[], float] = time.monotonic, at: int = 0,
        tries: int = 1,
    ) -> None:  # fmt: skip
        """at: the run to begin with, from 0, where those before were driven by another prompter. tries: of
        that run, with the next one."""
        self._wires, self._course, self._now_s = wires, course, now_s
        self._ahead_s = -math.inf  # of the poses' clock before this one: that of the pose that came fastest
        self._asked: Counter[str] = Counter()  # marks without an answer yet
        self.prompt = Prompt(at=at, tries=tries, said=_goes_on(course, at) if at or tries > 1 else "")
        self.learned: tuple[str, ...] = ()
        self.commands: tuple[str, ...] = ()

    @property
    def finished(self) -> bool:
        return self.prompt.phase == FINISHED

    def order(self, kind: str) -> None:
        """The driver's. Nothing is armed while no daemon could mark it."""
        if kind != ARM or self._wires.silent_s < UNHEARD_S:
            self._take(Order(kind))

    def leave(self) -> None:
        """Whatever is under way ends, and its note is in the log, if the daemon answers soon."""
        self._settle()  # a run that has just ended is done, if its mark arrives
        self._take(Leave())
        self._settle()
        self._show()

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
            self.order(order.kind)
        if math.isfinite(self._ahead_s):
            self._take(Tick(self._now_s() + self._ahead_s))
        return self._show()

    def _show(self) -> pb.ExperimentState:
        state = shown(self.prompt, self._course)
        if (silent_s := self._wires.silent_s) > UNHEARD_S and not self.finished:
            state.text = f"The daemon has not been heard for {silent_s:.0f} s: is it still running?"
        state.learned.extend(self.learned)
        state.commands.extend(self.commands)
        self._wires.show(state)
        return state

    def _begin_anew(self, why: str) -> None:
        self._ahead_s = -math.inf
        self._take(Anew(why))

    def _settle(self) -> None:
        """Until all marks are answered, at most LEAVE_S."""
        until_s = self._now_s() + LEAVE_S
        while self._asked and self._now_s() < until_s:
            for answer in self._wires.answers():
                self._take(answer)
            time.sleep(TURN_S / 2)

    def _take(self, came: Input) -> None:
        if isinstance(came, Marked):
            self._asked -= Counter([came.text])
        self.prompt, marks = step(self.prompt, self._course, came)
        for mark in marks:
            self._asked[mark.text] += 1
            self._wires.mark(mark.text)


def _goes_on(course: Course, at: int) -> str:
    """What a driver is told who goes on with run `at`."""
    said = f"The plan goes on with run {at + 1} of {len(course.drives)}: arm it when you are ready."
    if course.plan.field.corner is None:  # mid-field it would seem to go on
        said += f" {FIELD_FORGOTTEN}"
    return said
