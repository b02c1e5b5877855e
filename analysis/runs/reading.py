"""One channel of Tilth's own logs as tables, chunk by chunk: what is read and kept is what is asked for.

A log that was cut off is read as far as it is whole; what is damaged is left out. Both are counted.
"""

import io
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.records import Channel
from numpy.typing import NDArray

from tilth.analysis.runs.layout import ChannelLayout, TableColumn, layout_of
from tilth.analysis.runs.table import TEXTS, Table, Values, joined
from tilth.estimator.compiled import kernel
from tilth.logger.log.mcap_summary import topics_of
from tilth.replay.readers.log import Gap, OpenLog
from tilth.replay.readers.mcap_reader import LogRecords
from tilth.schemas import message_columns as wire
from tilth.schemas.message_columns import WireColumns

_definitions_of = kernel(wire.definitions_of)
_messages_of = kernel(wire.messages_of)
_fill = kernel(wire.fill)
_NAN_BITS: Final = np.array([np.nan]).view(np.int64)[0]
_GATHERED: Final = 1 << 22  # bytes of chunks that become tables at once: small ones cost more than their rows

Places = NDArray[np.int64]


def _nobody(read: int) -> None:
    """Hears how many bytes were read."""


@dataclass(slots=True)
class RunClock:
    """How log times become seconds and UTC."""

    start_ns: int  # t_ns of the run's first record
    utc_minus_ns: int | None = None  # added to a t_ns gives UTC; None: not known


@dataclass(slots=True)
class ChannelReader:
    """Reads the files of a run. `skipped`: what could not be read -> count, of all that was read so far."""

    paths: Sequence[Path]
    clock: RunClock
    skipped: Counter[str] = field(default_factory=Counter)
    say: Callable[[str], None] = lambda text: None  # takes what is damaged, once
    _said: set[str] = field(default_factory=set)
    _ahead: dict[str, Table] = field(default_factory=dict)

    def table(self, topic: str) -> Table:
        """All of a topic. Raises OSError."""
        if topic in self._ahead:
            return self._ahead[topic]
        return self._whole(topic, [table for _, table in self.tables((topic,))])

    def read_ahead(self, topics: Sequence[str]) -> None:
        """Keep the tables of these topics, from one pass over the files. Raises OSError."""
        parts: dict[str, list[Table]] = {topic: [] for topic in topics}
        for topic, table in self.tables(topics):
            parts[topic].append(table)
        self._ahead |= {topic: self._whole(topic, found) for topic, found in parts.items()}

    def _whole(self, topic: str, parts: Sequence[Table]) -> Table:
        return joined(parts) if parts else self._table(topic, b"", np.zeros((0, 4), np.int64))

    def batches(self, topic: str) -> Iterator[Table]:
        """The same, a table for each chunk of a file that has any of it."""
        for data, places in self._messages((topic,)):
            yield self._table(topic, data, places)

    def tables(
        self, topics: Sequence[str], heard: Callable[[int], None] = _nobody
    ) -> Iterator[tuple[str, Table]]:
        """(topic, table) of several topics, from one pass over the files, in the order of each topic.

        heard: takes how many bytes of the files were read. Raises OSError.
        """
        gathered: list[bytes] = []
        found: list[Places] = []
        size = 0
        for data, places in self._messages(topics, heard):
            found.append(places + np.array([0, 0, size, size]))
            gathered.append(data)
            size += len(data)
            if size >= _GATHERED:
                yield from self._tables(topics, b"".join(gathered), np.concatenate(found))
                gathered, found, size = [], [], 0
        if gathered:
            yield from self._tables(topics, b"".join(gathered), np.concatenate(found))

    def _tables(self, topics: Sequence[str], data: bytes, places: Places) -> Iterator[tuple[str, Table]]:
        for k, topic in enumerate(topics):
            its = places[places[:, 0] == k]
            if len(its):
                yield topic, self._table(topic, data, its)

    def payloads(self, topic: str) -> Iterator[tuple[int, bytes]]:
        """(t_ns of the record, Protobuf bytes) of a topic."""
        for data, places in self._messages((topic,)):
            for _, t_ns, start, stop in places.tolist():
                yield t_ns, data[start:stop]

    def _messages(
        self, wanted: Sequence[str], heard: Callable[[int], None] = _nobody
    ) -> Iterator[tuple[bytes, Places]]:
        """(records of a chunk, places [n, 4] as wire.messages_of fills them) where there are any; instead of
        the channel stands which of the wanted topics it is."""
        before = 0
        for path in self.paths:
            topics: dict[int, str] = {}
            for data in chunks(path, self.skipped, partial(_from, heard, before), self.tell):
                numbers = np.frombuffer(data, np.uint8)
                places = np.empty((numbers.size // wire.MCAP_HEAD + 1, 4), np.int64)
                defined = places[: _definitions_of(numbers, places)]
                for start, stop in defined[:, 2:].tolist():
                    channel = Channel.read(ReadDataStream(io.BytesIO(data[start:stop])))
                    topics[channel.id] = channel.topic
                which = np.full(max(topics, default=0) + 1, -1, np.int64)
                for id, topic in topics.items():
                    if topic in wanted:
                        which[id] = wanted.index(topic)
                count, cut = _messages_of(numbers, which >= 0, places)
                self.skipped["damaged_chunk"] += cut
                if count:
                    places[:count, 0] = which[places[:count, 0]]
                    yield data, places[:count]
            before += path.stat().st_size

    def tell(self, text: str) -> None:
        """Say what is damaged, once."""
        if text not in self._said:
            self._said.add(text)
            self.say(text)

    def _table(self, topic: str, data: bytes, places: NDArray[np.int64]) -> Table:
        layout = layout_of(topic)
        n = len(places)
        columns = WireColumns(
            np.full((n, layout.counts[wire.DOUBLE]), _NAN_BITS, np.int64),
            np.zeros((n, layout.counts[wire.INTEGER]), np.int64),
            np.zeros((n, layout.counts[wire.INTEGER]), np.bool_),
            np.zeros((n, layout.counts[wire.HASHED]), np.int64),
        )
        self.skipped["damaged_message"] += _fill(np.frombuffer(data, np.uint8), places, layout.wire, columns)
        return self._named(layout, columns, data, places)

    def _named(
        self, layout: ChannelLayout, columns: WireColumns, data: bytes, places: NDArray[np.int64]
    ) -> Table:
        named: dict[str, Values] = {}
        units: dict[str, str] = {}
        missing: dict[str, NDArray[np.bool_]] = {}
        logged_ns = places[:, 1]
        for column in layout.columns:
            values = _values(layout, column, columns, data, places)
            name = column.name
            if name in ("t_ns", "rx_ns", "timestamp"):
                stem = "t" if name == "t_ns" else "rx"
                times_ns = values if name != "timestamp" else logged_ns
                self._add_times(stem, np.where(times_ns > 0, times_ns, logged_ns), named, units)
                continue
            named[name] = values
            if column.unit:
                units[name] = column.unit
            if column.kind == wire.INTEGER and column.optional:
                missing[name] = ~columns.present[:, column.number]
        if "t_s" not in named:
            times: dict[str, Values] = {}
            self._add_times("t", logged_ns, times, units)
            named = times | named
        return Table(named, units, missing)

    def _add_times(
        self, stem: str, times_ns: NDArray[np.int64], named: dict[str, Values], units: dict[str, str]
    ) -> None:
        """Seconds since the run began and, of t, UTC in seconds since 1970."""
        named[f"{stem}_s"] = (times_ns - self.clock.start_ns) * 1e-9
        units[f"{stem}_s"] = "s"
        if stem == "t":
            ahead = self.clock.utc_minus_ns
            named["utc_s"] = np.full(len(times_ns), np.nan) if ahead is None else (times_ns + ahead) * 1e-9
            units["utc_s"] = "s"


def _values(
    layout: ChannelLayout, column: TableColumn, columns: WireColumns, data: bytes, places: NDArray[np.int64]
) -> Values:
    at = column.number
    if column.kind == wire.HASHED:
        return _texts(layout, column, columns.hashes[:, at], data, places)
    if column.kind == wire.INTEGER:
        return columns.integers[:, at].astype(column.type)
    bits = columns.doubles[:, at : at + column.width].copy()
    if not column.optional:  # Protobuf leaves out a zero
        bits[bits == _NAN_BITS] = 0
    doubles = bits.view(np.float64)
    return doubles if column.width > 1 else doubles[:, 0]


def _texts(
    layout: ChannelLayout,
    column: TableColumn,
    hashes: NDArray[np.int64],
    data: bytes,
    places: NDArray[np.int64],
) -> Values:
    """Texts of a column: of each that occurs one message is parsed."""
    assert column.read is not None
    found, first, codes = np.unique(hashes, return_index=True, return_inverse=True)
    texts = np.empty(len(found), TEXTS)
    for k, (value, row) in enumerate(zip(found, first, strict=True)):
        texts[k] = ""
        if value:
            try:
                texts[k] = column.read(layout.message.FromString(data[places[row, 2] : places[row, 3]]))
            except DecodeError:  # counted already
                continue
    return texts[codes]


def _from(heard: Callable[[int], None], before: int, read: int) -> None:
    """before: bytes of the files before this one."""
    heard(before + read)


def chunks(
    path: Path,
    skipped: Counter[str],
    heard: Callable[[int], None] = _nobody,
    say: Callable[[str], None] = lambda text: None,
) -> Iterator[bytes]:
    """The records of each chunk of a file. heard: takes how many of its bytes were read. say: takes what is
    damaged. Raises OSError."""
    with path.open("rb") as file:
        log = OpenLog(path, "MCAP", file, path.stat().st_size)
        records = LogRecords(log)
        yield records.definitions
        for data in records:
            if not isinstance(data, Gap):
                yield data
            heard(log.position())
        for text in log.told_damage():
            say(f"{path}: {text}")
        skipped.update(log.skipped)
        skipped["cut"] += log.truncated


def indexed_topics(path: Path) -> dict[int, str]:
    """Channel -> topic, by the index of a finished file; {} of another. Raises OSError."""
    with path.open("rb") as file:
        return topics_of(file, path.stat().st_size)
