"""What is in a run's files: read whole and checked (`survey`), or at a glance by their index (`glance`)."""

import io
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Metadata

from tilth.logger.mcap_file import DAMAGE, HEAD, MAGIC, MESSAGE, body_of, is_finished, place_at, unpacked
from tilth.logger.mcap_log import CAN_TOPIC
from tilth.logger.recovery import UNREADABLE
from tilth.schemas.invocation import command
from tilth.schemas.proto import tilth_pb2 as pb

GNSS, WHEEL = "/gnss/", "/measurement/wheel_angle"
SHORTEST_S: Final = 0.5  # a gap; and longer than
SPACINGS: Final = 4.0  # times the usual spacing
YOUNG_S: Final = 3.0  # a daemon's first status: what it counts was counted in this run


@dataclass(frozen=True, slots=True)
class Heard:
    """A bus or a sensor in a run: frames or positions or angles; gaps at the run's begin and end included."""

    count: int
    per_s: float
    gaps: tuple[tuple[int, float], ...]  # t_ns and length in s, the longest first


@dataclass(slots=True)
class Survey:
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
    heard: dict[str, Heard] = field(default_factory=dict)  # by topic
    faults: Counter[str] = field(
        default_factory=Counter
    )  # dropped frames by bus, and what the daemon counted
    steps_s: list[float] = field(default_factory=list)  # of the computer's clock
    backwards: int = 0  # times that ran back, from one record to the next
    events: list[pb.Event] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)  # with the files themselves, in words

    @property
    def good(self) -> bool:
        """Whether all that was received is in it and can be read."""
        return not (self.wrong or self.faults or self.backwards)


@dataclass(slots=True)
class _Reading:
    """What is collected on the way."""

    times: defaultdict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    statuses: list[pb.Status] = field(default_factory=list)
    clocks: list[Mapping[str, str]] = field(default_factory=list)


def survey(paths: Iterable[Path]) -> list[Survey]:
    """Every byte read and checked; a Survey of each run, in the order given. Raises OSError."""
    runs: dict[str, tuple[Survey, _Reading]] = {}
    for path in paths:
        metadata, clocks, damage = dict[str, Mapping[str, str]](), list[Mapping[str, str]](), Counter[str]()
        one, reading = None, _Reading()
        with path.open("rb") as file:
            for topic, row in _records(file, path.stat().st_size, damage):
                if isinstance(row, Metadata):
                    metadata.setdefault(row.name, row.metadata)
                    clocks += [row.metadata] if row.name == "clock" else []
                    continue
                if one is None:  # who wrote it has said all before its first message
                    one, reading = _run_of(runs, path, metadata)
                _take(one, reading, topic, *row)
        if one is None:
            one, reading = _run_of(runs, path, metadata)
        recover = command("recover")
        one.wrong += [
            f"{path.name}: {_DAMAGE[what].format(count, recover=recover)}"
            for what, count in sorted(damage.items())
        ]
        reading.clocks += clocks
    for one, reading in runs.values():
        _conclude(one, reading)
    return [one for one, _ in runs.values()]


_DAMAGE = {
    "cut": "was left unfinished; `{recover}` finishes it",
    "chunk": "chunks that cannot be read ({})",
    "bytes": "bytes that cannot be read ({})",
    "mcap": "is no MCAP file",
}

_Row = Metadata | tuple[int, bytes]


def _records(file: BinaryIO, size: int, damage: Counter[str]) -> Iterator[tuple[str, _Row]]:
    """("", metadata) and (topic, (t_ns, data)) of a whole file."""
    topics: dict[int, str] = {}
    if file.read(len(MAGIC)) != MAGIC:
        damage["mcap"] += 1
        return
    if not is_finished(file, size):
        damage["cut"] += 1
    at = len(MAGIC)
    while (place := place_at(file, at, size)) is not None and place.opcode != Opcode.DATA_END:
        at = place.end
        if place.opcode == UNREADABLE:
            damage["bytes"] += place.end - place.body
        elif place.opcode == Opcode.METADATA:
            with suppress(*DAMAGE):
                yield "", Metadata.read(ReadDataStream(io.BytesIO(body_of(file, place))))
        elif place.opcode == Opcode.CHUNK:
            try:
                data = unpacked(body_of(file, place))
            except DAMAGE:
                damage["chunk"] += 1
            else:
                yield from _messages(data, topics)


def _messages(data: bytes, topics: dict[int, str]) -> Iterator[tuple[str, _Row]]:
    start, end = 0, len(data)
    data += bytes(MESSAGE.size)
    while start < end:
        opcode, length, channel, _, t_ns, _ = MESSAGE.unpack_from(data, start)
        stop = start + HEAD.size + length
        if opcode == Opcode.MESSAGE:
            yield topics.get(channel, ""), (t_ns, data[start + MESSAGE.size : stop])
        elif opcode == Opcode.CHANNEL:
            told = Channel.read(ReadDataStream(io.BytesIO(data[start + HEAD.size : stop])))
            topics[told.id] = told.topic
        start = stop


def _run_of(
    runs: dict[str, tuple[Survey, _Reading]], path: Path, metadata: Mapping[str, Mapping[str, str]]
) -> tuple[Survey, _Reading]:
    """The run that a file belongs to, and the file its next part."""
    told = metadata.get("run", {})
    one, reading = runs.setdefault(told.get("id", str(path)), (Survey(), _Reading()))
    one.run, one.note = told.get("id", ""), told.get("note", "")
    one.machine = metadata.get("machine", {}).get("name", "")
    part = int(told.get("part", "0"))
    if one.parts and part != one.parts[-1] + 1:
        one.wrong.append(f"{path.name}: part {part} after part {one.parts[-1]}; what is between is missing")
    elif not one.parts and part > 1:
        one.wrong.append(f"{path.name}: part {part} comes first; what was before it is not here")
    one.files.append(path)
    one.parts.append(part)
    return one, reading


def _take(one: Survey, reading: _Reading, topic: str, t_ns: int, data: bytes) -> None:
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


def _conclude(one: Survey, reading: _Reading) -> None:
    buses = [times for topic, times in reading.times.items() if topic.startswith(CAN_TOPIC)]
    first_ns = min((times[0] for times in buses), default=one.first_ns)
    last_ns = max((times[-1] for times in buses), default=one.last_ns)
    for topic, times in sorted(reading.times.items()):
        one.heard[topic] = _heard(np.array([first_ns, *times, last_ns]))
    for status in reading.statuses[:1]:
        for mount in (receiver.mount for receiver in status.receivers):
            if f"{GNSS}{mount}" not in one.heard:
                one.heard[f"{GNSS}{mount}"] = Heard(0, 0.0, ())
        one.heard.setdefault(WHEEL, Heard(0, 0.0, ()))
    if reading.statuses:
        one.faults = _counted(reading.statuses[-1])
        if reading.statuses[0].uptime_s > YOUNG_S:
            one.faults -= _counted(reading.statuses[0])
    _clocks(one, reading.clocks)


def _heard(times: "np.ndarray[tuple[int], np.dtype[np.int64]]") -> Heard:
    """times: with the run's first and last instant before and after them."""
    apart = np.diff(times) * 1e-9
    usual = float(np.median(apart[1:-1])) if apart.size > 2 else 0.0
    where = np.flatnonzero(apart > max(SHORTEST_S, SPACINGS * usual))
    gaps = sorted(((int(times[i]), float(apart[i])) for i in where), key=lambda gap: -gap[1])
    span_s = float(times[-1] - times[0]) * 1e-9
    count = times.size - 2
    return Heard(count, count / span_s if span_s > 0 else 0.0, tuple(gaps))


def _counted(status: pb.Status) -> Counter[str]:
    counts = Counter({f"dropped on {bus.name}": bus.lost_frames for bus in status.buses})
    counts.update({fault.reason: fault.count for fault in status.faults})
    return +counts


def _clocks(one: Survey, clocks: list[Mapping[str, str]]) -> None:
    ahead = None
    for told in clocks:
        before, ahead = ahead, int(told["realtime_ns"]) - int(told["t_ns"])
        if told.get("why") == "step" and before is not None:
            one.steps_s.append((ahead - before) * 1e-9)
    if clocks:
        one.utc_minus_ns = int(clocks[-1].get("utc_minus_t_ns", "0"))
        one.by_gnss = "gnss_utc_minus_t_ns" in clocks[-1]


@dataclass(frozen=True, slots=True)
class Glance:
    """What the index and the last status tell of a file."""

    first_ns: int
    last_ns: int
    frames: int
    alive: int  # sensors, at its last frame
    sensors: int
    lost: tuple[str, ...]  # those that were not
    events: Counter[str]  # by kind
    utc_minus_ns: int
    note: str


def glance(path: Path) -> Glance | None:
    """None for a file without index: one that is being written, or was left unfinished. Raises OSError."""
    with path.open("rb") as file:
        if not is_finished(file, path.stat().st_size):
            return None
        file.seek(0)
        try:
            return _glance(file)
        except DAMAGE:
            return None


def _glance(file: BinaryIO) -> Glance | None:
    reader = make_reader(file)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        return None
    counts = summary.statistics.channel_message_counts
    buses = [channel.topic for channel in summary.channels.values() if channel.topic.startswith(CAN_TOPIC)]
    frames = sum(counts.get(id, 0) for id, channel in summary.channels.items() if channel.topic in buses)
    last = next(reader.iter_messages(buses, reverse=True), None) if buses else None
    until_ns = last[2].log_time + 1 if last else None
    told = next(reader.iter_messages(["/status"], ending_before=until_ns, reverse=True), None)
    status = pb.Status.FromString(told[2].data) if told else pb.Status()
    sensors = {receiver.mount.replace("_", " "): receiver.state for receiver in status.receivers}
    if told:
        sensors["wheel angle"] = status.wheel_angle.state
    events = Counter(pb.Event.FromString(row.data).kind for _, _, row in reader.iter_messages(["/event"]))
    metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    return Glance(
        first_ns=summary.statistics.message_start_time,
        last_ns=summary.statistics.message_end_time,
        frames=frames,
        alive=sum(state == "alive" for state in sensors.values()),
        sensors=len(sensors),
        lost=tuple(name for name, state in sensors.items() if state != "alive"),
        events=events,
        utc_minus_ns=int(metadata.get("clock", {}).get("utc_minus_t_ns", "0")),
        note=metadata.get("run", {}).get("note", ""),
    )
