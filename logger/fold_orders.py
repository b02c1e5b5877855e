"""What the operator says that enters the fold: it is logged, then used, then answered."""

from collections.abc import Callable
from functools import partial
from typing import Any, Final

from tilth.logger.clock import Clock
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log.marks import Marks, OrderWords
from tilth.logger.outlets import Outlets
from tilth.schemas.carried import said_of_load
from tilth.schemas.channels import ACCEPTED_TOPIC, CHANNEL, LOAD_TOPIC
from tilth.schemas.flow import Accepted, Carried, Event, Publication
from tilth.schemas.notices import in_words

ACCEPT: Final = "accept"  # the last part of its key
LOAD: Final = "load"
ACCEPT_ORDER: Final = OrderWords("an order to accept", "orders to accept", "the name of what has been moved")
LOAD_ORDER: Final = OrderWords("a load", "loads", "what the implement carries")

Used = list[tuple[Publication, bytes]]


class FoldOrders:
    """Asked for by a query on <prefix>/<machine>/<key> with a text.

    The value is logged before it is used; the answer, a tilth.Event, comes when it is on the disk.
    """

    def __init__(
        self, key: str, words: OrderWords, topic: str, meant: Callable[[str, int], Any], use:
        Callable[[Any], Used], clock: Clock, outlets: Outlets,
    ) -> None:  # fmt: skip
        """meant: the value that a text asks for at a time, or why there is none, in words. use: uses it."""
        self.requests = Marks(words)
        self._key, self._topic, self._meant, self._use = key, topic, meant, use
        self._clock = clock
        self._outlets = outlets

    def turn(self) -> None:
        """Log and use what is said, answer what is on the disk."""
        recording = self._outlets.recording
        for request in self.requests.requests():
            t_ns = self._clock.t_ns()
            value, event = self._meant(request.text, t_ns), Event(t_ns, self._key, in_words(request.text))
            if isinstance(value, str):
                self.requests.settle(request, event, value)
                continue
            recording.message(self._topic, t_ns, CHANNEL[self._topic].encode(value))
            for publication, data in self._use(value):
                self._outlets.put(publication.topic, publication.t_ns, data)
                if isinstance(publication.value, Event):
                    event = publication.value
                    self._outlets.show_event(event)
            recording.settle(partial(self.requests.settle, request, event))
        for request, event, refusal in self.requests.settled():
            request.answer(event, refusal)


def of_accepting(fold: GuardedFold, clock: Clock, outlets: Outlets) -> FoldOrders:
    """Of the name of what has been found moved: it is as it is now."""

    def meant(text: str, t_ns: int) -> Accepted | str:
        names = [name for names, _ in fold.moved for name in names]
        have = f"what has been is {', '.join(names)}" if names else "nothing has been"
        return fold.proposal(text, t_ns) or f"{text} has not been found moved; {have}"

    return FoldOrders(ACCEPT, ACCEPT_ORDER, ACCEPTED_TOPIC, meant, fold.accept, clock, outlets)


def of_loads(fold: GuardedFold, clock: Clock, outlets: Outlets) -> FoldOrders:
    """Of what the implement carries."""

    def meant(text: str, t_ns: int) -> Carried | str:
        return said_of_load(fold.empty, text, t_ns)

    return FoldOrders(LOAD, LOAD_ORDER, LOAD_TOPIC, meant, fold.carry_load, clock, outlets)
