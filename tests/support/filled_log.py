"""A log with messages of every channel, each field filled at random or left out, and what was put into it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from logs import MACHINE, MACHINE_TEXT, START_NS, some_frames

from tilth.analysis.runs.layout import LENGTHS, unit_of, with_unit
from tilth.analysis.runs.run import topics
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import PARAMETERS, Frame
from tilth.schemas.machine_toml import MachineFile

STEP_NS = 37_000_123
WORDS = ("", "wet", 'said "so", twice', "line\nbreak", "können")
Filled = dict[str, list[tuple[int, Any]]]  # topic -> (t_ns, message)


def filled_log(
    path: Path, count: int = 40, seed: int = 3, run: str = "rig_20231114T221320Z", part: int = 1,
    chunk_kilobytes: int = 4,
) -> tuple[Filled, list[Frame]]:  # fmt: skip
    """Write a part of a run; of each channel so many messages, and as many frames."""
    rng = np.random.default_rng(seed)
    log = MACHINE.log.model_copy(update={"chunk_kilobytes": chunk_kilobytes})
    began_ns = START_NS + (part - 1) * count * STEP_NS
    writer = LogWriter(
        path, MachineFile(MACHINE.model_copy(update={"log": log}), MACHINE_TEXT), RunPart(run, part, START_NS)
    )
    sent: Filled = {topic: [] for topic in topics()}
    frames = []
    for k, frame in enumerate(some_frames(count, seed)):
        t_ns = began_ns + k * STEP_NS
        frames.append(Frame(t_ns, t_ns - 1000, frame.bus, frame.can_id, k % 3 > 0, k % 5 == 0, frame.data))
        writer.frame(frames[-1])
        for topic, rows in sent.items():
            message = CHANNEL[topic].message()
            _fill(message, rng)
            for name in ("t_ns", "rx_ns"):
                if name in message.DESCRIPTOR.fields_by_name:
                    setattr(message, name, t_ns)
            writer.message(topic, t_ns, message.SerializeToString())
            rows.append((t_ns, message))
    writer.close()
    return sent, frames


def _fill(message: Any, rng: np.random.Generator) -> None:
    for field in message.DESCRIPTOR.fields:
        if field.message_type is not None:
            if field.name == "parameters":
                for name in PARAMETERS:
                    inner = message.parameters.add()
                    _fill(inner, rng)
                    inner.name = name
            elif field.message_type.name in ("Reason", "Notice"):
                continue  # of itself, so without end
            elif not field.is_repeated and field.message_type.file.package == "tilth":
                _fill(getattr(message, field.name), rng)
                getattr(message, field.name).SetInParent()
        elif rng.random() < 0.8:
            if field.is_repeated:
                many = LENGTHS.get(field.name, 2)
                getattr(message, field.name).extend(_value(field, rng) for _ in range(many))
            else:
                setattr(message, field.name, _value(field, rng))


def _value(field: FieldDescriptor, rng: np.random.Generator) -> Any:
    if field.type == FieldDescriptor.TYPE_STRING:
        return str(rng.choice(WORDS))
    if field.type == FieldDescriptor.TYPE_BOOL:
        return bool(rng.integers(2))
    if field.type == FieldDescriptor.TYPE_DOUBLE:
        return float("inf") if field.name == "bound" and rng.random() < 0.2 else float(rng.normal())
    if field.type == FieldDescriptor.TYPE_ENUM:
        return int(rng.integers(4))
    if field.name == "name":
        return int(rng.integers(1 << 63, dtype=np.uint64)) * 2 + 1
    return int(rng.integers(100))


def expected(topic: str, message: Any) -> dict[str, Any]:
    """What stands in the columns for a message, read from it field by field; None where it is absent."""
    found: dict[str, Any] = {}
    for name, unit_name, parameter, holder in _places(message):
        if unit_name in ("t_ns", "rx_ns") or unit_name not in holder.DESCRIPTOR.fields_by_name:
            continue
        field = holder.DESCRIPTOR.fields_by_name[unit_name]
        value = getattr(holder, unit_name)
        if field.name in LENGTHS and field.is_repeated:
            labels = [f"{a}_{b}" for a in PARAMETERS for b in PARAMETERS] if len(value) == 36 else PARAMETERS
            found |= {f"{name}_{label}": one for label, one in zip(labels, value, strict=False)}
            continue
        text = field.type == FieldDescriptor.TYPE_STRING
        if field.message_type is not None or (field.is_repeated and not text):
            continue  # position_covariance is no column
        if field.is_repeated:
            value = ", ".join(map(str, value))
        elif field.has_presence and not holder.HasField(unit_name):
            value = "" if isinstance(value, str) or unit_name == "name" else None
        elif unit_name == "name" and isinstance(value, int):
            value = f"{value:016X}"
        found[with_unit(name, unit_of(topic, unit_name, parameter))] = value
    return found


def _places(message: Any) -> Iterator[tuple[str, str, str, Any]]:
    """(column's name without unit, field, parameter, the message that has the field)."""
    for field in message.DESCRIPTOR.fields:
        if field.message_type is None:
            yield field.name, field.name, "", message
        elif field.name == "parameters":
            for row in message.parameters:
                for inner in row.DESCRIPTOR.fields:
                    if inner.name != "name":
                        yield f"{row.name}_{inner.name}".removesuffix("_value"), inner.name, row.name, row
        elif field.message_type.name in ("Reason", "Advice", "Notice"):
            continue  # the words beside it are a column
        elif field.message_type.file.package == "tilth" and not field.is_repeated:
            holder = getattr(message, field.name)
            for inner in holder.DESCRIPTOR.fields:
                if inner.message_type is None:
                    yield f"{field.name}_{inner.name}", inner.name, "", holder
