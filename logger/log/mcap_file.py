"""Walks the records of an MCAP file whatever has become of it: under all that reads such files.

Not mcap.stream_reader.StreamReader: that takes a record that runs past the end of a cut file for a whole one,
and gives up everything behind a fault. Here a fault costs what it lies in: what follows is found by the next
record that is whole, a chunk also by the length within it. mcap_records.py puts them in order;
mcap_summary.py reads what stands at the end of a whole file.
"""

import io
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO, Final

from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError

MAGIC: bytes = MCAP0_MAGIC
HEAD = struct.Struct("<BQ")  # opcode, length
MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel id, sequence, log_time, publish_time
FOOTER_SIZE = HEAD.size + 20
UNREADABLE = 0x80  # opcode: private, passed over by every reader; what a recovery keeps of a cut record
HOLE: Final = 0  # opcode of a place in which no record is whole; no record has it
# What damaged bytes raise in the parsers of records and in the decompressors.
DAMAGE = (
    McapError, DecodeError, ZstdError, struct.error, ValueError, RuntimeError, OverflowError, MemoryError,
    OSError,
)  # fmt: skip

_SEEN: Final = 64  # bytes of a record that tell whether it may be one: all of a chunk but its messages
_CHUNK_HEAD: Final = struct.Struct("<QQQII")  # start and end ns, size, CRC, length of the compression's name
_CHUNK_LEAST: Final = _CHUNK_HEAD.size + 8
_COMPRESSIONS: Final = (b"", b"zstd", b"lz4")
_BLOCK: Final = 1 << 20
_LONGEST_TEXT: Final = 1 << 28  # bytes of metadata or of a definition; more is damage
# Where a record may begin: an opcode of the format, a length below 4 GB.
_MAY_BEGIN: Final = re.compile(rb"(?=[\x01-\x0f][\s\S]{4}\0{4})")
_PARSED: Final[dict[Opcode, Any]] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
}
_FIXED: Final = {Opcode.FOOTER: 20, Opcode.DATA_END: 4, Opcode.SUMMARY_OFFSET: 17}
_MESSAGES_IN_A_ROW: Final = 4  # of top level, which have no structure, tell that they are some


@dataclass(frozen=True, slots=True)
class RecordPlace:
    """Where a record stands in its file, bytes; `start` is of its opcode, `body` of what it holds."""

    opcode: int
    start: int
    end: int
    head: bytes = b""  # of a chunk: times, size, CRC
    mended: bool = False  # its own head is damaged, its content is whole

    @property
    def body(self) -> int:
        return self.start + HEAD.size

    @property
    def times(self) -> tuple[int, int]:
        """(first, last) log time of a chunk as its head says, ns."""
        first, last = struct.unpack_from("<QQ", self.head)
        return first, last


def place_at(file: BinaryIO, start: int, size: int) -> RecordPlace | None:
    """The record that begins at `start` of a file of that size; None where what stands there is none that is
    whole, as far as that is told without its content. Raises OSError."""
    file.seek(start)
    seen = file.read(_SEEN)
    if len(seen) < HEAD.size:
        return None
    opcode, length = HEAD.unpack_from(seen)
    if opcode == HOLE or length > size - start - HEAD.size:  # zeros after a power cut; a record cut short
        return None
    place = RecordPlace(opcode, start, start + HEAD.size + length, seen[9:37] if opcode == 6 else b"")
    return place if _fits(file, place, seen[HEAD.size :]) else None


def _fits(file: BinaryIO, place: RecordPlace, seen: bytes) -> bool:
    """Whether the lengths within a record are those that its own length leaves room for."""
    length = place.end - place.body
    match place.opcode:
        case Opcode.MESSAGE_INDEX:
            rows = int.from_bytes(seen[2:6], "little")
            return rows == length - 6 and rows % 16 == 0
        case Opcode.CHUNK:
            return length >= _CHUNK_LEAST and _data_at(seen) is not None and _chunk_length(seen) == length
        case Opcode.MESSAGE:
            return length >= MESSAGE.size - HEAD.size
        case Opcode.FOOTER | Opcode.DATA_END | Opcode.SUMMARY_OFFSET:
            return length == _FIXED[Opcode(place.opcode)]
        case Opcode.HEADER | Opcode.SCHEMA | Opcode.CHANNEL | Opcode.METADATA:
            return fits_text(file, place)
        case Opcode.STATISTICS:
            return length >= 46 and int.from_bytes(seen[42:46], "little") == length - 46
        case Opcode.METADATA_INDEX:
            return length >= 20 and int.from_bytes(seen[16:20], "little") == length - 20
        case Opcode.CHUNK_INDEX:
            return length >= 64 and int.from_bytes(seen[32:36], "little") <= length - 64
        case Opcode.ATTACHMENT:
            return length >= 36 and int.from_bytes(seen[16:20], "little") <= length - 36
        case _:
            return True


def fits_text(file: BinaryIO, place: RecordPlace) -> bool:
    """Whether metadata, a definition or the header of a file can be parsed to its end. Raises OSError."""
    if place.end - place.body > _LONGEST_TEXT:
        return False
    body = body_of(file, place)
    stream = ReadDataStream(io.BytesIO(body))
    try:
        _PARSED[Opcode(place.opcode)].read(stream)
    except DAMAGE:
        return False
    return stream.count == len(body)


def _data_at(body: bytes) -> int | None:
    """Where in a chunk's body its messages begin; None where no compression is named that there is."""
    named = int.from_bytes(body[28:32], "little")
    return 40 + named if named <= 4 and body[32 : 32 + named] in _COMPRESSIONS else None


def _chunk_length(body: bytes) -> int:
    """Of a chunk's body, by the length within it."""
    at = _data_at(body)
    return -1 if at is None else at + int.from_bytes(body[at - 8 : at], "little")


def body_of(file: BinaryIO, place: RecordPlace) -> bytes:
    """The bytes of a record. Raises OSError."""
    file.seek(place.body)
    return file.read(place.end - place.body)


def packed_data(body: bytes) -> tuple[str, bytes]:
    """(compression, compressed records) of a chunk. Raises ValueError where it is of no known kind."""
    at = _data_at(body)
    if at is None:
        raise ValueError("not compressed in a way that is known here")
    return body[32 : at - 8].decode(), body[at:]


def unpacked(body: bytes) -> bytes:
    """The records of a chunk, its checksum verified. Raises one of DAMAGE."""
    compression, data = packed_data(body)
    _, _, size, crc, _ = _CHUNK_HEAD.unpack_from(body)
    if not crc and _chunk_length(body) != len(body):
        raise ValueError("the chunk's own length is not that of its record")
    chunk = Chunk(compression, data, 0, 0, crc, size)
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    data = stream.read(length)
    if not crc:
        _require_records(data, size)
    return data


def _require_records(data: bytes, size: int) -> None:
    """Whether these are `size` bytes of whole records, where no checksum tells. Raises ValueError."""
    start, end = 0, len(data)
    while start + HEAD.size <= end:
        opcode, length = HEAD.unpack_from(data, start)
        if opcode == HOLE or (opcode == Opcode.MESSAGE and length < MESSAGE.size - HEAD.size):
            break
        start += HEAD.size + length
    if start != end or end != size:
        raise ValueError("no whole records, or not as many as there were")


def is_sound(file: BinaryIO, place: RecordPlace) -> bool:
    """Whether a checksum of its own tells that a record is what was written. Raises OSError."""
    body = body_of(file, place)
    if place.opcode == Opcode.ATTACHMENT:
        crc = int.from_bytes(body[-4:], "little")
        return crc != 0 and crc == zlib.crc32(body[:-4])
    if place.opcode != Opcode.CHUNK:
        return False
    try:
        unpacked(body)
    except DAMAGE:
        return False
    return True


def next_record(file: BinaryIO, start: int, size: int) -> int:
    """Where from `start` on the next record begins that is whole, or the file's size: where to go on behind
    damage. Raises OSError."""
    while start < size:
        file.seek(start)
        block = file.read(_BLOCK + HEAD.size)
        for found in _MAY_BEGIN.finditer(block):
            if found.start() >= _BLOCK:
                break
            if _begins(file, start + found.start(), size):
                return start + found.start()
        start += _BLOCK
    return size


def _begins(file: BinaryIO, at: int, size: int) -> bool:
    """Whether a record is there: by its checksum, or by what follows it."""
    place = place_at(file, at, size)
    if place is not None and place.opcode == Opcode.CHUNK:
        return is_sound(file, place)
    for _ in range(_MESSAGES_IN_A_ROW):
        if place is None:
            return False
        if place.end == size or is_magic(file, place.end):
            return True
        following = place_at(file, place.end, size)
        if following is not None and place.opcode != Opcode.MESSAGE:
            return True
        place = following
    return place is not None


def checksum(file: BinaryIO, start: int, end: int) -> int:
    """CRC-32 of these bytes. Raises OSError."""
    file.seek(start)
    crc, left = 0, end - start
    while left > 0 and (block := file.read(min(_BLOCK, left))):
        crc = zlib.crc32(block, crc)
        left -= len(block)
    return crc


def names_tilth(header: bytes) -> bool:
    """Whether the body of a file's header names this software. Without a checksum one letter may be wrong."""
    library = Header.read(ReadDataStream(io.BytesIO(header))).library
    return sum(map(str.__eq__, library, "tilth")) >= 4


def is_magic(file: BinaryIO, at: int) -> bool:
    """Whether the bytes there are those that a file begins and ends with. Raises OSError."""
    file.seek(at)
    return file.read(len(MAGIC)) == MAGIC


def mended(file: BinaryIO, start: int, size: int) -> RecordPlace | None:
    """The chunk that begins at `start` with a damaged opcode or length, by its content; None where there is
    none. Raises OSError."""
    file.seek(start)
    seen = file.read(_SEEN)
    if len(seen) < _SEEN or not int.from_bytes(seen[33:37], "little"):  # no checksum
        return None
    _, length = HEAD.unpack_from(seen)
    for its in (_chunk_length(seen[HEAD.size :]), length):
        end = start + HEAD.size + its
        if its >= _CHUNK_LEAST and end <= size:
            place = RecordPlace(Opcode.CHUNK, start, end, seen[9:37], mended=True)
            if is_sound(file, place):
                return place
    return None


def is_finished(file: BinaryIO, size: int) -> bool:
    """Whether the file begins and ends as a whole one does. Raises OSError."""
    if size < 2 * len(MAGIC) + FOOTER_SIZE:
        return False
    file.seek(0)
    head = file.read(len(MAGIC))
    file.seek(size - len(MAGIC) - FOOTER_SIZE)
    end = file.read()
    return head == end[FOOTER_SIZE:] == MAGIC and HEAD.unpack_from(end) == (Opcode.FOOTER, 20)


def walk(file: BinaryIO, size: int, start: int = len(MAGIC)) -> Iterator[RecordPlace]:
    """The whole records from `start` on. The file may be moved between two of them. Raises OSError."""
    return (place for place in Walk(file, size, start) if place.opcode != HOLE)


class Walk:
    """The records of a file in its order, and HOLE where none is whole but one follows.

    Complete once it was iterated: `ended`, whether the file ends as a whole one does; `tail`, where at its
    end no record is whole any more; `closed`, whether an end was met at all; `appended`, where in it another
    file begins.
    The file may be moved between two records. Raises OSError.
    """

    def __init__(
        self, file: BinaryIO, size: int, start: int = len(MAGIC), behind: Mapping[int, int] | None = None
    ) -> None:
        """behind: end of a chunk -> where what indexes its messages ends, which is passed over then."""
        self._behind = behind or {}
        self._file, self._size, self._start = file, size, start
        self.ended = self.closed = False
        self.tail = size
        self.appended: list[int] = []

    def __iter__(self) -> Iterator[RecordPlace]:
        file, size, at = self._file, self._size, self._start
        here = place_at(file, at, size)
        while at < size:
            if here is None:
                if is_magic(file, at):
                    self.appended.append(at)
                    at += len(MAGIC)
                    here = place_at(file, at, size)
                    continue
                here = mended(file, at, size)
                if here is None:
                    until = next_record(file, at + 1, size)
                    if until == size:
                        self.tail = at
                        return
                    yield RecordPlace(HOLE, at, until)
                    at = until
                    here = place_at(file, at, size)
                    continue
            elif here.opcode > Opcode.DATA_END and here.opcode != UNREADABLE:
                here = mended(file, at, size) or here
            if here.opcode == Opcode.FOOTER and is_magic(file, here.end):
                yield here
                at = here.end + len(MAGIC)
                self.ended, self.closed = at == size, True
                here = place_at(file, at, size)
                continue
            after = self._behind.get(here.end, here.end)
            following = place_at(file, after, size)
            if following is None and after > here.end:
                after, following = here.end, place_at(file, here.end, size)
            if following is None and not here.mended and (until := self._wrong_until(here)):
                if until == size:
                    self.tail = at
                    return
                yield RecordPlace(HOLE, at, until)
                at = until
                here = place_at(file, at, size)
                continue
            yield here
            at, here = after, following

    def _wrong_until(self, place: RecordPlace) -> int:
        """Where the next record begins, if this one, with none behind it, is not what was written; else 0."""
        file, size = self._file, self._size
        if place.opcode != Opcode.CHUNK and place.end == size:
            return 0
        if is_magic(file, place.end) or is_sound(file, place) or mended(file, place.end, size):
            return 0
        until = next_record(file, place.start + 1, size)
        return until if until < place.end or place.opcode == Opcode.CHUNK else 0
