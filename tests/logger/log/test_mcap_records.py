"""Damage anywhere in a log costs what it lies in: a hundred places for each kind, through the reader."""

import os
import re
import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from logs import record, some_frames, write_mcap
from mcap.opcode import Opcode
from sampled import sampled

from tilth.analysis.runs.run import open_runs
from tilth.cli import main
from tilth.logger.log.mcap_file import HEAD, RecordPlace, walk
from tilth.replay.readers.any_log import open_log
from tilth.replay.readers.arrays import read_frames
from tilth.replay.readers.log import Gap
from tilth.replay.survey import survey
from tilth.schemas.flow import Frame

ROWS = some_frames(2000)
PLACES = 100
Damage = Callable[[bytes, np.random.Generator], bytes]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_mcap(tmp_path_factory.mktemp("log") / "x.mcap", ROWS, chunk_kilobytes=4).read_bytes()


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    rows = some_frames(700, seed=3)
    return write_mcap(tmp_path_factory.mktemp("other") / "x.mcap", rows, 4, run="other").read_bytes()


def chunks_of(content: bytes, path: Path) -> list[RecordPlace]:
    path.write_bytes(content)
    with path.open("rb") as file:
        return [place for place in walk(file, len(content)) if place.opcode == Opcode.CHUNK]


def flipped(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(17, len(content)))
    return content[:at] + bytes([content[at] ^ int(rng.integers(1, 256))]) + content[at + 1 :]


def zeroed(content: bytes, rng: np.random.Generator) -> bytes:
    count = int(rng.choice((40, 400, 2000)))
    at = int(rng.integers(17, len(content) - count))
    return content[:at] + bytes(count) + content[at + count :]


def removed(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(17, len(content) - 1000))
    return content[:at] + content[at + int(rng.choice((1, 9, 300, 1000))) :]


def inserted(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(17, len(content)))
    return content[:at] + rng.bytes(int(rng.choice((1, 9, 300, 3000)))) + content[at:]


@pytest.mark.parametrize("damage", sampled([flipped, zeroed, removed, inserted], [removed]))
def test_what_lies_behind_is_read(damage: Damage, log: bytes, tmp_path: Path) -> None:
    """At most the frames of the chunks that are hit are lost; a loss is a Gap, and `verify` is not good."""
    rng, path = np.random.default_rng(5), tmp_path / "x.mcap"
    each = len(ROWS) / len(chunks_of(log, path))
    for _ in range(PLACES):
        path.write_bytes(damage(log, rng))
        opened = open_log(path)
        records = list(opened.records)
        frames = [row for row in records if isinstance(row, Frame)]
        there = set(frames)
        assert frames == [row for row in ROWS if row in there]
        assert len(ROWS) - len(frames) <= 2.2 * each
        gaps = [row for row in records if isinstance(row, Gap)]
        assert len(gaps) <= 1 and (gaps or frames == ROWS)
        assert opened.skipped.get("damaged_chunk", 0) == len(gaps)
        assert len(read_frames(path)) == len(frames)
        (found,) = survey([path])
        assert not found.good


def rearranged(content: bytes, chunks: list[RecordPlace], rng: np.random.Generator, how: str) -> bytes:
    """Chunks doubled or exchanged, alone or with what indexes them, one taken out, or its length wrong."""
    spans = [(one.start, one.end) for one in chunks[:-1]]
    if how.endswith("with its index"):
        spans = [(one.start, following.start) for one, following in pairwise(chunks)]
    first, second = sorted(rng.choice(len(spans), 2, replace=False).tolist())
    (a, b), (c, d) = spans[first], spans[second]
    if how.startswith("doubled"):
        return content[:d] + content[a:b] + content[d:]
    if how.startswith("exchanged"):
        return content[:a] + content[c:d] + content[b:c] + content[a:b] + content[d:]
    if how.startswith("gone"):
        return content[:a] + content[b:]
    length = max(0, b - a - HEAD.size + int(rng.choice((-5, 7, 3000, 1 << 30, 1 << 62))))
    return content[:a] + HEAD.pack(Opcode.CHUNK, length) + content[a + HEAD.size :]


@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize(
    "how", ["doubled", "doubled with its index", "exchanged", "exchanged with its index", "length"]
)
def test_chunks_that_are_whole_are_all_used_once(
    how: str, finished: bool, log: bytes, tmp_path: Path
) -> None:
    rng, path = np.random.default_rng(7), tmp_path / "x.mcap"
    chunks = chunks_of(log, path)
    end = len(log) if finished else log.rindex(struct.pack("<BQ", Opcode.DATA_END, 4))
    for _ in range(PLACES // 4):
        path.write_bytes(rearranged(log[:end], chunks, rng, how))
        opened = open_log(path)
        assert list(opened.records) == ROWS and opened.damage and opened.truncated != finished
        assert not survey([path])[0].good


def test_a_chunk_that_is_gone_is_missed_by_the_index(log: bytes, tmp_path: Path) -> None:
    rng, path = np.random.default_rng(9), tmp_path / "x.mcap"
    path.write_bytes(rearranged(log, chunks_of(log, path), rng, "gone with its index"))
    opened = open_log(path)
    (gap,) = (row for row in opened.records if isinstance(row, Gap))
    assert "a part is missing" in gap.text
    (found,) = survey([path])
    assert any("messages were recorded, 1,9" in text for text in found.wrong)


@pytest.mark.parametrize("tail", [36, 136, 3000])
def test_the_end_of_another_file(tail: int, log: bytes, other: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    for content in (log[:-tail] + other[-tail:], log + other[-tail:]):
        path.write_bytes(content)
        found = [row for row in open_log(path).records if isinstance(row, Frame)]
        assert found == ROWS
        assert not survey([path])[0].good


def test_two_files_in_one(log: bytes, other: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(log + other)
    opened = open_log(path)
    assert list(opened.records) == [*ROWS, *some_frames(700, seed=3)]
    assert any("another file begins in it" in text for text in opened.damage)
    path.write_bytes(log + log)
    assert list(open_log(path).records) == ROWS


def test_a_log_that_grows_is_cut_not_damaged(log: bytes, tmp_path: Path) -> None:
    rng, path = np.random.default_rng(11), tmp_path / "x.mcap"
    end = log.rindex(struct.pack("<BQ", Opcode.DATA_END, 4))
    for size in sorted(rng.integers(3000, end, 40).tolist()):
        path.write_bytes(log[:size])
        opened = open_log(path)
        rows = list(opened.records)
        assert rows == ROWS[: len(rows)] and opened.truncated and not opened.damage


# The commands


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two parts of a run with results, zeros in the middle of the first."""
    from logs import MACHINE

    from tilth.simulator.traffic import simulate

    live = record(tmp_path_factory.mktemp("drive"), list(simulate(MACHINE, 3, 8.0)), 2)
    first = live.parts[0]
    content = first.read_bytes()
    at = chunks_of(content, first)[1].start + 500
    first.write_bytes(content[:at] + bytes(400) + content[at + 400 :])
    return live.parts


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (["verify", "{0}"], 1), (["decode", "{0}"], 0), (["replay", "{0}"], 0),
        (["replay", "--verify", "{0}", "{1}"], 1), (["recover", "{0}"], 1),
        (["export", "{0}", "--to", "csv", "--out", "{2}/out"], 1), (["logs", "{2}"], 0),
        (["recover", "{0}", "--out", "{2}/new.mcap"], 0),
    ],
)  # fmt: skip
def test_each_command_says_it_once(
    words: list[str], status: int, drive: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if words[0] == "logs":
        (tmp_path / "rig_20260301T080000Z_001.mcap").write_bytes(drive[0].read_bytes())
    before = drive[0].read_bytes()
    assert main([word.format(*drive, tmp_path) for word in words]) == status
    out, err = capsys.readouterr()
    assert drive[0].read_bytes() == before
    told = (out + err).count("damaged at byte")
    assert told == (0 if words[0] == "logs" or "new.mcap" in words[-1] else 1), err
    if "--verify" in words:
        assert "Not verifiable: " in " ".join(out.split()) and "Differs" not in out


def test_what_was_left_out_of_a_copy_is_missing_in_it(
    drive: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy, again = tmp_path / "rescued.mcap", tmp_path / "again.mcap"
    assert main(["recover", str(drive[0]), "--out", str(copy)]) == 0
    assert re.search(r"; \d+ bytes of it cannot be read", capsys.readouterr().out)
    assert main(["recover", str(copy), "--out", str(again)]) == 0
    assert again.read_bytes() == copy.read_bytes()
    assert main(["verify", str(copy)]) == 1
    out = capsys.readouterr().out
    assert out.count("could not be read when it was recovered") == 1 and "NOT ALL IS THERE" in out
    assert main(["replay", "--verify", str(copy), str(drive[1])]) == 1
    out = " ".join(capsys.readouterr().out.split())
    assert "Not verifiable: " in out and "Differs" not in out
    assert main(["recover", str(copy)]) == 0 and "was whole" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["verify"], ["recover"], ["decode"], ["replay"], ["fit"]])
def test_a_pipe_in_the_place_of_a_log_is_not_waited_for(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    try:
        status: object = main([*words, str(tmp_path / "pipe.mcap")])
    except SystemExit as ended:
        status = ended.code
    assert status in (1, 2) and "a pipe or a device" in capsys.readouterr().err


def test_analysis_says_it_once(drive: list[Path], tmp_path: Path) -> None:
    said: list[str] = []
    (run,) = open_runs(drive, say=said.append, cache=tmp_path)
    assert run.poses.rows and run.measurements("position").rows and run.whole
    assert (
        run.reader.skipped["damaged_chunk"] and len([text for text in said if "damaged at byte" in text]) == 1
    )
