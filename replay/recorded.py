"""A recorded run by time: the results that its files hold, found quickly wherever in it one wants to look.

It is read once from end to end when it is opened. After that a time costs the few chunks that hold what was
last said before it. Times `at_ns` are ns since the first result of the run and never run back: after a step
of the log's clock they go on where they were.
"""

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Final

from mcap.opcode import Opcode

from tilth.logger.log.mcap_file import DAMAGE, HOLE, RecordPlace, body_of, unpacked
from tilth.logger.log.mcap_records import McapRecords
from tilth.replay.readers.any_log import MCAP, open_log
from tilth.replay.readers.log import EmptyLog, ForeignLog, LogError
from tilth.replay.survey import messages_in
from tilth.replay.turns import turns
from tilth.schemas.channels import CHANNELS
from tilth.schemas.flow import EventKind
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.readable import readable

# What can be published again. The rig is said by whoever publishes, from the machine file.
TOPICS: Final = frozenset(row.topic for row in CHANNELS if row.key is not None and row.logged)
STATES: Final = TOPICS - {"/event"}  # of these the last one holds until the next
STEP_NS: Final = 1_000_000_000  # further back than that is a step of the clock
KEPT_CHUNKS: Final = 16  # unpacked ones
MOST_ROWS: Final = 4000  # of one kind in the overview
MOST_PLACES: Final = 600
CHUNK_HEAD: Final = 28  # bytes of a chunk's times, size and checksum
NO_PLACES: Final = frozenset({"heartbeat"})  # kinds of events that nobody wants to jump to

Progress = Callable[[float], None]  # takes the share that is done


class LostLog(LogError):
    """A file that could be read has been changed since, or cannot be reached any more."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """A result: its place in the run, its log time, its bytes."""

    at_ns: int
    t_ns: int
    topic: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Place:
    """Where one may want to jump to: an event, a mark or the begin of a turn."""

    at_ns: int
    t_ns: int
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class _Chunk:
    file: BinaryIO
    topics: dict[int, str]  # of its file, by channel
    place: RecordPlace
    head: bytes  # of its record, by which it is known again
    from_ns: int  # the place in the run at which it begins
    shift_ns: int  # which added to its log times gives places


@dataclass(slots=True)
class _Thinned:
    """Rows far enough apart that they stay few."""

    every_ns: int
    rows: list[Recorded] = field(default_factory=list)

    def add(self, row: Recorded) -> None:
        if self.rows and row.at_ns - self.rows[-1].at_ns < self.every_ns:
            return
        self.rows.append(row)
        if len(self.rows) >= MOST_ROWS:
            self.every_ns *= 2
            rows, self.rows = self.rows, []
            for one in rows:
                self.add(one)


class RecordedRun:
    """Of the files of one run. Close it; one thread uses it."""

    def __init__(self, paths: Sequence[Path], progress: Progress = lambda share: None) -> None:
        """Raises LogError where it holds no result or is no log of tilth's, OSError."""
        self.paths = tuple(paths)
        self.length_ns = 0
        self.damaged = 0  # chunks
        self.cut: list[Path] = []  # files without their end
        self.places: list[Place] = []
        self.overview: list[Recorded] = []  # some poses and estimates, all events, by place
        self._files: list[BinaryIO] = []
        self._chunks: list[_Chunk] = []
        self._holding: dict[str, list[int]] = {}  # topic -> the chunks that hold it
        self._kept: OrderedDict[int, list[Recorded]] = OrderedDict()
        self._shift_ns: int | None = None
        try:
            self._read(progress)
            if not self._chunks:
                raise EmptyLog(f"{paths[0]}: no result is in it")
        except BaseException:
            self.close()
            raise

    @property
    def has_poses(self) -> bool:
        return "/pose" in self._holding

    @property
    def text(self) -> str:
        """What is missing in it, in a sentence; "" where nothing is."""
        parts = [f"{readable(path.name)} is cut off: it plays as far as it is whole" for path in self.cut]
        parts += [f"{self.damaged} damaged parts are left out"] if self.damaged else []
        return "; ".join(parts)

    def after(self, at_ns: int) -> Iterator[Recorded]:
        """Every result later than that, in the order of the file. Raises LostLog."""
        first = max(0, bisect_right(self._chunks, at_ns, key=lambda chunk: chunk.from_ns) - 1)
        for number in range(first, len(self._chunks)):
            yield from (row for row in self._rows(number) if row.at_ns > at_ns)

    def before(self, at_ns: int) -> list[Recorded]:
        """The last result of each topic at that time or earlier; events are none, since they do not last.
        Raises LostLog."""
        found = []
        for topic in STATES & self._holding.keys():
            numbers = self._holding[topic]
            last = bisect_right(numbers, at_ns, key=lambda number: self._chunks[number].from_ns)
            for number in reversed(numbers[:last]):
                rows = [row for row in self._rows(number) if row.topic == topic and row.at_ns <= at_ns]
                if rows:
                    found.append(rows[-1])
                    break
        return sorted(found, key=lambda row: row.at_ns)

    def close(self) -> None:
        for file in self._files:
            file.close()

    def _rows(self, number: int) -> list[Recorded]:
        if number in self._kept:
            self._kept.move_to_end(number)
            return self._kept[number]
        rows = self._kept[number] = _rows(self._chunks[number])
        if len(self._kept) > KEPT_CHUNKS:
            self._kept.popitem(last=False)
        return rows

    def _read(self, progress: Progress) -> None:
        sizes = [path.stat().st_size if path.is_file() else 0 for path in self.paths]
        done, whole = 0, max(sum(sizes), 1)
        poses, estimates, events = _Thinned(200_000_000), _Thinned(1_000_000_000), list[Recorded]()
        yaw_rates: list[tuple[int, float]] = []
        for path, size in zip(self.paths, sizes, strict=True):
            for row in self._read_file(path, size, _later(progress, done / whole, 1 / whole)):
                if row.topic == "/pose":
                    poses.add(row)
                    body = pb.Pose.FromString(row.data).tractor
                    if body.HasField("yaw_rate"):
                        yaw_rates.append((row.at_ns, body.yaw_rate))
                elif row.topic == "/soil_tire":
                    estimates.add(row)
                elif row.topic == "/event":
                    events.append(row)
            done += size
        self.overview = sorted([*poses.rows, *estimates.rows, *events], key=lambda row: row.at_ns)
        self.places = _places(events, yaw_rates, poses.rows)

    def _read_file(self, path: Path, size: int, progress: Progress) -> Iterator[Recorded]:
        try:
            log = open_log(path)
        except EmptyLog:  # as a power cut leaves a part that had just begun
            self.cut.append(path)
            return
        file = log.file
        self._files.append(file)
        if log.form != MCAP:
            raise ForeignLog(f"{path}: holds frames only, no result that could be played")
        records, topics = McapRecords(file, size), dict[int, str]()
        list(messages_in(records.definitions, topics))
        for place, data in records:
            progress(place.start)
            if place.opcode == HOLE:
                self.damaged += 1
            elif place.opcode == Opcode.CHUNK:
                yield from self._take_chunk(file, topics, place, data)
        if records.cut:
            self.cut.append(path)

    def _take_chunk(
        self, file: BinaryIO, topics: dict[int, str], place: RecordPlace, data: bytes
    ) -> list[Recorded]:
        """Its results; where it has some it is remembered."""
        messages = list(messages_in(data, topics, TOPICS))
        if not messages:
            return []
        t_ns = messages[0][1][0]
        if self._shift_ns is None or t_ns + self._shift_ns < self.length_ns - STEP_NS:
            self._shift_ns = self.length_ns - t_ns
        file.seek(place.body)
        head = file.read(CHUNK_HEAD)
        chunk = _Chunk(file, topics, place, head, self.length_ns, self._shift_ns)
        rows = list(_placed(chunk, messages))
        for topic in {row.topic for row in rows}:
            self._holding.setdefault(topic, []).append(len(self._chunks))
        self._chunks.append(chunk)
        self.length_ns = rows[-1].at_ns
        return rows


def _later(progress: Progress, done: float, per_byte: float) -> Progress:
    return lambda at: progress(done + at * per_byte)


def _rows(chunk: _Chunk) -> list[Recorded]:
    """Raises LostLog."""
    try:
        body = body_of(chunk.file, chunk.place)
        if body[:CHUNK_HEAD] == chunk.head:
            return list(_placed(chunk, messages_in(unpacked(body), chunk.topics, TOPICS)))
    except DAMAGE:
        pass
    raise LostLog(
        f"{chunk.file.name}: changed since it was opened, or not there any more; open the run again"
    ) from None


def _placed(chunk: _Chunk, messages: "Iterator[_Message] | Sequence[_Message]") -> Iterator[Recorded]:
    at_ns = chunk.from_ns
    for topic, (t_ns, data) in messages:
        at_ns = max(at_ns, t_ns + chunk.shift_ns)
        yield Recorded(at_ns, t_ns, topic, data)


_Message = tuple[str, tuple[int, bytes]]


def _places(
    events: Sequence[Recorded], yaw_rates: Sequence[tuple[int, float]], poses: Sequence[Recorded]
) -> list[Place]:
    marks, others = list[Place](), list[Place]()
    for row in events:
        event = pb.Event.FromString(row.data)
        if event.kind not in NO_PLACES:
            place = Place(row.at_ns, row.t_ns, event.kind, event.text)
            (marks if event.kind == EventKind.MARK else others).append(place)
    for turn in turns(yaw_rates):
        number = bisect_right(poses, turn.begin_ns, key=lambda pose: pose.at_ns) - 1
        pose = poses[max(0, number)]
        marks.append(Place(turn.begin_ns, pose.t_ns + turn.begin_ns - pose.at_ns, "turn", turn.text))
    return sorted([*marks, *others][:MOST_PLACES], key=lambda place: place.at_ns)
