"""Logs the operator's marks, with the place and the time they were asked for."""

from functools import partial

from tilth.logger.clock import Clock
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log.marks import KIND, Marks
from tilth.logger.outlets import Outlets
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Event
from tilth.schemas.notices import in_words


class MarkLog:
    """A mark is published and answered when it is on the disk, not before."""

    def __init__(self, fold: GuardedFold, clock: Clock, outlets: Outlets) -> None:
        self.marks = Marks()
        self._fold = fold
        self._clock = clock
        self._outlets = outlets

    def turn(self) -> None:
        """Log the marks requested, answer those that are on the disk."""
        recording = self._outlets.recording
        for mark in self.marks.requests():
            t_ns = self._clock.t_ns()
            event = Event(t_ns, KIND, in_words(mark.text), *self._fold.place_deg, self._clock.utc_ns(t_ns))
            recording.message("/event", event.t_ns, CHANNEL["/event"].encode(event))
            recording.settle(partial(self.marks.settle, mark, event))
        for mark, event, refusal in self.marks.settled():
            if not refusal:
                self._outlets.publish("/event", CHANNEL["/event"].encode(event))
                self._outlets.show_event(event)
            mark.answer(event, refusal)
