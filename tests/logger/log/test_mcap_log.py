"""The log: what is written is what is read, a cut costs no whole chunk, no error of the disk ends a run."""

import shutil
import time
from pathlib import Path

import pytest
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given, settings
from hypothesis import strategies as st
from loopback import (
    START_NS,
    logged_frames,
    messages,
    numbered,
    records_of,
    rig,
    salvaged,
    udp_bus,
)
from mcap.reader import make_reader
from one_recording import Recorder, file_size_limit

from tilth.logger.clock import NEWEST_NS, OLDEST_NS, Clock, Relation
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log import run_files
from tilth.logger.log.disk import Disk, Spool
from tilth.logger.log.mcap_log import ClockReason, LogWriter, RunPart
from tilth.logger.log.recovery import finish
from tilth.schemas.channels import CHANNEL, CHANNELS
from tilth.schemas.flow import Event, Frame, Publication
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import in_words
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.simulator.traffic import simulate

RUN = RunPart("run", 1, START_NS)

frames = st.builds(
    Frame,
    t_ns=st.integers(0, 2**63),
    rx_ns=st.integers(0, 2**63),
    bus=st.sampled_from(["can0", "can1", "isobus"]),
    can_id=st.integers(0, 2**29 - 1),
    extended=st.booleans(),
    error=st.booleans(),
    data=st.binary(max_size=8),
)


@pytest.fixture
def machine(tmp_path: Path) -> tuple[Machine, str]:
    return rig(tmp_path, udp_bus("can0", 1))


@settings(derandomize=True, max_examples=25, deadline=None)
@given(st.lists(frames, max_size=40))
def test_frames_come_back_as_they_were_in_their_order(
    tmp_path_factory: pytest.TempPathFactory, some: list[Frame]
) -> None:
    folder = tmp_path_factory.mktemp("log")
    writer = LogWriter(folder / "a.mcap", MachineFile(*rig(folder, udp_bus("can0", 1))), RUN)
    for frame in some:
        writer.frame(frame)
    writer.close()
    assert logged_frames(folder / "a.mcap") == some
    with messages(folder / "a.mcap") as rows:
        assert [row.publish_time for _, row in rows] == [frame.rx_ns for frame in some]


def test_a_log_explains_itself(tmp_path: Path, machine: tuple[Machine, str]) -> None:
    """The schemas in the file are enough to read it, and the machine file is there word for word."""
    path = tmp_path / "a.mcap"
    writer = LogWriter(path, MachineFile(*machine), RUN)
    writer.frame(numbered(1)[0])
    writer.publications([Publication(START_NS, "/event", Event(START_NS, "mark", in_words("here")))])
    writer.snapshot(START_NS, "{}")
    writer.clocks(Clock(), ClockReason.START)
    writer.close()
    with path.open("rb") as stream:
        reader = make_reader(stream)
        observed = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None and schema.encoding == channel.message_encoding == "protobuf"
            pool = descriptor_pool.DescriptorPool()
            for file in FileDescriptorSet.FromString(schema.data).file:
                pool.Add(file)
            kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            observed[channel.topic] = str(kind.FromString(message.data))
        records = {record.name: record.metadata for record in reader.iter_metadata()}
    assert set(observed) == {"/can/can0", "/event", "/snapshot"}
    assert "here" in observed["/event"]
    assert records["machine"]["toml"] == machine[1]
    assert records["run"] == {"id": "run", "part": "1", "started_utc": "2026-09-21T14:13:20Z"}
    assert records["clock"]["why"] == "start" and int(records["clock"]["realtime_ns"]) > 0
    assert {"version", "python", "mcap", "protobuf"} <= set(records["tilth"])


def test_every_channel_can_be_logged_and_its_schema_is_whole(
    tmp_path: Path, machine: tuple[Machine, str]
) -> None:
    path = tmp_path / "a.mcap"
    writer = LogWriter(path, MachineFile(*machine), RUN)
    for channel in CHANNELS:
        writer.message(channel.topic, START_NS, b"")
    writer.close()
    with messages(path) as rows:
        assert [channel.topic for channel, _ in rows] == [channel.topic for channel in CHANNELS]


def test_a_log_is_never_overwritten(tmp_path: Path, machine: tuple[Machine, str]) -> None:
    (tmp_path / "a.mcap").write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        LogWriter(tmp_path / "a.mcap", MachineFile(*machine), RUN)
    assert (tmp_path / "a.mcap").read_bytes() == b"precious"


@pytest.fixture(scope="module")
def unfinished(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[int]]:
    """A file of 1000 frames that was never finished, and its size after each flush, each 100 frames."""
    folder = tmp_path_factory.mktemp("cut")
    writer = LogWriter(folder / "a.mcap", MachineFile(*rig(folder, udp_bus("can0", 1))), RUN)
    sizes = []
    for number, frame in enumerate(numbered(1000), 1):
        writer.frame(frame)
        if number % 100 == 0:
            writer.flush()
            sizes.append(writer.flushed_bytes)
    data = (folder / "a.mcap").read_bytes()
    writer.close()
    return data, sizes


@settings(derandomize=True, max_examples=40, deadline=None)
@given(keep=st.floats(0, 1))
def test_a_cut_costs_what_was_not_flushed_and_no_more(
    unfinished: tuple[bytes, list[int]], keep: float
) -> None:
    data, sizes = unfinished
    size = int(len(data) * keep)
    got = [int.from_bytes(frame.data, "little") for frame in salvaged(data[:size])]
    assert got == list(range(len(got)))
    assert len(got) >= 100 * sum(flushed <= size for flushed in sizes)


def test_rotation_loses_nothing_and_each_file_replays_alone(tmp_path: Path) -> None:
    run = Recorder(tmp_path, log="rotate_minutes = 0.05")
    frames = list(run.from_now(simulate(run.machine, 3, 8.0)))
    for frame in frames:
        run.take(frame)
    run.recording.close()
    files = run.recording.files
    assert len(files) == 3 and sorted(tmp_path.iterdir()) == files
    assert [path.name[-9:] for path in files] == ["_001.mcap", "_002.mcap", "_003.mcap"]
    assert [frame for path in files for frame in logged_frames(path)] == frames
    assert run.recording.frames == len(frames) and run.recording.missed == 0
    for part, path in enumerate(files, 1):
        snapshots = records_of(path, "/snapshot", pb.Snapshot)
        assert len(snapshots) == (part > 1)
        fold = GuardedFold(run.machine, snapshots[0].state_json if snapshots else None)
        again = [(p.topic, data) for f in logged_frames(path) for p, data in fold.take(f)]
        with messages(path) as rows:
            live = [(c.topic, row.data) for c, row in rows if c.topic in CHANNEL]
        assert again == live and len(live) > 200


def test_rotation_by_size(tmp_path: Path) -> None:
    run = Recorder(tmp_path, log="rotate_megabytes = 0.02")
    for frame in run.from_now(numbered(6000)):
        run.take(frame)
    run.recording.close()
    assert len(run.recording.files) > 2
    assert all(path.stat().st_size < 80_000 for path in run.recording.files)


def test_a_second_run_at_the_same_second_gets_a_name_of_its_own(tmp_path: Path) -> None:
    first, second = Recorder(tmp_path), Recorder(tmp_path)
    first.recording.close()
    second.recording.close()
    assert len(set(first.recording.files + second.recording.files)) == 2


def test_a_name_taken_at_the_last_moment_costs_one_try(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[Path] = []

    def too_late(disk: Disk, path: Path) -> Spool:
        if not taken:
            taken.append(path)
            path.write_text("another run's")
        return Spool(disk, path)

    monkeypatch.setattr(run_files, "Spool", too_late)
    run = Recorder(tmp_path, log="rotate_minutes = 0.02")
    assert not run.recording.recording
    run.until(lambda: run.recording.recording)
    for frame in run.from_now(numbered(4000)):
        run.take(frame)
    run.recording.close()
    first, second, *_ = run.recording.files
    assert taken[0] not in run.recording.files and taken[0].read_text() == "another run's"
    assert second.name == first.name.replace("_001", "_002")


def test_a_full_disk_is_said_and_recording_goes_on_when_there_is_room(tmp_path: Path) -> None:
    run = Recorder(tmp_path)
    frames = list(run.from_now(numbered(16_000)))
    with file_size_limit(25_000):
        for frame in frames[:4000]:
            run.take(frame)
        run.until(lambda: "not recording" in run.recording.problem)
        assert "check disk and folder" in run.recording.problem
    # What was begun before there was room may still fail.
    run.until(lambda: run.on_disk() and run.recording.problem == "")
    assert run.recording.recording
    for frame in frames[4000:]:
        run.take(frame)
    run.recording.close()
    texts = ["again" if "recording again" in event else "not" for event in run.events]
    assert texts and texts == ["not", "again"] * (len(texts) // 2)
    *_, last = run.recording.files
    assert len(records_of(last, "/snapshot", pb.Snapshot)) == 1
    tail = logged_frames(last)
    assert len(tail) >= 12_000 and tail == run.taken[-len(tail) :]
    assert run.recording.frames + run.recording.missed == len(frames)
    assert sum(len(logged_frames(finished(path))) for path in tmp_path.glob("*.mcap")) == run.recording.frames


@pytest.mark.parametrize("ticks", [0, 9, 11, 13])  # among them one at which it has just tried again
def test_a_disk_without_any_room_is_not_littered_with_empty_files(tmp_path: Path, ticks: int) -> None:
    with file_size_limit(500):
        run = Recorder(tmp_path)
        for frame in run.from_now(numbered(12_000)):
            run.take(frame)
        run.until(lambda: "not recording" in run.recording.problem)
        for _ in range(ticks):
            run.later()
        run.recording.close()
    assert list(tmp_path.iterdir()) == [] and run.recording.missed == 12_000 and len(run.events) == 1


def test_a_folder_that_is_removed_is_noticed_and_made_again(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    run = Recorder(folder)
    frames = list(run.from_now(numbered(9000)))
    for frame in frames[:1500]:
        run.take(frame)
    shutil.rmtree(folder)
    run.until(lambda: "not recording" in run.recording.problem)
    run.until(lambda: run.recording.problem == "")
    for frame in frames[1500:]:
        run.take(frame)
    run.recording.close()
    assert "not recording" in run.events[0] and "recording again" in run.events[1]
    (path,) = folder.iterdir()
    assert logged_frames(path) == run.taken[1500:]


def test_a_folder_that_cannot_be_is_said_and_tried_again(tmp_path: Path) -> None:
    """A file stands where the folder should be: no privilege gets past that."""
    folder = tmp_path / "logs"
    folder.write_text("in the way")
    run = Recorder(folder)
    frames = list(run.from_now(numbered(8000)))
    assert not run.recording.recording and str(folder) in run.recording.problem
    for frame in frames[:100]:
        run.take(frame)
    assert run.recording.missed == 100
    folder.unlink()
    run.until(lambda: run.recording.problem == "")
    for frame in frames[100:]:
        run.take(frame)
    run.recording.close()
    (path,) = run.recording.files
    assert len(records_of(path, "/snapshot", pb.Snapshot)) == 1  # it does not begin where the run began
    assert len(logged_frames(path)) == run.recording.frames == 8000 - 100


def finished(path: Path) -> Path:
    """The file, whole: as `tilth recover` or the next start makes it."""
    finish(path)
    return path


def relation(t_s: float, realtime_s: float) -> Relation:
    return Relation(int(t_s * 1e9), int(realtime_s * 1e9), 0, 0)


@pytest.mark.parametrize(
    ("ahead_s", "found_s"),
    [
        ([0.0, 0.0, 0.0], [0, 0, 0]),
        ([0.0, 0.05, 0.12], [0, 0, 0]),  # drift
        ([0.0, 0.0, 3600.0, 3600.0], [0, 0, 3600, 0]),
        ([0.0, -0.5, -0.5], [0, -0.5, 0]),
    ],
)
def test_a_step_of_the_wall_clock_is_found_once(ahead_s: list[float], found_s: list[float]) -> None:
    clock = Clock()
    looks = [clock.step_ns(relation(float(i), i + ahead)) * 1e-9 for i, ahead in enumerate(ahead_s)]
    assert looks == pytest.approx(found_s)


@pytest.mark.parametrize(
    ("age_ns", "waited_ns", "good"),
    [
        (150_000, 0, True),
        (OLDEST_NS - 100_000_000, 0, True),
        (OLDEST_NS + 100_000_000, 0, False),  # or the wall clock was set forward meanwhile
        (OLDEST_NS + 100_000_000, 200_000_000, True),  # the loop was busy when the frame came
        (3 * OLDEST_NS, 2 * OLDEST_NS - 100_000_000, False),
        (NEWEST_NS // 2, 0, True),
        (10 * NEWEST_NS, OLDEST_NS, False),  # the wall clock was set back meanwhile
    ],
)
def test_rx_ns_is_the_stamp_and_never_later_than_t_ns(age_ns: int, waited_ns: int, good: bool) -> None:
    clock = Clock()
    clock.offset_ns += 7_000_000_000  # as after a step of the wall clock since the start
    stamp_ns = time.time_ns() - age_ns
    ahead_ns = clock.wall_ahead_ns()
    t_ns = clock.t_ns()
    rx_ns = clock.rx_ns(stamp_ns - ahead_ns, t_ns, t_ns - waited_ns)
    assert rx_ns <= t_ns and clock.bad_stamps == (not good)
    assert ahead_ns == pytest.approx(-7_000_000_000, abs=100_000)
    assert rx_ns == (stamp_ns - ahead_ns if good and age_ns > 0 else t_ns)


def test_both_clocks_are_told_apart_to_a_microsecond() -> None:
    """Their difference stands between two steps: many looks agree, and begin at none."""
    clock = Clock()
    looks = [clock.wall_ahead_ns() for _ in range(1000)]
    assert max(map(abs, looks)) < 1_000
