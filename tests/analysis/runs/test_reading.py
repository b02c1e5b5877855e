"""Columns against the same messages as Protobuf parses them, for every channel; cut and damaged logs."""

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from logs import chunk_ends
from recorded import cut, recorded

from tilth.analysis.runs.layout import SUFFIXES, layout_of
from tilth.analysis.runs.reading import ChannelReader, RunClock
from tilth.analysis.runs.run import topics
from tilth.schemas.channels import CHANNEL

pytestmark = pytest.mark.long


CLOCK = RunClock(0, 0)
LOGGED = [topic for topic in topics() if CHANNEL[topic].logged and topic not in ("/status", "/ready")]


def reader(*paths: Path) -> ChannelReader:
    return ChannelReader(paths, CLOCK)


def plain(message: Any, name: str) -> Any:
    """What stands in a message for a column of that name."""
    for part in ("tractor", "implement", "wheel_angle", "own_steering", "of_place"):
        within = name.removeprefix(f"{part}_")
        if within != name and getattr(message, part, None) is not None:
            inner: Any = getattr(message, part)
            if hasattr(inner, "DESCRIPTOR"):
                return plain(inner, within)
    parameter: Any
    for parameter in getattr(message, "parameters", ()):
        if name == parameter.name or name.startswith(f"{parameter.name}_"):
            return plain(parameter, name.removeprefix(parameter.name).strip("_") or "value")
    fields: Any = message.DESCRIPTOR.fields_by_name
    if name not in fields:
        stems = [name.removesuffix(f"_{suffix}") for suffix in SUFFIXES.values()]
        name = next((stem for stem in stems if stem in fields), "value")
    field: Any = fields[name]
    if field.has_presence and not message.HasField(name):
        return None
    value = getattr(message, name)
    if field.is_repeated:
        return ", ".join(value) if field.type == field.TYPE_STRING else list(value)
    return value


@pytest.mark.parametrize("topic", LOGGED)
def test_columns_hold_what_protobuf_parses(topic: str) -> None:
    source = reader(*recorded().parts)
    table = source.table(topic)
    messages = [CHANNEL[topic].message.FromString(data) for _, data in source.payloads(topic)]
    assert table.rows == len(messages)
    for column in layout_of(topic).columns:
        if column.name in ("t_ns", "rx_ns"):
            continue
        for row in range(0, len(messages), max(1, len(messages) // 40)):
            expected, found = plain(messages[row], column.name), table[column.name][row]
            if expected is None and column.name in table.missing:
                assert table.missing[column.name][row]
            elif expected is None:
                assert math.isnan(found), (column.name, found)
            elif isinstance(expected, list):
                assert np.array_equal(found[: len(expected)], expected)
                assert np.isnan(found[len(expected) :]).all()
            else:
                assert found == expected, (column.name, row)


def test_times_are_seconds_of_the_run_and_utc() -> None:
    live = recorded()
    start_ns = live.rows[0].t_ns
    table = ChannelReader(live.parts, RunClock(start_ns, 37_000_000_000)).table("/measurement/wheel_angle")
    assert -0.01 < table.t_s[0] < 1.0 and np.all(np.diff(table.t_s) >= 0.0)
    assert table["utc_s"][0] == pytest.approx(start_ns * 1e-9 + 37.0 + table.t_s[0], abs=1e-6)
    assert np.isnan(ChannelReader(live.parts, RunClock(start_ns)).table("/pose")["utc_s"]).all()


@pytest.mark.parametrize("topic", topics())
def test_each_name_ends_with_its_unit(topic: str) -> None:
    for column in layout_of(topic).columns:
        assert not column.unit or column.name.endswith(f"_{SUFFIXES[column.unit]}"), column.name
    table = reader().table(topic)
    assert table.rows == 0 and "t_s" in table and table.units["t_s"] == "s"


def test_parts_of_a_run_are_one_table() -> None:
    whole, parts = (reader(*recorded(count).parts).table("/pose") for count in (1, 3))
    assert whole.rows == parts.rows > 200
    assert np.array_equal(whole["tractor_heading_rad"], parts["tractor_heading_rad"])
    batches = list(reader(*recorded().parts).batches("/measurement/position"))
    assert len(batches) > 1 and sum(batch.rows for batch in batches) > 500


def test_cut_and_damaged_logs_give_what_is_whole(tmp_path: Path) -> None:
    source = reader(cut())
    table = source.table("/pose")
    assert 100 < table.rows < reader(*recorded().parts).table("/pose").rows and source.skipped["cut"] == 1
    content = bytearray(recorded().parts[0].read_bytes())
    content[chunk_ends(bytes(content))[1] - 20] ^= 0xFF
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    damaged = reader(path)
    assert damaged.table("/measurement/position").rows > 100
    assert +damaged.skipped == Counter(damaged_chunk=1)


def test_damaged_messages_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    source = reader()
    data = b"\x09" + bytes(3)  # a fixed64 of which five bytes are missing
    places = np.array([[1, 5, 0, len(data)]], np.int64)
    table = source._table("/pose", data, places)
    assert source.skipped["damaged_message"] == 1 and np.isnan(table["articulation_rad"]).all()
