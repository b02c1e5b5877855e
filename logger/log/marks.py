"""Marks of the operator: a text, asked to be noted by a query on <prefix>/<machine>/mark.

The answer is a tilth.Event when the mark is on the disk, or an error in words. What is asked comes in a
thread of Zenoh's; the daemon's loop logs it between two frames and hears from the disk's thread what became
of it.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import zenoh

from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Event

MOST_BYTES: Final = 1024  # of UTF-8
MOST_WAITING: Final = 16  # not answered yet; a person is slower
KIND: Final = "mark"  # of the event, and the last part of the key


class MarkRefused(Exception):
    """Why a text is no mark, in words."""


@dataclass(frozen=True, slots=True)
class MarkRequest:
    """`answer` is called once: with the event and "", or with why it is not in the log. It never raises."""

    text: str
    answer: Callable[[Event, str], None]


class Marks:
    """Requests and their results: two queues between threads."""

    def __init__(self) -> None:
        self.refused = 0
        self._requests: deque[MarkRequest] = deque()
        self._settled: deque[tuple[MarkRequest, Event, str]] = deque()
        self._at_disk = 0

    def take(self, query: zenoh.Query) -> None:
        """Take a query on the key itself; a query by a wildcard is not a mark."""
        if "*" in str(query.key_expr):
            return
        try:
            text = text_of(query.payload)
            if len(self._requests) + self._at_disk >= MOST_WAITING:
                raise MarkRefused("too many marks at a time; try again in a second")
        except MarkRefused as refusal:
            self.refused += 1
            query.reply_err(str(refusal))
            return
        self._requests.append(MarkRequest(text, _answerer(query)))

    def requests(self) -> Iterator[MarkRequest]:
        """Requests to log now."""
        while self._requests:
            self._at_disk += 1
            yield self._requests.popleft()

    def settle(self, mark: MarkRequest, event: Event, refusal: str) -> None:
        """From any thread: it is on the disk, or why not."""
        self._settled.append((mark, event, refusal))

    def settled(self) -> Iterator[tuple[MarkRequest, Event, str]]:
        """Those to be answered now."""
        while self._settled:
            self._at_disk -= 1
            yield self._settled.popleft()


def text_of(payload: zenoh.ZBytes | None) -> str:
    """The text of a mark. Raises MarkRefused."""
    size = 0 if payload is None else len(payload)
    if payload is None or size == 0:
        raise MarkRefused("a mark needs a text: send it as the payload of the query, in UTF-8")
    if size > MOST_BYTES:
        raise MarkRefused(f"this mark has {size} bytes, {MOST_BYTES} are the most; write less")
    try:
        text = payload.to_bytes().decode().strip()
    except UnicodeDecodeError as error:
        raise MarkRefused(f"this mark is no UTF-8: {error.reason} at byte {error.start}") from None
    if not text.isprintable():
        raise MarkRefused("this mark holds control characters; write plain text in one line")
    if not text:
        raise MarkRefused("a mark needs a text, this one is blank")
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
