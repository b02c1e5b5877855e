"""tilth.CanFrame as Protobuf packs it, read into arrays by compiled code."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
# Tags of Protobuf: number of the field times 8, and its wire type.
RX_NS, CAN_ID, EXTENDED, ERROR, DATA = 9, 16, 24, 32, 42
VARINT, LENGTH_DELIMITED = 0, 2  # wire types
LONGEST_SHIFT = 28  # of a number in 7 bits a byte that fits 32 bits


class FrameColumns(NamedTuple):
    """A row per frame, n rows."""

    t_ns: NDArray[np.int64]  # [n]
    rx_ns: NDArray[np.int64]  # [n]
    bus: Bytes  # [n]
    can_id: NDArray[np.uint32]  # [n]
    extended: NDArray[np.bool_]  # [n]
    error: NDArray[np.bool_]  # [n]
    length: Bytes  # [n], bytes of data
    data: Bytes  # [n, 8], zero behind them


def little_endian(data: Bytes, at: int, count: int) -> int:
    """The unsigned number in `count` bytes from `at` on."""
    value = 0
    for k in range(count):
        value |= int(data[at + k]) << (8 * k)
    return value


def varint(data: Bytes, at: int, stop: int) -> tuple[int, int]:
    """The number at `at`, 7 bits a byte, and the place behind it; place -1: cut off or too long."""
    value, shift = 0, 0
    while at < stop and shift <= LONGEST_SHIFT:
        value |= (int(data[at]) & 127) << shift
        shift += 7
        at += 1
        if data[at - 1] <= 127:
            return value, at
    return value, -1


def next_field(records: Bytes, at: int, stop: int) -> tuple[int, int, int]:
    """Tag and number of the field at `at`, and the place behind it; place -1: damaged.

    rx_ns is a fixed64, all others are numbers of 7 bits a byte. Of DATA the number is its length, and the
    place that of its first byte. Bytes that a later version adds are passed over, with the tag 0.
    """
    tag = int(records[at])
    if tag == RX_NS:
        return (tag, little_endian(records, at + 1, 8), at + 9) if at + 9 <= stop else (tag, 0, -1)
    if tag & 7 != VARINT and tag & 7 != LENGTH_DELIMITED:
        return tag, 0, -1
    value, at = varint(records, at + 1, stop)
    if tag == DATA and (value > 8 or at + value > stop):
        return tag, 0, -1
    if tag & 7 == LENGTH_DELIMITED and tag != DATA and at >= 0:
        return 0, 0, at + value
    return tag, value, at
