"""Publishes on Zenoh: <prefix>/<machine>/<key> for each row of CHANNELS that has a key.

A plain get answers with the last value while it is fresh, and with its age in seconds as an attachment; a
liveliness token says that this process lives; the rig itself is there from the start.
Values are dropped rather than waited for: nothing here may cost a frame.
"""

import time
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

import zenoh

from tilth.logger.zenoh.session import open_session
from tilth.schemas.channels import CHANNEL, CHANNELS
from tilth.schemas.limiter import asked_by
from tilth.schemas.machine import Machine

if TYPE_CHECKING:
    from tilth.logger.zenoh.ros_node import RosNode

STALE_NS = 5_000_000_000  # estimates come each second: five missed in a row are no hiccup of the network
# What is computed from frames ends with them. Rig, status and events are the process's own: the last holds.
SIMULATED_SUFFIX = "replay"  # part of every key: no controller takes a simulation or a replay for a tractor
_COMPUTED = frozenset(channel.topic for channel in CHANNELS if channel.identical)


class ZenohSink:
    """One session. `note` says what is unusual about it, empty if nothing is."""

    def __init__(
        self,
        machine: Machine,
        prefix_suffix: str = "",
        now_ns: Callable[[], int] = time.monotonic_ns,
        answers: Mapping[str, Callable[[zenoh.Query, str], None]] = MappingProxyType({}),
        session: zenoh.Session | None = None,
    ) -> None:
        """prefix_suffix: "replay" for what a replay or simulation publishes: no controller hears that.

        now_ns: the clock that tells a value's age. answers: key -> takes queries on it, such as `mark`,
        and who asks.
        session: one that is there, and stays open. Raises zenoh.ZError where no session can be had.
        """
        self.base = "/".join(part for part in (machine.zenoh.prefix, machine.name, prefix_suffix) if part)
        self.failures = 0
        self._is_own = session is None
        self._session, self.endpoints, self.note = (session, [], "") if session else open_session(machine)
        self._publishers = {
            channel.topic: self._session.declare_publisher(
                f"{self.base}/{channel.key}",
                encoding=zenoh.Encoding(channel.encoding),
                congestion_control=zenoh.CongestionControl.DROP,
                express=True,  # do not wait for more to send together
            )
            for channel in CHANNELS
            if channel.key is not None
        }
        self._ros = self._ros_node(machine, bool(prefix_suffix)) if machine.zenoh.ros else None
        self._now_ns = now_ns
        self._last: dict[str, tuple[int, bytes]] = {}  # topic -> when it was put, what a get answers
        self.put("/rig", CHANNEL["/rig"].encode(machine))
        self._queryable = self._session.declare_queryable(f"{self.base}/**", self._answer, complete=True)
        for key, take in answers.items():
            self._session.declare_queryable(f"{self.base}/{key}", partial(self._asked, take), complete=True)
        self._token = self._session.liveliness().declare_token(f"{self.base}/alive")

    @property
    def problem(self) -> str:
        """What a person should do something about while this goes on, "" if nothing."""
        if self.failures:
            return f"{self.failures} values could not be published; restart it where they are missed"
        return self.note

    def put(self, topic: str, data: bytes) -> None:
        """Publish; a topic that has no key is passed over. Never raises, never waits."""
        publisher = self._publishers.get(topic)
        if publisher is None:
            return
        try:
            publisher.put(data)
            if self._ros is not None:
                self._ros.put(topic, data)
        except zenoh.ZError:
            self.failures += 1
        self._last[topic] = (self._now_ns(), data)

    def close(self) -> None:
        """Withdraw the token and end the session, or what was declared on one that stays open."""
        try:
            self._token.undeclare()
            if self._is_own:
                self._session.close()
                return
            self._queryable.undeclare()
            if self._ros is not None:
                self._ros.close()
            for publisher in self._publishers.values():
                publisher.undeclare()
        except zenoh.ZError:
            self.failures += 1

    def _ros_node(self, machine: Machine, replayed: bool) -> "RosNode | None":
        try:
            from tilth.logger.zenoh.ros_node import RosNode  # of an extra, and a third of a second
        except ModuleNotFoundError as error:
            missing = f"nothing is published for ROS: no {error.name} here; install `tilth[ros]`"
            self.note = "; ".join(part for part in (self.note, missing) if part)
            return None
        return RosNode(self._session, machine, replayed)

    def _asked(self, take: Callable[[zenoh.Query, str], None], query: zenoh.Query) -> None:
        take(query, asked_by(query, self._session))

    def _answer(self, query: zenoh.Query) -> None:
        # Runs in a thread of Zenoh's: takes a copy, changes nothing.
        now_ns = self._now_ns()
        for topic, (put_ns, data) in list(self._last.items()):
            publisher = self._publishers[topic]
            if not query.key_expr.intersects(publisher.key_expr):
                continue
            age_ns = now_ns - put_ns
            if topic in _COMPUTED and age_ns > STALE_NS:
                query.reply_err(
                    f"{publisher.key_expr}: no value for {age_ns * 1e-9:.0f} s: the buses are silent or "
                    "the daemon cannot compute; see status"
                )
            else:
                age = f"{age_ns * 1e-9:.3f}"
                query.reply(publisher.key_expr, data, encoding=publisher.encoding, attachment=age)
