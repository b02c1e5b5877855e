"""A log's raw frames as arrays: an hour of a season's drive in a second, for analysis with NumPy.

rows = read_frames("run_001.mcap", "run_002.mcap")
wheel = rows.can_id == 0x18FF0B15
angle = rows.data[wheel, 0:2].copy().view(">i2")
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.logger.log.mcap_file import DAMAGE, HEAD, MAGIC, unpacked
from tilth.replay.readers.log import ForeignLog, OpenLog
from tilth.replay.readers.mcap_reader import Channels, framed, from_summary, no_frames
from tilth.schemas.invocation import command

Bytes = NDArray[np.uint8]
_SMALLEST: Final = 31  # bytes of a message


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
    """The frames of Tilth's own logs, as far as each is whole; `skipped` counts what is not.

    Raises ForeignLog for another file, EmptyLog for one without frames, OSError.
    """
    buses: dict[str, int] = {}
    skipped: dict[str, int] = {}
    parts = [part for path in paths for part in _parts(Path(path), buses, skipped)]
    if not parts:
        parts = [_room(0)]
    columns: Any = map(np.concatenate, zip(*parts, strict=True))
    t_ns, rx_ns, bus, can_id, extended, error, length, data = columns
    return FrameArrays(t_ns, rx_ns, bus, can_id, extended, error, length, data, tuple(buses), skipped)


def _parts(path: Path, buses: dict[str, int], skipped: dict[str, int]) -> Iterator[tuple[NDArray[Any], ...]]:
    """The columns of FrameArrays, chunk by chunk."""
    with path.open("rb") as file:
        log = OpenLog(path, "MCAP", file, path.stat().st_size)
        if not MAGIC.startswith(file.read(len(MAGIC))):
            raise ForeignLog(f"{path}: no MCAP file; `{command('replay')}` reads other logs")
        channels = Channels(log)
        if from_summary(channels, file) and not channels.buses:
            raise no_frames(log)
        for opcode, body in framed(log):
            try:
                data = unpacked(body) if opcode == Opcode.CHUNK else HEAD.pack(opcode, len(body)) + body
            except DAMAGE:
                log.skip("damaged_chunk")
            else:
                yield from _chunk(channels, data, buses)
        if not channels.buses and not log.truncated:
            raise no_frames(log)
        if log.truncated:
            log.skip("cut")
    for reason, count in log.skipped.items():
        skipped[reason] = skipped.get(reason, 0) + count


def _chunk(channels: Channels, data: bytes, buses: dict[str, int]) -> Iterator[tuple[NDArray[Any], ...]]:
    numbers = np.frombuffer(data, np.uint8)
    at = 0
    while at < len(data):
        columns = _room((len(data) - at) // _SMALLEST + 1)
        count, damaged, at = _take(numbers, at, _bus_of(channels, buses), *columns)
        if damaged:
            channels.log.skipped["damaged_frame"] = channels.log.skipped.get("damaged_frame", 0) + damaged
        yield tuple(column[:count].copy() for column in columns)
        if at < len(data):  # a definition
            opcode, length = HEAD.unpack_from(data, at)
            channels.definition(opcode, data[at + HEAD.size : at + HEAD.size + length])
            at += HEAD.size + length


def _room(count: int) -> tuple[NDArray[Any], ...]:
    kinds = (np.int64, np.int64, np.uint8, np.uint32, np.bool_, np.bool_, np.uint8)
    return (*(np.empty(count, kind) for kind in kinds), np.zeros((count, 8), np.uint8))


def _bus_of(channels: Channels, buses: dict[str, int]) -> NDArray[np.int16]:
    """Channel -> which of the buses, -1 for what carries no frames."""
    table = np.full(max(channels.buses, default=0) + 2, -1, np.int16)
    for channel, bus in channels.buses.items():
        table[channel] = buses.setdefault(bus, len(buses))
    return table


@kernel
def _take(
    records: Bytes,
    start: int,
    bus_of: NDArray[np.int16],
    t_ns: NDArray[np.int64],
    rx_ns: NDArray[np.int64],
    bus: Bytes,
    can_id: NDArray[np.uint32],
    extended: NDArray[np.bool_],
    error: NDArray[np.bool_],
    length: Bytes,
    data: Bytes,
) -> tuple[int, int, int]:
    """Frames, damaged ones, and the place of the first record that is no message, or the end.

    records: whole MCAP records. The fields of a frame are those of tilth.CanFrame, as Protobuf packs them.
    """
    count, damaged = 0, 0
    while start < records.size:
        if records[start] != 5:
            return count, damaged, start
        stop = start + 9
        for k in range(8):
            stop += int(records[start + 1 + k]) << (8 * k)
        channel = int(records[start + 9]) | int(records[start + 10]) << 8
        if channel >= bus_of.size or bus_of[channel] < 0:
            start = stop
            continue
        t_ns[count], rx_ns[count], can_id[count], length[count] = 0, 0, 0, 0
        extended[count], error[count] = False, False
        for k in range(8):
            t_ns[count] |= int(records[start + 15 + k]) << (8 * k)
        bus[count] = bus_of[channel]
        at = start + 31
        whole = True
        while at < stop and whole:
            tag = int(records[at])
            at += 1
            value = 0
            if tag == 9:  # rx_ns
                whole = at + 8 <= stop
                if whole:
                    for k in range(8):
                        rx_ns[count] |= int(records[at + k]) << (8 * k)
                at += 8
                continue
            if tag & 7 != 0 and tag & 7 != 2:
                whole = False
                continue
            shift = 0
            more = True
            while more:  # a number, 7 bits a byte
                if at >= stop or shift > 28:
                    whole, more = False, False
                else:
                    value |= (int(records[at]) & 127) << shift
                    more = records[at] > 127
                    shift += 7
                    at += 1
            if tag == 16:
                can_id[count] = value
            elif tag == 24:
                extended[count] = value != 0
            elif tag == 32:
                error[count] = value != 0
            elif tag == 42:
                whole = whole and value <= 8 and at + value <= stop
                if whole:
                    length[count] = value
                    for k in range(value):
                        data[count, k] = records[at + k]
                at += value
            elif tag & 7 == 2:  # a field of a later version
                at += value
        if whole and at == stop:
            count += 1
        else:
            damaged += 1
            for k in range(8):
                data[count, k] = 0
        start = stop
    return count, damaged, start
