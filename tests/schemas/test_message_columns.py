"""Protobuf's wire format read into columns: numbers of every kind, lists, messages within, damage."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilth.schemas import message_columns as wire
from tilth.schemas.message_columns import WireColumns, WireLayout
from tilth.schemas.proto import tilth_pb2 as pb


def empty() -> WireColumns:
    doubles, integers, hashes = (np.zeros((1, 8), np.int64) for _ in range(3))
    return WireColumns(doubles, integers, np.zeros((1, 8), np.bool_), hashes)


def table(*entries: tuple[int, int, int, int, int, int]) -> WireLayout:
    """entries: node, field, kind, column, stride, most."""
    kinds, columns, strides, most = (np.zeros((2, 20), np.int64) for _ in range(4))
    layout = WireLayout(kinds, columns, strides, most)
    for node, field, kind, column, stride, times in entries:
        layout.kind[node, field], layout.column[node, field] = kind, column
        layout.stride[node, field], layout.most[node, field] = stride, times
    return layout


def filled(data: bytes, layout: WireLayout, damaged: int = 0) -> WireColumns:
    columns = empty()
    places = np.array([[1, 0, 0, len(data)]], np.int64)
    assert wire.fill(np.frombuffer(data, np.uint8), places, layout, columns) == damaged
    return columns


@given(st.floats(allow_nan=False), st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**63 - 1), st.text())
def test_fields_of_a_measurement(value: float, source: int, stamp: int, bus: str) -> None:
    message = pb.Measurement(t_ns=stamp, source=source, bus=bus, heading=value)
    layout = table(
        (0, 1, wire.INTEGER, 0, 0, 1), (0, 4, wire.ZIGZAG, 1, 0, 1), (0, 3, wire.HASHED, 0, 0, 1),
        (0, 16, wire.DOUBLE, 0, 0, 1),
    )  # fmt: skip
    columns = filled(message.SerializeToString(), layout)
    assert columns.doubles[0, :1].view(np.float64)[0] == value
    assert columns.integers[0, :2].tolist() == [stamp, source]
    assert (columns.hashes[0, 0] != 0) == bool(bus)


@given(st.lists(st.floats(allow_nan=False), max_size=6))
def test_packed_doubles_as_far_as_there_are_columns(values: list[float]) -> None:
    message = pb.SoilTireEstimate(log_covariance=values)
    columns = filled(message.SerializeToString(), table((0, 5, wire.DOUBLES, 0, 0, 4)))
    assert columns.doubles[0].view(np.float64)[: min(4, len(values))].tolist() == values[:4]
    assert not columns.doubles[0, 4:].any()


def test_messages_within_go_to_columns_of_their_own() -> None:
    message = pb.SoilTireEstimate()
    for k in range(3):
        message.parameters.add(name=f"p{k}", value=float(k + 1), status=pb.STALE)
    layout = table(
        (0, 4, wire.MESSAGE, 1, 0, 2), (1, 2, wire.DOUBLE, 1, 2, 1), (1, 4, wire.INTEGER, 0, 1, 1),
        (1, 1, wire.HASHED, 0, 1, 1),
    )  # fmt: skip
    columns = filled(message.SerializeToString(), layout)
    assert columns.doubles[0].view(np.float64)[:5].tolist() == [0.0, 1.0, 0.0, 2.0, 0.0]  # the third has none
    assert columns.integers[0, :3].tolist() == [pb.STALE, pb.STALE, 0]
    assert len(set(columns.hashes[0, :2].tolist())) == 2


def test_lists_of_texts_have_one_hash() -> None:
    layout = table((0, 13, wire.HASHED, 0, 0, 1))
    lists: tuple[list[str], ...] = (["a", "b"], ["b", "a"], ["ab"], ["a", "b", ""], [])
    hashes = [int(filled(pb.Pose(flags=texts).SerializeToString(), layout).hashes[0, 0]) for texts in lists]
    assert len(set(hashes)) == len(lists) and hashes[-1] == 0
    again = filled(pb.Pose(flags=["a", "b"], direction=1).SerializeToString(), layout)
    assert again.hashes[0, 0] == hashes[0]


def test_what_a_later_version_adds_is_passed_over() -> None:
    added = bytes([0xF8, 0x01, 5]) + bytes([0xFD, 0x01]) + bytes(4)  # fields 31: a varint, and 4 bytes
    data = added + pb.Pose(articulation=0.5).SerializeToString()
    columns = filled(data, table((0, 6, wire.DOUBLE, 0, 0, 1)))
    assert columns.doubles[0].view(np.float64)[0] == 0.5


@pytest.mark.parametrize("kept", range(1, 30))
def test_a_message_that_is_cut_is_counted_and_read_no_further(kept: int) -> None:
    data = pb.Pose(t_ns=7, articulation=0.5, wheel_angle=0.1, direction=-1).SerializeToString()
    whole = len(data)
    layout = table((0, 1, wire.INTEGER, 0, 0, 1), (0, 6, wire.DOUBLE, 0, 0, 1), (0, 8, wire.DOUBLE, 1, 0, 1))
    ends = {9, 18, 27, whole}
    columns = filled(data[:kept], layout, damaged=int(kept < whole and kept not in ends))
    found = columns.doubles[0].view(np.float64)[:2].tolist()
    assert found == [0.5 if kept >= 18 else 0.0, 0.1 if kept >= 27 else 0.0]


@given(st.binary(max_size=60))
def test_any_bytes_do_no_harm(data: bytes) -> None:
    layout = table((0, 4, wire.MESSAGE, 1, 0, 2), (1, 2, wire.DOUBLE, 1, 2, 1), (0, 5, wire.DOUBLES, 0, 0, 4))
    columns = empty()
    places = np.array([[1, 0, 0, len(data)]], np.int64)
    assert wire.fill(np.frombuffer(data, np.uint8), places, layout, columns) in (0, 1)


def test_records_of_a_chunk() -> None:
    def record(opcode: int, body: bytes) -> bytes:
        return bytes([opcode]) + len(body).to_bytes(8, "little") + body

    head = (3).to_bytes(2, "little") + bytes(4) + (99).to_bytes(8, "little") + bytes(8)
    data = record(4, b"channel") + record(5, head + b"abc") + record(7, b"index") + record(5, head)
    numbers, found = np.frombuffer(data, np.uint8), np.zeros((9, 4), np.int64)
    wanted = np.zeros(4, np.bool_)
    wanted[3] = True
    assert wire.messages_of(numbers, wanted, found) == (2, 0)
    assert found[:2, :2].tolist() == [[3, 99], [3, 99]]
    assert data[found[0, 2] : found[0, 3]] == b"abc" and found[1, 2] == found[1, 3]
    assert wire.definitions_of(numbers, found) == 1 and data[found[0, 2] : found[0, 3]] == b"channel"
    assert wire.messages_of(numbers[:-5], wanted, found) == (1, 1)
