"""Orders that a driver gives on the page: they come over Zenoh in threads, and wait for a loop."""

import queue
import threading
from collections.abc import Sequence
from typing import Final

import zenoh
from google.protobuf.message import DecodeError

from tilth.client.received import Refused, text
from tilth.schemas.limiter import Limiter, asked_by
from tilth.schemas.proto import tilth_pb2 as pb

MOST: Final = 64  # that wait
EACH: Final = 32  # of them, of one client
LARGEST_ORDER: Final = 1024  # bytes


OrderMessage = type[pb.ExperimentOrder] | type[pb.CalibrationOrder]


class OrderQueue:
    """`take` it as the handler of a queryable's queries."""

    def __init__(self, message: OrderMessage, kinds: Sequence[str], session: zenoh.Session) -> None:
        """session: over which they come."""
        self._message, self._kinds = message, tuple(kinds)
        self._session = session
        self._waiting: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
        self._limiter = Limiter(MOST, EACH, "orders", threading.Lock())

    def new(self) -> list[str]:
        """Kinds of those since the last call, in their order."""
        found = []
        while not self._waiting.empty():
            kind, client = self._waiting.get()
            self._limiter.leave(client)
            found.append(kind)
        return found

    def take(self, query: zenoh.Query) -> None:
        """Answer it: with nothing when it was taken, else with the reason. In a thread that hears."""
        try:
            kind = self._kind_of(query)
            client = asked_by(query, self._session)
            if refused := self._limiter.enter(client):
                raise Refused(refused)
        except Refused as refusal:
            query.reply_err(str(refusal))
        else:
            self._waiting.put((kind, client))
            query.reply(query.key_expr, b"")
        query.drop()

    def _kind_of(self, query: zenoh.Query) -> str:
        """Raises Refused."""
        name = self._message.__name__
        payload = query.payload
        if payload is None or len(payload) > LARGEST_ORDER or "*" in str(query.key_expr):
            raise Refused(f"an order is a message {name}")
        try:
            kind = self._message.FromString(payload.to_bytes()).kind
        except DecodeError:
            raise Refused(f"no {name}") from None
        if kind not in self._kinds:
            raise Refused(f"{text(kind)[:40]!r}: no order; there are {', '.join(self._kinds)}")
        return kind
