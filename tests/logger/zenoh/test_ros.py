"""What the daemon publishes for ROS 2, by rmw_zenoh's rules; in Rust, as another implementation reads it."""

import math
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
import zenoh
from field_rig import FieldRig
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from hypothesis import given
from hypothesis import strategies as st
from loopback import PATIENCE_S, START_NS, breath, rig, session, udp_bus, until
from paths import MACHINE_FILE, ROOT
from posed import pose_of
from rust_build import in_rust
from zenoh.ext import Int64, z_deserialize

from tilth.estimator.pose.body_frames import body_frames
from tilth.logger.zenoh.ros_messages import STORE, RosMessages, ros_name
from tilth.logger.zenoh.sink import ZenohSink
from tilth.schemas.channels import payload
from tilth.schemas.flow import (
    PARAMETERS,
    BodyPose,
    Estimate,
    Mount,
    ParameterEstimate,
    Payload,
    Pose,
    Publication,
    Status,
)
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.simulator.scenario import ORIGIN_DEG

# As ROS 2 Jazzy has them, from the type descriptions of its own packages.
HASHES = {
    "nav_msgs/msg/Odometry": "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "sensor_msgs/msg/NavSatFix": "62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404",
}
OWN = "jd7930_parker500"
UTC_NS = START_NS + 5_000_000_000
DEMO = parse_machine(MACHINE_FILE.read_text())


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    made = rig(tmp_path, udp_bus("can0", 1))[0]
    return made.model_copy(update={"zenoh": made.zenoh.model_copy(update={"ros": True, "ros_domain": 7})})


@pytest.fixture
def sink(machine: Machine) -> Iterator[ZenohSink]:
    one = ZenohSink(machine)
    yield one
    one.close()


def pose(heading: float = 0.0, roll: float | None = 0.0) -> Pose:
    body = BodyPose(3.0, 5.0, 0.02, heading, 0.003, 4.0, 0.2, 0.03, 0.03, 0.1, 0.005, roll, 0.01)
    return replace(pose_of(4.0, 0.1, 0.02), t_ns=START_NS, utc_ns=UTC_NS, tractor=body, implement=body)


def sent(topic: str, value: Payload) -> bytes:
    return payload(Publication(START_NS, topic, value))


def estimate(status: Status) -> bytes:
    rows = tuple(ParameterEstimate(2e5, 1e4, status, None, 3.0) for _ in PARAMETERS)
    return sent("/soil_tire", Estimate(START_NS, "pem", "m", rows, (), ()))


def fix() -> bytes:
    message = LocationFix(latitude=43.5, longitude=-83.4, altitude=200.0, frame_id="tractor_front")
    message.position_covariance.extend([0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.04])
    message.position_covariance_type = LocationFix.APPROXIMATED
    message.timestamp.FromNanoseconds(START_NS)
    return message.SerializeToString()


def status() -> bytes:
    receiver = pb.ReceiverStatus(mount="tractor_front", state="alive", fix="rtk_fixed", per_s=10)
    return pb.Status(
        t_ns=START_NS,
        health="good",
        receivers=[receiver],
        buses=[pb.BusStatus(name="can0", state="open")],
        wheel_angle=pb.ReceiverStatus(state="lost", fault="no frame"),
    ).SerializeToString()


def everything(machine: Machine) -> list[tuple[str, bytes]]:
    frames = body_frames(machine, pose())
    assert frames is not None
    return [
        ("/pose", sent("/pose", pose())),
        ("/drawing/frames", sent("/drawing/frames", frames)),
        ("/status", status()),
        (f"/gnss/{Mount.TRACTOR_FRONT.value}", fix()),
        ("/soil_tire", estimate(Status.ESTIMATED)),
    ]


def one(messages: RosMessages, topic: str, data: bytes, name: str) -> Any:
    (found,) = [message.value for message in messages.of(topic, data) if message.topic.endswith(name)]
    return found


def test_keys_types_and_tokens_are_those_of_rmw_zenoh(sink: ZenohSink) -> None:
    with session(sink.endpoints) as other:
        tokens = [str(reply.ok.key_expr) for reply in other.liveliness().get("@ros2_lv/**") if reply.ok]
        (node,) = [token for token in tokens if "/NN/" in token]
        _, domain, _, _, _, _, enclave, namespace, name = node.split("/")
        assert (domain, enclave, namespace, name) == ("7", "%", f"%{OWN}", "tilth")
        publishers = {token.split("/")[9]: token.split("/") for token in tokens if "/MP/" in token}
        assert set(publishers) >= {f"%{OWN}%tractor%odometry", "%tf", "%diagnostics", f"%{OWN}%soil_tire"}
        assert len({parts[4] for parts in publishers.values()}) == len(publishers)
        kind, hashed, quality = publishers[f"%{OWN}%tractor%odometry"][10:]
        assert kind == "nav_msgs::msg::dds_::Odometry_" and quality == "::,10:,:,:,,"
        assert hashed == f"RIHS01_{HASHES['nav_msgs/msg/Odometry']}"


@pytest.mark.parametrize("kind", HASHES)
def test_a_type_has_the_hash_that_ros_gives_it(kind: str) -> None:
    assert STORE.hash_rihs01(kind) == f"RIHS01_{HASHES[kind]}"


def test_each_message_carries_its_number_its_time_and_its_publisher(
    sink: ZenohSink, machine: Machine
) -> None:
    with session(sink.endpoints) as other:
        samples: SimpleQueue[zenoh.Sample] = SimpleQueue()
        subscriber = other.declare_subscriber(f"7/{OWN}/soil_tire/**", samples.put)
        list(other.liveliness().get("@ros2_lv/**"))  # so the subscription is known
        for _ in range(2):
            sink.put("/soil_tire", estimate(Status.ESTIMATED))
        heard = [samples.get(timeout=PATIENCE_S) for _ in range(2)]
        told = []
        for sample in heard:
            assert sample.attachment is not None
            told.append(z_deserialize(tuple[Int64, Int64, bytes], sample.attachment))
            assert len(sample.attachment.to_bytes()) == 8 + 8 + 1 + 16
        assert [int(number) for number, _, _ in told] == [1, 2]
        assert told[0][2] == told[1][2] and len(told[0][2]) == 16 and told[0][1] <= told[1][1]
        read = STORE.deserialize_cdr(heard[0].payload.to_bytes(), "tilth_msgs/msg/SoilTireEstimate")
        assert [row.name for row in read.parameters] == list(PARAMETERS)  # type: ignore[attr-defined]
        subscriber.undeclare()
    sink.close()


@given(heading=st.floats(-math.pi, math.pi), roll=st.floats(-0.3, 0.3))
def test_a_pose_is_east_north_up_and_anticlockwise(heading: float, roll: float) -> None:
    messages = RosMessages(DEMO)
    odometry = one(messages, "/pose", sent("/pose", pose(heading, roll)), "tractor/odometry")
    at, turned = odometry.pose.pose.position, odometry.pose.pose.orientation
    assert (at.x, at.y) == (5.0, 3.0)
    yaw = 2 * math.atan2(turned.z, turned.w)
    assert math.remainder(yaw - (math.pi / 2 - heading), 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    linear, angular = odometry.twist.twist.linear, odometry.twist.twist.angular
    assert (linear.x, linear.y, angular.z) == (4.0, -0.2, -0.1)
    covariance = odometry.pose.covariance.reshape(6, 6)
    assert covariance[0, 0] == covariance[1, 1] == pytest.approx(0.02**2)
    assert covariance[5, 5] == pytest.approx(0.003**2) and covariance[2, 2] > 1e5
    stamp = odometry.header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == UTC_NS
    frames = body_frames(DEMO, pose(heading, roll))
    assert frames is not None
    rows = one(messages, "/drawing/frames", sent("/drawing/frames", frames), "tf").transforms
    by_child = {row.child_frame_id: row for row in rows}
    body = by_child[f"{OWN}/base_link"]
    assert body.header.frame_id == f"{OWN}/odom" and by_child[f"{OWN}/odom"].header.frame_id == f"{OWN}/map"
    for axis in "xyzw":
        assert getattr(body.transform.rotation, axis) == pytest.approx(getattr(turned, axis), abs=1e-12)


@pytest.mark.parametrize("one_status", Status)
def test_a_number_is_there_only_while_it_may_be_used(one_status: Status) -> None:
    read = one(RosMessages(DEMO), "/soil_tire", estimate(one_status), "soil_tire")
    for row in read.parameters:
        assert row.status == one_status and row.age == 3.0
        assert math.isnan(row.value) == math.isnan(row.sd) == (one_status is not Status.ESTIMATED)


def test_diagnostics_tell_what_does_not_work() -> None:
    rows = one(RosMessages(DEMO), "/status", status(), "diagnostics").status
    levels = {row.name.partition(": ")[2]: row.level for row in rows}
    assert levels == {"daemon": 0, "bus can0": 0, "tractor_front": 0, "wheel_angle": 2}


def test_a_replay_has_topics_and_frames_of_its_own(machine: Machine) -> None:
    live, replayed = RosMessages(machine), RosMessages(machine, replayed=True)
    assert not {topic.name for topic in live.topics} & {topic.name for topic in replayed.topics}
    assert all(topic.name.startswith(f"/{OWN}/replay/") for topic in replayed.topics)
    for topic, data in everything(machine):
        for message in replayed.of(topic, data):
            assert message.topic in {topic.name for topic in replayed.topics}
            header = getattr(message.value, "header", None)
            assert header is None or header.frame_id in ("", *(f"{OWN}/replay/{x}" for x in FRAMES))


@pytest.mark.parametrize(("suffix", "domain"), [("", "7"), ("replay", "100")])
def test_a_replay_is_never_heard_in_the_domain_of_the_tractor(
    suffix: str, domain: str, machine: Machine
) -> None:
    sink = ZenohSink(machine, suffix)
    messages = RosMessages(machine)
    topics = {one.topic for topic, data in everything(machine) for one in messages.of(topic, data)}
    of_ros = set[str]()

    def take(sample: zenoh.Sample) -> None:
        if "::dds_" in (key := str(sample.key_expr)):
            of_ros.add(key)

    def send() -> None:
        for topic, data in everything(machine):
            sink.put(topic, data)
            breath()

    with session(sink.endpoints) as other:
        heard = other.declare_subscriber("**", take)
        tokens = [str(reply.ok.key_expr) for reply in other.liveliness().get("@ros2_lv/**") if reply.ok]
        until(lambda: len(of_ros) >= len(topics), send)  # of many at once Zenoh drops some on a busy computer
        heard.undeclare()
    sink.close()
    assert {key.split("/")[0] for key in of_ros} == {token.split("/")[1] for token in tokens} == {domain}
    assert all(f"/{OWN}/replay/" in key for key in of_ros) == bool(suffix)


def test_replays_have_another_domain_than_the_tractor() -> None:
    with pytest.raises(ValueError, match="ros_replay_domain must not be ros_domain"):
        type(DEMO.zenoh)(ros_domain=100)


FRAMES = ("map", "odom", "base_link", "implement_link", "tractor_front")


@pytest.mark.parametrize(
    ("name", "topic"), [("jd7930-parker500", OWN), ("7930", "_7930"), ("a.b c", "a_b_c"), ("Hof_1", "Hof_1")]
)
def test_a_machine_name_becomes_part_of_a_topic(name: str, topic: str) -> None:
    assert ros_name(name) == topic


def test_without_the_package_a_sentence_says_what_to_install(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("rosbags", "rosbags.typesys"):
        monkeypatch.setitem(sys.modules, module, None)
    for module in ("tilth.logger.zenoh.ros_node", "tilth.logger.zenoh.ros_messages"):
        monkeypatch.delitem(sys.modules, module)
    sink = ZenohSink(machine)
    assert "tilth[ros]" in sink.note and "rosbags" in sink.note
    sink.put("/soil_tire", estimate(Status.ESTIMATED))
    assert sink.failures == 0
    sink.close()


@pytest.mark.rust
def test_another_implementation_of_ros_reads_all_of_it(sink: ZenohSink, machine: Machine) -> None:
    listener = in_rust(ROOT / "examples/ros2/listener")
    command = [str(listener), sink.endpoints[0], "7", f"/{OWN}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        head = [line.rstrip() for line in iter(running.stdout.readline, "listening\n")]
        assert f"node /{OWN} tilth" in head
        assert f"topic /{OWN}/tractor/odometry nav_msgs::msg::dds_::Odometry_" in head
        assert "topic /tf tf2_msgs::msg::dds_::TFMessage_" in head
        for topic, data in everything(machine):
            sink.put(topic, data)
        told = running.stdout.read()
        assert running.wait(PATIENCE_S) == 0
    assert f"odometry {OWN}/odom {OWN}/base_link 5.000 3.000 0.707107 0.707107" in told
    assert f"transform {OWN}/odom {OWN}/base_link" in told
    assert f"fix {OWN}/tractor_front 43.5000000 -83.4000000" in told
    assert f"estimate jd7930-parker500 pem {UTC_NS // 10**9}" in told
    assert told.count("parameter ") == 6 and "parameter C_af 1 200000.0 " in told


@pytest.mark.rust
def test_another_implementation_of_ros_hears_a_daemon_that_hears_a_tractor(tmp_path: Path) -> None:
    """`tilth run` in a process of its own, the virtual tractor on its bus, and the listener as a third."""
    listener = in_rust(ROOT / "examples/ros2/listener")
    tractor = FieldRig(tmp_path, 600.0)
    tractor.file.write_text(tractor.text.replace("[zenoh]\n", "[zenoh]\nros = true\nros_domain = 7\n"))
    tractor.start()
    try:
        place = ("127.0.0.1", int(tractor.endpoint.rpartition(":")[2]))

        def listens() -> bool:
            with socket.socket() as probe:
                return probe.connect_ex(place) == 0

        until(listens)
        words = [str(listener), tractor.endpoint, "7", f"/{OWN}"]
        heard = subprocess.run(words, capture_output=True, text=True, timeout=2 * PATIENCE_S, check=False)
    finally:
        tractor.close()
    assert heard.returncode == 0, heard.stderr
    nodes = re.findall(r"^node (\S+) (\S+)$", heard.stdout, re.M)
    assert (f"/{OWN}", "tilth") in nodes and not any("replay" in where for where, _ in nodes)
    (odometry,) = re.findall(
        rf"^odometry {OWN}/odom {OWN}/base_link (\S+) (\S+) (\S+) (\S+)$", heard.stdout, re.M
    )
    east, north, *turned = map(float, odometry)
    assert math.hypot(*turned) == pytest.approx(1.0, abs=0.01) and math.hypot(east, north) < 1e4
    (fix,) = re.findall(rf"^fix {OWN}/tractor_front (\S+) (\S+)$", heard.stdout, re.M)
    assert [float(degrees) for degrees in fix] == pytest.approx(list(ORIGIN_DEG), abs=0.1)
    assert f"transform {OWN}/odom {OWN}/implement_link" in heard.stdout
    assert heard.stdout.count("parameter ") == 6 and "diagnostic 0 " in heard.stdout
