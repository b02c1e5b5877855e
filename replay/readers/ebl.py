"""Actisense's EBL: what a gateway has sent, with the computer's time in between.

Two layers. Of the file: ESC SOH <tag> … ESC LF holds a mark, all else is the gateway's stream; a byte ESC of
either is written twice. Of the stream: DLE STX <message> DLE ETX, a byte DLE of the message written twice.
A message is its kind, its length, its bytes and a checksum that makes their sum 0; a mark may hold one too.

    kind   what            stamps
    0x93   a message       t_ns: the mark before it; rx_ns: the gateway's own milliseconds on that clock
    0xD0   a message       the same
    0x95   a CAN frame     both: the mark before it; the gateway's counter wraps too soon

0x94, what the gateway was given to send, has no source; it and all other kinds are counted.
"""

import struct
from collections.abc import Iterator
from typing import BinaryIO, Final

from tilth.logger.can.adapter_clock import AdapterClock
from tilth.replay.readers.log import ForeignLog, OpenLog, stamp_fault
from tilth.schemas import can_id
from tilth.schemas.flow import Frame

MAGIC: Final = b"\x1b\x01"
BUS: Final = "can0"

_ESC, _SOH, _LF = 0x1B, 0x01, 0x0A
_DLE, _STX, _ETX = 0x10, 0x02, 0x03
_VERSION, _TIME, _MESSAGE = 0x01, 0x03, 0x07  # tags
_KNOWN: Final = 1002  # the newest version of the file, in thousandths
_FILETIME_1970: Final = 116_444_736_000_000_000  # 100 ns since 1601
_MOST: Final = 4096  # bytes of a mark or a message; more is damage
_CHUNK: Final = 64 * 1024

Piece = tuple[int | None, bytes]
"""A tag and what it holds, or None and bytes of the gateway's stream."""


def ebl(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """Frames and assembled messages, stamped as in the table above."""
    clock = AdapterClock()
    framed = _Messages(log)
    t_ns = 0
    for tag, content in _pieces(log, stream):
        messages: Iterator[bytes] = iter(())
        if tag is None:
            messages = framed.feed(content)
        elif tag == _TIME and len(content) == 8:
            t_ns = (int.from_bytes(content, "little") - _FILETIME_1970) * 100
        elif tag == _MESSAGE:
            messages = iter([content])
        elif tag == _VERSION:
            _check_version(log, int.from_bytes(content, "little"))
        for message in messages:
            found = _frame(message, tag == _MESSAGE, t_ns, clock)
            if isinstance(found, Frame):
                yield found
            else:
                log.skip(found)
    log.truncated = log.truncated or framed.open


def _check_version(log: OpenLog, version: int) -> None:
    if version > _KNOWN:
        raise ForeignLog(
            f"{log.path}: EBL of version {version / 1000:.3f}; up to {_KNOWN / 1000:.3f} is known here"
        )


def _pieces(log: OpenLog, stream: BinaryIO) -> Iterator[Piece]:
    """Marks and pieces of the stream in their order, without their escapes."""
    mark: bytearray | None = None
    escaped = False  # the last byte was an ESC that is still to be understood
    last = 0
    while chunk := stream.read(_CHUNK):
        last = chunk[-1]
        for number, part in enumerate(chunk.split(bytes([_ESC]))):
            if number:  # an ESC is before this part
                if escaped:  # the second of two
                    escaped = False
                    part = bytes([_ESC]) + part
                else:
                    escaped = True
            if escaped and part:
                escaped = False
                code, part = part[0], part[1:]
                if code == _LF and mark:
                    yield mark[0], bytes(mark[1:])
                elif mark is not None:
                    log.skip("damaged_mark")
                mark = bytearray() if code == _SOH else None
            if mark is None and part:
                yield None, part
            elif mark is not None and len(mark) <= _MOST:
                mark += part
    log.truncated = log.truncated or mark is not None or escaped or last == 0


class _Messages:
    """Takes the gateway's stream, gives its messages."""

    def __init__(self, log: OpenLog) -> None:
        self._log = log
        self._message: bytearray | None = None
        self._escaped = False

    @property
    def open(self) -> bool:
        """Whether a message has begun and not ended."""
        return self._message is not None

    def feed(self, stream: bytes) -> Iterator[bytes]:
        for number, part in enumerate(stream.split(bytes([_DLE]))):
            if number:
                if self._escaped:
                    self._escaped = False
                    part = bytes([_DLE]) + part
                else:
                    self._escaped = True
            if self._escaped and part:
                self._escaped = False
                code, part = part[0], part[1:]
                if code == _ETX and self._message is not None:
                    yield bytes(self._message)
                elif self._message is not None:
                    self._log.skip("damaged_message")
                self._message = bytearray() if code == _STX else None
            if self._message is not None:
                self._message += part
                if len(self._message) > _MOST:
                    self._log.skip("damaged_message")
                    self._message = None


def _frame(message: bytes, bare: bool, t_ns: int, clock: AdapterClock) -> Frame | str:
    """The frame of a message, or why it is none; `bare` ones may come without their checksum."""
    kind = message[0] if message else 0
    typed = 0xD0 <= kind <= 0xDF  # their length has two bytes and counts all but the checksum
    length = int.from_bytes(message[1:3], "little") if typed else 2 + int.from_bytes(message[1:2], "little")
    summed = len(message) == length + 1 and sum(message) % 256 == 0
    if not (summed or (bare and len(message) == length)):
        return "damaged_message"
    found: tuple[int, int, bytes] | None = None
    if kind == 0x93 and length >= 13 and message[12] == length - 13:
        found = _of_93(message[2:length])
    elif kind == 0xD0 and length >= 13:
        found = _of_d0(message[3:length])
    elif kind == 0x95 and 8 <= length <= 16:
        identifier = int.from_bytes(message[4:8], "little") & 0x1FFFFFFF
        found = identifier, 0, message[8:length]
    if found is None:
        return "gateway_message"
    identifier, stamp_ms, data = found
    fault = stamp_fault(t_ns)
    if fault:
        return fault
    rx_ns = clock.rx_ns(stamp_ms * 1_000_000, t_ns) if stamp_ms else t_ns
    return Frame(t_ns, max(rx_ns, 0), BUS, identifier, True, False, data)


def _of_93(body: bytes) -> tuple[int, int, bytes] | None:
    priority, low, high, page, destination, source, stamp_ms, _ = struct.unpack_from("<6BIB", body)
    pgn = low | high << 8 | page << 16
    if pgn > 0x3FFFF:
        return None
    return can_id.join(priority, pgn, source, destination), stamp_ms, body[11:]


def _of_d0(body: bytes) -> tuple[int, int, bytes]:
    destination, source, specific, pdu_format, page_and_priority, _, stamp_ms = struct.unpack_from(
        "<6BI", body
    )
    pgn = (page_and_priority & 3) << 16 | pdu_format << 8 | specific
    return can_id.join(page_and_priority >> 2, pgn, source, destination), stamp_ms, body[10:]
