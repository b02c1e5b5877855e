"""A log opens in the usual viewers: schemas that they know, a layout whose topics and fields are in it."""

import json
import math
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from circle import demo_machine
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from loopback import START_NS, TEXT
from mcap.reader import make_reader
from numpy.typing import NDArray
from paths import ROOT
from scipy.spatial.transform import Rotation

from tilth.estimator.fold import initial, step
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.schemas.flow import PARAMETERS, Mount
from tilth.schemas.machine_toml import MachineFile
from tilth.simulator.traffic import simulate

LAYOUT = ROOT / "deploy/foxglove/tilth.json"
PANELS = json.loads(LAYOUT.read_text())["configById"]
# Unlike the packaged ones, so that a length from elsewhere is seen.
LENGTHS = {"a": 1.9, "b": 1.3, "c": 2.4, "d": 4.0, "e": 0.25}
HEIGHTS = {"tractor": 1.05, "implement": 1.3}
MACHINE = demo_machine(
    **{
        f"\n{name} = {old}\n": f"\n{name} = {LENGTHS[name]}\n"
        for name, old in {"a": 1.7, "b": 1.2, "c": 2.1, "d": 3.62, "e": 0.1}.items()
    },
    **{"cg_height = 1.1\n": "cg_height = 1.05\n", "cg_height = 1.2\n": "cg_height = 1.3\n"},
)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a simulated drive."""
    path = tmp_path_factory.mktemp("foxglove") / "a.mcap"
    writer, state = LogWriter(path, MachineFile(MACHINE, TEXT), RunPart("r", 1, START_NS)), initial(MACHINE)
    for frame in simulate(MACHINE, 1, 12.0):
        writer.frame(frame)
        writer.publications(step(state, frame))
    writer.close()
    return path


@pytest.fixture(scope="module")
def found(log: Path) -> dict[str, Descriptor]:
    """Topic -> schema as the log itself tells it."""
    schemas: dict[str, Descriptor] = {}
    with log.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("protobuf", "protobuf")
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
            pool.Add(file)
        schemas[channel.topic] = pool.FindMessageTypeByName(schema.name)
    return schemas


def test_four_receivers_are_places_on_a_map(found: dict[str, Descriptor]) -> None:
    topics = {f"/gnss/{mount.value}" for mount in Mount}
    assert {found[topic].full_name for topic in topics} == {"foxglove.LocationFix"}
    assert set(PANELS["map!receivers"]["topicColors"]) == topics
    assert PANELS["map!receivers"]["followTopic"] in topics


def _plotted() -> Iterator[tuple[str, str]]:
    for name, panel in PANELS.items():
        for path in panel.get("paths", ()):
            yield name, path["value"]


@pytest.mark.parametrize(("panel", "path"), [*_plotted()])
def test_what_is_plotted_is_a_number_in_the_log(found: dict[str, Descriptor], panel: str, path: str) -> None:
    assert panel.startswith("Plot!")
    topic, *names = re.sub(r"\[:\]\{[^}]*\}", "", path).split(".")
    at: Any = found[topic]
    for name in names[:-1]:
        at = at.fields_by_name[name].message_type
    assert at.fields_by_name[names[-1]].cpp_type in (
        FieldDescriptor.CPPTYPE_DOUBLE,
        FieldDescriptor.CPPTYPE_ENUM,
    )
    for parameter in re.findall(r'name=="(\w+)"', path):
        assert parameter in PARAMETERS


def test_the_layout_shows_all_of_its_panels() -> None:
    def part_names(part: Any) -> set[str]:
        return {part} if isinstance(part, str) else part_names(part["first"]) | part_names(part["second"])

    assert part_names(json.loads(LAYOUT.read_text())["layout"]) == set(PANELS)


@pytest.fixture(scope="module")
def messages_of(log: Path, found: dict[str, Descriptor]) -> dict[str, list[Any]]:
    """Topic -> messages of the log, decoded by nothing but its own schemas."""
    kinds = {topic: message_factory.GetMessageClass(schema) for topic, schema in found.items()}
    messages: dict[str, list[Any]] = defaultdict(list)
    with log.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            messages[channel.topic].append(kinds[channel.topic].FromString(message.data))
    return messages


Matrix = NDArray[np.float64]


def _placed(transforms: Any) -> dict[str, Matrix]:
    """Frame -> from its coordinates to the world's, (4, 4). A parent that is not told is a KeyError."""
    placed: dict[str, Matrix] = {"world": np.eye(4)}
    for one in transforms:
        at, q = one.translation, one.rotation
        ours = np.eye(4)
        ours[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        ours[:3, 3] = at.x, at.y, at.z
        placed[one.child_frame_id] = placed[one.parent_frame_id] @ ours
    return placed


def _to_world(placed: dict[str, Matrix], frame: str, *point: float) -> Matrix:
    return np.asarray((placed[frame] @ [*point, 1.0])[:3])


def test_the_frames_of_a_moment_are_its_pose(messages_of: dict[str, list[Any]]) -> None:
    poses = {pose.t_ns: pose for pose in messages_of["/pose"]}
    assert len(poses) > 50 and len(messages_of["/drawing/frames"]) > 50
    gaps = []
    for message in messages_of["/drawing/frames"]:
        (t_ns,) = {one.timestamp.ToNanoseconds() for one in message.transforms}
        pose, placed = poses[t_ns], _placed(message.transforms)
        for name in ("tractor", "implement"):
            body = getattr(pose, name)
            assert _to_world(placed, name, 0, 0, 0)[:2] == pytest.approx([body.y, body.x])  # east, north
            ahead = placed[name][:3, 0]
            assert ahead == pytest.approx([math.sin(body.heading), math.cos(body.heading), 0.0], abs=1e-9)
            assert placed[name][2, 1] == pytest.approx(math.sin(body.roll))  # the left side, upwards
            below = _to_world(placed, name, 0, 0, -HEIGHTS[name])
            assert below[2] == pytest.approx(0.0, abs=1e-9)
        tractor, implement = [
            _to_world(placed, name, along, 0, 0.5 - HEIGHTS[name])
            for name, along in (("tractor", -LENGTHS["c"]), ("implement", LENGTHS["d"]))
        ]
        gaps.append(tractor - implement)
        wheel = placed["tractor"][:3, :3].T @ placed["tractor_front_left"][:3, 0]
        assert wheel == pytest.approx([math.cos(pose.wheel_angle), -math.sin(pose.wheel_angle), 0])
    # Both bodies meet at the hitch, half a metre above the ground, which no pose says.
    assert np.abs(np.median(gaps, axis=0)) == pytest.approx([0.0, 0.0, 0.0], abs=0.1)


def test_the_bodies_have_the_lengths_of_the_machine_file(messages_of: dict[str, list[Any]]) -> None:
    frames = _placed(messages_of["/drawing/frames"][-1].transforms)
    assert len(messages_of["/drawing/bodies"]) >= 3  # for who opens the log in its midst
    first, *others = messages_of["/drawing/bodies"]
    assert all(len(other.entities) == len(first.entities) for other in others)
    entities = {entity.id: entity for entity in first.entities}
    assert len(entities) == len(first.entities)
    assert {entity.frame_id for entity in first.entities} | {"world"} == set(frames)
    parts = {name: (entity.cubes or entity.cylinders)[0] for name, entity in entities.items()}
    for receiver in MACHINE.receiver:
        forward, right, height = receiver.position
        at, body = parts[receiver.mount.value].pose.position, receiver.mount.value.partition("_")[0]
        assert entities[receiver.mount.value].frame_id == body
        assert (at.x, -at.y, at.z + HEIGHTS[body]) == pytest.approx((forward, right, height))
    axles = {
        "front": (np.linalg.inv(frames["tractor"]) @ frames["tractor_front_right"])[0, 3],
        "rear": parts["tractor_rear_left"].pose.position.x,
        "implement": parts["implement_left"].pose.position.x,
    }
    wanted = {"front": LENGTHS["a"], "rear": -LENGTHS["b"], "implement": -LENGTHS["e"]}
    assert axles == pytest.approx(wanted)
    bar, tongue = parts["tractor_drawbar"], parts["implement_tongue"]
    assert bar.pose.position.x - bar.size.x / 2 == pytest.approx(-LENGTHS["c"])
    assert tongue.pose.position.x + tongue.size.x / 2 == pytest.approx(LENGTHS["d"])
    frame = parts["tractor_frame"]
    assert frame.size.x == pytest.approx(LENGTHS["a"] + LENGTHS["b"])


def test_the_panel_of_the_bodies_follows_a_frame_that_there_is(messages_of: dict[str, list[Any]]) -> None:
    panel = PANELS["3D!bodies"]
    frames = set(_placed(messages_of["/drawing/frames"][-1].transforms))
    assert panel["followTf"] in frames and panel["layers"]["ground"]["frameId"] in frames
    assert set(panel["topics"]) == {"/drawing/bodies"}
