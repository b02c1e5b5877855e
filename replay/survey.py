"""Reads and checks all files of a run."""

import errno
import io
from collections import Counter, defaultdict
from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata

from tilth.logger.log.lock import is_being_written
from tilth.logger.log.mcap_file import HEAD, HOLE, MAGIC, MESSAGE
from tilth.logger.log.mcap_log import CAN_TOPIC, ClockReason
from tilth.logger.log.mcap_records import McapRecords
from tilth.logger.log.recovery import is_ours
from tilth.logger.log.runs import file_name
from tilth.replay.readers.log import MOST_TOLD
from tilth.schemas.invocation import command
from tilth.schemas.proto import tilth_pb2 as pb

GNSS, WHEEL = "/gnss/", "/measurement/wheel_angle"
SHORTEST_S: Final = 0.5  # a gap; and longer than
SPACINGS: Final = 4.0  # times the usual spacing
DROPPED: Final = "dropped"  # frames of one bus, before they were read
NOT_RECORDED: Final = "not_recorded"  # frames, as in Status.faults
YOUNG_S: Final = 3.0  # a daemon's first status: what it counts was counted in this run


@dataclass(frozen=True, slots=True)
class Coverage:
    """A bus or a sensor in a run: frames or positions or angles; gaps at the run's begin and end included."""

    count: int
    per_s: float
    gaps: tuple[tuple[int, float], ...]  # t_ns and length in s, the longest first


class LoggedFault(NamedTuple):
    """Something that the daemon counted in the run: dropped frames of one bus, or a row of Status.faults."""

    reason: str
    bus: str = ""

    def __str__(self) -> str:
        return f"{self.reason} on {self.bus}" if self.bus else self.reason


@dataclass(slots=True)
class RunSurvey:
    """A run, or the part of it that was given."""

    run: str = ""
    note: str = ""
    machine: str = ""
    files: list[Path] = field(default_factory=list)
    parts: list[int] = field(default_factory=list)
    first_ns: int = 0  # of all that was logged
    last_ns: int = 0
    utc_minus_ns: int = 0  # what gives UTC, added to the log's times
    by_gnss: bool = False  # whether receivers have confirmed it
    coverage: dict[str, Coverage] = field(default_factory=dict)  # by topic
    faults: Counter[LoggedFault] = field(default_factory=Counter)
    steps_s: list[float] = field(default_factory=list)  # of the computer's clock
    backwards: int = 0  # times that ran back, from one record to the next
    events: list[pb.Event] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)  # with the files themselves, in words
    goes_on_in: str = ""  # the next file, where it is there and was not given
    being_written: bool = False  # by another program, now: read as far as it was on the disk

    @property
    def duration_s(self) -> float:
        """s, by the clock of the log, which never steps."""
        return (self.last_ns - self.first_ns) * 1e-9

    @property
    def good(self) -> bool:
        """Whether every frame received is in the log and can be read. A step of the clock does no harm."""
        lost_frames = any(fault.reason in (DROPPED, NOT_RECORDED) for fault in self.faults)
        return not (self.wrong or lost_frames or self.backwards)


@dataclass(slots=True)
class _Reading:
    """Collected while the files of a run are read."""

    times: defaultdict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    statuses: list[pb.Status] = field(default_factory=list)
    clocks: list[Mapping[str, str]] = field(default_factory=list)
    ended: str = ""  # why the last file did


def survey(paths: Iterable[Path]) -> list[RunSurvey]:
    """Read and check every byte; a RunSurvey of each run, in the order given. Raises OSError."""
    runs: dict[str, tuple[RunSurvey, _Reading]] = {}
    for path in paths:
        _read(path, runs)
    for one, reading in runs.values():
        _conclude(one, reading)
    return [one for one, _ in runs.values()]


def _read(path: Path, runs: dict[str, tuple[RunSurvey, _Reading]]) -> None:
    """A file, into the run that it is of."""
    metadata, clocks = dict[str, Mapping[str, str]](), list[Mapping[str, str]]()
    one, reading = None, _Reading()
    if path.exists() and not path.is_file() and not path.is_dir():  # a pipe would be waited for
        raise OSError(errno.EINVAL, "a pipe or a device", str(path))
    with path.open("rb") as file:
        being_written = is_being_written(file)
        records = _FileReading(file, path.stat().st_size, being_written)
        for topic, row in records:
            if isinstance(row, Metadata):
                metadata.setdefault(row.name, row.metadata)
                clocks += [row.metadata] if row.name == "clock" else []
                continue
            if one is None:  # who wrote it has said all before its first message
                one, reading = _run_of(runs, path, metadata)
            _take(one, reading, topic, *row)
    if one is None:
        one, reading = _run_of(runs, path, metadata)
    one.being_written |= being_written
    one.wrong += [f"{path.name}: {what}" for what in records.wrong]
    reading.clocks += clocks
    reading.ended = clocks[-1].get("why", "") if clocks else ""


_Row = Metadata | tuple[int, bytes]


class _FileReading:
    """Reads a file to its end; `wrong`, in sentences, is complete then."""

    def __init__(self, file: BinaryIO, size: int, being_written: bool) -> None:
        self.wrong: list[str] = []
        self._file, self._size, self._being_written = file, size, being_written

    def __iter__(self) -> Iterator[tuple[str, _Row]]:
        """("", metadata) and (topic, (t_ns, data))."""
        file, size = self._file, self._size
        if file.read(len(MAGIC)) != MAGIC:
            empty = is_ours(file, size)
            if not (empty and self._being_written):
                self.wrong.append("is empty: nothing of it reached the disk" if empty else "is no MCAP file")
            return
        if not is_ours(file, size):
            self.wrong.append("is no log of tilth")
            return
        every_byte = not self._being_written
        records = McapRecords(file, size, (Opcode.METADATA, Opcode.ATTACHMENT), every_byte=every_byte)
        topics: dict[int, str] = {}
        list(messages_in(records.definitions, topics))
        count = 0
        for place, data in records:
            if place.opcode == Opcode.METADATA:
                yield "", Metadata.read(ReadDataStream(io.BytesIO(data[HEAD.size :])))
            elif place.opcode not in (HOLE, Opcode.ATTACHMENT):
                for topic, row in messages_in(data, topics):
                    count += 1
                    yield topic, row
        self._tell(records, count)

    def _tell(self, records: McapRecords, count: int) -> None:
        if records.covered:
            self.wrong.append(f"bytes that cannot be read ({records.covered})")
        if records.cut and not self._being_written:
            how = "--out NEW.mcap` writes what can be read" if records.faults else "` finishes it"
            self.wrong.append(f"was left unfinished; `{command('recover')}{' ' * bool(records.faults)}{how}")
        faults = [str(fault) for fault in records.faults]
        self.wrong += faults[:MOST_TOLD]
        if len(faults) > MOST_TOLD:
            self.wrong.append(f"damaged at {len(faults) - MOST_TOLD} places more")
        told = records.told_messages
        if told is not None and told != count:
            self.wrong.append(f"{told:,} messages were recorded, {count:,} can be read")


def messages_in(
    data: bytes, topics: dict[int, str], wanted: Container[str] | None = None
) -> Iterator[tuple[str, tuple[int, bytes]]]:
    """(topic, (t_ns, data)) of the records of a chunk; `topics`, by channel, learns those it defines.
    wanted: other topics are passed over."""
    start, end = 0, len(data)
    data += bytes(MESSAGE.size)
    while start < end:
        opcode, length, channel, _, t_ns, _ = MESSAGE.unpack_from(data, start)
        stop = start + HEAD.size + length
        if opcode == Opcode.MESSAGE:
            topic = topics.get(channel, "")
            if wanted is None or topic in wanted:
                yield topic, (t_ns, data[start + MESSAGE.size : stop])
        elif opcode == Opcode.CHANNEL:
            definition = Channel.read(ReadDataStream(io.BytesIO(data[start + HEAD.size : stop])))
            topics[definition.id] = definition.topic
        start = stop


def _run_of(
    runs: dict[str, tuple[RunSurvey, _Reading]], path: Path, metadata: Mapping[str, Mapping[str, str]]
) -> tuple[RunSurvey, _Reading]:
    """The run that a file belongs to, and the file its next part."""
    run_metadata = metadata.get("run", {})
    one, reading = runs.setdefault(run_metadata.get("id", str(path)), (RunSurvey(), _Reading()))
    one.run, one.note = run_metadata.get("id", ""), run_metadata.get("note", "")
    one.machine = metadata.get("machine", {}).get("name", "")
    part = _number(run_metadata.get("part"))
    if one.parts and part > one.parts[-1] + 1:
        one.wrong.append(f"{path.name}: part {part} after part {one.parts[-1]}; what is between is missing")
    elif one.parts and part <= one.parts[-1]:
        one.wrong.append(f"{path.name}: part {part} after part {one.parts[-1]}; give each once and in order")
    elif not one.parts and part > 1:
        one.wrong.append(f"{path.name}: part {part} comes first; what was before it is not here")
    one.files.append(path)
    one.parts.append(part)
    return one, reading


def _take(one: RunSurvey, reading: _Reading, topic: str, t_ns: int, data: bytes) -> None:
    if t_ns < one.last_ns:
        one.backwards += 1
    one.first_ns = one.first_ns or t_ns
    one.last_ns = t_ns
    if topic.startswith((CAN_TOPIC, GNSS)) or topic == WHEEL:
        reading.times[topic].append(t_ns)
    elif topic == "/status":
        reading.statuses.append(pb.Status.FromString(data))
    elif topic == "/event":
        one.events.append(pb.Event.FromString(data))


def _conclude(one: RunSurvey, reading: _Reading) -> None:
    buses = [times for topic, times in reading.times.items() if topic.startswith(CAN_TOPIC)]
    first_ns = min((times[0] for times in buses), default=one.first_ns)
    last_ns = max((times[-1] for times in buses), default=one.last_ns)
    for topic, times in sorted(reading.times.items()):
        one.coverage[topic] = _coverage_of(np.array([first_ns, *times, last_ns]))
    if reading.statuses:
        for topic in (*(f"{GNSS}{receiver.mount}" for receiver in reading.statuses[0].receivers), WHEEL):
            one.coverage.setdefault(topic, Coverage(0, 0.0, ()))
        one.faults = _counted(reading.statuses[-1])
        if reading.statuses[0].uptime_s > YOUNG_S:
            one.faults -= _counted(reading.statuses[0])
    _clocks(one, reading.clocks)
    if reading.ended == ClockReason.ROTATION:
        _look_on(one)


def _look_on(one: RunSurvey) -> None:
    """For the part that follows the last one."""
    run, part = one.files[-1].name.rpartition("_")[0], one.parts[-1]
    following = one.files[-1].with_name(file_name(run, part + 1))
    if following.exists():  # it may have begun since the files to be read were named
        one.goes_on_in = following.name
    else:
        one.wrong.append(f"part {part} is not the last one; what comes after it is not here")


def _coverage_of(times: "np.ndarray[tuple[int], np.dtype[np.int64]]") -> Coverage:
    """times: with the run's first and last instant before and after them."""
    apart = np.diff(times) * 1e-9
    usual = float(np.median(apart[1:-1])) if apart.size > 2 else 0.0
    where = np.flatnonzero(apart > max(SHORTEST_S, SPACINGS * usual))
    gaps = sorted(((int(times[i]), float(apart[i])) for i in where), key=lambda gap: -gap[1])
    span_s = float(times[-1] - times[0]) * 1e-9
    count = times.size - 2
    return Coverage(count, count / span_s if span_s > 0 else 0.0, tuple(gaps))


def _counted(status: pb.Status) -> Counter[LoggedFault]:
    counts = Counter({LoggedFault(DROPPED, bus.name): bus.lost_frames for bus in status.buses})
    counts.update({LoggedFault(fault.reason): fault.count for fault in status.faults})
    return +counts


def _clocks(one: RunSurvey, clocks: list[Mapping[str, str]]) -> None:
    ahead = None
    for clock in clocks:
        before, ahead = ahead, _number(clock.get("realtime_ns")) - _number(clock.get("t_ns"))
        if clock.get("why") == ClockReason.STEP and before is not None:
            one.steps_s.append((ahead - before) * 1e-9)
    if clocks:
        one.utc_minus_ns = _number(clocks[-1].get("utc_minus_t_ns"))
        one.by_gnss = "gnss_utc_minus_t_ns" in clocks[-1]


def _number(text: str | None) -> int:
    """0 for a text that is no number: metadata have no checksum."""
    try:
        return int(text or "0")
    except ValueError:
        return 0
