"""Which columns the messages of a channel have, from their Protobuf definition.

The name of each ends with its unit, unless it has none: `tractor_yaw_rate_radps`.

What a later version adds to the messages gets a column by itself; a test asks for its unit.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, Final

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message as ProtoMessage

from tilth.schemas import message_columns as wire
from tilth.schemas.channels import CHANNEL, KINDS, TOPIC_OF
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.message_columns import WireLayout

UNITS: Final[dict[str, str]] = {
    "sd_time": "s", "x": "m", "y": "m", "sd_position": "m", "heading": "rad", "sd_heading": "rad",
    "course": "rad", "forward_velocity": "m/s", "lateral_velocity": "m/s", "sd_velocity": "m/s",
    "sd_lateral_velocity": "m/s", "speed": "m/s", "yaw_rate": "rad/s", "sd_yaw_rate": "rad/s", "roll": "rad",
    "sd_roll": "rad", "pitch": "rad", "articulation": "rad", "sd_articulation": "rad", "wheel_angle": "rad",
    "sd_wheel_angle": "rad", "angle": "rad", "curvature": "1/m", "latitude": "deg", "longitude": "deg",
    "altitude": "m", "disk_free_bytes": "byte", "log_bytes": "byte", "hours_left": "h", "d": "m", "e": "m",
    "a": "m", "b": "m", "c": "m", "h_t": "m", "h_i": "m", "m_t": "kg", "m_i": "kg", "I_t": "kg m^2",
    "I_i": "kg m^2", "rms": "rad", "seconds": "s", "mass": "kg", "whole_mass": "kg",
    "carried_mass": "kg", "full_load": "kg",
}  # fmt: skip
"""Of fields whose name does not end with its unit."""
_IN_NAMES: Final = {"s": "s", "ns": "ns", "m": "m", "deg": "deg"}
WITHOUT_UNIT: Final = frozenset({
    "bus", "source", "name", "mount", "pgn", "sid", "repeat", "fix", "satellites", "hdop", "direction",
    "manufacturer", "identity", "receivers", "flags", "status", "reason", "method", "model", "rank",
    "condition", "rule", "determined", "advice", "bound", "log_covariance", "kind", "text", "adopted",
    "awaited", "ready", "run", "version", "frames", "measurements", "poses", "recording", "log_file",
    "problems", "health", "resting", "preparing", "frame_id", "state", "fault", "position_covariance_type",
    "per_s", "what", "machine_sha256", "share", "this_pass", "neighbours", "prior", "result", "job_sha256",
    "implement", "implements", "statistic", "threshold", "above",
})  # fmt: skip
"""Texts, counts, codes, ratios, natural logarithms."""
SUFFIXES: Final = {
    "m": "m", "rad": "rad", "m/s": "mps", "rad/s": "radps", "1/m": "per_m", "deg": "deg", "s": "s",
    "ns": "ns", "N/rad": "N_per_rad", "kg": "kg", "kg m^2": "kg_m2", "h": "h", "byte": "bytes",
    "m/s^2/rad": "mps2_per_rad",
}  # fmt: skip
SD_UNITS: Final = {"position": "m", "velocity": "m/s", "heading": "rad", "yaw_rate": "rad/s",
                   "attitude": "rad", "time": "s", "wheel_angle": "rad", "load": "kg"}  # fmt: skip
"""Of the sd of each kind of measurement that has one."""
LENGTHS: Final = {"log_covariance": 36, "bound": 6}  # of lists of doubles
_WHOLE: Final = {FieldDescriptor.TYPE_SINT32: wire.ZIGZAG, FieldDescriptor.TYPE_SINT64: wire.ZIGZAG}
_IN_WORDS: Final = ("Reason", "Advice", "Notice")  # messages whose words stand in a field beside them
_NAME: Final = "name"  # of a device, 64 bits: no number to reckon with
_OF_ALL: Final = ("t_ns", "rx_ns", "bus", "source", _NAME, "mount", "pgn", "sid")
_KIND: Final = {TOPIC_OF[kind]: kind for _, kind in KINDS}
Reader = Callable[[Any], Any]  # message -> what stands in a column of texts


@dataclass(frozen=True, slots=True)
class TableColumn:
    """One column. kind: DOUBLE, INTEGER, HASHED or DOUBLES of message_columns.py; number: its place among
    those of its kind."""

    name: str
    unit: str
    kind: int
    number: int
    optional: bool = False  # may be absent
    width: int = 1
    read: Reader | None = None  # of HASHED
    type: Any = np.float64  # numpy's, of the values; texts aside


@dataclass(frozen=True, slots=True)
class ChannelLayout:
    """Of the messages of a channel."""

    message: type[ProtoMessage]
    columns: tuple[TableColumn, ...]
    wire: WireLayout
    counts: Mapping[int, int]  # kind -> columns that `wire.fill` fills; of DOUBLE with those of DOUBLES


def with_unit(name: str, unit: str) -> str:
    """A column's name with its unit at the end, once."""
    suffix = SUFFIXES[unit] if unit else ""
    return name if not suffix or name.endswith(f"_{suffix}") else f"{name}_{suffix}"


def unit_of(topic: str, field: str, repetition: str = "") -> str:
    """Unit of a field, "" for none. repetition: the parameter that it is of. Raises KeyError."""
    if repetition and field in ("value", "sd"):
        return "N/rad" if repetition.startswith("C_") else "m"
    if field in ("per_mass", "per_mass_sd"):
        return "m/s^2/rad"
    if field == "sd":
        return SD_UNITS.get(topic.rpartition("/")[2], "")
    if field in WITHOUT_UNIT:
        return ""
    return UNITS[field] if field in UNITS else _IN_NAMES[field.rpartition("_")[2]]


@cache
def layout_of(topic: str) -> ChannelLayout:
    """Columns of a row of CHANNELS: of its message, and of the messages in it that come once or, as the
    parameters do, in a known order. Of a measurement those that its kind has."""
    message = CHANNEL[topic].message
    making = _Making(topic, _fields(message.DESCRIPTOR))
    for field in making.fields:
        making.add(field)
    columns = tuple(column for column in making.columns if _belongs(topic, column))
    return ChannelLayout(message, columns, making.table, making.counts)


def _belongs(topic: str, column: TableColumn) -> bool:
    """Whether a kind of measurement has this column."""
    kind = _KIND.get(topic)
    return kind is None or any(
        column.name == name or column.name.startswith(f"{name}_")
        for name in (*_OF_ALL, *(field.name for field in fields(kind)))
    )


class _Making:
    """A layout that is being made, field by field."""

    def __init__(self, topic: str, outer: Sequence[FieldDescriptor]) -> None:
        self.topic = topic
        self.fields = outer
        self.columns: list[TableColumn] = []
        self.counts = {wire.DOUBLE: 0, wire.INTEGER: 0, wire.HASHED: 0}
        nodes = [outer, *(_fields(field.message_type) for field in outer if field.message_type)]
        shape = len(nodes), max(field.number for node in nodes for field in node) + 1
        kind, column, stride, most = (np.zeros(shape, np.int64) for _ in range(4))
        self.table = WireLayout(kind, column, stride, most)
        self._nodes = 0

    def add(self, field: FieldDescriptor) -> None:
        """Add the columns of a field of the message."""
        if field.message_type is None:
            self._column(0, field, field.name, "", _reader(field.name))
            return
        self._nodes += 1
        repetitions = PARAMETERS if field.is_repeated else ("",)
        self.table.kind[0, field.number], self.table.column[0, field.number] = wire.MESSAGE, self._nodes
        self.table.most[0, field.number] = len(repetitions)
        inner = [row for row in _fields(field.message_type) if not (field.is_repeated and row.name == _NAME)]
        for turn, parameter in enumerate(repetitions):
            before = dict(self.counts)
            for row in inner:
                name = f"{parameter or field.name}_{row.name}".removesuffix("_value")
                read = _reader(field.name, turn if parameter else None, row.name)
                self._column(0 if turn else self._nodes, row, name, parameter, read)
            if not turn:
                for row in inner:
                    width = self.counts[_counted(row)] - before[_counted(row)]
                    self.table.stride[self._nodes, row.number] = width

    def _column(self, node: int, field: FieldDescriptor, name: str, parameter: str, read: Reader) -> None:
        """Add a column; node 0 of a field within: it has its entry from the first repetition."""
        kind, counted, unit = _kind(field), _counted(field), unit_of(self.topic, field.name, parameter)
        width = LENGTHS[field.name] if kind == wire.DOUBLES else 1
        column = TableColumn(
            with_unit(name, unit), unit, kind, self.counts[counted],
            field.has_presence or kind == wire.DOUBLES, width,
            read if kind == wire.HASHED else None, _type(field),
        )  # fmt: skip
        self.counts[counted] += width
        self.columns.append(column)
        if node or field in self.fields:
            wired = _WHOLE.get(field.type, kind) if kind == wire.INTEGER else kind
            self.table.kind[node, field.number], self.table.column[node, field.number] = wired, column.number
            self.table.most[node, field.number] = width


def _fields(descriptor: Any) -> list[FieldDescriptor]:
    """The fields of a message that have columns: not lists of messages (`Run.nuisances` reads those of
    estimates), parameters aside, and not what only viewers need."""
    return [field for field in descriptor.fields if _has_columns(field)]


def _has_columns(field: FieldDescriptor) -> bool:
    if field.message_type is not None:
        name, ours = field.message_type.name, field.message_type.file.package == "tilth"
        return ours and name not in _IN_WORDS and (not field.is_repeated or name == "Parameter")
    return not field.is_repeated or _is_text(field) or field.name in LENGTHS


def _is_text(field: FieldDescriptor) -> bool:
    return field.type in (FieldDescriptor.TYPE_STRING, FieldDescriptor.TYPE_BYTES)


def _type(field: FieldDescriptor) -> Any:
    if _counted(field) == wire.DOUBLE:
        return np.float64
    if field.type == FieldDescriptor.TYPE_BOOL:
        return np.bool_
    return np.uint64 if field.name == _NAME else np.int64


def _kind(field: FieldDescriptor) -> int:
    """DOUBLE, INTEGER, HASHED or DOUBLES."""
    if field.type == FieldDescriptor.TYPE_DOUBLE:
        return wire.DOUBLES if field.is_repeated else wire.DOUBLE
    return wire.HASHED if _is_text(field) else wire.INTEGER


def _counted(field: FieldDescriptor) -> int:
    """The kind with which a field's columns are numbered."""
    kind = _kind(field)
    return wire.DOUBLE if kind == wire.DOUBLES else kind


def _reader(*path: str | int | None) -> Reader:
    """What stands in a message at this path: a text; of a list its texts, divided by commas."""

    def read(message: Any) -> str:
        found = message
        for step in path:
            if isinstance(step, int):
                found = found[step] if step < len(found) else ""
            elif step is not None:
                found = getattr(found, step, "")
        return found if isinstance(found, str) else ", ".join(map(str, found))

    return read
