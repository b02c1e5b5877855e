"""The daemon while its estimators are not ready: all is recorded, and a replay begins where it began."""

import time
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from circle import demo_machine
from loopback import rig, until

from tilth.logger import live_estimation
from tilth.logger.daemon import Daemon
from tilth.logger.display import NoDisplay
from tilth.logger.log.run_files import RunFiles
from tilth.logger.run_summary import RunSummary
from tilth.replay.compare import Comparison
from tilth.replay.offline import ReplayOutputs, ReplaySummary, replay
from tilth.replay.readers.any_log import open_log
from tilth.replay.readers.log import Logged
from tilth.schemas.channels import READY_TOPIC
from tilth.schemas.flow import Estimate, Event, Frame
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.sentences import event_sentence
from tilth.simulator.traffic import simulate

pytestmark = pytest.mark.long


VIRTUAL = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-v"\n\n'
SENT = list(simulate(demo_machine(), 5, 4.5))
HALF = len(SENT) // 2


class ByHand:
    """Of Preparing, what the daemon sees; the test says when it is ready, however fast this computer is."""

    ready = False
    text = "compiling kernels"
    seconds = 12.0
    remaining_s = 7.5

    def __init__(self, machine: Machine, report: Callable[[str, str], None]) -> None:
        self.closed = False

    def close(self) -> None:
        self.closed = True

    def done(self) -> None:
        self.ready, self.text, self.remaining_s = True, "", None  # type: ignore[assignment]


class Shown(NoDisplay):
    def __init__(self) -> None:
        self.statuses: list[pb.Status] = []
        self.events: list[str] = []

    def show(self, status: pb.Status, estimate: Estimate | None) -> None:
        self.statuses.append(status)

    def event(self, event: Event) -> None:
        self.events.append(event_sentence(event))


class Drive:
    """A daemon on a virtual bus."""

    def __init__(self, folder: Path, talker: can.BusABC, log: str = "") -> None:
        self.machine, self.text = rig(folder, VIRTUAL, log=log)
        self.shown = Shown()
        self.daemon = Daemon(MachineFile(self.machine, self.text), folder, None, self.shown)
        self._talker = talker
        self._folder = folder
        self._sent = 0
        until(lambda: self.daemon.parts.buses.live_buses[0].state == "open", self.daemon.turn)

    def send(self, frames: list[Frame]) -> None:
        """In real time: what comes at once is of one instant, and gives no pose."""
        began_ns = time.monotonic_ns() - frames[0].t_ns
        for k, frame in enumerate(frames):
            message = can.Message(arbitration_id=frame.can_id, is_extended_id=frame.extended, data=frame.data)
            self._talker.send(message)
            if k % 32 == 0:
                due_ns = began_ns + frame.t_ns
                while time.monotonic_ns() < due_ns:
                    self.daemon.turn(0.005)
        self._sent += len(frames)
        until(lambda: self.daemon.parts.counts.frames == self._sent, self.daemon.turn)

    def rotated(self, parts: int) -> None:
        """However fast this computer is, the log has come to so many files."""
        until(lambda: len(list(self._folder.glob("*.mcap"))) >= parts, self.daemon.turn)

    def ready(self) -> None:
        by_hand = self.daemon.parts.estimation.preparing
        assert isinstance(by_hand, ByHand)
        by_hand.done()

    def end(self) -> RunSummary:
        return self.daemon.close()

    def again(self, paths: tuple[Path, ...]) -> tuple[ReplaySummary, Comparison, list[str]]:
        comparison, output = Comparison(), list[str]()
        outputs = ReplayOutputs(comparison=comparison)
        return (
            replay(paths, MachineFile(self.machine, self.text), outputs=outputs, say=output.append),
            comparison,
            output,
        )


@pytest.fixture(autouse=True)
def by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_estimation, "Preparing", ByHand)


def marks(paths: tuple[Path, ...]) -> list[tuple[bool, int, set[str]]]:
    """(ready, frames before it, topics before it) of each mark in a run's log."""
    found, frames, topics = [], 0, set[str]()
    everything = {READY_TOPIC, "/pose", "/soil_tire/tracker"}
    for path in paths:
        for row in open_log(path, everything).records:
            if isinstance(row, Frame):
                frames += 1
            elif isinstance(row, Logged) and row.topic == READY_TOPIC:
                found.append((pb.Ready.FromString(row.data).ready, frames, set(topics)))
            elif isinstance(row, Logged):
                topics.add(row.topic)
    return found


@pytest.mark.parametrize("log", ["", "rotate_minutes = 0.012"], ids=["one file", "parts"])
def test_estimates_begin_where_the_log_says_and_a_replay_begins_there(
    tmp_path: Path, talker: can.BusABC, log: str
) -> None:
    drive = Drive(tmp_path, talker, log)
    drive.send(SENT[:HALF])
    until(lambda: any(status.poses for status in drive.shown.statuses), drive.daemon.turn)
    waiting = drive.shown.statuses[-1]
    assert (waiting.preparing, waiting.ready_in_s) == ("compiling kernels", 7.5) and waiting.recording
    states = [{one.state for one in status.receivers} for status in drive.shown.statuses]
    assert {"alive"} in states  # on a busy computer not in each status
    drive.rotated(2 if log else 1)
    drive.ready()
    drive.send(SENT[HALF:])
    drive.rotated(4 if log else 1)  # one is there because the run's name was corrected
    summary = drive.end()
    assert any("compiled for 12 s while frames were recorded" in text for text in drive.shown.events)
    assert summary.recorded == len(SENT) and summary.faults == 0 and summary.poses > 3
    (not_yet, before, _), (ready, at, observed) = marks(summary.log_files)
    assert (not_yet, before, ready, at) == (False, 0, True, HALF)
    assert observed == {"/pose"}  # and estimates only after it
    assert summary.estimates["tracker"].t_ns > 0
    replayed, comparison, output = drive.again(summary.log_files)
    assert comparison.difference == "" and comparison.compared > summary.measurements
    assert replayed.poses == summary.poses
    assert [text for text in output if f"{HALF} frames came before the estimators were ready" in text]
    assert len(summary.log_files) >= (4 if log else 1)
    for path in summary.log_files[1:]:
        assert drive.again((path,))[1].difference == ""


def test_a_run_that_ends_before_has_all_frames_and_says_why_there_is_no_estimate(
    tmp_path: Path, talker: can.BusABC
) -> None:
    drive = Drive(tmp_path, talker)
    drive.send(SENT[:HALF])
    by_hand = drive.daemon.parts.estimation.preparing
    summary = drive.end()
    assert isinstance(by_hand, ByHand) and by_hand.closed
    replayed, comparison, output = drive.again(summary.log_files)
    assert (comparison.difference, replayed.frames) == ("", HALF)
    assert any("ends before the estimators were ready" in text for text in output)
    assert all(p.age_s is None for one in replayed.estimates.values() for p in one.parameters)


def test_a_log_of_another_run_is_taken_from_its_first_frame_on(tmp_path: Path, talker: can.BusABC) -> None:
    """Also after one that never was ready; and so is every log of before."""
    first = Drive(tmp_path / "a", talker)
    first.send(SENT[:100])
    waiting = first.end().log_files
    other = Drive(tmp_path / "b", talker)
    other.ready()
    other.daemon.turn()
    other.send(SENT)
    ready = other.end().log_files
    replayed, _, _ = other.again((*waiting, *ready))
    assert replayed.estimates["tracker"].t_ns > 0


def test_a_disk_that_has_not_made_the_first_file_yet_ends_nothing(
    tmp_path: Path, talker: can.BusABC, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = Drive(tmp_path, talker)
    with monkeypatch.context() as patch:
        patch.setattr(RunFiles, "paths", property(lambda files: []))
        drive.send(SENT[:HALF])
        shown = len(drive.shown.statuses)
        until(lambda: len(drive.shown.statuses) > shown + 1, drive.daemon.turn)
    assert drive.shown.statuses[-1].recording and drive.shown.statuses[-1].log_file == ""
    until(lambda: bool(drive.shown.statuses[-1].log_file), drive.daemon.turn)
    assert drive.end().log_files


def test_ready_while_ignition_is_off_the_next_run_is_estimated_from_its_first_frame(
    tmp_path: Path, talker: can.BusABC
) -> None:
    drive = Drive(tmp_path, talker, "ignition_off_s = 1.0")
    drive.send(SENT[:HALF])
    until(lambda: drive.daemon.parts.outlets.recording.resting, drive.daemon.turn)
    drive.ready()
    drive.daemon.turn()
    drive.send(SENT[HALF:])
    summary = drive.end()
    assert marks(summary.log_files) == []
    replayed, comparison, _ = drive.again(summary.log_files)
    assert comparison.difference == "" and replayed.estimates["tracker"].t_ns > 0
