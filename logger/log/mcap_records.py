"""What an MCAP file holds, in the order in which it was written, and what is wrong with it.

The order of the file, with one exception: chunks that its index (or, in a log of Tilth's that has none, their
times) shows in another place than that at which they were written are put back, each as a whole.
"""

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain, pairwise
from typing import BinaryIO, Final, NamedTuple

from mcap.opcode import Opcode

from tilth.logger.log.mcap_fault import FaultKind, LogFault
from tilth.logger.log.mcap_file import (
    DAMAGE,
    HEAD,
    HOLE,
    MAGIC,
    MESSAGE,
    UNREADABLE,
    RecordPlace,
    Walk,
    body_of,
    checksum,
    is_sound,
    names_tilth,
    unpacked,
)
from tilth.logger.log.mcap_summary import message_indexes

_REPLAY: Final = b"\x06\0\0\0replay"  # how metadata begin of a log whose times may run back: others' may
TILTH: Final = b"\x05\0\0\0tilth"  # the same, of a log of Tilth's
_NS: Final = 1e-9
_DEFINITIONS: Final = (Opcode.SCHEMA, Opcode.CHANNEL)
_INDEXES: Final = (Opcode.STATISTICS, Opcode.CHUNK_INDEX)


class _Entry(NamedTuple):
    """A row of the index of chunks."""

    start: int
    key: tuple[int, int, int, int]  # first and last time, length in the file, bytes unpacked


@dataclass(slots=True)
class _Summary:
    """What stands behind the data."""

    chunks: list[_Entry] = field(default_factory=list)
    definitions: list[bytes] = field(default_factory=list)
    statistics: bytes | None = None
    believed: bool = True  # as far as its checksum tells
    footers: int = 0


class McapRecords:
    """(place, records) of a file, in order: of a chunk what it holds unpacked, of any other record itself.

    A HOLE comes where messages are missing, with no records; what is wrong stands in `faults`, which is
    complete once all was read, and so is `cut`. Raises OSError.
    """

    def __init__(
        self, file: BinaryIO, size: int, others: Iterable[int] = (), *, every_byte: bool = False
    ) -> None:
        """others: opcodes of records that are wanted besides chunks, messages and definitions. every_byte:
        compare the checksum of all data too, which reads the file once more."""
        self.faults: list[LogFault] = []
        self.is_tilths = False  # by its header
        self.covered = 0  # bytes that an earlier recovery has kept without being able to read them
        self.lost: LogFault | None = None  # what the last HOLE has cost
        self._file, self._size, self._every_byte = file, size, every_byte
        self._walk = Walk(file, size, behind=None if every_byte else message_indexes(file, size))
        self._summary = _Summary()
        self._data_end: RecordPlace | None = None
        self._wanted = {Opcode.CHUNK, Opcode.MESSAGE, *_DEFINITIONS, HOLE, UNREADABLE, *others}
        self._kept_too = UNREADABLE in others
        self._behind: Iterator[RecordPlace] = iter(())
        self._may_run_back = self._has_header = False
        self._places = self._looked_through()
        self._chunked = not any(place.opcode == Opcode.MESSAGE for place in self._places[-1:])
        if self._chunked:
            self._end()
            self._restore_order()
            self._find_missing()

    @property
    def cut(self) -> bool:
        """Whether its end is missing."""
        return not self._walk.ended

    @property
    def damaged(self) -> bool:
        """Whether anything is wrong but what an earlier recovery has left out."""
        return any(fault.kind != FaultKind.LEFT_OUT for fault in self.faults)

    @property
    def closed(self) -> bool:
        """Whether a whole file's end is in it, whatever follows."""
        return self._walk.closed

    @property
    def tail(self) -> int:
        """Where at its end nothing is whole any more; its size where all is."""
        return self._walk.tail

    @property
    def ends_in_index(self) -> bool:
        """Whether all data stand before the end, or the cut."""
        return self._data_end is not None

    @property
    def definitions(self) -> bytes:
        """The records of its schemas and channels, by the index: a damaged first chunk defined them too."""
        return b"".join(self._summary.definitions)

    @property
    def told_messages(self) -> int | None:
        """How many its index tells of; None where there is none that can be believed."""
        body = self._summary.statistics
        if body is None or not self._summary.believed or self._walk.appended:
            return None
        return int.from_bytes(body[:8], "little")

    def __iter__(self) -> Iterator[tuple[RecordPlace, bytes]]:
        for number, place in enumerate(chain(self._places, self._behind)):
            if place.opcode == HOLE:
                fault = self._hole(place, number)
                self.faults.append(fault)
                if fault.costs:
                    self.lost = fault
                    yield place, b""
            elif place.opcode == UNREADABLE:
                yield from self._kept_unread(place, number)
            elif place.opcode == Opcode.CHUNK:
                yield self._chunk(place, number)
            elif place.opcode == Opcode.ATTACHMENT and self._is_changed(place):
                self.faults.append(LogFault(FaultKind.HOLE, place.start, place.end))
            else:
                yield place, HEAD.pack(place.opcode, place.end - place.body) + body_of(self._file, place)
        if not self._chunked:
            self._end()
        if self._every_byte and not self.damaged and not self._is_as_written():
            self.faults.append(LogFault(FaultKind.CHANGED, 0, self._size))
        self.faults.sort(key=lambda fault: fault.start)

    def _chunk(self, place: RecordPlace, number: int) -> tuple[RecordPlace, bytes]:
        """With what it holds unpacked, or a HOLE in its place."""
        try:
            return place, unpacked(body_of(self._file, place))
        except DAMAGE:
            self.lost = self._around(FaultKind.CHUNK, place, number)
            self.faults.append(self.lost)
            return RecordPlace(HOLE, place.start, place.end), b""

    def _kept_unread(self, place: RecordPlace, number: int) -> Iterator[tuple[RecordPlace, bytes]]:
        """What an earlier recovery could not read: a HOLE, if it was not the end of the file."""
        fault = self._around(FaultKind.LEFT_OUT, place, number)
        if fault.until_s is not None:
            self.faults.append(fault)
            self.lost = fault
            yield RecordPlace(HOLE, place.end, place.end), b""
        elif self._kept_too:
            yield place, HEAD.pack(place.opcode, place.end - place.body) + body_of(self._file, place)

    def _is_changed(self, attachment: RecordPlace) -> bool:
        crc = body_of(self._file, attachment)[-4:]
        return any(crc) and not is_sound(self._file, attachment)

    def _is_as_written(self) -> bool:
        """Whether the checksum of all data is right, where there is one."""
        place = self._data_end
        wanted = 0 if place is None else int.from_bytes(body_of(self._file, place), "little")
        if place is None or not wanted or self._walk.appended:
            return True
        return wanted == checksum(self._file, 0, place.start)

    def _looked_through(self) -> list[RecordPlace]:
        """The places of the records that are wanted, without reading them; of a file without chunks up to
        the first message."""
        found: list[RecordPlace] = []
        self._behind = self._wanted_ones()
        for place in self._behind:
            found.append(place)
            if place.opcode == Opcode.MESSAGE:
                break
        return found

    def _wanted_ones(self) -> Iterator[RecordPlace]:
        for place in self._walk:
            opcode = place.opcode
            if opcode == Opcode.CHUNK:
                if place.mended:
                    self.faults.append(LogFault(FaultKind.HEAD, place.start, place.body))
                self._data_end = None
            elif opcode == Opcode.MESSAGE_INDEX:
                continue
            elif opcode == HOLE and self._data_end is not None:
                self._summary.believed = False
                continue
            elif opcode == Opcode.HEADER:
                self.is_tilths = self.is_tilths or names_tilth(body_of(self._file, place))
                self._has_header = True
            elif opcode == Opcode.METADATA:
                body = body_of(self._file, place)
                self._may_run_back |= body.startswith(_REPLAY)
                self.is_tilths |= not self._has_header and body.startswith(TILTH)
            elif opcode == UNREADABLE:
                self.covered += place.end - place.body
            elif opcode == Opcode.DATA_END:
                self._data_end = place
            elif opcode == Opcode.FOOTER:
                self._take_footer(place)
            elif opcode in _INDEXES or (opcode in _DEFINITIONS and self._data_end is not None):
                self._take_summary(place)
                continue
            if opcode in self._wanted:
                yield place

    def _take_summary(self, place: RecordPlace) -> None:
        body = body_of(self._file, place)
        if place.opcode == Opcode.CHUNK_INDEX:
            first, last, start, length = struct.unpack_from("<QQQQ", body)
            base = self._walk.appended[-1] if self._walk.appended else 0
            size = int.from_bytes(body[-8:], "little")
            self._summary.chunks.append(_Entry(base + start, (first, last, length, size)))
        elif place.opcode == Opcode.STATISTICS:
            self._summary.statistics = body
        else:
            self._summary.definitions.append(HEAD.pack(place.opcode, len(body)) + body)

    def _take_footer(self, place: RecordPlace) -> None:
        body = body_of(self._file, place)
        start, _, crc = struct.unpack("<QQI", body)
        begin = self._data_end.end if self._data_end else start or place.start
        self._summary.footers += 1
        if crc and crc != checksum(self._file, begin, place.body + 16):
            self._summary.believed = False

    def _end(self) -> None:
        """The walk has come to the end of the file."""
        self.faults += [LogFault(FaultKind.APPENDED, at, at) for at in self._walk.appended]
        if self._summary.footers and not self._summary.believed:
            at = self._size if self._data_end is None else self._data_end.end
            self.faults.append(LogFault(FaultKind.INDEX, at, at))

    # Order

    def _restore_order(self) -> None:
        self._leave_out_doubles()
        chunks = [place for place in self._places if place.opcode == Opcode.CHUNK]
        starts = [place.times[0] for place in chunks if not place.mended]
        if all(a <= b for a, b in pairwise(starts)):
            return
        ranks = self._ranks()
        if ranks:
            order = _filled([ranks.get(place.start) for place in chunks])
        elif self.is_tilths and not self._may_run_back and not (self._walk.ended and self._summary.believed):
            order = _filled([self._first_ns(place) for place in chunks])
        else:
            return
        if all(a <= b for a, b in pairwise(order)):
            return
        in_order = [chunks[k] for k in sorted(range(len(chunks)), key=order.__getitem__)]
        self.faults += [
            LogFault(FaultKind.MOVED, now.start, now.end)
            for now, one in zip(chunks, in_order, strict=True)
            if now is not one
        ]
        following = iter(in_order)
        self._places = [next(following) if place.opcode == Opcode.CHUNK else place for place in self._places]

    def _first_ns(self, place: RecordPlace) -> int | None:
        """Log time of a chunk's first message; None where it is damaged. Its head has no checksum."""
        try:
            data = unpacked(body_of(self._file, place)) + bytes(MESSAGE.size)
        except DAMAGE:
            return None
        at = 0
        while at < len(data) - MESSAGE.size:
            opcode, length, _, _, t_ns, _ = MESSAGE.unpack_from(data, at)
            if opcode == Opcode.MESSAGE:
                return int(t_ns)
            at += HEAD.size + length
        return None

    def _leave_out_doubles(self) -> None:
        kept: dict[tuple[bytes, int], RecordPlace] = {}
        places: list[RecordPlace] = []
        for place in self._places:
            first = kept.setdefault((place.head, place.end - place.start), place)
            if place.opcode != Opcode.CHUNK or first is place or not self._same(first, place):
                places.append(place)
            else:
                self.faults.append(LogFault(FaultKind.DOUBLED, place.start, place.end))
        self._places = places

    def _same(self, one: RecordPlace, other: RecordPlace) -> bool:
        return body_of(self._file, one) == body_of(self._file, other)

    def _ranks(self) -> dict[int, int]:
        """Start of each chunk that the index names -> its place among all that were written."""
        entries = self._summary.chunks if self._summary.believed else []
        by_key = {entry.key: rank for rank, entry in reversed(list(enumerate(entries)))}
        by_start = {entry.start: rank for rank, entry in enumerate(entries)}
        found = {}
        for place in self._places:
            if place.opcode == Opcode.CHUNK:
                rank = by_key.get(_key(place), by_start.get(place.start))
                if rank is not None:
                    found[place.start] = rank
        return found

    # What is missing

    def _find_missing(self) -> None:
        """Chunks that the index names and that are not there: a HOLE each where they stood, and no other."""
        entries, ranks = self._summary.chunks, self._ranks()
        if not entries or not self._summary.believed:
            return
        there = {entries[rank].key for rank in ranks.values()}  # a file that is appended to itself has two
        missing = [rank for rank, entry in enumerate(entries) if entry.key not in there]
        if not ranks and any(place.opcode == Opcode.CHUNK for place in self._places):
            self.faults.append(LogFault(FaultKind.INDEX, self.tail, self.tail))  # of another file
            return
        if not missing:
            if not self.faults and any(entries[rank].start != start for start, rank in ranks.items()):
                self.faults.append(LogFault(FaultKind.INDEX, self.tail, self.tail))
            self._places = [_free(place) if place.opcode == HOLE else place for place in self._places]
            return
        self._places = _with_holes(self._places, ranks, missing)

    def _hole(self, place: RecordPlace, number: int) -> LogFault:
        if place.mended:  # no message is missing there
            return LogFault(FaultKind.HOLE, place.start, place.end)
        return self._around(FaultKind.HOLE, place, number)

    def _around(self, kind: FaultKind, place: RecordPlace, number: int) -> LogFault:
        """A fault that costs messages, and what was before and behind it."""
        before = next((p for p in reversed(self._places[:number]) if p.opcode == Opcode.CHUNK), None)
        behind = next((p for p in self._places[number + 1 :] if p.opcode == Opcode.CHUNK), None)
        first = next((p for p in self._places if p.opcode == Opcode.CHUNK), None)
        first_ns = first.times[0] if first else 0
        return LogFault(
            kind, place.start, place.end, True,
            None if before is None else (before.times[1] - first_ns) * _NS,
            None if behind is None else (behind.times[0] - first_ns) * _NS,
            0 if before is None else before.times[1],
        )  # fmt: skip


def _free(place: RecordPlace) -> RecordPlace:
    """A HOLE of which it is known that no message was in it."""
    return RecordPlace(HOLE, place.start, place.end, mended=True)


def _with_holes(places: list[RecordPlace], ranks: dict[int, int], missing: list[int]) -> list[RecordPlace]:
    """A HOLE where chunks are missing, and others marked as free of messages. missing: ranks, sorted."""
    found: list[RecordPlace] = []
    waiting: list[RecordPlace] = []  # of holes and other records since the last chunk
    last, end = -1, len(MAGIC)
    left = list(missing)

    def close(rank: int) -> None:
        lost = any(last < one < rank for one in left)
        holes = [place for place in waiting if place.opcode == HOLE]
        found.extend(place if lost or place.opcode != HOLE else _free(place) for place in waiting)
        if lost and not holes:
            found.append(RecordPlace(HOLE, end, end))
        waiting.clear()

    for place in places:
        if place.opcode != Opcode.CHUNK:
            waiting.append(place)
            continue
        rank = ranks.get(place.start, last)
        close(rank)
        found.append(place)
        last, end = max(last, rank), place.end
    close(1 << 62)
    return found


def _filled(ranks: list[int | None]) -> list[int]:
    """Those without a rank stay behind the one before them."""
    found: list[int] = []
    for rank in ranks:
        found.append(rank if rank is not None else found[-1] if found else -1)
    return found


def _key(place: RecordPlace) -> tuple[int, int, int, int]:
    first, last, size = struct.unpack_from("<QQQ", place.head)
    return first, last, place.end - place.start, size
