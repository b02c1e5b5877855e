"""CAN frames in MCAP logs of ROS."""

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from log_forms import EPOCH_S, ROS2_FRAME, ROS_HEADER, frame, ros, ros1_message, ros2_message
from logs import SECOND, drained
from mcap.writer import CompressionType
from paths import shared

from tilth.replay.readers.log import EmptyLog, ForeignLog
from tilth.schemas.flow import Frame

T = EPOCH_S * SECOND


def rows(count: int = 60) -> list[Frame]:
    return [
        replace(
            frame(T + i * 10_000_000, 0x18FEF300 + i if i % 3 else 0x100 + i, bytes(range(i % 9)).hex(),
                  ("can0", "can1", "implement")[i % 3], extended=bool(i % 3)),
            rx_ns=T + i * 10_000_000 - 500_000,
        )
        for i in range(count)
    ]  # fmt: skip


def shuffled(f: Frame) -> bytes:
    """dataspeed_can_msgs/CanMessageStamped and the like: no error flag, another order, within a message."""
    head = struct.pack("<iII", f.rx_ns // SECOND, f.rx_ns % SECOND, 1) + b"\0"
    body = head + f.data.ljust(8, b"\0")
    body += bytes(-len(body) % 4) + struct.pack("<I?B", f.can_id, f.extended, len(f.data))
    return b"\0\1\0\0" + body


def sequence(f: Frame) -> bytes:
    """ros2_socketcan's FdFrame: as many bytes as there are."""
    head = struct.pack("<iII", f.rx_ns // SECOND, f.rx_ns % SECOND, 5) + b"can0\0"
    body = head + bytes(-len(head) % 4) + struct.pack("<I??B", f.can_id, f.extended, f.error, len(f.data))
    return b"\0\1\0\0" + body + bytes(-len(body) % 4) + struct.pack("<I", len(f.data)) + f.data


def as_json(f: Frame) -> bytes:
    stamp = {"sec": f.rx_ns // SECOND, "nanosec": f.rx_ns % SECOND}
    return json.dumps(
        {
            "header": {"stamp": stamp, "frame_id": ""},
            "id": f.can_id,
            "is_extended": f.extended,
            "data": list(f.data),
        }
    ).encode()


NESTED = (
    """std_msgs/Header header
CanMessage msg
================================================================================
MSG: dataspeed_can_msgs/CanMessage
uint8 STANDARD=0  # a constant
uint8[8] data
uint32 id
bool extended
uint8 dlc
"""
    + ROS_HEADER
)
FD = (
    "std_msgs/Header header\nuint32 id\nbool is_extended\nbool is_error\nuint8 len\nuint8[<=64] data\n"
    + ROS_HEADER
)
ROS1 = ("can_msgs/Frame", "ros1msg")
CASES: dict[str, tuple[Callable[[Frame], bytes], dict[str, Any]]] = {
    "ROS 2": (ros2_message, {}),
    "ROS 2, most significant byte first": (lambda f: ros2_message(f, ">"), {}),
    "without the header's definition": (ros2_message, {"definition": ROS2_FRAME}),
    "IDL": (ros2_message, {"schema": ("can_msgs/msg/Frame", "ros2idl"), "definition": "module can_msgs {};"}),
    "no definition": (ros2_message, {"definition": ""}),
    "no chunks": (ros2_message, {"use_chunking": False}),
    "lz4": (ros2_message, {"compression": CompressionType.LZ4}),
    "not packed": (ros2_message, {"compression": CompressionType.NONE}),
    "no summary": (ros2_message, {"repeat_schemas": False, "repeat_channels": False}),
    "ROS 1": (ros1_message, {"schema": ROS1, "encoding": "ros1",
                             "definition": ROS2_FRAME.replace("std_msgs/Header", "Header")}),
    "CanMessageStamped": (shuffled, {"definition": NESTED,
                                     "schema": ("dataspeed_can_msgs/CanMessageStamped", "ros2msg")}),
    "FdFrame": (sequence, {"definition": FD, "schema": ("ros2_socketcan_msgs/msg/FdFrame", "ros2msg")}),
    "JSON": (as_json, {"encoding": "json", "schema": ("CanFrame", "jsonschema"),
                       "definition": '{"properties": {"id": {}, "data": {}, "is_extended": {}}}'}),
}  # fmt: skip


def test_frames_in_protobuf_of_others(tmp_path: Path) -> None:
    """With a class that only the file describes."""
    kinds = FieldDescriptorProto
    fields = (("timestamp", kinds.TYPE_MESSAGE, ".google.protobuf.Timestamp"), ("id", kinds.TYPE_UINT32, ""),
              ("is_extended", kinds.TYPE_BOOL, ""), ("data", kinds.TYPE_BYTES, ""))  # fmt: skip
    described = FileDescriptorProto(name="can.proto", package="vehicle", syntax="proto3")
    described.dependency.append(timestamp_pb2.DESCRIPTOR.name)
    message = described.message_type.add(name="CanFrame")
    for number, (name, kind, type_name) in enumerate(fields, 1):
        message.field.add(
            name=name, number=number, type=kind, label=kinds.LABEL_OPTIONAL, type_name=type_name or None
        )
    stamp = FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    files = FileDescriptorSet(file=[stamp, described])
    pool = DescriptorPool()
    for file in files.file:
        pool.Add(file)
    made = GetMessageClass(pool.FindMessageTypeByName("vehicle.CanFrame"))

    def encode(f: Frame) -> bytes:
        at = {"seconds": f.rx_ns // SECOND, "nanos": f.rx_ns % SECOND}
        return made(timestamp=at, id=f.can_id, is_extended=f.extended, data=f.data).SerializeToString()

    content = ros(rows(), encode, schema=("vehicle.CanFrame", "protobuf"), encoding="protobuf",
                  definition=files.SerializeToString())  # fmt: skip
    (tmp_path / "x.mcap").write_bytes(content)
    found, log = drained(tmp_path / "x.mcap")
    assert (found, log.skipped) == (rows(), {})


@pytest.mark.parametrize("case", CASES)
def test_frames_of_ros(case: str, tmp_path: Path) -> None:
    message, options = CASES[case]
    (tmp_path / "x.mcap").write_bytes(ros(rows(), message, **options))
    found, log = drained(tmp_path / "x.mcap")
    assert found == rows()
    assert (log.form, log.truncated, log.skipped, log.note) == ("MCAP of ROS", False, {}, "")


def test_stamps_that_are_none_or_of_another_clock_are_left(tmp_path: Path) -> None:
    wanted = [replace(f, rx_ns=f.t_ns) for f in rows()]
    for other_ns in (0, 5 * SECOND, T + 100 * SECOND):
        rx = [replace(f, rx_ns=other_ns) for f in rows()]
        (tmp_path / "x.mcap").write_bytes(ros(rx))
        assert drained(tmp_path / "x.mcap")[0] == wanted


def test_topics_are_buses(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(ros([replace(f, bus=f"{f.bus}/from_can_bus") for f in rows()]))
    found, _ = drained(tmp_path / "x.mcap")
    assert [f.bus for f in found] == [f"{f.bus}_from_can_bus" for f in rows()]


BAD: tuple[tuple[Callable[[bytes], bytes], str], ...] = (
    (lambda m: m[:-3], "damaged_message"),
    (lambda m: b"", "damaged_message"),
    (lambda m: b"\0\3" + m[2:], "damaged_message"),
    (lambda m: m[:28] + b"\1" + m[29:], "remote_frame"),
)


@pytest.mark.parametrize(("damage", "reason"), BAD)
def test_bad_messages_are_counted(damage: Callable[[bytes], bytes], reason: str, tmp_path: Path) -> None:
    def message(f: Frame) -> bytes:
        return damage(ros2_message(f)) if f.t_ns == T + 30_000_000 else ros2_message(f)

    (tmp_path / "x.mcap").write_bytes(ros(rows(), message))
    found, log = drained(tmp_path / "x.mcap")
    assert found == [f for f in rows() if f.t_ns != T + 30_000_000]
    assert log.skipped == {reason: 1}


def test_other_mcap_files_are_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(
        ros(rows(), schema=("geometry_msgs/msg/Twist", "ros2msg"), definition="float64 x\n")
    )
    with pytest.raises(ForeignLog, match=r"can_msgs/Frame"):
        drained(tmp_path / "x.mcap")


def test_a_log_of_ros_without_a_frame(tmp_path: Path) -> None:
    message = ros(rows(), lambda f: ros2_message(f)[:8])
    (tmp_path / "x.mcap").write_bytes(message)
    with pytest.raises(EmptyLog):
        drained(tmp_path / "x.mcap")


def test_the_given_rosbag() -> None:
    path = shared("data/strangers/second/13-rosbag2-fastwrite.mcap")
    found, log = drained(path)
    assert (len(found), found[0].t_ns, found[0].can_id) == (400, 1777881599_900959000, 0x0CF00203)
    assert {f.bus for f in found} == {"from_can_bus"} and (log.truncated, log.skipped) == (False, {})
