"""Frames as arrays: the same as one by one, of whole files and of cut and damaged ones."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from logs import MACHINE, MACHINE_TEXT, chunk_ends, some_frames, write_mcap
from mcap.writer import Writer

from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.replay.readers import arrays
from tilth.replay.readers.arrays import FrameArrays, read_frames
from tilth.replay.readers.log import EmptyLog, ForeignLog
from tilth.schemas.flow import Frame
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto.tilth_pb2 import CanFrame


def each(rows: FrameArrays) -> Iterator[Frame]:
    for i in range(len(rows)):
        yield Frame(
            int(rows.t_ns[i]), int(rows.rx_ns[i]), rows.buses[rows.bus[i]], int(rows.can_id[i]),
            bool(rows.extended[i]), bool(rows.error[i]), rows.data[i, : rows.length[i]].tobytes(),
        )  # fmt: skip


def test_arrays_hold_what_was_written(tmp_path: Path) -> None:
    frames = some_frames(1500)
    frames[3] = Frame(1, 2, "can0", 0x123, False, True, b"")
    path = write_mcap(tmp_path / "x.mcap", frames)
    rows = read_frames(path)
    assert list(each(rows)) == frames and rows.skipped == {}
    assert not rows.data[rows.length == 0].any()
    both = read_frames(path, write_mcap(tmp_path / "y.mcap", some_frames(100, 8)))
    assert list(each(both)) == [*frames, *some_frames(100, 8)]


def test_interpreted_it_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = some_frames(60)
    path = write_mcap(tmp_path / "x.mcap", frames)
    monkeypatch.setattr(arrays, "_take", arrays._take.interpreted())
    assert list(each(read_frames(path))) == frames


def test_cut_and_damaged_files_give_their_whole_chunks(tmp_path: Path) -> None:
    frames = some_frames(500)
    path = write_mcap(tmp_path / "x.mcap", frames)
    content = path.read_bytes()
    ends = chunk_ends(content)
    path.write_bytes(content[: ends[4] + 5])
    rows = read_frames(path)
    assert rows.skipped == {"cut": 1} and 0 < len(rows) < 500
    assert list(each(rows)) == frames[: len(rows)]
    damaged = bytearray(content)
    damaged[ends[3] - 20] ^= 0xFF
    path.write_bytes(damaged)
    rows = read_frames(path)
    assert rows.skipped == {"damaged_chunk": 1} and set(each(rows)) < set(frames)


def test_a_frame_that_is_none_is_counted_and_a_later_version_is_read(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    good = CanFrame(rx_ns=5, can_id=6, extended=True, data=b"abc").SerializeToString()
    later = good + b"\x30\x01" + b"\x3a\x02hi"  # two fields more
    bad = [good[:-1], good[:5], b"\x2a\x09123456789", b"\x10\xff\xff\xff\xff\xff\xff", b"\x0d1234"]
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("tilth.CanFrame", "protobuf", b"")
        channel = writer.register_channel("/can/can0", "protobuf", schema)
        for number, data in enumerate([good, *bad, later]):
            writer.add_message(channel, number, data, number)
        writer.finish()
    rows = read_frames(path)
    assert list(each(rows)) == [Frame(t, 5, "can0", 6, True, False, b"abc") for t in (0, 1 + len(bad))]
    assert rows.skipped == {"damaged_frame": len(bad)}


def test_what_holds_no_frames(tmp_path: Path) -> None:
    LogWriter(tmp_path / "empty.mcap", MachineFile(MACHINE, MACHINE_TEXT), RunPart("r", 1, 0)).close()
    with pytest.raises(EmptyLog):
        read_frames(tmp_path / "empty.mcap")
    (tmp_path / "text.mcap").write_text("hello, this is no log")
    with pytest.raises(ForeignLog):
        read_frames(tmp_path / "text.mcap")
    assert len(read_frames()) == 0 and np.array_equal(read_frames().data, np.zeros((0, 8)))
