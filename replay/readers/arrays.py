"""A log's raw frames as arrays: an hour of a season's drive in a second, for analysis with NumPy.

rows = read_frames("run_001.mcap", "run_002.mcap")
wheel = rows.can_id == 0x18FF0B15
angle = rows.data[wheel, 0:2].copy().view(">i2")
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.logger.log.mcap_file import HEAD, MAGIC
from tilth.replay.readers.log import ForeignLog, Gap, OpenLog
from tilth.replay.readers.mcap_reader import Channels, LogRecords, no_frames
from tilth.schemas.frame_columns import (
    CAN_ID,
    DATA,
    ERROR,
    EXTENDED,
    RX_NS,
    Bytes,
    FrameColumns,
    little_endian,
    next_field,
)
from tilth.schemas.invocation import command

_MESSAGE: Final = 5  # opcode
_SMALLEST: Final = 31  # bytes of a message before its content


@dataclass(frozen=True, slots=True)
class FrameArrays:
    """n frames in the order of the files, which is the order in which they were processed."""

    t_ns: NDArray[np.int64]  # [n]
    rx_ns: NDArray[np.int64]  # [n]
    bus: Bytes  # [n], which of `buses`
    can_id: NDArray[np.uint32]  # [n]
    extended: NDArray[np.bool_]  # [n]
    error: NDArray[np.bool_]  # [n]
    length: Bytes  # [n], bytes of data
    data: Bytes  # [n, 8], zero behind them
    buses: tuple[str, ...]
    skipped: dict[str, int]  # what could not be read -> count

    def __len__(self) -> int:
        return self.t_ns.size


def read_frames(*paths: Path | str) -> FrameArrays:
    """The frames of Tilth's own logs, all that can be read; `skipped` counts what cannot.

    Raises ForeignLog for another file, EmptyLog for one without frames, OSError.
    """
    buses: dict[str, int] = {}
    skipped: dict[str, int] = {}
    parts = [part for path in paths for part in frame_parts(Path(path), buses, skipped)]
    if not parts:
        parts = [_room(0)]
    joined = FrameColumns._make(map(np.concatenate, zip(*parts, strict=True)))
    return FrameArrays(*joined, tuple(buses), skipped)


def _nobody(read: int) -> None:
    """Hears how many bytes were read."""


def frame_parts(
    path: Path, buses: dict[str, int], skipped: dict[str, int], heard: Callable[[int], None] = _nobody
) -> Iterator[FrameColumns]:
    """The columns of FrameArrays, chunk by chunk.

    buses: gets the names of the buses, with their numbers. skipped: gets what could not be read, at the end.
    heard: takes how many bytes of the file were read. Raises as `read_frames`.
    """
    with path.open("rb") as file:
        log = OpenLog(path, "MCAP", file, path.stat().st_size)
        if not MAGIC.startswith(file.read(len(MAGIC))):
            raise ForeignLog(f"{path}: no MCAP file; `{command('replay')}` reads other logs")
        reading, channels = LogRecords(log), Channels(log)
        if reading.define(channels) and not channels.buses:
            raise no_frames(log)
        for data in reading:
            if not isinstance(data, Gap):
                yield from _chunk(channels, data, buses)
            heard(log.position())
        if not channels.buses and not log.truncated:
            raise no_frames(log)
        if log.truncated:
            log.skip("cut")
    for reason, count in log.skipped.items():
        skipped[reason] = skipped.get(reason, 0) + count


def _chunk(channels: Channels, data: bytes, buses: dict[str, int]) -> Iterator[FrameColumns]:
    numbers = np.frombuffer(data, np.uint8)
    at = 0
    while at < len(data):
        columns = _room((len(data) - at) // _SMALLEST + 1)
        count, damaged, at = _take(numbers, at, _bus_of(channels, buses), columns)
        if damaged:
            channels.log.skipped["damaged_frame"] = channels.log.skipped.get("damaged_frame", 0) + damaged
        yield FrameColumns._make(column[:count].copy() for column in columns)
        if at < len(data):  # a definition
            opcode, length = HEAD.unpack_from(data, at)
            channels.definition(opcode, data[at + HEAD.size : at + HEAD.size + length])
            at += HEAD.size + length


def _room(count: int) -> FrameColumns:
    return FrameColumns(
        np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.uint8),
        np.empty(count, np.uint32), np.empty(count, np.bool_), np.empty(count, np.bool_),
        np.empty(count, np.uint8), np.empty((count, 8), np.uint8),
    )  # fmt: skip


def _bus_of(channels: Channels, buses: dict[str, int]) -> NDArray[np.int16]:
    """Channel -> which of the buses, -1 for what carries no frames."""
    table = np.full(max(channels.buses, default=0) + 2, -1, np.int16)
    for channel, bus in channels.buses.items():
        table[channel] = buses.setdefault(bus, len(buses))
    return table


@kernel
def _take(
    records: Bytes, start: int, bus_of: NDArray[np.int16], columns: FrameColumns
) -> tuple[int, int, int]:
    """Frames, damaged ones, and the place of the first record that is no message, or the end.

    records: whole MCAP records. bus_of [channels]: number of the bus, -1 for what carries no frames.
    """
    t_ns, rx_ns, bus, can_id, extended, error, length, data = columns
    count, damaged = 0, 0
    while start < records.size:
        if records[start] != _MESSAGE:
            return count, damaged, start
        stop = start + 9 + little_endian(records, start + 1, 8)
        channel = little_endian(records, start + 9, 2)
        if channel >= bus_of.size or bus_of[channel] < 0:
            start = stop
            continue
        t_ns[count] = little_endian(records, start + 15, 8)
        bus[count] = bus_of[channel]
        rx_ns[count], can_id[count], length[count] = 0, 0, 0
        extended[count], error[count] = False, False
        for k in range(8):
            data[count, k] = 0
        at = start + _SMALLEST
        while 0 <= at < stop:
            tag, value, at = next_field(records, at, stop)
            if tag == RX_NS:
                rx_ns[count] = value
            elif tag == CAN_ID:
                can_id[count] = value
            elif tag == EXTENDED:
                extended[count] = value != 0
            elif tag == ERROR:
                error[count] = value != 0
            elif tag == DATA and at >= 0:
                length[count] = value
                for k in range(value):
                    data[count, k] = records[at + k]
                at += value
        count += at == stop
        damaged += at != stop
        start = stop
    return count, damaged, start
