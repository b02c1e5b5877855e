"""A viewer that knows only the Foxglove WebSocket protocol."""

import base64
import json
import struct
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor import Descriptor
from loopback import PATIENCE_S
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

MESSAGE, TIME = 1, 2  # opcodes of binary messages


class Viewer:
    """Speaks the protocol; knows nothing of Tilth."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}  # by topic
        self.heard: dict[str, list[tuple[int, bytes]]] = defaultdict(list)  # topic -> time, message
        self.times: list[int] = []
        self._topics: list[str] = []  # by subscription

    def subscribe(self, *topics: str) -> None:
        rows = []
        for topic in topics:
            rows.append({"id": len(self._topics), "channelId": self.channels[topic]["id"]})
            self._topics.append(topic)
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": rows}))

    def hear_until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, {topic: len(rows) for topic, rows in self.heard.items()}
            self._take(self._socket.recv(timeout=PATIENCE_S))

    def _take(self, result: str | bytes) -> None:
        if isinstance(result, str):
            output = json.loads(result)
            if output["op"] == "serverInfo":
                self.info = output
            elif output["op"] == "advertise":
                self.channels |= {row["topic"]: row for row in output["channels"]}
        elif result[0] == MESSAGE:
            subscription, t_ns = struct.unpack_from("<IQ", result, 1)
            self.heard[self._topics[subscription]].append((t_ns, result[13:]))
        elif result[0] == TIME:
            self.times.append(struct.unpack_from("<Q", result, 1)[0])

    def schema(self, topic: str) -> Descriptor:
        """As the server told it."""
        row, pool = self.channels[topic], descriptor_pool.DescriptorPool()
        assert (row["encoding"], row["schemaEncoding"]) == ("protobuf", "protobuf")
        for file in descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(row["schema"])).file:
            pool.Add(file)
        return pool.FindMessageTypeByName(row["schemaName"])

    def decoded(self, topic: str) -> list[Any]:
        """By the schema that the server told."""
        kind = message_factory.GetMessageClass(self.schema(topic))
        return [kind.FromString(data) for _, data in self.heard[topic]]

    def misbehave(self) -> None:
        for nonsense in ("nonsense", '{"op": "subscribe"}', b"\x63", b""):
            self._socket.send(nonsense)


@contextmanager
def viewer_at(address: str) -> Iterator[Viewer]:
    with connect(address, subprotocols=[Subprotocol("foxglove.sdk.v1")], max_size=None) as socket:
        assert socket.subprotocol == "foxglove.sdk.v1"
        yield Viewer(socket)
