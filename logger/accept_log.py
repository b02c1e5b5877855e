"""Logs values that the operator accepts, then uses them."""

from functools import partial

from tilth.logger.clock import Clock
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log.marks import Marks, OrderWords
from tilth.logger.outlets import Outlets
from tilth.schemas.channels import ACCEPTED_TOPIC, CHANNEL
from tilth.schemas.flow import Event
from tilth.schemas.notices import in_words

KEY = "accept"  # the last part of it
ORDER = OrderWords("an order to accept", "orders to accept", "the name of what has been moved")


class AcceptLog:
    """Asked for by a query on <prefix>/<machine>/accept with the name of what has been moved.

    The value is logged before it is used; the answer, a tilth.Event, comes when it is on the disk.
    """

    def __init__(self, fold: GuardedFold, clock: Clock, outlets: Outlets) -> None:
        self.requests = Marks(ORDER)
        self._fold = fold
        self._clock = clock
        self._outlets = outlets

    def turn(self) -> None:
        """Log and use what is accepted, answer what is on the disk."""
        recording = self._outlets.recording
        for request in self.requests.requests():
            t_ns = self._clock.t_ns()
            accepted, asked = self._fold.proposal(request.text, t_ns), in_words(request.text)
            if accepted is None:
                self.requests.settle(request, Event(t_ns, KEY, asked), self._refusal(request.text))
                continue
            recording.message(ACCEPTED_TOPIC, t_ns, CHANNEL[ACCEPTED_TOPIC].encode(accepted))
            event = Event(t_ns, KEY, asked)
            for publication, data in self._fold.accept(accepted):
                self._outlets.put(publication.topic, publication.t_ns, data)
                if isinstance(publication.value, Event):
                    event = publication.value
                    self._outlets.show_event(event)
            recording.settle(partial(self.requests.settle, request, event))
        for request, event, refusal in self.requests.settled():
            request.answer(event, refusal)

    def _refusal(self, text: str) -> str:
        names = [name for names, _ in self._fold.moved for name in names]
        have = f"what has been is {', '.join(names)}" if names else "nothing has been"
        return f"{text} has not been found moved; {have}"
