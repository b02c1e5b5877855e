"""The page of messages is current; who adds a field must say what it is, in which unit, and since when."""

from pathlib import Path
from typing import Any

import pytest
from paths import ROOT

from tilth.analysis.runs.layout import unit_of
from tilth.deploy import wire_page
from tilth.deploy.wire_page import WireMessage, messages
from tilth.estimator.snapshot import VERSION
from tilth.schemas.channels import CHANNELS
from tilth.schemas.proto import tilth_pb2


@pytest.fixture(scope="module")
def found() -> dict[str, WireMessage]:
    return {message.name: message for message in messages()}


def test_the_page_is_current() -> None:
    page = (ROOT / wire_page.TARGET).read_text(encoding="utf-8")
    assert page == wire_page.text(), "uv run python -m tilth.deploy.generate"


def test_every_field_of_every_message_says_what_it_is(found: dict[str, WireMessage]) -> None:
    lacking = [one for message in found.values() for one in message.lacking]
    assert not lacking, "in schemas/proto/tilth.proto, whose head says how:\n" + "\n".join(lacking)
    for name, message in tilth_pb2.DESCRIPTOR.message_types_by_name.items():
        assert {row.name for row in found[name].fields} == set(message.fields_by_name)
    assert all(1 <= row.since <= VERSION for message in found.values() for row in message.fields)


@pytest.mark.parametrize(
    ("fields", "lacking"),
    [
        ("// since 3: 1\nmessage A { double x = 1; // m, north\n }", "A: say what it is"),
        ("// An a.\nmessage A { double x = 1; // m, north\n }", "A.x: its number is missing behind `since`"),
        (
            "// An a.\n// since 3: 1, 4-6; since 9: 8\nmessage A { double x = 2; // m, north\n }",
            "A.x: its number",
        ),
        ("// An a.\n// since 3: 1\nmessage A { double x = 1; }", "A.x: say what it is"),
        (
            "// An a.\n// since 3: 1\nmessage A { repeated double x = 1; // north\n }",
            "A.x: begin its comment",
        ),
        (
            "// An a.\n// since 3: 1\nmessage A { double x = 1; // furlong, north\n }",
            "A.x: begin its comment",
        ),
        ("// An a.\n// since 3: 1\nmessage A { double x = 1; // m, north\n }", ""),
        ("// An a.\n// since 3: 1-2\nmessage A { bool x = 2; // it is so\n }", ""),
        ("// An a.\n// since 3: 0\nenum A { X = 0; // none yet\n }", ""),
    ],
)
def test_what_a_comment_lacks_is_told(fields: str, lacking: str, tmp_path: Path) -> None:
    (tmp_path / "a.proto").write_text(f'syntax = "proto3";\npackage tilth;\n\n{fields}\n')
    (message,) = messages(tmp_path / "a.proto")
    assert [one for one in message.lacking if lacking and one.startswith(lacking)] or not lacking
    assert bool(message.lacking) == bool(lacking)


def _units(topic: str, one: Any, found: dict[str, WireMessage]) -> None:
    for row in found[one.full_name.removeprefix("tilth.")].fields:
        field = one.fields_by_name[row.name]
        if field.message_type is not None:
            if field.message_type.name in ("BodyPose", "Parameter", "OwnSteering"):
                _units(topic, field.message_type, found)
            continue
        if row.unit in ("", "1", "unit of the value"):
            continue
        allowed = {"bytes": ("byte",), "1/s": ("",)}.get(row.unit, tuple(row.unit.split(" or ")))
        for repetition in ("C_af", "sigma_f") if one.name == "Parameter" else ("",):
            assert unit_of(topic, row.name, repetition) in allowed, (one.name, row.name)


@pytest.mark.parametrize("topic", ["/pose", "/soil_tire", "/status", "/rig", "/load"])
def test_units_are_those_of_the_tables_of_logs(topic: str, found: dict[str, WireMessage]) -> None:
    (channel,) = (channel for channel in CHANNELS if channel.topic == topic)
    _units(topic, channel.message.DESCRIPTOR, found)
