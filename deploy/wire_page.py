"""docs/wire.md: every message and field that is logged or published. `deploy/generate.py` writes it.

What it says of a field stands in the comments of schemas/proto/tilth.proto, whose head has their rules.
"""

import re
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from subprocess import run
from typing import Any, Final

from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FieldDescriptorProto,
    FileDescriptorSet,
)

from tilth.schemas.channels import CHANNELS, Channel
from tilth.schemas.tolerances import TOLERANCES

TARGET: Final = "docs/wire.md"
PROTO: Final = Path(__file__).resolve().parents[1] / "schemas/proto/tilth.proto"
UNITS: Final = (
    "m", "rad", "deg", "m/s", "rad/s", "1/m", "1/s", "s", "h", "kg", "kg m^2", "N/rad", "m/s^2/rad", "1",
    "SI", "unit of the value",
)  # fmt: skip
OF_NAMES: Final = {"ns": "ns", "s": "s", "m": "m", "deg": "deg", "bytes": "bytes"}
"""End of a field's name -> its unit."""
_ONE_UNIT: Final = "|".join(re.escape(unit) for unit in sorted(UNITS, key=len, reverse=True))
_UNIT: Final = re.compile(rf"((?:{_ONE_UNIT})(?: or (?:{_ONE_UNIT}))*), (.*)")
_SINCE: Final = re.compile(r"since (\d+): ([\d, -]+)(?:; |$)")
_FILE: Final = re.compile(r"(?<![\w/`])((?:docs|schemas|estimator|examples)/[\w./-]+\.(?:md|py|proto))")
_SHORTEST: Final = 3  # letters that can say anything
_MESSAGE, _ENUM, _NESTED, _FIELD, _VALUE = 4, 5, 3, 2, 2  # of descriptor.proto, as paths in it have them
_HEAD: Final = """# Messages

Written by `python -m tilth.deploy.generate` from [schemas/proto/tilth.proto](../schemas/proto/tilth.proto)
and the table `CHANNELS` in [schemas/channels.py](../schemas/channels.py).

Logs are [MCAP](https://mcap.dev); the network is [Zenoh](https://zenoh.io). Both carry the same bytes,
messages in [Protobuf](https://protobuf.dev) (proto3). A log contains the definitions of its messages, so
any MCAP reader can open it. On Zenoh, values are published on `PREFIX/MACHINE/KEY`, such as
`tilth/jd7930-parker500/pose`, with the encoding `application/protobuf;tilth.Pose`; a replay or
simulation has `replay/` before the key. For rates, ages, and behaviour when something fails, see
[client.md](client.md#what-you-can-count-on).

To read messages, use [examples/subscriber.py](../examples/subscriber.py) in Python, or
[the client](client.md); [examples/consumer-rust](../examples/consumer-rust) in Rust;
[examples/consumer-cpp](../examples/consumer-cpp) in C++. For other languages, compile
`tilth.proto` with `protoc`. For logs as tables, see [export.md](export.md).

## Topics

| topic in a log | key on Zenoh | message | same in a replay |
|---|---|---|---|
"""
_TELLS: Final = """
`/can/BUS` has the raw frames; everything else is computed from them. Messages that are only on the
network have the topic –, those that are only in the log have the key –. Orders and answers of the
report, the player, experiments and calibrations have their own keys, given with their messages below.
Messages named `foxglove.…` are
[Foxglove's](https://docs.foxglove.dev/docs/visualization/message-schemas/introduction); the frames and axes
of the drawing are in [notation.md](notation.md#frames).

## Fields

World frame: x north, y east. Body frames: x forward, y right, z down. Headings and courses clockwise from
true north; right turns and wheels turned right positive; roll positive right side down, pitch nose up.
Symbols and words: [notation.md](notation.md).

- **type**: with `?`, the field may be absent, which is not 0
  ([why that matters](../schemas/proto/tilth.proto)).
  `[]`: any number of them.
- **unit**: – for texts, booleans, counts and codes; 1 for ratios and for natural logarithms. `ns`
  is on the log's clock unless it says UTC.
- **tolerance**: how much a replay on another kind of processor may differ: in the field's unit, for
  numbers above one as a fraction of the number; next to an `sd` in sds. Without a tolerance, the value is
  equal everywhere or not part of a replay ([schemas/tolerances.py](../schemas/tolerances.py)).
- **since**: the version of the estimator's state when the field was added (`version` in the
  `state_json` of a log's [snapshots](#snapshot)). Logs of later versions have the field; some of this
  version may lack it. Fields are added; their meaning never changes.
"""


@dataclass(frozen=True, slots=True)
class WireField:
    """One row."""

    number: int
    name: str
    type: str
    unit: str
    meaning: str
    since: int  # version of the estimator's state; 0 where it is not told


@dataclass(frozen=True, slots=True)
class WireMessage:
    """One message or enumeration."""

    name: str
    meaning: str
    fields: tuple[WireField, ...]
    lacking: tuple[str, ...]  # what its comments do not say


def messages(proto: Path = PROTO) -> list[WireMessage]:
    """In the order of the file. Raises CalledProcessError where protoc refuses it."""
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "set"
        command = ["-m", "grpc_tools.protoc", f"-I{proto.parent}", "--include_source_info"]
        run([sys.executable, *command, f"--descriptor_set_out={made}", str(proto)], check=True)
        (file,) = FileDescriptorSet.FromString(made.read_bytes()).file
    places = {tuple(place.path): place for place in file.source_code_info.location}
    comments = {
        path: " ".join(f"{place.leading_comments} {place.trailing_comments}".split())
        for path, place in places.items()
    }
    found = [
        *_below((_MESSAGE,), file.message_type, "", comments),
        *((path, _enumeration(one, path, comments)) for path, one in _numbered((_ENUM,), file.enum_type)),
    ]
    return [message for path, message in sorted(found, key=lambda row: tuple(places[row[0]].span))]


def text() -> str:
    """The page. Raises ValueError where a comment lacks something."""
    found = messages()
    if lacking := [one for message in found for one in message.lacking]:
        raise ValueError("; ".join(lacking))
    topics = [
        ("`/can/BUS`", "–", _link("CanFrame"), "it is the input"),
        *((f"`{one.topic}`" if one.logged else "–", *_told_of(one)) for one in CHANNELS),
        ("`/snapshot`", "–", _link("Snapshot"), ""),
    ]
    rows = "".join(f"| {' | '.join(row)} |\n" for row in topics)
    return _HEAD + rows + _TELLS + "".join(map(_section, found))


def _told_of(channel: Channel) -> tuple[str, str, str]:
    name = channel.message.DESCRIPTOR.full_name
    message = _link(name.removeprefix("tilth.")) if name.startswith("tilth.") else name
    return f"`{channel.key}`" if channel.key else "–", message, "yes" if channel.identical else ""


def _link(name: str) -> str:
    return f"[{name}](#{name.replace('.', '').lower()})"


_Path = tuple[int, ...]
_Comments = Mapping[_Path, str]


def _numbered(path: _Path, rows: Sequence[Any]) -> Iterator[tuple[_Path, Any]]:
    return (((*path, k), row) for k, row in enumerate(rows))


def _below(
    path: _Path, rows: Sequence[DescriptorProto], within: str, comments: _Comments
) -> Iterator[tuple[_Path, WireMessage]]:
    for at, one in _numbered(path, rows):
        name = f"{within}{one.name}"
        told = [
            (field.number, field.name, _type_of(field), comments.get((*at, _FIELD, k), ""))
            for k, field in enumerate(one.field)
        ]
        yield at, _message(name, comments.get(at, ""), told)
        yield from _below((*at, _NESTED), one.nested_type, f"{name}.", comments)


def _enumeration(one: EnumDescriptorProto, path: _Path, comments: _Comments) -> WireMessage:
    told = [
        (value.number, value.name, "", comments.get((*path, _VALUE, k), ""))
        for k, value in enumerate(one.value)
    ]
    return _message(one.name, comments.get(path, ""), told)


def _message(name: str, comment: str, told: Sequence[tuple[int, str, str, str]]) -> WireMessage:
    """told: number, name, type and comment of each field."""
    meaning = _SINCE.split(comment)[0].strip()
    since = {number: int(one[1]) for one in _SINCE.finditer(comment) for number in _numbers(one[2])}
    fields = tuple(
        WireField(number, field, kind, *_unit_and_meaning(field, words), since.get(number, 0))
        for number, field, kind, words in told
    )
    lacking = [] if meaning else [f"{name}: say what it is in a comment above it"]
    for row in fields:
        if not row.since:
            lacking.append(f"{name}.{row.name}: its number is missing behind `since` above the message")
        if len(row.meaning) < _SHORTEST:
            lacking.append(f"{name}.{row.name}: say what it is in a comment")
        if not row.unit and row.type.startswith("double"):
            lacking.append(f"{name}.{row.name}: begin its comment with its unit and a comma")
    return WireMessage(name, meaning, fields, tuple(lacking))


def _numbers(ranges: str) -> Iterator[int]:
    for part in ranges.split(","):
        first, _, last = part.partition("-")
        yield from range(int(first), int(last or first) + 1)


def _unit_and_meaning(name: str, comment: str) -> tuple[str, str]:
    if found := _UNIT.fullmatch(comment):
        return found[1], found[2]
    return ("1/s" if name.endswith("per_s") else OF_NAMES.get(name.rpartition("_")[2], "")), comment


def _type_of(field: FieldDescriptorProto) -> str:
    named = field.type_name.removeprefix(".tilth.")
    kind = _link(named) if named else FieldDescriptorProto.Type.Name(field.type)[5:].lower()
    if field.label == FieldDescriptorProto.LABEL_REPEATED:
        return f"{kind}[]"
    return f"{kind}?" if field.proto3_optional else kind


def _section(message: WireMessage) -> str:
    tolerances = TOLERANCES.get(message.name, {})
    lines = [
        f"| {row.number} | `{row.name}` | {row.type or '–'} | {row.unit or '–'} | {_marked(row.meaning)} "
        f"| {tolerances.get(row.name, '')} | {row.since} |\n"
        for row in message.fields
    ]
    heads = "| | field | type | unit | meaning | tolerance | since |\n|---|---|---|---|---|---|---|\n"
    return f"\n### {message.name}\n\n{_marked(message.meaning)}\n\n{heads}{''.join(lines)}"


def _marked(words: str) -> str:
    """Comments as Markdown has them: files are links, and a bar is none of the table's."""

    def linked(found: re.Match[str]) -> str:
        path = found[1]
        return f"[{path}]({path.removeprefix('docs/') if path.startswith('docs/') else f'../{path}'})"

    return _FILE.sub(linked, words).replace(" | ", " \\| ")
