"""What a daemon publishes, live over the Foxglove WebSocket protocol, for Foxglove, Lichtblick and such.

Topics, schemas and bytes are those of the log: one layout serves both. Only what `tilth experiment` prompts
is in no log, and served as foxglove_prompt.py makes it. Needs the extra `foxglove`; nothing else of this
package imports this module. Threads of Zenoh's fill it.
"""

import threading
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final, cast

import zenoh
from foxglove import Channel, Context, Schema, start_server
from foxglove.websocket import Capability
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor import Descriptor
from google.protobuf.message import DecodeError, Message

from tilth.client.received import LARGEST, Refused, parse
from tilth.monitor.door import Gate, hidden_host
from tilth.monitor.foxglove_prompt import nobody_prompts, prompt_of
from tilth.monitor.origin import Refusal
from tilth.schemas import channels
from tilth.schemas.proto import tilth_pb2 as pb

# The rig is said once, when a daemon begins, and would be missed; viewers have the drawing instead.
SERVED: Final = tuple(row for row in channels.CHANNELS if row.key is not None and row.logged)
PROMPT_TOPIC: Final = "/experiment"
SILENT_NS: Final = 2_000_000_000  # without a prompt, of which ten come a second: nobody prompts any more
BACK_NS: Final = 5_000_000_000  # further back than any message is late: another run, or a clock that stepped
DESKTOP: Final = ("file://",)  # viewers with a window of their own; no page of a network has this origin
LATEST_NS: Final = 1 << 63


class FoxgloveServer:
    """Serves until it is stopped. What it is sent by viewers it does not listen to."""

    def __init__(
        self,
        host: str,
        port: int,
        allowed: Sequence[str] = (),
        refused: Callable[[Refusal, str], None] = lambda refusal, origin: None,
    ) -> None:
        """allowed, refused: as of gate.Gate. Raises OSError."""
        self._context = context = Context()  # it ends with its last reference, and all channels with it
        self.served, self.refused = 0, Counter[str]()
        self._now_ns = 0  # of the daemon's clock
        self._prompted_ns = 0  # when the last prompt came; 0: nobody prompts
        self._lock = threading.Lock()
        self._subscribers: list[zenoh.Subscriber[None]] = []
        hidden = hidden_host()
        try:
            self._server = start_server(
                name="tilth", host=hidden, port=0, capabilities=[Capability.Time], context=context
            )
        except RuntimeError as error:
            raise OSError(str(error).removeprefix("FoxgloveError: ")) from None
        try:
            self._gate = Gate(host, port, (hidden, self._server.port), (*DESKTOP, *allowed), refused)
        except OSError:
            self._server.stop()
            raise
        self.port = self._gate.port
        self._channels = {row.topic: _channel(row.topic, row.message, context) for row in SERVED}
        self._channels[PROMPT_TOPIC] = _channel(PROMPT_TOPIC, pb.ExperimentPrompt, context)

    def follow(self, session: zenoh.Session, base: str) -> None:
        """Serve what is said on the keys of a machine from now on."""
        for row in SERVED:
            take = partial(self._take, row)
            self._subscribers.append(session.declare_subscriber(f"{base}/{row.key}", take))
        self._subscribers.append(session.declare_subscriber(f"{base}/experiment", self._take_prompt))

    def stop(self) -> None:
        """Before the session is closed."""
        for subscriber in self._subscribers:
            subscriber.undeclare()
        self._gate.stop()
        self._server.stop()

    def _take(self, row: channels.Channel, sample: zenoh.Sample) -> None:
        with self._lock:
            try:
                data, t_ns = _checked(row, sample)
            except ValueError as refusal:
                self.refused[f"{row.topic}: {refusal}"] += 1
                return
            self._log(row.topic, data, t_ns)
            if self._prompted_ns and abs(self._now_ns - self._prompted_ns) > SILENT_NS:
                self._prompted_ns = 0
                self._log(PROMPT_TOPIC, nobody_prompts(self._now_ns).SerializeToString(), self._now_ns)

    def _take_prompt(self, sample: zenoh.Sample) -> None:
        with self._lock:
            try:
                state = parse(pb.ExperimentState, sample.payload.to_bytes(), str(sample.encoding))
            except Refused:
                self.refused[f"{PROMPT_TOPIC}: not an ExperimentState"] += 1
                return
            t_ns = state.t_ns or self._now_ns  # before the first pose it says what is to be done, too
            if not 0 < t_ns < LATEST_NS:
                self.refused[f"{PROMPT_TOPIC}: without a time"] += 1
                return
            self._log(PROMPT_TOPIC, prompt_of(state, t_ns).SerializeToString(), t_ns)
            self._prompted_ns = self._now_ns

    def _log(self, topic: str, data: bytes, t_ns: int) -> None:
        if not self._now_ns - BACK_NS < t_ns <= self._now_ns:
            self._now_ns = t_ns
            self._server.broadcast_time(t_ns)
        self._channels[topic].log(data, log_time=t_ns)
        self.served += 1


def _channel(topic: str, message: type[Message], context: Context) -> Channel:
    descriptor = cast(Descriptor, message.DESCRIPTOR)
    schema = Schema(
        name=descriptor.full_name, encoding="protobuf", data=channels.file_descriptor_set(descriptor)
    )
    return Channel(topic, message_encoding="protobuf", schema=schema, context=context)


def _checked(row: channels.Channel, sample: zenoh.Sample) -> tuple[bytes, int]:
    """The bytes of a message and its own time. Raises ValueError."""
    if len(sample.payload) > LARGEST:
        raise ValueError("too many bytes")
    if str(sample.encoding) != row.encoding:
        raise ValueError(f"its encoding is not {row.encoding}")
    data, message = sample.payload.to_bytes(), row.message()
    try:
        message.ParseFromString(data)
    except DecodeError:
        raise ValueError(f"not a {row.message.DESCRIPTOR.name}") from None
    t_ns = _time_ns(message)
    if not 0 < t_ns < LATEST_NS:
        raise ValueError("without a time")
    return data, t_ns


def _time_ns(message: Any) -> int:
    """Ours have their time as t_ns, Foxglove's as a timestamp; 0: none."""
    if isinstance(message, LocationFix):
        return int(message.timestamp.ToNanoseconds())
    if isinstance(message, (FrameTransforms, SceneUpdate)):
        parts = message.transforms if isinstance(message, FrameTransforms) else message.entities
        return int(parts[0].timestamp.ToNanoseconds()) if parts else 0
    return int(message.t_ns)
