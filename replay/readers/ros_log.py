"""CAN frames in MCAP logs of ROS: can_msgs/Frame and its like, in CDR (ROS 2), ROS 1's encoding, JSON or
protobuf.

    std_msgs/Header header      t_ns: when it was logged; rx_ns: its stamp, where that is shortly before
    uint32 id
    bool is_rtr, is_extended, is_error
    uint8 dlc
    uint8[8] data

Fields are known by their names (columns.py), in any order, also in a message within the message: the schema
in the file says where they are. A topic is a bus.
"""

import base64
import io
import json
import re
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Final

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

from tilth.logger.log.mcap_file import DAMAGE, HEAD
from tilth.logger.log.mcap_log import CAN_TOPIC
from tilth.logger.log.mcap_records import McapRecords
from tilth.replay.readers.columns import frame_of, role_of
from tilth.replay.readers.log import Gap, OpenLog, stamp_fault
from tilth.replay.readers.mcap_reader import LogRecords
from tilth.replay.readers.text_clock import SECOND
from tilth.schemas.flow import Frame
from tilth.schemas.proto.tilth_pb2 import CanFrame

FORM: Final = "MCAP of ROS"
_PRIMITIVES: Final = {
    "bool": "?", "byte": "B", "char": "B", "octet": "B", "int8": "b", "uint8": "B", "int16": "h",
    "uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_COMMON: Final = {  # what definitions leave out
    "Header": "{sequence}time stamp\nstring frame_id",
    "Time": "int32 sec\nuint32 nanosec",
    "Duration": "int32 sec\nuint32 nanosec",
    "Frame": "std_msgs/Header header\nuint32 id\nbool is_rtr\nbool is_extended\nbool is_error\nuint8 dlc\n"
    "uint8[8] data",
}
_FIELD: Final = re.compile(
    r"\s*([A-Za-z][\w/]*)(?:<=\d+)?(\[(?:<=)?\d*\])?\s+([A-Za-z]\w*)(?:\s+[^=\s].*)?\s*$"
)
_LATE_NS: Final = SECOND  # from the stamp in a message to when it was logged, at most
_DEEPEST: Final = 8  # messages within one another


@dataclass(slots=True)
class _Definition:
    """Fields of a message, those of inner ones in their place: (name, type, how many; -1: as it says)."""

    fields: list[tuple[str, str, int | None]]

    @property
    def is_frame(self) -> bool:
        """Whether it holds what a CAN frame is made of."""
        roles = {role_of(name) for name, _, _ in self.fields}
        return {"id", "data"} <= roles and bool(roles & {"dlc", "length", "extended"})


def definition_of(schema: Schema) -> _Definition:
    """Raises ValueError for a definition that cannot be read."""
    ros1 = schema.encoding == "ros1msg"
    texts = {
        name: text.format(sequence="uint32 seq\n") if ros1 and name == "Header" else text.format(sequence="")
        for name, text in _COMMON.items()
    }
    main = schema.name.split("/")[-1]
    if schema.encoding in ("ros1msg", "ros2msg") and schema.data:
        whole, *inner = re.split(r"\n=+\s*\n", schema.data.decode("utf-8", "replace"))
        texts[main] = whole
        for text in inner:
            head, _, body = text.partition("\n")
            texts[head.removeprefix("MSG:").strip().split("/")[-1]] = body
    if main not in texts:
        raise ValueError("a definition that is not there")
    return _Definition(list(_flat(texts, texts[main], 0)))


def _flat(texts: dict[str, str], text: str, depth: int) -> Iterator[tuple[str, str, int | None]]:
    if depth > _DEEPEST:
        raise ValueError("messages without end")
    for line in text.splitlines():
        match = _FIELD.match(line.partition("#")[0])
        if match is None:
            continue
        kind, array, name = match.groups()
        count = None if array is None else int(array[1:-1]) if array[1:-1].isdecimal() else -1
        short = kind.split("/")[-1]
        if kind in ("time", "duration", "builtin_interfaces/Time", "builtin_interfaces/msg/Time"):
            yield name, "time", count
        elif kind in _PRIMITIVES or kind in ("string", "wstring"):
            yield name, kind, count
        elif short in texts and count is None:
            yield from _flat(texts, texts[short], depth + 1)
        else:
            raise ValueError(f"{kind} is not defined")


@dataclass(slots=True)
class _Cursor:
    """Reads a message's bytes; aligned to `widest` at most where it is CDR, not at all where that is 1."""

    data: bytes
    order: str
    widest: int
    start: int = 0  # where alignment counts from
    at: int = 0

    def number(self, kind: str) -> int | float:
        code = _PRIMITIVES[kind]
        size = struct.calcsize(code)
        step = min(size, self.widest)
        self.at += (self.start - self.at) % step
        found: tuple[int | float] = struct.unpack_from(self.order + code, self.data, self.at)
        self.at += size
        return found[0]

    def octets(self, count: int) -> bytes:
        found = self.data[self.at : self.at + count]
        if len(found) < count:
            raise ValueError("it ends too soon")
        self.at += count
        return found

    def value(self, kind: str, count: int | None) -> Any:
        if count == -1:
            count = int(self.number("uint32"))
        if count is not None:
            if kind in ("uint8", "byte", "octet", "char"):
                return self.octets(count)
            if count > len(self.data):
                raise ValueError("more than there is")
            return [self.value(kind, None) for _ in range(count)]
        if kind == "string":
            return self.octets(int(self.number("uint32")))
        if kind == "wstring":
            return self.octets(2 * int(self.number("uint32")))
        if kind == "time":
            return int(self.number("uint32")) * SECOND + int(self.number("uint32"))
        return self.number(kind)


def _cdr(data: bytes) -> _Cursor:
    """Raises ValueError for an encapsulation that is not read here."""
    kind = data[1] if len(data) > 4 and data[0] == 0 else -1
    if kind not in (0, 1, 6, 7, 8, 9):
        raise ValueError("an encapsulation that is not known")
    cursor = _Cursor(data, "<" if kind % 2 else ">", 8 if kind < 2 else 4, 4, 4)
    if kind in (8, 9):
        cursor.number("uint32")  # its length
    return cursor


def _of_fields(definition: _Definition, cursor: _Cursor) -> dict[str, Any]:
    return {name: cursor.value(kind, count) for name, kind, count in definition.fields}


def _of_json(data: bytes) -> dict[str, Any]:
    found: dict[str, Any] = {}
    inner = [json.loads(data)]
    while inner and len(found) < 1000:
        for name, value in dict(inner.pop()).items():
            if isinstance(value, dict) and not value.keys() & {"sec", "secs"}:
                inner.append(value)
            elif isinstance(value, dict):
                parts = [value[key] for key in ("sec", "secs", "nanosec", "nsec", "nsecs") if key in value]
                found[name] = int(parts[0]) * SECOND + sum(map(int, parts[1:]))
            elif role_of(name) == "data":
                found[name] = base64.b64decode(value) if isinstance(value, str) else bytes([*value])
            else:
                found[name] = value
    return found


def _of_protobuf(message: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for described in message.DESCRIPTOR.fields:
        value = getattr(message, described.name)
        if described.message_type is None or described.is_repeated:
            found[described.name] = value
        elif described.message_type.full_name == "google.protobuf.Timestamp":
            found[described.name] = value.seconds * SECOND + value.nanos
        elif message.HasField(described.name):
            found |= _of_protobuf(value)
    return found


def _protobuf_class(schema: Schema) -> Any:
    """Raises DAMAGE, TypeError, LookupError for a description that is none."""
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(schema.name))


_Decode = Callable[[bytes], dict[str, Any]]


def _decoder(channel: Channel, schema: Schema | None) -> _Decode | None:
    """What takes the messages of a channel apart; None where they are no CAN frames."""
    if schema is None or not re.search("can|frame", f"{schema.name} {channel.topic}", re.IGNORECASE):
        return None
    if channel.message_encoding == "json":
        names = set(re.findall(rb'"(\w+)"\s*:', schema.data))
        roles = {role_of(name.decode()) for name in names}
        return _of_json if {"id", "data"} <= roles else None
    if channel.message_encoding == "protobuf":
        try:
            of_class = _protobuf_class(schema)
        except (*DAMAGE, TypeError, LookupError):
            return None
        roles = {role_of(described.name) for described in of_class.DESCRIPTOR.fields}
        return (lambda data: _of_protobuf(of_class.FromString(data))) if {"id", "data"} <= roles else None
    try:
        definition = definition_of(schema)
    except ValueError:
        return None
    if not definition.is_frame:
        return None
    if channel.message_encoding == "cdr":
        return lambda data: _of_fields(definition, _cdr(data))
    if channel.message_encoding == "ros1":
        return lambda data: _of_fields(definition, _Cursor(data, "<", 1))
    return None


@dataclass(slots=True)
class _Channels:
    schemas: dict[int, Schema] = field(default_factory=dict)
    decoders: dict[int, tuple[str, _Decode]] = field(default_factory=dict)  # channel -> topic, decoder
    own: bool = False  # one is of this software

    def definition(self, opcode: int, body: bytes) -> None:
        stream = ReadDataStream(io.BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            schema = self.schemas.get(channel.schema_id)
            own = CanFrame.DESCRIPTOR.full_name
            self.own = self.own or (
                schema is not None and schema.name == own and channel.topic.startswith(CAN_TOPIC)
            )
            decoder = _decoder(channel, schema)
            if decoder is not None:
                self.decoders[channel.id] = channel.topic, decoder


def is_one(log: OpenLog) -> bool:
    """Whether an MCAP log holds CAN frames of ROS and none of this software; read until that is known."""
    channels, records = _Channels(), McapRecords(log.file, log.size)
    pieces = chain([records.definitions], (data for _, data in records))
    for opcode, body in chain.from_iterable(map(_inner, pieces)):
        if opcode == Opcode.MESSAGE:
            continue
        with suppress(*DAMAGE):  # said where it is read
            channels.definition(opcode, body)
        if channels.own or channels.decoders:
            break
    return bool(channels.decoders) and not channels.own


def _inner(data: bytes) -> Iterator[tuple[int, bytes]]:
    """(opcode, body) of whole MCAP records, one after the other."""
    at = 0
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        at += HEAD.size + length
        yield opcode, data[at - length : at]


def frames(log: OpenLog) -> Iterator[Frame | Gap]:
    """Its CAN frames in file order; a Gap where messages are missing."""
    log.form = FORM
    channels, records = _Channels(), LogRecords(log)
    for opcode, body in _inner(records.definitions):
        with suppress(*DAMAGE):  # its data define them too
            channels.definition(opcode, body)
    return _frames(log, channels, records)


def _frames(log: OpenLog, channels: _Channels, records: LogRecords) -> Iterator[Frame | Gap]:
    for piece in records:
        if isinstance(piece, Gap):
            yield piece
        else:
            yield from _frames_of(log, channels, piece)


def _frames_of(log: OpenLog, channels: _Channels, data: bytes) -> Iterator[Frame]:
    for opcode, body in _inner(data):
        try:
            if opcode != Opcode.MESSAGE:
                channels.definition(opcode, body)
                continue
            message = Message.read(ReadDataStream(io.BytesIO(body)), len(body))
            known = channels.decoders.get(message.channel_id)
            if known is None:
                continue
            found = _frame(known[0], message.log_time, known[1](message.data))
        except (*DAMAGE, LookupError, TypeError):
            found = "damaged_message"
        if isinstance(found, str):
            log.skip(found)
        else:
            yield found


def _frame(topic: str, t_ns: int, fields: dict[str, Any]) -> Frame | str:
    row = {role: value for name, value in fields.items() if (role := role_of(name)) is not None}
    stamp_ns = next((fields[name] for name in ("stamp", "timestamp") if isinstance(fields.get(name), int)), 0)
    rx_ns = stamp_ns if 0 <= t_ns - stamp_ns <= _LATE_NS else t_ns
    return stamp_fault(t_ns) or frame_of(
        (t_ns, rx_ns),
        topic.strip("/"),
        int(row["id"]),
        bytes(row["data"]),
        extended=bool(row.get("extended", False)),
        remote=bool(row.get("remote", False)),
        error=bool(row.get("error", False)),
        dlc=int(row["dlc"]) if "dlc" in row else None,
        length=int(row["length"]) if "length" in row else None,
    )
