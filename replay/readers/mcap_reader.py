"""Reads MCAP logs: frames, snapshots and the results logged live, in file order. Damage costs only itself.

Chunks are taken apart by `Channels.records`, at a fraction of what `iter_messages` costs. Where arrays of raw
frames are enough, `arrays.read_frames` takes a fraction of that (bench/replay_speed.py).
"""

import io
import struct
from collections.abc import Iterator

from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from tilth.logger.log.mcap_file import DAMAGE, HOLE, MESSAGE, is_finished
from tilth.logger.log.mcap_log import CAN_TOPIC, SNAPSHOT_TOPIC
from tilth.logger.log.mcap_records import McapRecords
from tilth.logger.log.mcap_summary import metadata_bodies
from tilth.replay.readers.log import EmptyLog, ForeignLog, Gap, Logged, OpenLog, Record
from tilth.schemas.flow import Frame
from tilth.schemas.frame_columns import RX_NS
from tilth.schemas.proto.tilth_pb2 import CanFrame, Snapshot

DAMAGED = "damaged_chunk"  # how a part that cannot be read is counted
_HEAD_OF_FRAME = struct.Struct(MESSAGE.format + "BQ")  # with tag and value of CanFrame.rx_ns
_KINDS = 8192  # identifiers remembered; beyond them the memory starts anew
MACHINE = "machine"  # metadata record: name, toml, dbc, sha256


class Channels:
    """What each channel of a file carries, and how the records of a chunk become ours."""

    def __init__(self, log: OpenLog) -> None:
        self.log = log
        self.schemas: dict[int, str] = {}
        self.buses: dict[int, str] = {}  # channel -> bus
        self.others: dict[int, str] = {}  # channel -> topic, of snapshots and of the results asked for
        self.known: set[int] = set()
        self.defined: set[int] = set()  # channels of schemas that are known
        self._kinds: dict[bytes, tuple[int, bool, bool]] = {}  # as packed -> identifier, extended, error

    def add(self, channel: Channel) -> None:
        """Take a channel; a file appended to another gives its own numbers."""
        self.buses.pop(channel.id, None)
        self.others.pop(channel.id, None)
        self.known.add(channel.id)
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
        unpack = _HEAD_OF_FRAME.unpack_from
        bus_of, kind_of = self.buses.get, self._kinds.get
        end = len(data)
        data += bytes(_HEAD_OF_FRAME.size)  # a short last record can be unpacked like any other
        start = 0
        while start < end:
            opcode, length, channel, _, t_ns, _, tag, rx_ns = unpack(data, start)
            stop = start + 9 + length
            if opcode != 5:
                self.definition(opcode, data[start + 9 : stop])
            elif (bus := bus_of(channel)) is not None:
                if tag == RX_NS and (kind := kind_of(data[start + 40 : stop - 8])) is not None:
                    keep(Frame(t_ns, rx_ns, bus, *kind, data[stop - 8 : stop]))
                elif (frame := self._frame(data[start + 31 : stop], t_ns, bus)) is not None:
                    keep(frame)
            elif channel in self.others:
                keep(self._other(self.others[channel], t_ns, data[start + 31 : stop]))
            elif channel not in self.known:  # in a cut log, what is damaged may have defined it
                self.log.skip("undefined_channel")
            start = stop
        return found

    def _frame(self, body: bytes, t_ns: int, bus: str) -> Frame | None:
        """A frame by Protobuf. What stands between its time and its data is the same in each frame of its
        identifier: known of one, it is looked up for all that follow."""
        try:
            raw = CanFrame.FromString(body)
        except DecodeError:
            self.log.skip("damaged_frame")
            return None
        if len(raw.data) == 8 and raw.rx_ns and raw.SerializeToString() == body:
            if len(self._kinds) >= _KINDS:
                self._kinds.clear()
            self._kinds[body[9:-8]] = raw.can_id, raw.extended, raw.error
        return Frame(t_ns, raw.rx_ns, bus, raw.can_id, raw.extended, raw.error, raw.data)

    def _other(self, topic: str, t_ns: int, data: bytes) -> Record:
        return Snapshot.FromString(data) if topic == SNAPSHOT_TOPIC else Logged(topic, t_ns, data)


def records(log: OpenLog) -> Iterator[Record]:
    """Frames, snapshots and the results of log.topics, in file order, and a Gap where some are missing.

    What is damaged costs only itself: it is left out, counted and told in log.damage; log.truncated says at
    the end whether the file was cut. Raises ForeignLog for a whole file without frames of this software.
    """
    reading = LogRecords(log)
    channels = Channels(log)
    if reading.define(channels) and not channels.buses:
        raise no_frames(log)
    for data in reading:
        if isinstance(data, Gap):
            yield data
            continue
        try:
            found = channels.records(data)
        except DAMAGE:
            log.skip(DAMAGED)
        else:
            yield from found
    if not channels.buses and not log.truncated:
        raise no_frames(log)


class LogRecords:
    """The records of a log, piece by piece, as `McapRecords` gives them; what is wrong goes to the log."""

    def __init__(self, log: OpenLog) -> None:
        self._log = log
        self._records = McapRecords(log.file, log.size)

    @property
    def definitions(self) -> bytes:
        """As McapRecords.definitions."""
        return self._records.definitions

    def define(self, channels: Channels) -> bool:
        """Learn the channels from the index of a file, since a damaged first chunk costs only itself then;
        False where there is no index: the chunks define the channels as well."""
        channels.records(self.definitions)
        return bool(channels.defined)

    def __iter__(self) -> Iterator[bytes | Gap]:
        """Whole MCAP records, of a chunk or one alone; a Gap where messages are missing."""
        for place, data in self._records:
            if place.opcode != HOLE:
                yield data
            elif (lost := self._records.lost) is not None:
                self._log.skip(DAMAGED)
                yield Gap(lost.from_ns, str(lost))
        self._log.damage += map(str, self._records.faults)
        self._log.truncated = self._records.cut


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


def no_frames(log: OpenLog) -> EmptyLog | ForeignLog:
    if MACHINE in metadata(log):
        return EmptyLog(f"{log.path}: no frame was recorded in it")
    return ForeignLog(
        f"{log.path}: an MCAP file without the topics {CAN_TOPIC}<bus> of tilth.CanFrame and without "
        "can_msgs/Frame; only logs written by tilth or by ROS can be replayed from MCAP"
    )
