"""Summarises a log file without reading all of it: from its index, or else from the heads of its records."""

import math
import struct
from collections import Counter, defaultdict
from collections.abc import Container, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum, auto
from pathlib import Path
from typing import BinaryIO

from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import McapReader, make_reader
from mcap.records import Metadata

from tilth.logger.log.lock import is_being_written
from tilth.logger.log.mcap_file import DAMAGE, RecordPlace, body_of, is_finished, unpacked, walk
from tilth.logger.log.mcap_log import CAN_TOPIC
from tilth.logger.log.mcap_summary import times_of
from tilth.logger.log.recovery import is_ours
from tilth.replay.simulated import mark_of
from tilth.replay.survey import messages_in
from tilth.schemas.proto import tilth_pb2 as pb

LAST = ("/pose", "/soil_tire")  # whose last message is told
_INDEX = struct.Struct("<HI")  # of a message index: channel, bytes of its entries, of which each has
_ENTRY = 16
_WITHIN = tuple(kind for kind in DAMAGE if kind is not OSError)


class FileState(Enum):
    WHOLE = auto()
    BEING_WRITTEN = auto()  # by another program, now
    UNFINISHED = auto()
    DAMAGED = auto()  # its index cannot be used
    NO_LOG = auto()  # not one of tilth's


@dataclass(slots=True)
class Glance:
    """Summary of one log file. Times are log times, ns; 0 where there is no message."""

    state: FileState
    first_ns: int = 0
    last_ns: int = 0
    frames: int = 0
    sensors: dict[str, str] = field(default_factory=dict)  # name -> its state at the last frame
    events: Counter[str] = field(default_factory=Counter)  # by kind
    utc_minus_ns: int = 0
    note: str = ""
    simulated: bool = False
    machine: str = ""  # its name
    run: str = ""  # its id and start: the logs of `tilth replay` share an id
    part: str = ""  # of the run
    pose: pb.Pose | None = None  # the last
    estimate: pb.SoilTireEstimate | None = None  # the last that was recommended


def glance(path: Path) -> Glance:
    """Raises OSError where it cannot be read."""
    with path.open("rb") as file:
        size = path.stat().st_size
        if not is_finished(file, size):
            if not is_ours(file, size):
                return Glance(FileState.NO_LOG)
            found = Glance(FileState.BEING_WRITTEN if is_being_written(file) else FileState.UNFINISHED)
            return _by_heads(file, size, found)
        if not is_ours(file, size):
            return Glance(FileState.NO_LOG)
        try:
            if times_of(file, size) is not None:
                file.seek(0)
                return _by_index(make_reader(file, validate_crcs=True))
        except (*DAMAGE, LookupError):
            pass  # its index cannot be used, or what it names is damaged
        return _by_heads(file, size, Glance(FileState.DAMAGED))


def brief(path: Path) -> Glance:
    """State and times alone, of a whole log of gigabytes in milliseconds. Raises OSError."""
    with path.open("rb") as file:
        try:
            size = path.stat().st_size
            times = times_of(file, size)
            if times is None or not is_ours(file, size):
                return glance(path)
        except DAMAGE:
            return glance(path)
    return Glance(FileState.WHOLE, *times)


def _by_index(reader: McapReader) -> Glance:
    """Raises one of DAMAGE."""
    found = Glance(FileState.WHOLE)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise ValueError("no index")
    counts = summary.statistics.channel_message_counts
    buses = [channel.topic for channel in summary.channels.values() if channel.topic.startswith(CAN_TOPIC)]
    found.frames = sum(
        counts.get(id, 0) for id, channel in summary.channels.items() if channel.topic in buses
    )
    found.first_ns = summary.statistics.message_start_time
    found.last_ns = summary.statistics.message_end_time
    last = next(reader.iter_messages(buses, reverse=True), None) if buses else None
    until_ns = last[2].log_time + 1 if last else None
    status = next(reader.iter_messages(["/status"], ending_before=until_ns, reverse=True), None)
    if status:
        found.sensors = _sensors(status[2].data)
    for topic in LAST:
        row = next(reader.iter_messages([topic], reverse=True), None)
        if row is not None:
            _take_last(found, topic, row[2].data)
    found.events = _kinds(row.data for _, _, row in reader.iter_messages(["/event"]))
    for record in reader.iter_metadata():
        _metadata(found, record)
    return found


def _sensors(data: bytes) -> dict[str, str]:
    status = pb.Status.FromString(data)
    sensors = {receiver.mount.replace("_", " "): receiver.state for receiver in status.receivers}
    return sensors | {"wheel angle": status.wheel_angle.state}


def _kinds(events: Iterable[bytes]) -> Counter[str]:
    return Counter(pb.Event.FromString(data).kind for data in events)


def _take_last(found: Glance, topic: str, data: bytes) -> None:
    if topic == "/pose":
        found.pose = pb.Pose.FromString(data)
    else:
        found.estimate = pb.SoilTireEstimate.FromString(data)


def _metadata(found: Glance, record: Metadata) -> None:
    found.simulated |= bool(mark_of({record.name: record.metadata}))
    if record.name == "clock":
        found.utc_minus_ns = int(record.metadata.get("utc_minus_t_ns", "0"))
    elif record.name == "run":
        found.note = record.metadata.get("note", "")
        found.part = record.metadata.get("part", "")
        found.run = " ".join(record.metadata.get(key, "") for key in ("id", "started_utc")).strip()
    elif record.name == "machine":
        found.machine = record.metadata.get("name", "")


@dataclass(slots=True)
class _ChunkPlaces:
    """The chunks of a file without index, and which of them hold what."""

    file: BinaryIO
    places: list[RecordPlace] = field(default_factory=list)
    counts: defaultdict[int, Counter[int]] = field(default_factory=lambda: defaultdict(Counter))
    topics: dict[int, str] = field(default_factory=dict)  # of the channels met so far

    def messages(self, number: int, wanted: Container[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        """(topic, t_ns, data) of a chunk; of a damaged one as far as it can be read. Raises OSError."""
        with suppress(*_WITHIN):
            data = unpacked(body_of(self.file, self.places[number]))
            for topic, (t_ns, payload) in messages_in(data, self.topics):
                if wanted is None or topic in wanted:
                    yield topic, t_ns, payload

    def holding(self, topics: Container[str]) -> list[int]:
        return [n for n, row in self.counts.items() if any(self.topics.get(id, "") in topics for id in row)]


def _by_heads(file: BinaryIO, size: int, found: Glance) -> Glance:
    """As far as the file is whole; damaged chunks are passed over: `tilth verify` reports them."""
    chunks = _ChunkPlaces(file)
    times: list[int] = []
    for place in walk(file, size):
        _take(chunks, place, found, times)
    found.first_ns, found.last_ns = min(times, default=0), max(times, default=0)
    with suppress(DecodeError):
        _look_into(chunks, found)
    return found


def _take(chunks: _ChunkPlaces, place: RecordPlace, found: Glance, times: list[int]) -> None:
    file = chunks.file
    if place.opcode == Opcode.CHUNK:
        file.seek(place.body)
        head = file.read(16)
        times += [t for at in (0, 8) if (t := int.from_bytes(head[at : at + 8], "little"))]
        chunks.places.append(place)
    elif place.opcode == Opcode.MESSAGE_INDEX:
        file.seek(place.body)
        channel, size = _INDEX.unpack(file.read(_INDEX.size))
        chunks.counts[len(chunks.places) - 1][channel] = size // _ENTRY
    elif place.opcode == Opcode.METADATA:
        file.seek(place.body)
        _metadata(found, Metadata.read(ReadDataStream(file)))


def _look_into(chunks: _ChunkPlaces, found: Glance) -> None:
    """Open the few chunks that define channels or hold what is wanted of them."""
    for number, row in chunks.counts.items():
        if any(id not in chunks.topics for id in row):
            for _ in chunks.messages(number):
                pass
    buses = {topic for topic in chunks.topics.values() if topic.startswith(CAN_TOPIC)}
    found.frames = sum(
        n for row in chunks.counts.values() for id, n in row.items() if chunks.topics.get(id) in buses
    )
    for number in chunks.holding({"/event"}):
        found.events += _kinds(data for _, _, data in chunks.messages(number, {"/event"}))
    for topic in LAST:
        if (last := _last(chunks, topic)) is not None:
            _take_last(found, topic, last)
    with_frames = chunks.holding(buses)[-1:]
    until_ns = max((t for number in with_frames for _, t, _ in chunks.messages(number, buses)), default=0)
    if (status := _last(chunks, "/status", until_ns)) is not None:
        found.sensors = _sensors(status)


def _last(chunks: _ChunkPlaces, topic: str, until_ns: float = math.inf) -> bytes | None:
    """The last message of a topic until then."""
    for number in reversed(chunks.holding({topic})):
        if rows := [data for _, t_ns, data in chunks.messages(number, {topic}) if t_ns <= until_ns]:
            return rows[-1]
    return None
