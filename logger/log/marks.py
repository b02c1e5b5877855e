"""Marks of the operator: a text, asked to be noted by a query on <prefix>/<machine>/mark. Other orders of a
text in one line, such as to accept what has been moved, come in the same way.

The answer is a tilth.Event when the mark is on the disk, or an error in words. What is asked comes in a
thread of Zenoh's; the daemon's loop logs it between two frames and hears from the disk's thread what became
of it.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import zenoh

from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Event, EventKind
from tilth.schemas.limiter import Limiter

MOST_BYTES: Final = 1024  # of UTF-8
MOST_WAITING: Final = 16  # not answered yet; a person is slower
EACH: Final = 8  # of them, of one client
KIND: Final = EventKind.MARK  # of the event, and the last part of the key


class OrderWords(NamedTuple):
    """What an order is called where it is refused."""

    one: str
    many: str
    needs: str  # what its text is


MARK: Final = OrderWords("a mark", "marks", "a text")


class MarkRefused(Exception):
    """Why a text is no such order, in words."""


@dataclass(frozen=True, slots=True)
class MarkRequest:
    """`answer` is called once: with the event and "", or with why it is not in the log. It never raises."""

    text: str
    answer: Callable[[Event, str], None]
    client: str


class Marks:
    """Requests and their results: two queues between threads."""

    def __init__(self, words: OrderWords = MARK) -> None:
        self._words = words
        self.refused = 0
        self._requests: deque[MarkRequest] = deque()
        self._settled: deque[tuple[MarkRequest, Event, str]] = deque()
        self._limiter = Limiter(MOST_WAITING, EACH, words.many, threading.Lock())

    def take(self, query: zenoh.Query, client: str) -> None:
        """Take a query on the key itself; a query by a wildcard is not a mark. client: who asks."""
        if "*" in str(query.key_expr):
            return
        try:
            text = text_of(query.payload, self._words)
            if refused := self._limiter.enter(client):
                raise MarkRefused(refused)
        except MarkRefused as refusal:
            self.refused += 1
            query.reply_err(str(refusal))
            return
        self._requests.append(MarkRequest(text, _answerer(query), client))

    def requests(self) -> Iterator[MarkRequest]:
        """Requests to log now."""
        while self._requests:
            yield self._requests.popleft()

    def settle(self, mark: MarkRequest, event: Event, refusal: str) -> None:
        """From any thread: it is on the disk, or why not."""
        self._settled.append((mark, event, refusal))

    def settled(self) -> Iterator[tuple[MarkRequest, Event, str]]:
        """Those to be answered now."""
        while self._settled:
            settled = self._settled.popleft()
            self._limiter.leave(settled[0].client)
            yield settled


def text_of(payload: zenoh.ZBytes | None, words: OrderWords) -> str:
    """The text of an order. Raises MarkRefused."""
    one, _, needs = words
    size = 0 if payload is None else len(payload)
    if payload is None or size == 0:
        raise MarkRefused(f"{one} needs {needs}: send it as the payload of the query, in UTF-8")
    if size > MOST_BYTES:
        raise MarkRefused(f"{one} has at most {MOST_BYTES} bytes, these are {size} bytes; write less")
    try:
        text = payload.to_bytes().decode().strip()
    except UnicodeDecodeError as error:
        reason = f"{error.reason} at byte {error.start}"
        raise MarkRefused(f"{one} is written in UTF-8, this is no UTF-8: {reason}") from None
    if not text.isprintable():
        raise MarkRefused(f"{one} is plain text in one line, this one holds control characters")
    if not text:
        raise MarkRefused(f"{one} needs {needs}, this one is blank")
    return text


def _answerer(query: zenoh.Query) -> Callable[[Event, str], None]:
    channel = CHANNEL["/event"]

    def answer(event: Event, refusal: str) -> None:
        try:
            if refusal:
                query.reply_err(refusal)
            else:
                query.reply(query.key_expr, channel.encode(event), encoding=channel.encoding)
            query.drop()
        except zenoh.ZError:  # who asked has gone; the mark is in the log all the same
            return

    return answer
