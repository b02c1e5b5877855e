"""MCAP logs: what was logged comes back in file order, as far as a cut or damaged file is whole."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from logs import MACHINE, MACHINE_TEXT, chunk_ends, drained, messages, some_frames, write_mcap, write_with_can
from mcap.writer import CompressionType, Writer

from tilth.logger.log.mcap_file import MESSAGE
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.replay.readers.any_log import frames, metadata, open_log
from tilth.replay.readers.log import EmptyLog, ForeignLog, Logged, OpenLog
from tilth.replay.readers.mcap_reader import Channels
from tilth.schemas.flow import Frame
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto.tilth_pb2 import CanFrame, Snapshot


def test_mcap_gives_what_was_logged(tmp_path: Path) -> None:
    rows = some_frames(500)
    path = write_mcap(tmp_path / "x.mcap", rows)
    log = open_log(path)
    assert metadata(log)["machine"]["toml"] == MACHINE_TEXT
    assert metadata(log)["run"]["part"] == "1"
    assert list(log.records) == rows
    assert not log.truncated
    other = open_log(write_with_can(tmp_path / "x.csv", messages(1)))
    assert metadata(other) == {}
    other.file.close()


def test_snapshots_and_results_stand_where_they_were_logged(tmp_path: Path) -> None:
    first, second = some_frames(2)
    writer = LogWriter(tmp_path / "x.mcap", MachineFile(MACHINE, MACHINE_TEXT), RunPart("run", 1, 0))
    writer.frame(first)
    writer.message("/pose", 5, b"pose")
    writer.message("/event", 6, b"event")
    writer.snapshot(7, "{}")
    writer.frame(second)
    writer.close()
    records = list(open_log(tmp_path / "x.mcap", {"/pose"}).records)
    assert records[:2] == [first, Logged("/pose", 5, b"pose")]
    assert isinstance(records[2], Snapshot)
    assert (records[2].t_ns, records[2].state_json) == (7, "{}")
    assert records[3:] == [second]


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("chunked", [True, False])
def test_any_compression_and_none(compression: CompressionType, chunked: bool, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    rows = some_frames(50)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=500, compression=compression, use_chunking=chunked)
        writer.start()
        schema = writer.register_schema("tilth.CanFrame", "protobuf", b"")
        channels = {
            bus: writer.register_channel(f"/can/{bus}", "protobuf", schema) for bus in ("can0", "implement")
        }
        for row in rows:
            raw = CanFrame(rx_ns=row.rx_ns, can_id=row.can_id, extended=True, data=row.data)
            writer.add_message(channels[row.bus], row.t_ns, raw.SerializeToString(), row.rx_ns)
        writer.finish()
    assert list(frames(path)) == rows


def frames_per_chunk(path: Path, content: bytes, ends: list[int]) -> list[int]:
    """Frames in the file up to each chunk's end, counted one prefix at a time."""
    counts = []
    for end in ends:
        path.write_bytes(content[:end])
        counts.append(sum(1 for _ in frames(path)))
    return counts


def test_mcap_cut_at_any_byte_gives_its_whole_chunks(tmp_path: Path) -> None:
    rows = some_frames(400)
    content = write_mcap(tmp_path / "x.mcap", rows).read_bytes()
    path = tmp_path / "cut.mcap"
    ends = chunk_ends(content)
    counts = frames_per_chunk(path, content, ends)
    assert len(ends) > 8 and counts[-1] == 400 and counts == sorted(set(counts))
    rng = np.random.default_rng(11)
    near = [end + k for end in ends for k in (-9, -1, 0, 1, 8, 9)]
    for cut in [
        *range(1, 60),
        *near,
        *rng.integers(60, len(content), 200).tolist(),
        len(content) - 1,
    ]:
        path.write_bytes(content[:cut])
        found, log = drained(path)
        whole = max((count for end, count in zip(ends, counts, strict=True) if end <= cut), default=0)
        assert found == rows[:whole], cut
        assert log.truncated, cut


@pytest.mark.parametrize("tail", [1, 8, 9, 10, 4096, 100_003])
def test_zeros_after_a_power_cut(tail: int, tmp_path: Path) -> None:
    rows = some_frames(100)
    path = write_mcap(tmp_path / "x.mcap", rows, finish=False)
    with path.open("ab") as stream:
        stream.write(bytes(tail))
    found, log = drained(path)
    assert found == rows
    assert log.truncated


@settings(derandomize=True, max_examples=150, deadline=None)
@given(st.data())
def test_damaged_bytes_never_raise_anything_but_a_log_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.getbasetemp()
    path = folder / "good.mcap"
    rows = some_frames(150)
    content = bytearray((path if path.exists() else write_mcap(path, rows)).read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        content[data.draw(st.integers(8, len(content) - 1))] = data.draw(st.integers(0, 255))
    bad = folder / "bad.mcap"
    bad.write_bytes(content)
    try:
        found, _ = drained(bad)
    except (EmptyLog, ForeignLog):
        return
    assert set(found) <= set(rows)


def test_a_damaged_chunk_costs_only_itself(tmp_path: Path) -> None:
    rows = some_frames(300)
    path = write_mcap(tmp_path / "x.mcap", rows)
    content = bytearray(path.read_bytes())
    first, second = chunk_ends(bytes(content))[:2]
    for end in (first, second):
        damaged = bytearray(content)
        damaged[end - 20] ^= 0xFF
        path.write_bytes(damaged)
        found, log = drained(path)
        assert log.skipped == {"damaged_chunk": 1}
        assert 0 < len(found) < 300
        assert [row for row in rows if row in found] == found
        assert not log.truncated


def test_an_mcap_of_something_else(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("camera", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/can/fake", "json", schema), 1, b"{}", 1)
        writer.finish()
    with pytest.raises(ForeignLog, match="/can/<bus>"):
        list(frames(path))


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.integers(0, 2**63 - 1), st.sampled_from([0, 5, 0x7FF, 0x09F80223, 0x18FF0B15]), st.booleans(),
            st.booleans(), st.sampled_from([b"", b"\x2a\x08", bytes(8), b"12345678", bytes(range(20))]),
            st.booleans(),
        ), max_size=30,
    )
)  # fmt: skip
def test_a_frame_is_read_as_protobuf_reads_it(drawn: list[tuple[int, int, bool, bool, bytes, bool]]) -> None:
    """Also where another writer has put the time behind the rest, or left it out."""
    bodies = []
    for rx_ns, can_id, extended, error, data, turned in drawn:
        rest = CanFrame(can_id=can_id, extended=extended, error=error, data=data).SerializeToString()
        time = CanFrame(rx_ns=rx_ns).SerializeToString()
        bodies.append(rest + time if turned else time + rest)
    heads = [MESSAGE.pack(5, len(body) + 22, 1, 0, 7, 7) for body in bodies]
    channels = Channels(OpenLog(Path("log"), "MCAP", BytesIO(), 0))
    channels.buses[1] = "can0"
    read = channels.records(b"".join(map(bytes.__add__, heads, bodies)))
    wanted = [
        Frame(7, raw.rx_ns, "can0", raw.can_id, raw.extended, raw.error, raw.data)
        for raw in map(CanFrame.FromString, bodies)
    ]
    assert read == wanted
