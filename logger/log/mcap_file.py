"""The framing of MCAP files, walked as far as a file is whole: what replay, recovery and lists of logs share.

Not mcap.stream_reader.StreamReader: that takes a record that runs past the end of a cut file for a whole one
and reports cuts and zeros as four unlike errors.
"""

import io
import struct
from collections.abc import Container, Iterator
from dataclasses import dataclass
from typing import BinaryIO

from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, Statistics
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError

MAGIC: bytes = MCAP0_MAGIC
HEAD = struct.Struct("<BQ")  # opcode, length
MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel id, sequence, log_time, publish_time
FOOTER_SIZE = HEAD.size + 20
UNREADABLE = 0x80  # opcode: private, passed over by every reader; what `tilth recover` covers damage with
# What damaged bytes raise in the parsers of records and in the decompressors.
DAMAGE = (McapError, DecodeError, ZstdError, struct.error, ValueError, RuntimeError, OverflowError, OSError)
_SIGNATURE = b"\4\0\0\0zstd"  # of a chunk as it is written here
_SIGNATURE_AT = HEAD.size + 28  # in a chunk's record
_BLOCK = 1 << 20


@dataclass(frozen=True, slots=True)
class RecordPlace:
    """Where a record stands in its file, bytes; `start` is of its opcode, `body` of what it holds."""

    opcode: int
    start: int
    end: int

    @property
    def body(self) -> int:
        return self.start + HEAD.size


def place_at(file: BinaryIO, start: int, size: int) -> RecordPlace | None:
    """The record that begins at `start` of a file of that size; None where none does that is whole."""
    file.seek(start)
    head = file.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    opcode, length = HEAD.unpack(head)
    if opcode == 0 or length > size - start - HEAD.size:  # zeros after a power cut; a record cut short
        return None
    return RecordPlace(opcode, start, start + HEAD.size + length)


def walk(file: BinaryIO, size: int, start: int = len(MAGIC)) -> Iterator[RecordPlace]:
    """The whole records from `start` on, the footer the last. The file may be moved between two of them."""
    while (place := place_at(file, start, size)) is not None:
        yield place
        if place.opcode == Opcode.FOOTER:
            return
        start = place.end


def body_of(file: BinaryIO, place: RecordPlace) -> bytes:
    """The bytes of a record. Raises OSError."""
    file.seek(place.body)
    return file.read(place.end - place.body)


def next_chunk(file: BinaryIO, start: int, size: int) -> int:
    """Where after `start` the next whole chunk begins, its checksum verified, or the file's size: where to go
    on behind damage. Raises OSError."""
    file.seek(start)
    before = b""
    while block := file.read(_BLOCK):
        after, block_at = file.tell(), file.tell() - len(block) - len(before)
        block = before + block
        found = block.find(_SIGNATURE)
        while found >= 0:
            at = block_at + found - _SIGNATURE_AT
            if at >= start and _is_chunk(file, at, size):
                return at
            found = block.find(_SIGNATURE, found + 1)
        before = block[-len(_SIGNATURE) + 1 :]
        file.seek(after)
    return size


def _is_chunk(file: BinaryIO, start: int, size: int) -> bool:
    place = place_at(file, start, size)
    if place is None or place.opcode != Opcode.CHUNK:
        return False
    try:
        unpacked(body_of(file, place))
    except DAMAGE:
        return False
    return True


def is_finished(file: BinaryIO, size: int) -> bool:
    """Whether the file begins and ends as a whole one does."""
    if size < 2 * len(MAGIC) + FOOTER_SIZE:
        return False
    file.seek(0)
    head = file.read(len(MAGIC))
    file.seek(size - len(MAGIC) - FOOTER_SIZE)
    end = file.read()
    return head == end[FOOTER_SIZE:] == MAGIC and HEAD.unpack_from(end) == (Opcode.FOOTER, 20)


def summarised(
    file: BinaryIO, size: int, wanted: Container[int] = (Opcode.SCHEMA, Opcode.CHANNEL)
) -> Iterator[tuple[int, bytes]]:
    """(opcode, body) of the wanted records of the summary at the end of a whole file; none of another. mcap's
    own reader keeps the index of chunks too, kilobytes for each. Raises OSError."""
    if not is_finished(file, size):
        return
    file.seek(size - len(MAGIC) - FOOTER_SIZE + HEAD.size)
    start = int.from_bytes(file.read(8), "little")
    for place in walk(file, size, start) if len(MAGIC) <= start < size else ():
        if place.opcode in wanted:
            yield place.opcode, body_of(file, place)


def metadata_bodies(file: BinaryIO, size: int) -> Iterator[bytes]:
    """Of a whole file's metadata records by their index, of another's by reading through it. Raises
    OSError."""
    summary = list(summarised(file, size, (Opcode.STATISTICS, Opcode.METADATA_INDEX)))
    count = next((_statistics(body).metadata_count for code, body in summary if code == Opcode.STATISTICS), 0)
    starts = [int.from_bytes(body[:8], "little") for code, body in summary if code == Opcode.METADATA_INDEX]
    places = [place_at(file, start, size) for start in starts]
    if not count or len(places) != count or any(p is None or p.opcode != Opcode.METADATA for p in places):
        places = [place for place in walk(file, size) if place.opcode == Opcode.METADATA]
    for place in places:
        if place is not None:
            yield body_of(file, place)


def times_of(file: BinaryIO, size: int) -> tuple[int, int] | None:
    """(first, last) log time of a whole file's messages, ns; None of another. Raises OSError."""
    for _, body in summarised(file, size, (Opcode.STATISTICS,)):
        found = _statistics(body)
        return found.message_start_time, found.message_end_time
    return None


def _statistics(body: bytes) -> Statistics:
    found: Statistics = Statistics.read(ReadDataStream(io.BytesIO(body)))
    return found


def unpacked(body: bytes) -> bytes:
    """The records of a chunk, its checksum verified. Raises one of DAMAGE."""
    chunk = Chunk.read(ReadDataStream(io.BytesIO(body)))
    length_at = 32 + len(chunk.compression)
    if int.from_bytes(body[length_at : length_at + 8], "little") != len(body) - length_at - 8:
        raise ValueError("the chunk's own length is not that of its record")
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(length)
