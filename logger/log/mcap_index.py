"""Writes the records of an MCAP file to another one, and the index at its end, which its writer could not."""

import io
import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterable
from typing import BinaryIO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from tilth.logger.log.mcap_file import HEAD, MAGIC, MESSAGE, packed_data

Rows = dict[int, list[tuple[int, int]]]  # channel -> log time and place within its chunk of each message


def contents(data: bytes) -> tuple[Rows, list[tuple[int, bytes]]]:
    """The messages of a chunk, and (opcode, body) of what it defines. Raises ValueError, struct.error."""
    rows: Rows = defaultdict(list)
    definitions = []
    start, end = 0, len(data)
    padded = data + bytes(MESSAGE.size)
    while start < end:
        opcode, length, channel, _, t_ns, _ = MESSAGE.unpack_from(padded, start)
        stop = start + HEAD.size + length
        if opcode == Opcode.MESSAGE:
            rows[channel].append((t_ns, start))
        else:
            definitions.append((opcode, data[start + HEAD.size : stop]))
        start = stop
    if start != end:
        raise ValueError("the last record of the chunk runs past its end")
    return rows, definitions


class IndexedCopy:
    """Takes records in their order. What it does not index, it writes as it came."""

    def __init__(self, out: BinaryIO, known: bytes = b"") -> None:
        """known: records of schemas and channels that a damaged chunk may have defined."""
        self.counts: Counter[int] = Counter()  # channel -> messages
        self._out = out
        self._at = 0
        self._crc = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._times: list[int] = []  # the first and the last of each chunk, or of each message alone
        self._has_header = False
        self._known_schemas: dict[int, Schema] = {}
        self._known_channels: dict[int, Channel] = {}
        for opcode, body in contents(known)[1]:
            self._define(opcode, body, self._known_schemas, self._known_channels)
        self._write(MAGIC)

    @property
    def first_ns(self) -> int:
        """Log time, 0 where there is no message."""
        return min(self._times, default=0)

    @property
    def last_ns(self) -> int:
        """Log time, 0 where there is no message."""
        return max(self._times, default=0)

    def record(self, opcode: int, body: bytes) -> None:
        """One that is no chunk. Raises OSError."""
        if opcode == Opcode.HEADER:
            if self._has_header:
                return
            self._has_header = True
        elif not self._has_header:
            self._built(Header("", "tilth"))
            self._has_header = True
        stream, length = ReadDataStream(io.BytesIO(body)), HEAD.size + len(body)
        if opcode == Opcode.METADATA:
            self._metadata.append(MetadataIndex(self._at, length, Metadata.read(stream).name))
        elif opcode == Opcode.ATTACHMENT:
            found = Attachment.read(stream)
            self._attachments.append(
                AttachmentIndex(
                    self._at, length, found.log_time, found.create_time, len(found.data), found.name,
                    found.media_type,
                )
            )  # fmt: skip
        elif opcode == Opcode.MESSAGE:
            message = Message.read(stream, len(body))
            self._define_missing([message.channel_id])
            self.counts[message.channel_id] += 1
            self._times.append(message.log_time)
        else:
            self._define(opcode, body, self._schemas, self._channels)
        self._write(HEAD.pack(opcode, len(body)) + body)

    def chunk(self, body: bytes, data: bytes) -> None:
        """body: of the chunk; data: what it holds unpacked. Raises OSError, ValueError."""
        rows, definitions = contents(data)
        for opcode, definition in definitions:
            self._define(opcode, definition, self._schemas, self._channels)
        self._define_missing(rows)
        compression, packed = packed_data(body)
        times = [t_ns for each in rows.values() for t_ns, _ in each] or [0]
        chunk = Chunk(compression, packed, max(times), min(times), zlib.crc32(data), len(data))
        at, length = self._at, self._built(chunk)
        offsets, begin = {}, self._at
        for channel, each in rows.items():
            offsets[channel] = self._at
            self.counts[channel] += len(each)
            self._built(MessageIndex(channel, each))
        if rows:
            self._times += [min(times), max(times)]
        self._chunks.append(
            ChunkIndex(
                chunk_start_offset=at,
                chunk_length=length,
                compression=compression,
                compressed_size=len(packed),
                uncompressed_size=len(data),
                message_start_time=min(times),
                message_end_time=max(times),
                message_index_offsets=offsets,
                message_index_length=self._at - begin,
            )
        )

    def finish(self) -> None:
        """The end of the data, the summary, the footer. Raises OSError."""
        if not self._has_header:
            self._built(Header("", "tilth"))
        self._built(DataEnd(self._crc))
        self._write(self._summary(self._at))
        self._write(MAGIC)

    def _write(self, data: bytes) -> None:
        self._out.write(data)
        self._at += len(data)
        self._crc = zlib.crc32(data, self._crc)

    def _built(self, record: McapRecord) -> int:
        builder = RecordBuilder()
        record.write(builder)
        data: bytes = builder.end()
        self._write(data)
        return len(data)

    @staticmethod
    def _define(opcode: int, body: bytes, schemas: dict[int, Schema], channels: dict[int, Channel]) -> None:
        stream = ReadDataStream(io.BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            channels[channel.id] = channel

    def _define_missing(self, used: Iterable[int]) -> None:
        """What a damaged chunk defined: as the index knew it, or else by a name that says what is known."""
        for id in used:
            if id in self._channels:
                continue
            channel = self._known_channels.get(id) or Channel(id, f"/unknown/{id}", "protobuf", {}, 0)
            schema = self._known_schemas.get(channel.schema_id)
            if channel.schema_id not in self._schemas and schema is not None:
                self._schemas[schema.id] = schema
                self._built(schema)
            if channel.schema_id not in self._schemas:
                channel.schema_id = 0
            self._channels[id] = channel
            self._built(channel)

    def _summary(self, start: int) -> bytes:
        builder = RecordBuilder()
        offsets = []
        groups: tuple[tuple[Opcode, list[McapRecord]], ...] = (
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, list(self._chunks)),
            (Opcode.ATTACHMENT_INDEX, list(self._attachments)),
            (Opcode.METADATA_INDEX, list(self._metadata)),
        )
        for opcode, records in groups:
            begin = builder.count
            for record in records:
                record.write(builder)
            if records:
                offsets.append(SummaryOffset(opcode, start + begin, builder.count - begin))
        offsets_start = start + builder.count
        for offset in offsets:
            offset.write(builder)
        data: bytes = builder.end()
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start)
        Footer(start, offsets_start, zlib.crc32(head, zlib.crc32(data))).write(builder)
        footer: bytes = builder.end()
        return data + footer

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self._chunks),
            message_count=self.counts.total(),
            metadata_count=len(self._metadata),
            message_start_time=self.first_ns,
            message_end_time=self.last_ns,
            schema_count=len(self._schemas),
        )
