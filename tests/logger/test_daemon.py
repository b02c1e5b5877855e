"""The whole live chain: real buses, real log, real signals. What goes wrong is said and costs no frame."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import can
import numpy as np
import pytest
from loopback import (
    PATIENCE_S,
    Sender,
    answers,
    free_port,
    logged_frames,
    machine_text,
    messages,
    numbered,
    records_of,
    rig,
    salvaged,
    session,
    udp_bus,
    until,
)
from mcap.reader import make_reader

from tilth.estimator import fold
from tilth.logger import daemon as daemon_module
from tilth.logger import guarded_fold
from tilth.logger.clock import Clock, Relation
from tilth.logger.daemon import Daemon, run_daemon
from tilth.logger.display import NoDisplay
from tilth.logger.guarded_fold import PAUSE_NS, GuardedFold
from tilth.logger.status import YOUNG_S
from tilth.logger.status_line import PlainDisplay
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Estimate, Event, Frame, Publication, Status
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.sentences import event_sentence
from tilth.simulator.traffic import simulate

VIRTUAL = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-daemon"\n\n'


COMMAND = """
import sys
sys.modules["asammdf"] = None  # two seconds of import for reading files
from tilth.cli import main
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.sentences import event_sentence
raise SystemExit(main())
"""


@dataclass
class Command:
    """`tilth run`, starting in a process of its own."""

    process: "subprocess.Popen[str]"
    folder: Path

    def ready(self) -> None:
        assert self.process.stdout is not None
        assert self.process.stdout.readline().endswith("starting\n")
        assert "recording, 0.0 MB" in self.process.stdout.readline()

    @property
    def log(self) -> Path:
        (path,) = self.folder.iterdir()
        return path


@pytest.fixture(scope="module", autouse=True)
def commands(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[dict[str, Command], int]]:
    """Three of them on one bus, and the bus's port. Early, so that they start while other tests wait."""
    port = free_port()
    started = {}
    for name in ("TERM", "INT", "KILL"):
        folder = tmp_path_factory.mktemp(name)
        file = folder / "m.toml"
        # Chunks so large that only the flush of each second brings anything to the disk.
        text = machine_text(folder / "logs", udp_bus("can0", port), log="chunk_kilobytes = 4096")
        file.write_text(text)
        words = [sys.executable, "-c", COMMAND, "run", str(file)]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        started[name] = Command(process, folder / "logs")
    yield started, port
    for command in started.values():
        command.process.kill()
        command.process.communicate()


@pytest.fixture
def talker() -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel="tilth-daemon") as bus:
        yield bus


def say(bus: can.BusABC, frame: Frame) -> None:
    bus.send(can.Message(arbitration_id=frame.can_id, is_extended_id=frame.extended, data=frame.data))


class Shown(NoDisplay):
    """A display that remembers."""

    def __init__(self) -> None:
        self.status = pb.Status()
        self.sensors: list[tuple[set[str], set[str], str]] = []  # of each status: states, fixes, wheel angle
        self.events: list[Event] = []

    def show(self, status: pb.Status, estimate: Estimate | None) -> None:
        self.status = status
        rows = status.receivers
        self.sensors.append(({r.state for r in rows}, {r.fix for r in rows}, status.wheel_angle.state))

    def event(self, event: Event) -> None:
        self.events.append(event)


# ---- the chain ----


@pytest.mark.usefixtures("prepared")
def test_what_is_live_is_what_a_replay_gives(tmp_path: Path, sender: Sender) -> None:
    """Frames of another process over a real socket: all logged as sent; the log gives the same bytes."""
    port = free_port()
    machine, text = rig(tmp_path, udp_bus("can0", port), log="rotate_minutes = 0.03")
    sent = list(simulate(machine, 5, 4.0))
    displayed = Shown()
    began = threading.Event()

    def stop() -> bool:
        if not began.is_set() and displayed.status.buses and displayed.status.buses[0].state == "open":
            began.set()
            sender.begin([port], [(0, f, (f.t_ns - sent[0].t_ns) * 1e-9) for f in sent])
        return displayed.status.frames == len(sent)

    summary = run_daemon(MachineFile(machine, text), seconds=PATIENCE_S, status=displayed, stop=stop)
    sender.finish()
    assert summary.frames == summary.recorded == len(sent) and summary.lost == summary.not_recorded == 0
    got = [frame for path in summary.log_files for frame in logged_frames(path)]
    assert [(f.can_id, f.extended, f.data) for f in got] == [(f.can_id, f.extended, f.data) for f in sent]
    assert len(summary.log_files) > 1
    for path in summary.log_files:
        snapshot = records_of(path, "/snapshot", pb.Snapshot)
        replay = GuardedFold(machine, snapshot[0].state_json if snapshot else None)
        again = [(p.topic, p.t_ns, data) for f in logged_frames(path) for p, data in replay.take(f)]
        with messages(path) as rows:
            live = [(c.topic, m.log_time, m.data) for c, m in rows if c.topic in CHANNEL]
            taken_ns = 0
            for channel, row in rows:  # raw first: results stand behind the frame that caused them
                raw = channel.topic.startswith("/can/")
                assert raw or channel.topic not in CHANNEL or row.log_time >= taken_ns
                assert raw or channel.topic != "/pose" or row.log_time == taken_ns
                taken_ns = row.log_time if raw else taken_ns
        identical = [row for row in live if CHANNEL[row[0]].identical]
        assert identical == [row for row in again if CHANNEL[row[0]].identical]
    assert summary.measurements > 1000 and summary.poses > 0 and summary.faults == 0
    assert ({"alive"}, {"rtk_fixed"}, "alive") in displayed.sensors  # on a busy computer not in each status


def test_the_status_is_published_and_logged_each_second(tmp_path: Path, talker: can.BusABC) -> None:
    machine, text = rig(tmp_path, VIRTUAL)
    daemon = Daemon(MachineFile(machine, text), tmp_path, "", NoDisplay())
    say(talker, numbered(1)[0])
    with session(machine.zenoh.listen) as other:
        key = f"tilth/{machine.name}/status"

        def last_status() -> pb.Status:
            return pb.Status.FromString(answers(other, key).get(key, (b"", ""))[0])

        ended_s = [time.monotonic()]

        def turn() -> None:
            daemon.turn()
            ended_s.append(time.monotonic())

        until(lambda: last_status().frames == 1 and last_status().uptime_s > 2.0, turn)
        last = last_status()
    summary = daemon.close()
    assert last.recording and last.log_file == str(summary.log_files[0]) and last.log_bytes > 0
    assert [bus.name for bus in last.buses] == ["can0"] and len(last.receivers) == 4
    assert sum("not heard yet" in problem and "tractor front" in problem for problem in last.problems) == 1
    statuses = records_of(summary.log_files[0], "/status", pb.Status)
    assert last in statuses
    assert not any(status.problems for status in statuses if status.uptime_s < YOUNG_S)  # too early
    apart_s = np.diff([status.t_ns for status in statuses[:-1]]) * 1e-9  # the last is that of the end
    assert apart_s.min() >= 1.0
    assert apart_s.max() < 1.1 + 2 * max(np.diff(ended_s))  # as soon as the loop comes round


# ---- signals, with the real command in a process of its own ----


def test_signals_and_a_crash(commands: tuple[dict[str, Command], int], sender: Sender) -> None:
    """SIGTERM and SIGINT end with a whole file and all frames; SIGKILL costs what was not yet synced."""
    started, port = commands
    for command in started.values():
        command.ready()
    sent = numbered(2500)
    sender.begin([port], [(0, frame, i / 1000) for i, frame in enumerate(sent)])
    sender.finish()
    until(lambda: len(salvaged(started["KILL"].log.read_bytes())) >= 1000)
    started["KILL"].process.kill()
    for name, signum in (("TERM", signal.SIGTERM), ("INT", signal.SIGINT)):
        command = started[name]
        command.process.send_signal(signum)
        out, _ = command.process.communicate(timeout=PATIENCE_S)
        assert command.process.returncode == 0, out
        assert f"2500 frames, 0 measurements, 0 poses\nLog: {command.log}\n" in out
        assert [frame.data for frame in logged_frames(command.log)] == [frame.data for frame in sent]
    started["KILL"].process.wait(PATIENCE_S)
    remaining = salvaged(started["KILL"].log.read_bytes())
    assert [frame.data for frame in remaining] == [frame.data for frame in sent[: len(remaining)]]
    assert len(remaining) >= 1000


# ---- what goes wrong ----


def test_a_fault_in_the_estimators_costs_no_frame(
    tmp_path: Path, talker: can.BusABC, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine, text = rig(tmp_path, VIRTUAL)

    def breaks(state: fold.State, frame: Frame) -> list[Publication]:
        if frame.data == numbered(4)[3].data:
            raise ZeroDivisionError("a model")
        return fold.step(state, frame)

    monkeypatch.setattr(guarded_fold, "step", breaks)
    displayed = Shown()
    for frame in numbered(10):
        say(talker, frame)  # nobody listens yet
    daemon = Daemon(MachineFile(machine, text), tmp_path, None, displayed)
    until(lambda: daemon.turn() == 0 and displayed.status.buses[0].state == "open")
    for frame in numbered(10):
        say(talker, frame)
    until(lambda: daemon.turn() == 0 and bool(displayed.events))
    summary = daemon.close()
    (path,) = summary.log_files
    assert [f.data for f in logged_frames(path)] == [f.data for f in numbered(10)] and summary.faults == 1
    (event,) = [event for event in displayed.events if event.kind == "fault"]
    assert "ZeroDivisionError: a model" in event_sentence(event)
    (estimate,) = records_of(path, "/soil_tire", pb.SoilTireEstimate)
    assert {row.status for row in estimate.parameters} == {int(Status.INVALID)}
    assert all("ZeroDivisionError" in row.reason and not row.HasField("value") for row in estimate.parameters)
    replay = GuardedFold(machine)  # fails at the same frame and says the same
    again = [data for f in logged_frames(path) for p, data in replay.take(f) if p.topic == "/soil_tire"]
    assert again == [estimate.SerializeToString()] and replay.faults == 1


def test_after_a_fault_the_fold_pauses_and_its_counts_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine, _ = rig(tmp_path, VIRTUAL)
    guarded = GuardedFold(machine)
    frames = list(simulate(machine, 1, 3.0))
    for frame in frames:
        guarded.take(frame)
    before = (guarded.measurements, guarded.poses, guarded.rejected)
    with monkeypatch.context() as broken:
        broken.setattr(guarded_fold, "step", lambda state, frame: 1 / 0)
        assert guarded.take(frames[-1]) != [] and guarded.take(frames[-1]) == [] and guarded.faults == 1
    assert (guarded.measurements, guarded.poses, guarded.rejected) == before
    last_ns = frames[-1].t_ns
    assert guarded.take(replace(frames[-1], t_ns=last_ns + PAUSE_NS - 1)) == []
    again = [replace(f, t_ns=f.t_ns + 4 * PAUSE_NS, rx_ns=f.rx_ns + 4 * PAUSE_NS) for f in frames]
    assert sum(len(guarded.take(frame)) for frame in again) > 500 and guarded.measurements > before[0]


def test_a_log_folder_that_cannot_be_written_does_not_stop_the_rest(
    tmp_path: Path, talker: can.BusABC
) -> None:
    (tmp_path / "logs").write_text("in the way")
    machine, text = rig(tmp_path / "logs", VIRTUAL)
    displayed = Shown()
    daemon = Daemon(MachineFile(machine, text), tmp_path / "logs", "", displayed)
    with session(machine.zenoh.listen) as other:
        key = f"tilth/{machine.name}/event"
        until(lambda: key in answers(other, key), daemon.turn)
        assert b"not recording" in answers(other, key)[key][0]
    say(talker, numbered(1)[0])
    until(lambda: displayed.status.frames == 1, daemon.turn)
    summary = daemon.close()
    assert summary.frames == summary.not_recorded == 1 and summary.log_files == ()
    assert not displayed.status.recording and "not recording" in displayed.status.problems[0]


@pytest.mark.usefixtures("watched_by_hand")
def test_a_bus_that_does_not_exist_is_said_and_the_other_is_logged(
    tmp_path: Path, talker: can.BusABC
) -> None:
    missing = '[[bus]]\nname = "can9"\ninterface = "socketcan"\nchannel = "nosuchcan9"\n\n'
    machine, text = rig(tmp_path, VIRTUAL, missing)
    displayed = Shown()
    daemon = Daemon(MachineFile(machine, text), tmp_path, None, displayed)
    until(lambda: bool(displayed.events), daemon.turn)
    say(talker, numbered(1)[0])
    until(lambda: displayed.status.frames == 1, daemon.turn)
    summary = daemon.close()
    assert "can9" in (words := event_sentence(displayed.events[0])) and "nosuchcan9" in words
    assert any(problem.startswith("bus can9 failed") for problem in displayed.status.problems)
    assert [frame.bus for frame in logged_frames(summary.log_files[0])] == ["can0"]
    collected = [(event.kind, event.text) for event in records_of(summary.log_files[0], "/event", pb.Event)]
    assert collected == [(event.kind, event_sentence(event)) for event in displayed.events]
    assert collected[1:] == [("bus", "can0: its frames are stamped by the driver behind python-can")]


class SteppingClock(Clock):
    """The computer's clock is set forward by an hour at the second look."""

    looks = 0

    def relation(self) -> Relation:
        now = super().relation()
        self.looks += 1
        return now if self.looks < 3 else replace(now, realtime_ns=now.realtime_ns + 3_600_000_000_000)


@pytest.mark.usefixtures("watched_by_hand")
def test_a_step_of_the_clock_is_noted_and_the_log_goes_on_evenly(
    tmp_path: Path, talker: can.BusABC, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daemon_module, "Clock", SteppingClock)
    machine, text = rig(tmp_path, VIRTUAL)
    displayed = Shown()
    daemon = Daemon(MachineFile(machine, text), tmp_path, None, displayed)
    until(lambda: bool(displayed.events), daemon.turn)
    for frame in numbered(3):
        say(talker, frame)
    until(lambda: displayed.status.frames == 3, daemon.turn)
    summary = daemon.close()
    assert displayed.events[0].kind == "clock" and "set by +3600.000 s" in event_sentence(displayed.events[0])
    times = [frame.t_ns for frame in logged_frames(summary.log_files[0])]
    assert times == sorted(times) and times[-1] - times[0] < PATIENCE_S * 1e9  # and not the hour
    assert clock_records(summary.log_files[0]) == ["start", "step", "end"]


def clock_records(path: Path) -> list[str]:
    with path.open("rb") as stream:
        return [r.metadata["why"] for r in make_reader(stream).iter_metadata() if r.name == "clock"]


def test_a_terminal_that_goes_away_does_not_stop_the_log(tmp_path: Path, talker: can.BusABC) -> None:
    machine, text = rig(tmp_path, VIRTUAL)
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as gone:
        daemon = Daemon(MachineFile(machine, text), tmp_path, None, PlainDisplay(gone))
        for _ in range(3):
            daemon.turn(0.0)
        say(talker, numbered(1)[0])
        until(lambda: daemon.turn() == 1)
        assert daemon.close().recorded == 1
        with contextlib.suppress(BrokenPipeError):
            gone.close()
