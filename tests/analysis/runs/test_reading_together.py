"""Several channels in one pass over the files are the same as each by itself."""

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from filled_log import filled_log

from tilth.analysis.runs import reading
from tilth.analysis.runs.run import open_runs, topics
from tilth.analysis.runs.table import Table, joined
from tilth.replay.readers.arrays import frame_parts, read_frames
from tilth.schemas import message_columns as wire


def _same(one: Table, other: Table) -> None:
    assert list(one) == list(other) and one.units == other.units
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    for name, absent in one.missing.items():
        np.testing.assert_array_equal(absent, other.missing[name], err_msg=name)


@pytest.mark.parametrize("gathered", [1, 30_000, 1 << 22])
def test_one_pass_gives_what_single_passes_give(
    tmp_path: Path, gathered: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "_GATHERED", gathered)
    for part in (1, 2):
        filled_log(tmp_path / f"{part}.mcap", 30, seed=part, part=part)
    (run,) = open_runs([tmp_path / "1.mcap", tmp_path / "2.mcap"])
    heard: list[int] = []
    parts = defaultdict(list)
    for topic, table in run.reader.tables(topics(), heard.append):
        parts[topic].append(table)
    assert set(parts) == set(topics())
    for topic, tables in parts.items():
        _same(joined(tables), run.table(topic))
    assert len(parts["/pose"]) == 1 or gathered < 1 << 22
    size = sum(file.path.stat().st_size for file in run.files)
    assert heard == sorted(heard) and size / 2 < heard[-1] <= size


def test_raw_frames_in_parts_say_how_far_they_are(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    filled_log(path)
    heard: list[int] = []
    buses: dict[str, int] = {}
    parts = list(frame_parts(path, buses, {}, heard.append))
    whole = read_frames(path)
    np.testing.assert_array_equal(np.concatenate([part.t_ns for part in parts]), whole.t_ns)
    assert tuple(buses) == whole.buses and heard == sorted(heard) and heard[-1] <= path.stat().st_size


def test_lists_of_texts_differ_by_their_empty_texts_too() -> None:
    """Of each hash one message is parsed for all."""
    lists = [
        [],
        [b""],
        [b"", b""],
        [b"", b"", b""],
        [b"a"],
        [b"a", b""],
        [b"a", b"", b""],
        [b"", b"a"],
        [b"aa"],
    ]
    hashes = []
    for texts in lists:
        value = 0
        for text in texts:
            value = wire.hashed(np.frombuffer(text, np.uint8), 0, len(text), value)
        hashes.append(value)
    assert hashes[0] == 0 and len(set(hashes)) == len(lists)
