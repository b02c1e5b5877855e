"""Files that were cut or damaged: finished in place, nothing of them dropped, and any reader opens them."""

import fcntl
import shutil
from pathlib import Path

import numpy as np
import pytest
from logs import chunk_ends, some_frames, write_mcap
from loopback import logged_frames
from mcap.reader import make_reader

from tilth.cli import main
from tilth.logger.log import recovery
from tilth.logger.log.mcap_file import HEAD, is_finished
from tilth.logger.log.recovery import NoLog, finish, unfinished
from tilth.schemas.flow import Frame

ROWS = some_frames(400)
RNG = np.random.default_rng(5)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_mcap(tmp_path_factory.mktemp("whole") / "x.mcap", ROWS).read_bytes()


@pytest.fixture(scope="module")
def cut_short(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The same, never finished."""
    return write_mcap(tmp_path_factory.mktemp("open") / "x.mcap", ROWS, finish=False).read_bytes()


def checked(path: Path) -> list[Frame]:
    """Frames by the index and without it, which must be the same."""
    with path.open("rb") as file:
        assert is_finished(file, path.stat().st_size)
        file.seek(0)
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        messages = list(reader.iter_messages())
        assert summary.statistics.message_count == len(messages)
        assert sum(summary.statistics.channel_message_counts.values()) == len(messages)
        assert {record.name for record in reader.iter_metadata()} <= {"machine", "tilth", "run"}
    frames = logged_frames(path)
    assert len(frames) == len(messages)
    return frames


@pytest.mark.parametrize("share", np.linspace(0.0, 1.0, 12).tolist())
def test_a_cut_at_any_byte_leaves_a_file_that_can_be_finished(
    share: float, whole: bytes, cut_short: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "x.mcap"
    ends = chunk_ends(cut_short)
    for content in (whole, cut_short):
        size = round(share * len(content)) - int(RNG.integers(9) if share > 0.5 else 0)
        path.write_bytes(content[:size])
        done = finish(path)
        frames = checked(path)
        assert frames == ROWS[: len(frames)] and done.messages == len(frames)
        chunks = sum(end <= size for end in ends)
        assert len(chunk_ends(path.read_bytes())) == chunks
        retained = path.read_bytes()[:size]
        # Only the head of the cut record, less than a head, or half an index has been written over.
        same = next(
            (i for i, (a, b) in enumerate(zip(retained, content[:size], strict=False)) if a != b), size
        )
        assert retained[same + HEAD.size :] == content[same + HEAD.size : size] or same >= ends[-1] or (
            size - same < HEAD.size
        )  # fmt: skip
        again = finish(path)
        assert again.was_whole and again.messages == done.messages


def test_every_byte_of_a_short_file(tmp_path: Path) -> None:
    content = write_mcap(tmp_path / "x.mcap", ROWS[:3]).read_bytes()
    path = tmp_path / "cut.mcap"
    end = chunk_ends(content)[-1]
    for size in [*range(20), *range(end - 20, end + 40), *range(end + 40, len(content), 211)]:
        path.write_bytes(content[:size])
        finish(path)
        frames = checked(path)
        assert frames == ROWS[: len(frames)] and (len(frames) == 3) == (size >= end)


@pytest.mark.parametrize("tail", [1, 8, 9, 4096, 70_001])
def test_zeros_that_a_power_cut_left_behind(tail: int, cut_short: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(cut_short + bytes(tail))
    assert finish(path).messages == 400
    assert checked(path) == ROWS


def test_damage_costs_its_chunk_alone(whole: bytes, cut_short: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    first, second, third = chunk_ends(cut_short)[3:6]  # the first two tell what the channels are
    for content in (whole, cut_short):
        damaged = bytearray(content)
        damaged[second - 40 : second - 20] = bytes(20)
        path.write_bytes(damaged)
        done = finish(path)
        frames = checked(path)
        assert [row for row in ROWS if row in frames] == frames
        assert 330 < len(frames) < 400 and 0 < done.unreadable_bytes < third - first
        assert ROWS[0] in frames and ROWS[-1] in frames


def test_damaged_bytes_never_make_a_file_worse(cut_short: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    known = set(ROWS)
    for _ in range(60):
        damaged = bytearray(cut_short)
        for at in RNG.integers(8, len(cut_short), int(RNG.integers(1, 6))).tolist():
            damaged[at] = int(RNG.integers(256))
        path.write_bytes(damaged)
        try:
            finish(path)
        except NoLog:
            assert path.read_bytes() == damaged
        else:
            found = {frame for frame in logged_frames(path) if frame.bus in ("can0", "implement")}
            assert found <= known


def test_a_cut_while_a_file_is_being_finished(cut_short: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    size = chunk_ends(cut_short)[-1] - 20  # within the last chunk
    path.write_bytes(cut_short[:size])
    messages = finish(path).messages
    done = path.read_bytes()
    for _ in range(40):
        at = int(RNG.integers(size, len(done)))
        path.write_bytes(done[:at])
        assert finish(path).messages == messages
        checked(path)


def test_no_room_for_the_index_changes_nothing_that_was_written(
    cut_short: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from one_recording import file_size_limit

    path = tmp_path / "x.mcap"
    path.write_bytes(cut_short)
    with file_size_limit(len(cut_short) + 100), pytest.raises(OSError, match="too large"):
        finish(path)
    assert path.read_bytes() == cut_short
    assert finish(path).messages == 400


def test_what_is_found_at_a_start(whole: bytes, cut_short: bytes, tmp_path: Path) -> None:
    for name, content in {
        "whole": whole, "cut": cut_short, "empty": b"", "zeros": bytes(5000), "head": whole[:5],
        "foreign": whole[:8] + b"\x01\x20" + bytes(40), "text": b"not a log at all",
    }.items():  # fmt: skip
        (tmp_path / f"{name}.mcap").write_bytes(content)
    (tmp_path / "busy.mcap").write_bytes(cut_short)
    with (tmp_path / "busy.mcap").open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert [path.stem for path in unfinished(tmp_path)] == ["cut", "empty", "head", "zeros"]
        with pytest.raises(NoLog, match="is being recorded"):
            finish(tmp_path / "busy.mcap")
    assert unfinished(tmp_path / "no such folder") == []


def test_the_command(
    whole: bytes, cut_short: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut, good, text = (tmp_path / name for name in ("cut.mcap", "good.mcap", "text.mcap"))
    cut.write_bytes(cut_short[:-5])
    good.write_bytes(whole)
    text.write_text("a letter")
    assert main(["recover", str(cut), str(good)]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert "finished now: " in first and "bytes of it cannot be read" in first
    assert second.startswith(f"{good}: was whole: 400 messages, 2023-")
    shutil.copy(good, tmp_path / "b.mcap")
    assert main(["recover", str(text), str(tmp_path / "none"), str(good)]) == 1
    out, err = capsys.readouterr()
    assert "is no MCAP file" in err and "no such file" in err and "was whole" in out
    assert good.read_bytes() == whole and text.read_text() == "a letter"


def test_a_file_of_another_program_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    content = write_mcap(path, ROWS).read_bytes().replace(b"tilth 0.1.0", b"camera 9.9.", 1)
    path.write_bytes(content[:-200])
    with pytest.raises(NoLog, match="no log of tilth"):
        recovery.finish(path)
    assert path.read_bytes() == content[:-200]
