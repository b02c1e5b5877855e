"""Finishes, in place, log files that a power cut, a crash or a full disk has left unfinished.

Nothing that was written is taken away: the index is appended after the last whole record, and bytes in which
no record is whole stay where they are, under a record of a private kind (opcode 128) that every reader of
MCAP passes over. Only the nine bytes of its head and zeros at the end of the file are written over. A cut
while a file is being finished leaves one that can be finished again.
"""

import contextlib
import io
import os
import struct
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    Header,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
)

from tilth.logger.log.lock import grows, is_being_written, lock
from tilth.logger.log.mcap_file import (
    DAMAGE,
    HEAD,
    MAGIC,
    MESSAGE,
    UNREADABLE,
    RecordPlace,
    body_of,
    is_finished,
    next_chunk,
    place_at,
    unpacked,
    walk,
)
from tilth.logger.log.mcap_index import Content, ending

_CHUNK_HEAD = struct.Struct("<QQQII4sQ")  # start, end, size, crc, 4, "zstd", length
_BLOCK = 1 << 20
_LONGEST_HEADER = 1 << 16


class NoLog(Exception):
    """The file cannot be finished: it is none of ours, or another program is writing it."""


@dataclass(frozen=True, slots=True)
class Finished:
    """What a file was like and what there is in it."""

    path: Path
    was_whole: bool
    messages: int
    first_ns: int  # log_time of the first and the last message; 0 where there is none
    last_ns: int
    utc_minus_ns: int  # what gives UTC, added to them, as far as it was known when the file ended
    unreadable_bytes: int  # still in the file, in records that readers pass over


def finish(path: Path) -> Finished:
    """Finish a file where it is not whole. Raises NoLog, and OSError where it cannot be read or written."""
    with path.open("r+b") as file:
        try:
            written = not lock(file.fileno()) and grows(file)
        except BlockingIOError:
            written = True
        if written:
            raise NoLog(f"{path}: is being recorded; it is whole when that run has ended")
        size = file.seek(0, io.SEEK_END)
        whole = is_finished(file, size)
        content = _survey(path, file, size)
        if content.chunks and not content.header:
            raise NoLog(f"{path}: is no log of tilth; finish it with what wrote it")
        if not whole or content.bad:
            _complete(file, size, content)
        times = [t for chunk in content.chunks for t in (chunk.message_start_time, chunk.message_end_time)]
        return Finished(
            path=path,
            was_whole=whole,
            messages=content.counts.total(),
            first_ns=min(times, default=0),
            last_ns=max(times, default=0),
            utc_minus_ns=content.utc_minus_ns,
            unreadable_bytes=content.covered + sum(end - start for start, end in content.bad),
        )


def unfinished(folder: Path) -> list[Path]:
    """Logs of tilth in the folder that want finishing and are not being written, oldest name first."""
    found: list[Path] = []
    if not folder.is_dir():
        return found
    for path in sorted(folder.glob("*.mcap")):
        try:
            if not path.is_file():  # a pipe of that name would be waited for
                continue
            with path.open("rb") as file:
                size = file.seek(0, io.SEEK_END)
                if not is_finished(file, size) and not is_being_written(file) and is_ours(file, size):
                    found.append(path)
        except OSError:  # it will be found again
            continue
    return found


def finish_all(
    folder: Path, report: Callable[[str, str], None], ours: Callable[[], Sequence[Path]] = tuple
) -> None:
    """Finish what earlier runs could not. report: takes kind and text of an event for each file. ours: what
    this program writes itself."""
    for path in unfinished(folder):
        if path in ours():
            continue
        try:
            done = finish(path)
        except FileNotFoundError:  # deleted meanwhile to make room
            continue
        except Exception as error:  # whatever lies there, those after it are finished
            report("log", f"{path.name} was left unfinished and stays so: {error}")
        else:
            report("log", f"{path.name} was left unfinished; finished now: {done.messages} messages")


def is_ours(file: BinaryIO, size: int) -> bool:
    """Whether tilth began to write it; a file of which nothing reached the disk may be."""
    file.seek(0)
    head = file.read(_LONGEST_HEADER)
    if not head.strip(b"\0"):
        return True
    place = place_at(file, len(MAGIC), size) if head.startswith(MAGIC) else None
    if place is None:  # cut within its first record
        return MAGIC.startswith(head[: len(MAGIC)].rstrip(b"\0"))
    return place.opcode == Opcode.HEADER and b"tilth" in head[place.body : place.end]


def _survey(path: Path, file: BinaryIO, size: int) -> Content:
    """Read the whole file, every checksum verified. Raises NoLog."""
    content = Content(end=len(MAGIC))
    file.seek(0)
    head = file.read(len(MAGIC))
    if head != MAGIC:
        begun = head.rstrip(b"\0")
        if MAGIC.startswith(begun) and _is_zero(file, len(begun), size):
            content.end = 0
            return content
        raise NoLog(f"{path}: is no MCAP file")
    at = content.end
    while at < size:
        place = place_at(file, at, size)
        if place is not None and _ends_data(file, place, size):
            break
        if place is None or not _take(content, file, place):
            start, at = at, next_chunk(file, at + 1, size)
            if place is not None and place.end < at and place_at(file, place.end, size):
                at = place.end  # damaged, but it ends where another record begins
            if at < size:
                content.bad.append((start, at))
            continue
        content.end = at = place.end
    _complete_definitions(content, file, at, size)
    return content


def _ends_data(file: BinaryIO, place: RecordPlace, size: int) -> bool:
    """Whether what follows is the index, whole or not, which is written anew."""
    ends = (place.opcode, place.end - place.body) == (Opcode.DATA_END, 4)
    return ends and next_chunk(file, place.end, size) == size


def _take(content: Content, file: BinaryIO, place: RecordPlace) -> bool:
    """Note what a record tells; False where it is damaged."""
    if place.opcode == UNREADABLE:
        content.covered += place.end - place.start
        return True
    body = body_of(file, place)
    stream = ReadDataStream(io.BytesIO(body))
    try:
        match place.opcode:
            case Opcode.HEADER:
                content.header = "tilth" in Header.read(stream).library
            case Opcode.CHUNK:
                _chunk(content, place, body)
            case Opcode.MESSAGE_INDEX:
                _message_index(content, place, MessageIndex.read(stream))
            case Opcode.METADATA:
                metadata = Metadata.read(stream)
                if metadata.name == "clock":
                    content.utc_minus_ns = int(metadata.metadata.get("utc_minus_t_ns", "0"))
                content.metadata.append(MetadataIndex(place.start, place.end - place.start, metadata.name))
            case Opcode.SCHEMA | Opcode.CHANNEL:
                _define(content, place.opcode, body)
            case _:
                return False
    except DAMAGE:
        return False
    return True


def _chunk(content: Content, place: RecordPlace, body: bytes) -> None:
    index: dict[int, list[tuple[int, int]]] = defaultdict(list)
    definitions = []
    data = unpacked(body)
    start, end = 0, len(data)
    padded = data + bytes(MESSAGE.size)
    while start < end:
        opcode, length, channel, _, t_ns, _ = MESSAGE.unpack_from(padded, start)
        stop = start + HEAD.size + length
        if opcode == Opcode.MESSAGE:
            index[channel].append((t_ns, start))
        else:
            definitions.append((opcode, data[start + HEAD.size : stop]))
        start = stop
    if start != end:
        raise ValueError("the last record of the chunk runs past its end")
    for opcode, definition in definitions:
        _define(content, opcode, definition)
    for channel, rows in index.items():
        content.counts[channel] += len(rows)
    times = [t_ns for rows in index.values() for t_ns, _ in rows]
    _, _, size, _, _, compression, compressed = _CHUNK_HEAD.unpack_from(body)
    content.chunks.append(
        ChunkIndex(
            chunk_start_offset=place.start,
            chunk_length=place.end - place.start,
            compression=compression.decode(),
            compressed_size=compressed,
            uncompressed_size=size,
            message_start_time=min(times, default=0),
            message_end_time=max(times, default=0),
            message_index_offsets={},
            message_index_length=0,
        )
    )
    content.unindexed[place.start] = [MessageIndex(channel, rows) for channel, rows in index.items()]


def _define(content: Content, opcode: int, body: bytes) -> None:
    stream = ReadDataStream(io.BytesIO(body))
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        content.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        content.channels[channel.id] = channel


def _message_index(content: Content, place: RecordPlace, index: MessageIndex) -> None:
    """Believed where it is that of the chunk before it, message for message."""
    if not content.chunks:
        raise ValueError("an index before the first chunk")
    chunk = content.chunks[-1]
    rows = content.unindexed.get(chunk.chunk_start_offset, ())
    if index not in rows:
        raise ValueError("not the index of the chunk before it")
    chunk.message_index_offsets[index.channel_id] = place.start
    chunk.message_index_length += place.end - place.start
    if len(rows) == len(chunk.message_index_offsets):
        del content.unindexed[chunk.chunk_start_offset]


def _complete_definitions(content: Content, file: BinaryIO, start: int, size: int) -> None:
    """What a damaged chunk defined: from the index at the end, or else a name that says what is known."""
    for place in walk(file, size, start):
        if place.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            with contextlib.suppress(*DAMAGE):
                _define(content, place.opcode, body_of(file, place))
    for id in content.counts:
        content.channels.setdefault(id, Channel(id, f"/unknown/{id}", "protobuf", {}, 0))
    for channel in content.channels.values():
        if channel.schema_id and channel.schema_id not in content.schemas:
            channel.schema_id = 0


def _is_zero(file: BinaryIO, start: int, end: int) -> bool:
    file.seek(start)
    while start < end and (block := file.read(min(_BLOCK, end - start))):
        if block.strip(b"\0"):
            return False
        start += len(block)
    return True


def _complete(file: BinaryIO, size: int, content: Content) -> None:
    """Make the file a whole one."""
    for start, end in content.bad:
        if end - start < HEAD.size:
            raise NoLog(f"{file.name}: is damaged in a way that cannot be mended in place, at byte {start}")
        _cover(file, start, end)
    end = content.end
    place = place_at(file, end, size) if end else None
    is_index = place is not None and _ends_data(file, place, size)
    if end and not is_index and size - end >= HEAD.size and not _is_zero(file, end, size):
        _cover(file, end, size)
        content.bad.append((end, size))
        end = size
    # From here on the file is only appended to: what a cut in the middle of this leaves begins a new tail.
    file.truncate(end)
    file.seek(end)
    try:
        file.write(b"".join(ending(content, end)))
        file.flush()
    except OSError:  # no room: a file without an index is finished another time, half an index is clutter
        file.truncate(end)
        raise
    os.fsync(file.fileno())


def _cover(file: BinaryIO, start: int, end: int) -> None:
    file.seek(start)
    file.write(HEAD.pack(UNREADABLE, end - start - HEAD.size))
