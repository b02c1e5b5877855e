"""Files that were cut: finished by a copy, nothing dropped, any reader opens them. Others are left alone."""

import fcntl
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from logs import chunk_ends, some_frames, write_mcap
from loopback import logged_frames
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from tilth.cli import main
from tilth.logger.log import recovery
from tilth.logger.log.mcap_file import HEAD, is_finished
from tilth.logger.log.recovery import COPY, Damaged, NoLog, finish, finish_all, rescue, unfinished
from tilth.schemas.flow import Frame
from tilth.schemas.notices import Notice, NoticeCode, notice

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
        # The chunks are those that were there, to the byte, and what was cut of the next one is kept.
        written, end = path.read_bytes(), next((end for end in reversed(ends) if end <= size), 0)
        assert written[:end] == content[:end]
        assert size > ends[-1] or content[_last_record(content[:size]) : size].rstrip(b"\0") in written
        again = finish(path)
        assert again.was_whole and again.messages == done.messages


def _last_record(content: bytes) -> int:
    """Where the record begins that is not whole."""
    at = 8
    while at + 9 <= len(content) and at + 9 + int.from_bytes(content[at + 1 : at + 9], "little") <= len(
        content
    ):
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    return at


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


def test_damage_in_the_middle_is_left_as_it_is_and_out_has_the_rest(
    whole: bytes, cut_short: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "x.mcap"
    second = chunk_ends(cut_short)[4]  # the first two tell what the channels are
    for number, content in enumerate((whole, cut_short)):
        damaged = bytearray(content)
        damaged[second - 40 : second - 20] = bytes(20)
        path.write_bytes(damaged)
        with pytest.raises(Damaged, match=r"damaged at byte .* left as it is, and .*recover FILE --out"):
            finish(path)
        assert path.read_bytes() == damaged
        to = tmp_path / f"{number}.mcap"
        done = rescue(path, to)
        frames = checked(to)
        assert frames == [row for row in ROWS if row in set(frames)] and done.messages == len(frames)
        assert 330 < len(frames) < 400 and ROWS[0] in frames and ROWS[-1] in frames
        assert path.read_bytes() == damaged and finish(to).was_whole
        with pytest.raises(FileExistsError):
            rescue(path, to)


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
        assert sorted(tmp_path.iterdir()) == [path]


def test_a_cut_while_a_file_is_being_finished(cut_short: bytes, tmp_path: Path) -> None:
    """The original is there as it was, half a copy beside it: the next start makes another one."""
    path, copy = tmp_path / "x.mcap", tmp_path / f"x.mcap{COPY}"
    size = chunk_ends(cut_short)[-1] - 20  # within the last chunk
    path.write_bytes(cut_short[:size])
    messages = finish(path).messages
    done = path.read_bytes()
    for at in RNG.integers(0, len(done), 5).tolist():
        path.write_bytes(cut_short[:size])
        copy.write_bytes(done[:at])
        said: list[tuple[str, Notice]] = []
        finish_all(tmp_path, lambda *event, said=said: said.append(event))
        assert path.read_bytes() == done and sorted(tmp_path.iterdir()) == [path]
        assert said == [("log", notice(NoticeCode.FINISHED, file="x.mcap", messages=messages))]
    path.unlink()
    copy.write_bytes(done)  # its file was deleted to make room
    finish_all(tmp_path, lambda kind, told: None)
    assert list(tmp_path.iterdir()) == []


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


@settings(derandomize=True, max_examples=40, deadline=None)
@given(st.data())
def test_any_valid_mcap_is_left_to_the_byte(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("valid") / "x.mcap"
    library = data.draw(st.sampled_from(("tilth 0.1.0", "tilth", "camera 9", "")))
    yes = st.booleans()
    with path.open("wb") as stream:
        writer = Writer(
            stream,
            chunk_size=data.draw(st.sampled_from((1, 300, 1 << 20))),
            compression=data.draw(st.sampled_from(CompressionType)),
            index_types=data.draw(st.sampled_from((IndexType.ALL, IndexType.NONE, IndexType.CHUNK))),
            repeat_channels=data.draw(yes), repeat_schemas=data.draw(yes), use_chunking=data.draw(yes),
            use_statistics=data.draw(yes), use_summary_offsets=data.draw(yes), enable_crcs=data.draw(yes),
            enable_data_crcs=data.draw(yes),
        )  # fmt: skip
        writer.start("any", library)
        channels = [
            writer.register_channel(topic, "json", writer.register_schema(topic, "jsonschema", b"{}"))
            for topic in ("a", "b", "c")[: data.draw(st.integers(1, 3))]
        ]
        for number in range(data.draw(st.integers(0, 30))):
            match data.draw(st.sampled_from("mmmmmxd")):
                case "x":
                    writer.add_attachment(number, number, "photo", "image/png", bytes(range(number + 1)))
                case "d":
                    writer.add_metadata("said", {"number": str(number)})
                case _:  # times that run back, now and then
                    t_ns = data.draw(st.integers(0, 1 << 62))
                    writer.add_message(data.draw(st.sampled_from(channels)), t_ns, bytes(number), t_ns)
        writer.finish()
    content = path.read_bytes()
    try:
        assert finish(path).was_whole
    except NoLog as error:
        assert not library.startswith("tilth") and "left as it is" in str(error)
    assert path.read_bytes() == content and list(path.parent.iterdir()) == [path]
    path.write_bytes(content[: data.draw(st.integers(9, len(content) - 1))])
    cut = path.read_bytes()
    try:
        finish(path)
    except NoLog:
        assert path.read_bytes() == cut


def test_attachments_and_private_records_are_kept(tmp_path: Path) -> None:
    """Of a log of Tilth's to which somebody has added them, cut afterwards."""
    path = tmp_path / "x.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=300)
        writer.start("", "tilth 0.1.0")
        channel = writer.register_channel("a", "json", writer.register_schema("a", "jsonschema", b"{}"))
        for number in range(40):
            writer.add_message(channel, number, bytes(50), number)
        writer.add_attachment(1, 2, "photo", "image/png", bytes(range(200)))
        writer.flush()
        stream.write(HEAD.pack(0x93, 3) + b"abc")
    assert not finish(path).was_whole
    assert HEAD.pack(0x93, 3) + b"abc" in path.read_bytes()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        (photo,) = reader.iter_attachments()
        assert photo.data == bytes(range(200)) and len(list(reader.iter_messages())) == 40


def test_a_disk_without_room_for_a_copy_leaves_the_file(
    cut_short: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(cut_short)
    full = shutil.disk_usage(tmp_path)._replace(free=len(cut_short))
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: full)
    with pytest.raises(NoLog, match="no room for a copy"):
        finish(path)
    assert path.read_bytes() == cut_short and list(tmp_path.iterdir()) == [path]
