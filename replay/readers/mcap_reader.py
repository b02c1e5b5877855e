"""Reads MCAP logs: frames, snapshots and the results logged live, in file order, as far as the file is whole.

Chunks are taken apart by `Channels.records`, at a fraction of what `iter_messages` costs. Where arrays of raw
frames are enough, `arrays.read_frames` takes a fraction of that (bench/replay_speed.py).
"""

import io
from collections.abc import Container, Iterator
from typing import BinaryIO

from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from tilth.logger.log.mcap_file import (
    DAMAGE,
    HEAD,
    MAGIC,
    MESSAGE,
    body_of,
    is_finished,
    metadata_bodies,
    summarised,
    unpacked,
    walk,
)
from tilth.logger.log.mcap_log import CAN_TOPIC, SNAPSHOT_TOPIC
from tilth.replay.readers.log import EmptyLog, ForeignLog, Logged, OpenLog, Record
from tilth.schemas.flow import Frame
from tilth.schemas.proto.tilth_pb2 import CanFrame, Snapshot

MACHINE = "machine"  # metadata record: name, toml, dbc, sha256


class Channels:
    """What each channel of a file carries, and how the records of a chunk become ours."""

    def __init__(self, log: OpenLog) -> None:
        self.log = log
        self.schemas: dict[int, str] = {}
        self.buses: dict[int, str] = {}  # channel -> bus
        self.others: dict[int, str] = {}  # channel -> topic, of snapshots and of the results asked for
        self.defined: set[int] = set()  # channels of schemas that are known

    def add(self, channel: Channel) -> None:
        if channel.schema_id in self.schemas:
            self.defined.add(channel.id)
        is_frame = self.schemas.get(channel.schema_id) == CanFrame.DESCRIPTOR.full_name
        if channel.topic.startswith(CAN_TOPIC) and is_frame:
            self.buses[channel.id] = channel.topic.removeprefix(CAN_TOPIC)
        elif channel.topic == SNAPSHOT_TOPIC or channel.topic in self.log.topics:
            self.others[channel.id] = channel.topic

    def definition(self, opcode: int, body: bytes) -> None:
        """Take a record that defines a schema or a channel."""
        stream = ReadDataStream(io.BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self.schemas[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            self.add(Channel.read(stream))

    def records(self, data: bytes) -> list[Record]:
        """Records among `data`, a sequence of whole MCAP records. The hot loop of replay."""
        found: list[Record] = []
        keep = found.append
        parse = CanFrame.FromString
        unpack = MESSAGE.unpack_from
        bus_of = self.buses.get
        end = len(data)
        data += bytes(MESSAGE.size)  # a short last record can be unpacked like any other
        start = 0
        while start < end:
            opcode, length, channel, _, t_ns, _ = unpack(data, start)
            stop = start + 9 + length
            if opcode != 5:
                self.definition(opcode, data[start + 9 : stop])
            elif (bus := bus_of(channel)) is not None:
                try:
                    raw = parse(data[start + 31 : stop])
                except DecodeError:
                    self.log.skip("damaged_frame")
                else:
                    keep(Frame(t_ns, raw.rx_ns, bus, raw.can_id, raw.extended, raw.error, raw.data))
            elif channel in self.others:
                keep(self._other(self.others[channel], t_ns, data[start + 31 : stop]))
            start = stop
        return found

    def _other(self, topic: str, t_ns: int, data: bytes) -> Record:
        return Snapshot.FromString(data) if topic == SNAPSHOT_TOPIC else Logged(topic, t_ns, data)


def records(log: OpenLog) -> Iterator[Record]:
    """Frames, snapshots and the results of log.topics, in file order.

    A chunk that is damaged is left out and counted; at the end log.truncated says whether the file was cut.
    Raises ForeignLog for a whole file without frames of this software.
    """
    channels = Channels(log)
    if from_summary(channels, log.file) and not channels.buses:
        raise no_frames(log)
    for opcode, body in framed(log):
        try:
            if opcode == Opcode.CHUNK:
                found = channels.records(unpacked(body))
            else:  # of a file without chunks
                found = channels.records(HEAD.pack(opcode, len(body)) + body)
        except DAMAGE:
            log.skip("damaged_chunk")
        else:
            yield from found
    if not channels.buses and not log.truncated:
        raise no_frames(log)


def metadata(log: OpenLog) -> dict[str, dict[str, str]]:
    """The first metadata record of each name, as far as the file is whole."""
    found: dict[str, dict[str, str]] = {}
    log.truncated = not is_finished(log.file, log.size)
    for body in metadata_bodies(log.file, log.size):
        try:
            record = Metadata.read(ReadDataStream(io.BytesIO(body)))
        except DAMAGE:
            log.skip("damaged_metadata")
        else:
            found.setdefault(record.name, record.metadata)
    return found


_WANTED = {Opcode.CHUNK, Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL}


def framed(log: OpenLog, wanted: Container[int] = _WANTED) -> Iterator[tuple[int, bytes]]:
    """(opcode, body) of the wanted records; sets log.truncated where the file ends without its footer."""
    log.truncated = True
    for place in walk(log.file, log.size):
        if place.opcode == Opcode.FOOTER:
            log.file.seek(place.end)
            log.truncated = log.file.read(len(MAGIC)) != MAGIC
        elif place.opcode in wanted:
            yield place.opcode, body_of(log.file, place)


def from_summary(channels: Channels, file: BinaryIO) -> bool:
    """Learn the channels from the index of a finished file: a damaged first chunk costs only itself then.

    False where there is no such index: the chunks define the channels as well.
    """
    found = False
    try:
        for opcode, body in summarised(file, channels.log.size):
            channels.definition(opcode, body)
            found |= opcode == Opcode.CHANNEL
    except DAMAGE:
        return False
    return found


def no_frames(log: OpenLog) -> EmptyLog | ForeignLog:
    if MACHINE in metadata(log):
        return EmptyLog(f"{log.path}: no frame was recorded in it")
    return ForeignLog(
        f"{log.path}: an MCAP file without the topics {CAN_TOPIC}<bus> of tilth.CanFrame and without "
        "can_msgs/Frame; only logs written by tilth or by ROS can be replayed from MCAP"
    )
