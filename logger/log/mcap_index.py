"""Builds the index at the end of an MCAP file from its content, where the writer could not."""

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from tilth.logger.log.mcap_file import MAGIC


@dataclass(slots=True)
class Content:
    """What is in a file, as far as its index tells it."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)  # channel -> messages
    metadata: list[MetadataIndex] = field(default_factory=list)
    # chunk's start -> its index, of chunks whose index is not whole in the file
    unindexed: dict[int, list[MessageIndex]] = field(default_factory=dict)
    bad: list[tuple[int, int]] = field(default_factory=list)  # start and end of what is no record
    covered: int = 0  # bytes found under private records, of an earlier recovery
    end: int = 0  # of the last whole record
    header: bool = False
    utc_minus_ns: int = 0  # by the last record of the clocks: what gives UTC, added to log times


def ending(content: Content, end: int) -> Iterator[bytes]:
    """All that follows the data: missing indexes, the end of data, the summary, the footer."""
    builder = RecordBuilder()
    if end == 0:
        yield MAGIC
        end = len(MAGIC)
    if not content.header:
        Header("", "tilth").write(builder)
    for chunk in content.chunks:
        missing = content.unindexed.get(chunk.chunk_start_offset)
        if missing is None:
            continue
        begin = builder.count
        chunk.message_index_offsets.clear()
        for index in missing:
            chunk.message_index_offsets[index.channel_id] = end + builder.count
            index.write(builder)
        chunk.message_index_length = builder.count - begin
    DataEnd(0).write(builder)
    data = builder.end()
    yield data
    yield _summary(content, end + len(data))
    yield MAGIC


def _summary(content: Content, start: int) -> bytes:
    builder = RecordBuilder()
    offsets = []
    groups: tuple[tuple[Opcode, list[McapRecord]], ...] = (
        (Opcode.SCHEMA, list(content.schemas.values())),
        (Opcode.CHANNEL, list(content.channels.values())),
        (Opcode.STATISTICS, [_statistics(content)]),
        (Opcode.CHUNK_INDEX, list(content.chunks)),
        (Opcode.METADATA_INDEX, list(content.metadata)),
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


def _statistics(content: Content) -> Statistics:
    times = [t for chunk in content.chunks for t in (chunk.message_start_time, chunk.message_end_time)]
    return Statistics(
        attachment_count=0,
        channel_count=len(content.channels),
        channel_message_counts=dict(content.counts),
        chunk_count=len(content.chunks),
        message_count=content.counts.total(),
        metadata_count=len(content.metadata),
        message_start_time=min(times, default=0),
        message_end_time=max(times, default=0),
        schema_count=len(content.schemas),
    )
