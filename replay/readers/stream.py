"""The bytes of a log as a stream: unpacked, and without the zero bytes that a power cut leaves behind."""

import contextlib
import io
import re
import zlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, BinaryIO, Final

from tilth.replay.readers.log import OpenLog

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

PACKED: Final = b"\x1f\x8b"  # how gzip begins
CHUNK: Final = 16 * 1024
BUFFER: Final = 64 * 1024
TAIL: Final = 64  # zeros that are too many for the end of any record
_MEMBER: Final = b"\x1f\x8b\x08"  # how each member begins: gzip, deflated
_BROKEN: Final = b"\0\n"  # ends a line of text, which is not read then
_GZIP: Final = 31  # zlib's number for: gzip, with its header
_ZEROS: Final = re.compile(rb"\0+")


def unpacked(log: OpenLog) -> BinaryIO:
    """What gzip has packed, as far as it is there; log.truncated says that its end is missing."""
    return _stream(_members(log))


def without_zeros(log: OpenLog, stream: BinaryIO) -> BinaryIO:
    """A text's bytes: zero bytes at the end are a cut, others make an unreadable line of where they are."""
    return _stream(_text(log, stream))


def written(log: OpenLog) -> int:
    """How many bytes a power cut has left of what was not packed: a long run of zeros at its end is none."""
    end = log.size
    while end:
        start = max(0, end - BUFFER)
        log.file.seek(start)
        block = log.file.read(end - start).rstrip(b"\0")
        end = start + len(block)
        if block:
            break
    log.file.seek(0)
    return end if log.size - end >= TAIL else log.size


def before_zeros(log: OpenLog) -> BinaryIO:
    """A binary log's bytes up to the zeros at its end; log.truncated says that there are such."""
    end = written(log)
    return log.file if end == log.size else _stream(_limited(log, end))


class _PieceReader(io.RawIOBase):
    """Pieces of bytes, none of them empty, as a file."""

    def __init__(self, chunks: Iterator[bytes]) -> None:
        self._chunks = chunks
        self._unread = b""

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: "WriteableBuffer", /) -> int:
        view = memoryview(buffer)
        self._unread = self._unread or next(self._chunks, b"")
        count = min(len(view), len(self._unread))
        view[:count] = self._unread[:count]
        self._unread = self._unread[count:]
        return count


def _stream(chunks: Iterator[bytes]) -> BinaryIO:
    return io.BufferedReader(_PieceReader(chunks), BUFFER)


def _members(log: OpenLog) -> Iterator[bytes]:
    """gzip files may follow one another, and zeros may follow the last."""
    member = zlib.decompressobj(_GZIP)
    while piece := log.file.read(CHUNK):
        while piece:
            if member.eof:
                piece = piece.lstrip(b"\0")
                if not piece:
                    break
                member = zlib.decompressobj(_GZIP)
            before = member.copy()
            try:
                found = member.decompress(piece)
            except zlib.error:
                yield from _up_to_damage(before, piece)
                log.skip("damaged_gzip")
                piece = _next_member(log, piece[1:])
                if not piece:
                    log.truncated = True
                    return
                member = zlib.decompressobj(_GZIP)
                yield _BROKEN
                continue
            if found:
                yield found
            piece = member.unused_data
    if not member.eof:
        log.truncated = True


def _next_member(log: OpenLog, rest: bytes) -> bytes:
    """What is read from the beginning of the next member on that can be unpacked; b"" where there is none.
    rest: what was read behind the damage."""
    while True:
        at = rest.find(_MEMBER)
        if at >= 0 and len(rest) - at < CHUNK and (more := log.file.read(CHUNK)):
            rest += more
        elif at >= 0:
            with contextlib.suppress(zlib.error):
                zlib.decompressobj(_GZIP).decompress(rest[at : at + CHUNK])
                return rest[at:]
            rest = rest[at + 1 :]
        else:
            rest = rest[-len(_MEMBER) + 1 :] if rest else b""
            more = log.file.read(CHUNK)
            if not more:
                return b""
            rest += more


def _up_to_damage(member: "zlib._Decompress", piece: bytes) -> Iterator[bytes]:
    for at in range(len(piece)):
        try:
            found = member.decompress(piece[at : at + 1])
        except zlib.error:
            return
        if found:
            yield found


def _limited(log: OpenLog, remaining: int) -> Iterator[bytes]:
    while remaining and (piece := log.file.read(min(remaining, BUFFER))):
        remaining -= len(piece)
        yield piece
    log.truncated = True


def _text(log: OpenLog, stream: BinaryIO) -> Iterator[bytes]:
    zeros = False  # came last
    while chunk := stream.read(BUFFER):
        body = chunk.rstrip(b"\0")
        if not body:
            zeros = True
            continue
        if zeros:
            body = b"\0" + body
        zeros = chunk[-1] == 0
        yield _ZEROS.sub(b"\0\n", body)
    if zeros:
        log.truncated = True
