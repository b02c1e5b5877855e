"""The wheel holds every module and data file of the tree, and the generated files are up to date."""

import json
import zipfile
from email import message_from_bytes
from pathlib import Path
from types import ModuleType

import pytest
from google.protobuf import descriptor_pb2
from grpc_tools import protoc
from paths import ROOT

from tilth.deploy import motion_equations, observation_equations
from tilth.schemas.machine import Machine
from tilth.schemas.proto import tilth_pb2

FOLDERS = (
    "schemas", "estimator", "logger", "replay", "simulator", "analysis", "client", "monitor", "cli", "deploy",
)  # fmt: skip
SHIPPED = {
    ".py", ".pyi", ".proto", ".json", ".toml", ".txt", ".service", ".rules", ".sysusers", ".sysctl",
    ".timesyncd", ".html", ".js", ".css", ".svg",
}  # fmt: skip


def in_the_tree(name: str) -> str:
    """Where a file of the wheel is in the checkout."""
    place = name.removeprefix("tilth/")
    return f"examples/{place}" if place.startswith(("adaptive_guidance/", "ros2/")) else place


def test_the_licences_of_what_it_ships_are_in_the_wheel(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as content:
        (record,) = (name for name in content.namelist() if name.endswith(".dist-info/METADATA"))
        metadata = message_from_bytes(content.read(record))
        found = {
            name: content.read(f"{record.rpartition('/')[0]}/licenses/{name}").decode()
            for name in metadata.get_all("License-File", [])
        }
    assert metadata["License-Expression"] == "Apache-2.0 AND MIT"
    assert "Leon Sorokin" in found["monitor/page/uplot/LICENSE"] and "Apache License" in found["LICENSE"]
    # What is none of ours stands in a folder of its own, with its licence, and in NOTICE.
    for licence in (path for folder in FOLDERS for path in (ROOT / folder).rglob("*LICEN*")):
        place = str(licence.relative_to(ROOT))
        assert place in found and place in found["NOTICE"]


def test_the_wheel_is_complete(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    tree = {
        f"tilth/{path.relative_to(ROOT)}"
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("*")
        if path.suffix in SHIPPED and "__pycache__" not in path.parts
    }
    assert tree - names == set()
    assert not [name for name in names if "studies" in name or "dissertation/" in name]
    made = {name for name in names if ".dist-info/" in name or name.startswith("tilth/estimator/kernels/")}
    assert {name for name in names if not (ROOT / in_the_tree(name)).exists()} <= made
    assert wheel.name.startswith("tilth-") and "-py3-none-linux_" in wheel.name
    compiled = " ".join(made)
    assert all(f".{name}-" in compiled for name in ("over_ticks", "rate_jacobians"))
    assert {name for name in names if name.startswith("tilth/schemas/proto/")} >= {
        "tilth/schemas/proto/tilth.proto"
    }


def test_the_generated_protobuf_module_is_that_of_the_proto_file(tmp_path: Path) -> None:
    folder = ROOT / "schemas" / "proto"
    target = tmp_path / "set.bin"
    assert (
        protoc.main(["protoc", f"-I{folder}", f"--descriptor_set_out={target}", str(folder / "tilth.proto")])
        == 0
    )
    wanted = descriptor_pb2.FileDescriptorSet.FromString(target.read_bytes()).file[0]
    shipped = descriptor_pb2.FileDescriptorProto()
    tilth_pb2.DESCRIPTOR.CopyToProto(shipped)
    for message in (*wanted.message_type, *shipped.message_type):
        for one in (message, *message.nested_type):
            for field in one.field:
                field.ClearField("json_name")
    assert shipped == wanted, "run `python -m tilth.deploy.generate` after a change of tilth.proto"


def test_the_shipped_json_schema_is_that_of_the_machine_file() -> None:
    shipped = json.loads((ROOT / "schemas" / "machine.schema.json").read_text())
    assert shipped == Machine.model_json_schema(), (
        "run `python -m tilth.deploy.generate` after a change of it"
    )


@pytest.mark.parametrize("equations", [motion_equations, observation_equations], ids=["motion", "sensors"])
def test_the_kernels_are_those_of_their_equations(equations: ModuleType) -> None:
    shipped = (ROOT / equations.TARGET).read_text()
    assert shipped == equations.source(), (
        "run `python -m tilth.deploy.generate` after a change of equations, UNKNOWNS or STATES"
    )


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_checkers_find_each_folder(folder: str) -> None:
    assert (ROOT / ".typing" / "tilth" / folder).resolve() == ROOT / folder
