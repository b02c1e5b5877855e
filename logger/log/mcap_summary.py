"""The summary at the end of a whole MCAP file: what is told of it without reading it."""

import io
import struct
from collections.abc import Container, Iterator
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Statistics

from tilth.logger.log.mcap_file import (
    FOOTER_SIZE,
    HEAD,
    MAGIC,
    RecordPlace,
    body_of,
    checksum,
    fits_text,
    is_finished,
    walk,
)


def summarised(
    file: BinaryIO, size: int, wanted: Container[int] = (Opcode.SCHEMA, Opcode.CHANNEL)
) -> Iterator[tuple[int, bytes]]:
    """(opcode, body) of the wanted records of the summary at the end of a whole file; none of another, nor
    where its checksum is wrong. mcap's own reader keeps the index of chunks too, kilobytes for each. Raises
    OSError."""
    if not is_finished(file, size):
        return
    footer = size - len(MAGIC) - FOOTER_SIZE + HEAD.size
    file.seek(footer)
    start, _, crc = struct.unpack("<QQI", file.read(20))
    if not len(MAGIC) <= start < size or (crc and crc != checksum(file, start, footer + 16)):
        return
    for place in walk(file, size, start):
        if place.opcode in wanted:
            yield place.opcode, body_of(file, place)


def metadata_bodies(file: BinaryIO, size: int) -> Iterator[bytes]:
    """Of a whole file's metadata records by their index, of another's by reading through it. Raises
    OSError."""
    summary = list(summarised(file, size, (Opcode.STATISTICS, Opcode.METADATA_INDEX)))
    count = next((_statistics(body).metadata_count for code, body in summary if code == Opcode.STATISTICS), 0)
    rows = [struct.unpack_from("<QQ", body) for code, body in summary if code == Opcode.METADATA_INDEX]
    indexed = [RecordPlace(Opcode.METADATA, start, start + length) for start, length in rows]
    places = [place for place in indexed if place.end <= size and fits_text(file, place)]
    if not count or len(places) != count:
        places = [place for place in walk(file, size) if place.opcode == Opcode.METADATA]
    for place in places:
        yield body_of(file, place)


def times_of(file: BinaryIO, size: int) -> tuple[int, int] | None:
    """(first, last) log time of a whole file's messages, ns; None of another. Raises OSError."""
    for _, body in summarised(file, size, (Opcode.STATISTICS,)):
        found = _statistics(body)
        return found.message_start_time, found.message_end_time
    return None


def message_indexes(file: BinaryIO, size: int) -> dict[int, int]:
    """Where those of each chunk begin and end, of a whole file; {} of another. Raises OSError."""
    found = {}
    for _, body in summarised(file, size, (Opcode.CHUNK_INDEX,)):
        start, length, offsets = struct.unpack_from("<QQI", body, 16)
        found[start + length] = start + length + int.from_bytes(body[36 + offsets : 44 + offsets], "little")
    return found


def topics_of(file: BinaryIO, size: int) -> dict[int, str]:
    """Channel -> topic, of a whole file; {} of another. Raises OSError."""
    found: dict[int, str] = {}
    for _, body in summarised(file, size, (Opcode.CHANNEL,)):
        channel = Channel.read(ReadDataStream(io.BytesIO(body)))
        found[channel.id] = channel.topic
    return found


def _statistics(body: bytes) -> Statistics:
    found: Statistics = Statistics.read(ReadDataStream(io.BytesIO(body)))
    return found
