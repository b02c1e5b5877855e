"""A log opens in the usual viewers: schemas that they know, a layout whose topics and fields are in it."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from circle import demo_machine
from google.protobuf import descriptor_pb2, descriptor_pool
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from loopback import START_NS, TEXT
from mcap.reader import make_reader

from tilth.estimator.fold import initial, step
from tilth.logger.mcap_log import LogWriter, Run
from tilth.replay.traffic import simulate
from tilth.schemas.flow import PARAMETERS, Mount

LAYOUT = Path(__file__).resolve().parents[1] / "deploy/foxglove/tilth.json"
PANELS = json.loads(LAYOUT.read_text())["configById"]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Descriptor]:
    """Topic -> schema as the log itself tells it, of a simulated drive."""
    path = tmp_path_factory.mktemp("foxglove") / "a.mcap"
    machine = demo_machine()
    writer, state = LogWriter(path, machine, TEXT, Run("r", 1, START_NS)), initial(machine)
    for frame in simulate(machine, 1, 3.0):
        writer.frame(frame)
        writer.publications(step(state, frame))
    writer.close()
    schemas: dict[str, Descriptor] = {}
    with path.open("rb") as stream:
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
    def shown(part: Any) -> set[str]:
        return {part} if isinstance(part, str) else shown(part["first"]) | shown(part["second"])

    assert shown(json.loads(LAYOUT.read_text())["layout"]) == set(PANELS)
