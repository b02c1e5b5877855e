"""Messages of one MCAP channel into columns: Protobuf's wire format and MCAP's framing.

The functions can be compiled.

A layout says where each field goes. What is no number, a text or a list, gives a hash: equal values have
equal hashes, so that one message of each is parsed by Protobuf itself.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.schemas.frame_columns import Bytes, little_endian

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

NOTHING, DOUBLE, INTEGER, ZIGZAG, DOUBLES, HASHED, MESSAGE = 0, 1, 2, 3, 4, 5, 6
"""What a field is: passed over, a double, a whole number (also in 8 bytes), one whose sign stands in its last
bit, several doubles in a row, something to hash, a message whose fields have a node of the layout."""
MCAP_CHANNEL, MCAP_MESSAGE = 4, 5  # opcodes
MCAP_HEAD: Final = 31  # bytes of a message before its content
_BASIS, _OTHER_BASIS, _PRIME = 2166136261, 709607, 16777619  # FNV-1a, 32 bits; twice, from two beginnings
_LOW: Final = 0xFFFFFFFF


class WireLayout(NamedTuple):
    """Of one kind of message. node: 0 the message itself, then those within it; f: number of a field."""

    kind: Integers  # [nodes, f], NOTHING to MESSAGE
    column: Integers  # [nodes, f], first column of its kind; of a MESSAGE its node
    stride: Integers  # [nodes, f], columns from one repetition of its node to the next
    most: Integers  # [nodes, f], repetitions of the field that have columns


class WireColumns(NamedTuple):
    """A row per message, n rows."""

    doubles: Integers  # [n, columns], their bits; those of NaN where absent
    integers: Integers  # [n, columns], 0 where absent
    present: NDArray[np.bool_]  # [n, columns], of the integers
    hashes: Integers  # [n, columns], of texts and lists


def messages_of(records: Bytes, wanted: NDArray[np.bool_], found: Integers) -> tuple[int, int]:
    """Fill found [most, 4] with channel, log time in ns, start and end of the messages on wanted channels.

    records: whole MCAP records. wanted [channels]. Returns their number, and that of records which run past
    the end.
    """
    count, at = 0, 0
    while at + 9 <= records.size:
        stop = at + 9 + little_endian(records, at + 1, 8)
        if stop > records.size or stop <= at:
            return count, 1
        if records[at] == MCAP_MESSAGE and stop - at >= MCAP_HEAD:
            channel = little_endian(records, at + 9, 2)
            if channel < wanted.size and wanted[channel]:
                found[count, 0] = channel
                found[count, 1] = little_endian(records, at + 15, 8)
                found[count, 2], found[count, 3] = at + MCAP_HEAD, stop
                count += 1
        at = stop
    return count, 0


def definitions_of(records: Bytes, found: Integers) -> int:
    """Fill found[:, 2:4] with start and end of the definitions of channels; returns their number.

    records: whole MCAP records.
    """
    count, at = 0, 0
    while at + 9 <= records.size:
        stop = at + 9 + little_endian(records, at + 1, 8)
        if stop > records.size or stop <= at:
            return count
        if records[at] == MCAP_CHANNEL:
            found[count, 2], found[count, 3] = at + 9, stop
            count += 1
        at = stop
    return count


def eight_bytes(data: Bytes, at: int) -> int:
    """The signed number of 8 bytes at `at`, which may be the bits of a double."""
    high = int(data[at + 7])
    return little_endian(data, at, 7) + ((high - 256 if high > 127 else high) << 56)


def long_varint(data: Bytes, at: int, stop: int) -> tuple[int, int]:
    """The number at `at`, 7 bits a byte, and the place behind it; place -1: cut off or too long."""
    value, shift = 0, 0
    while at < stop and shift <= 63:
        byte = int(data[at])
        if shift < 63:
            value |= (byte & 127) << shift
        elif byte & 1:
            value |= -1 << 63
        shift += 7
        at += 1
        if byte <= 127:
            return value, at
    return value, -1


def hashed(data: Bytes, start: int, stop: int, before: int) -> int:
    """Two hashes of 31 and 32 bits in one number. before: of what came before in the same list, or 0."""
    one = (((before >> 32) ^ _BASIS) * _PRIME) & _LOW  # a second empty text must not undo the first
    other = (((before & _LOW) ^ _OTHER_BASIS) * _PRIME) & _LOW
    for k in range(start, stop):
        one = ((one ^ int(data[k])) * _PRIME) & _LOW
        other = ((other ^ int(data[k])) * _PRIME) & _LOW
    return ((one & 0x7FFFFFFF) << 32) | other


def one_field(
    data: Bytes, at: int, stop: int, row: int, place: tuple[int, int, int], columns: WireColumns
) -> int:
    """Put the value at `at` into its column; the place behind it, -1 where it is damaged.

    place: wire type; kind and column of the layout.
    """
    wire, kind, column = place
    if wire == 0:
        value, at = long_varint(data, at, stop)
        if kind in (INTEGER, ZIGZAG):
            columns.integers[row, column] = (value >> 1) ^ -(value & 1) if kind == ZIGZAG else value
            columns.present[row, column] = True
        return at
    if wire == 1:
        if at + 8 > stop:
            return -1
        if kind == DOUBLE:
            columns.doubles[row, column] = eight_bytes(data, at)
        elif kind == INTEGER:
            columns.integers[row, column] = eight_bytes(data, at)
            columns.present[row, column] = True
        return at + 8
    length = 4
    if wire == 2:
        length, at = long_varint(data, at, stop)
    if at < 0 or length < 0 or at + length > stop or (wire != 2 and wire != 5):
        return -1
    if kind == HASHED:
        columns.hashes[row, column] = hashed(data, at, at + length, columns.hashes[row, column])
    return at + length


def fill(data: Bytes, places: Integers, layout: WireLayout, columns: WireColumns) -> int:
    """Fill the columns from n messages; the number of damaged ones, whose further fields stay absent.

    places [n, 4]: as messages_of fills it. Messages stand at most one within another.
    """
    kinds, targets, strides, most = layout
    damaged = 0
    times = np.zeros(kinds.shape, np.int64)  # how often a field of a node has come
    for row in range(places.shape[0]):
        at, end = places[row, 2], places[row, 3]
        times[:] = 0
        node, turn, stop = 0, 0, end
        while 0 <= at < end:
            if at == stop:  # the end of a message within
                node, turn, stop = 0, 0, end
            tag, at = long_varint(data, at, stop)
            wire, number = tag & 7, tag >> 3
            if at < 0 or number >= kinds.shape[1] or number < 1:
                at = one_field(data, at, stop, row, (wire, NOTHING, 0), columns) if at >= 0 else -1
                continue
            kind, column, before = kinds[node, number], targets[node, number], times[node, number]
            times[node, number] += 1
            if kind != HASHED and before >= most[node, number]:
                kind = NOTHING
            if kind == MESSAGE and wire == 2:
                length, at = long_varint(data, at, stop)
                if at < 0 or length < 0 or at + length > stop:
                    at = -1
                elif length > 0:
                    node, turn, stop = column, before, at + length
                    times[node, :] = 0
            elif kind == DOUBLES and wire == 2:
                at = packed_doubles(data, at, stop, row, (column, most[node, number]), columns)
            else:
                column += turn * strides[node, number]
                at = one_field(data, at, stop, row, (wire, kind, column), columns)
        damaged += at != end
    return damaged


def packed_doubles(
    data: Bytes, at: int, stop: int, row: int, place: tuple[int, int], columns: WireColumns
) -> int:
    """Put doubles that stand one after the other into their columns, the first of which is place[0], at most
    place[1] of them; the place behind them, -1 where they are damaged."""
    length, at = long_varint(data, at, stop)
    if at < 0 or length < 0 or at + length > stop:
        return -1
    for k in range(min(length // 8, place[1])):
        columns.doubles[row, place[0] + k] = eight_bytes(data, at + 8 * k)
    return at + length
