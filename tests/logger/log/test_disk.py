"""Disks that are full or slow: a real small one, and one that does not answer for a while."""

import json
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from loopback import logged_frames, numbered, records_of
from one_recording import Recorder
from paths import SUPPORT
from small_disk import on_a_small_disk

from tilth.logger.log.disk import Disk, Spool
from tilth.logger.log.run_log import FLUSH_NS
from tilth.logger.log.runs import stored_runs
from tilth.logger.status import recording_hours
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Event
from tilth.schemas.notices import in_words
from tilth.schemas.proto import tilth_pb2 as pb


def recorded_while_full(job: str, folder: Path) -> dict[str, Any]:
    done = on_a_small_disk(folder, "24m", sys.executable, SUPPORT / "full_disk.py", folder, job)
    assert done.status == 0, done.err
    output: dict[str, Any] = json.loads(done.out)
    return output


def test_a_full_disk_stops_the_recording_alone_and_it_resumes(tmp_path: Path) -> None:
    result = recorded_while_full("resumes", tmp_path)
    assert result["said"].startswith("not recording: ") and "disk" in result["said"]
    assert not result["recording while full"] and result["folded"] == 12_000
    assert result["first"] and result["last"]  # what had been written before, and all after there was room
    assert (
        result["in the files"] == result["recorded"] == 12_000 - result["missed"] and result["missed"] >= 2000
    )
    assert "recording again" in result["events"][-1]


def test_room_is_made_of_runs_that_are_copied_off_and_not_kept(tmp_path: Path) -> None:
    result = recorded_while_full("makes room", tmp_path)
    assert result["left"] == ["20260101", "20260102"]
    deleted = [event for event in result["events"] if "deleted to make room: 3 MB" in event]
    assert ["20260103" in deleted[0], "20260104" in deleted[1], len(deleted)] == [True, True, 2]


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """The disk writes while this is set."""
    answers, sync = threading.Event(), os.fdatasync

    def stalling(descriptor: int) -> None:
        answers.wait()
        sync(descriptor)

    monkeypatch.setattr(os, "fdatasync", stalling)
    return answers


def test_a_disk_that_stalls_costs_no_frame_and_no_time(
    tmp_path: Path, answers: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers.set()
    run = Recorder(tmp_path, log="rotate_minutes = 0.05")
    frames = list(run.from_now(numbered(12_000)))
    for frame in frames[:2000]:
        run.take(frame)
    answers.clear()
    longest = 0.0
    for frame in frames[2000:7000]:  # five seconds of frames, and two new files in them
        began = time.thread_time()
        run.take(frame)
        longest = max(longest, time.thread_time() - began)
    assert longest < 0.5 and run.recording.recording
    since = time.monotonic() - 10.0  # it has waited for so long
    monkeypatch.setattr(run.recording._disk, "_busy_since_s", since)
    run.recording.tick(frames[6999].t_ns + 2 * FLUSH_NS)
    assert "the log waits in memory" in run.recording.problem
    answers.set()
    for frame in frames[7000:]:
        run.take(frame)
    run.until(lambda: run.recording.problem == "")
    run.recording.close()
    assert [frame for path in run.recording.files for frame in logged_frames(path)] == run.taken
    assert run.recording.missed == 0 and run.events == []


def test_a_disk_that_never_answers_stops_the_recording_before_memory_is_full(
    tmp_path: Path, answers: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tilth.logger.log.run_log.MOST_WAITING", 50_000)
    run = Recorder(tmp_path)
    for frame in run.from_now(numbered(9000)):
        run.take(frame)
    assert "does not keep up" in run.recording.problem and run.recording.missed > 0
    answers.set()
    run.until(lambda: run.recording.problem == "")
    for frame in run.from_now(numbered(1000)):
        run.take(frame)
    run.recording.close()
    found = [frame for path in sorted(tmp_path.glob("*.mcap")) for frame in logged_frames(path)]
    assert len(found) == run.recording.frames == 10_000 - run.recording.missed
    assert found[-1000:] == run.taken[-1000:]


def test_a_run_ends_with_the_ignition_and_the_next_frame_begins_another(tmp_path: Path) -> None:
    run = Recorder(tmp_path, log="ignition_off_s = 3")
    frames = list(run.from_now(numbered(4000)))
    for frame in frames[:2000]:
        run.take(frame)
    first = run.recording.run_id
    run.until(lambda: run.recording.resting)
    event = CHANNEL["/event"].encode(Event(frames[0].t_ns, "bus", in_words("can0: silent")))
    run.recording.message("/event", frames[0].t_ns, event)
    before = sorted(tmp_path.glob("*.mcap"))
    for frame in frames[2000:]:
        run.take(frame)
    run.recording.close()
    assert run.recording.run_id != first and run.events[-1].startswith(
        "log: ignition is on: a new run begins"
    )
    one, two = sorted(tmp_path.glob("*.mcap"), key=lambda path: path not in before)
    assert (
        before == [one] and logged_frames(one) == run.taken[:2000] and logged_frames(two) == run.taken[2000:]
    )
    assert len(records_of(two, "/snapshot", pb.Snapshot)) == 1  # it replays alone
    assert [retained.text for retained in records_of(two, "/event", pb.Event)] == ["can0: silent"]
    assert len(stored_runs(tmp_path)) == 2


def test_hours_left_are_those_at_the_rate_of_recording(tmp_path: Path) -> None:
    run = Recorder(tmp_path)
    assert run.recording.bytes_per_s is None and recording_hours(144e6) == 1.0
    for frame in run.from_now(numbered(25_000)):
        run.take(frame)
    rate = run.recording.bytes_per_s
    run.recording.close()
    assert rate == pytest.approx(run.recording.files[0].stat().st_size / 25.0, rel=0.2)
    assert rate is not None and recording_hours(rate * 7200.0, rate) == pytest.approx(2.0)


def test_what_was_written_reaches_the_disk_also_if_another_job_is_the_last(tmp_path: Path) -> None:
    """Room is looked for behind the head of a file: without a frame nothing else would bring that there."""
    disk = Disk(tmp_path)
    spool, hold = Spool(disk, tmp_path / "a.mcap"), threading.Event()
    spool.make(0.0)
    disk.do(lambda: (hold.wait(), None)[1])
    spool.write(b"head")
    spool.send(0)
    disk.do(disk.look)
    hold.set()
    assert disk.stop() and (spool.safe_bytes, spool.error) == (4, None)
