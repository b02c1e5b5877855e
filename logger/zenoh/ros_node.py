"""One node of ROS 2 on a session of Zenoh, as rmw_zenoh has it: keys, attachments, liveliness tokens.

    data      <domain>/<topic>/<type>/<type hash>
    token     @ros2_lv/<domain>/<session>/<node>/<entity>/<kind>/<enclave>/<namespace>/<node's name>
              and for a publisher /<topic>/<type>/<type hash>/<quality of service>

with % for each / within a part of a token. Payloads are CDR, little-endian. An attachment holds a sequence
number, the time of sending in ns since 1970 (int64 each) and 16 bytes that name the publisher.
"""

import itertools
import time
from typing import Any, Final

import xxhash
import zenoh
from zenoh.ext import Int64, z_serialize

from tilth.logger.zenoh.ros_messages import STORE, RosMessage, RosMessages, RosTopic
from tilth.schemas.machine import Machine

NODE: Final = "tilth"
DEPTH: Final = 10  # of the history that subscribers are told of
_NOBODY: Final = "%"  # an empty enclave


class _Publisher:
    def __init__(self, session: zenoh.Session, key: str, token: str) -> None:
        self._publisher = session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.DROP, express=True
        )
        self._token = session.liveliness().declare_token(token)
        self._gid = xxhash.xxh3_128(token.encode()).digest()
        self._sequence = itertools.count(1)

    def put(self, kind: str, value: Any) -> None:
        sent = z_serialize((Int64(next(self._sequence)), Int64(time.time_ns()), self._gid))
        self._publisher.put(bytes(STORE.serialize_cdr(value, kind)), attachment=sent)

    def close(self) -> None:
        self._token.undeclare()
        self._publisher.undeclare()


class RosNode:
    """What a sink publishes, for ROS as well. The session stays the caller's."""

    def __init__(self, session: zenoh.Session, machine: Machine, replayed: bool) -> None:
        self._messages = RosMessages(machine, replayed)
        domain = machine.zenoh.ros_replay_domain if replayed else machine.zenoh.ros_domain
        head = f"@ros2_lv/{domain}/{session.zid()}/0"
        where = f"{_NOBODY}/{_mangled(self._messages.namespace)}/{NODE}"
        self._token = session.liveliness().declare_token(f"{head}/0/NN/{where}")
        self._publishers: dict[str, _Publisher] = {}
        for entity, topic in enumerate(self._messages.topics, 1):
            typed = f"{_dds_name(topic.type)}/{STORE.hash_rihs01(topic.type)}"
            key = f"{domain}/{topic.name.strip('/')}/{typed}"
            token = f"{head}/{entity}/MP/{where}/{_mangled(topic.name)}/{typed}/::,{DEPTH}:,:,:,,"
            self._publishers[topic.name] = _Publisher(session, key, token)

    @property
    def topics(self) -> tuple[RosTopic, ...]:
        return self._messages.topics

    def put(self, topic: str, data: bytes) -> None:
        """A publication of Tilth's. Raises zenoh.ZError."""
        for message in self._messages.of(topic, data):
            self._send(message)

    def close(self) -> None:
        for publisher in self._publishers.values():
            publisher.close()
        self._token.undeclare()

    def _send(self, message: RosMessage) -> None:
        publisher = self._publishers.get(message.topic)
        if publisher is not None:  # a receiver that the machine file does not have
            publisher.put(message.type, message.value)


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def _dds_name(kind: str) -> str:
    package, part, name = kind.split("/")
    return f"{package}::{part}::dds_::{name}_"
