"""Marks of an operator: on the disk before anybody is told, refused with a reason otherwise."""

import calendar
import queue
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from hypothesis import example, given, settings
from hypothesis import strategies as st
from loopback import PATIENCE_S, free_port, machine_text, records_of, rig, session, udp_bus, until
from turned import turning

from tilth.cli import main
from tilth.logger.clock import LEAST_TIMES
from tilth.logger.daemon import Daemon
from tilth.logger.display import NoDisplay
from tilth.logger.log.marks import EACH
from tilth.logger.log.recovery import finish
from tilth.logger.run_parts import all_rejected
from tilth.schemas.limiter import LOCAL
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto import tilth_pb2 as pb

KEY = "tilth/jd7930-parker500/mark"


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    machine, text = rig(tmp_path, udp_bus("can0", free_port()))
    with turning(Daemon(MachineFile(machine, text), tmp_path / "logs", "", NoDisplay())) as one:
        yield one


@pytest.fixture(scope="module")
def listening(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    """One for many queries."""
    folder = tmp_path_factory.mktemp("listening")
    machine, text = rig(folder, udp_bus("can0", free_port()))
    with turning(Daemon(MachineFile(machine, text), folder / "logs", "", NoDisplay())) as one:
        yield one


@pytest.fixture(scope="module")
def other(listening: Daemon) -> Iterator[zenoh.Session]:
    assert listening.parts.outlets.sink is not None
    with session(listening.parts.outlets.sink.endpoints) as one:
        yield one


def text_of(sample: zenoh.Sample) -> str:
    return pb.Event.FromString(sample.payload.to_bytes()).text


def ask(other: zenoh.Session, key: str, payload: bytes | str | None) -> list[zenoh.Reply]:
    return list(other.get(key, payload=payload, timeout=PATIENCE_S))


def noted(folder: Path, cut: Path) -> list[str]:
    """Marks in the log as a power cut now would leave it."""
    (path,) = folder.glob("*.mcap")
    copy = cut / "cut.mcap"
    shutil.copy(path, copy)
    finish(copy)
    return [event.text for event in records_of(copy, "/event", pb.Event) if event.kind == "mark"]


def test_a_mark_tells_utc_where_the_computer_woke_in_1970(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    wall = time.time_ns
    truth_ns = wall()
    behind_ns = truth_ns - 20_000_000_000
    monkeypatch.setattr(time, "time_ns", lambda: wall() - behind_ns)
    machine, text = rig(tmp_path, udp_bus("can0", free_port()))
    daemon = Daemon(MachineFile(machine, text), tmp_path / "logs", "", NoDisplay())
    path = tmp_path / "m.toml"
    path.write_text(text)
    with turning(daemon):
        assert main(["mark", "too early", "--machine", str(path)]) == 0
        assert "at a time that is not known yet, marked: too early" in capsys.readouterr().out
        for k in range(LEAST_TIMES):
            t_ns = daemon.parts.clock.t_ns()
            daemon.parts.clock.add_gnss_time(t_ns + k, t_ns + k + behind_ns)
        assert main(["mark", "a stone", "--machine", str(path)]) == 0
        output = capsys.readouterr().out.split()[0]
    told_ns = calendar.timegm(time.strptime(output, "%Y-%m-%dT%H:%M:%SZ")) * 1_000_000_000
    assert -1_000_000_000 <= told_ns - truth_ns < 120_000_000_000


def test_a_mark_is_on_the_disk_when_it_is_acknowledged_and_published_once(
    daemon: Daemon, tmp_path: Path
) -> None:
    sink = daemon.parts.outlets.sink
    assert sink is not None
    received: list[str] = []
    with session(sink.endpoints) as other:
        events = KEY.replace("mark", "event")
        with other.declare_subscriber(events, lambda sample: received.append(text_of(sample))):
            (reply,) = ask(other, KEY, "nasse Senke, Spur 3")
            assert reply.ok is not None
            event = pb.Event.FromString(reply.ok.payload.to_bytes())
            assert (event.kind, event.text) == ("mark", "nasse Senke, Spur 3")
            assert str(reply.ok.encoding) == "application/protobuf;tilth.Event"
            assert noted(tmp_path / "logs", tmp_path) == ["nasse Senke, Spur 3"]
            until(lambda: "nasse Senke, Spur 3" in received)
        # On a computer without kernels an event tells of their compiling.
        assert [text for text in received if not text.startswith("compiling")] == ["nasse Senke, Spur 3"]


REFUSED = {
    "nothing": (None, "as the payload of the query"),
    "blank": ("  ", "blank"),
    "long": ("x" * 1025, "1025 bytes"),
    "huge": (b"y" * 10_000_000, "10000000 bytes"),
    "no UTF-8": (b"\xff\xfe", "no UTF-8"),
    "control characters": ("a\x1b[2Jb", "control characters"),
}


def test_what_is_no_mark_is_refused_with_a_reason_and_changes_nothing(daemon: Daemon, tmp_path: Path) -> None:
    sink = daemon.parts.outlets.sink
    assert sink is not None
    accept = KEY.replace("mark", "accept")
    with session(sink.endpoints) as other:
        for key, order in ((KEY, "a mark "), (accept, "an order to accept ")):
            for payload, reason in REFUSED.values():
                (reply,) = ask(other, key, payload)
                said = reply.err.payload.to_string() if reply.err is not None else ""
                assert said.startswith(order) and reason in said
        (reply,) = ask(other, accept, None)
        assert (
            reply.err is not None and "needs the name of what has been moved" in reply.err.payload.to_string()
        )
        # Who asks for everything there is asks for no mark, and gets no error.
        assert all(reply.ok for reply in ask(other, KEY.replace("mark", "**"), "by accident"))
        assert ask(other, KEY, "x" * 1024)[0].ok
    counts = all_rejected(daemon.parts)
    assert (counts["mark"], counts["accept"]) == (len(REFUSED), len(REFUSED) + 1)


def test_a_mark_that_cannot_be_recorded_is_refused(tmp_path: Path) -> None:
    (tmp_path / "logs").write_text("a file where the folder should be")
    machine, text = rig(tmp_path, udp_bus("can0", free_port()))
    with turning(Daemon(MachineFile(machine, text), tmp_path / "logs", "", NoDisplay())) as daemon:
        assert daemon.parts.outlets.sink is not None
        with session(daemon.parts.outlets.sink.endpoints) as other:
            (reply,) = ask(other, KEY, "here")
    assert reply.err is not None and "not record" in reply.err.payload.to_string()


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "m.toml"
    file.write_text(machine_text(tmp_path / "logs", udp_bus("can0", free_port())))
    assert main(["mark", "nobody", "--machine", str(file)]) == 2
    assert "tilth run" in capsys.readouterr().err
    machine, text = rig(tmp_path / "logs", udp_bus("can0", free_port()))
    file.write_text(text)
    with turning(Daemon(MachineFile(machine, text), tmp_path / "logs", "", NoDisplay())):
        assert main(["mark", "stone", "--machine", str(file)]) == 0
        assert "marked: stone" in capsys.readouterr().out
        assert main(["mark", "x" * 2000, "--machine", str(file)]) == 2
        assert "2000 bytes" in capsys.readouterr().err
        assert main(["mark", "elsewhere", "--endpoint", machine.zenoh.listen[0]]) == 0
    assert noted(tmp_path / "logs", tmp_path) == ["stone", "elsewhere"]


def test_the_command_in_a_simulation(tmp_path: Path) -> None:
    """As `tilth demo` runs the daemon, and as the page marks there."""
    machine, text = rig(tmp_path, udp_bus("can0", free_port()))
    with turning(Daemon(MachineFile(machine, text), tmp_path / "logs", "replay", NoDisplay())):
        assert main(["mark", "stone", "--endpoint", machine.zenoh.listen[0]]) == 0
    assert noted(tmp_path / "logs", tmp_path) == ["stone"]


@settings(max_examples=40, deadline=None)
@given(key=st.sampled_from(["mark", "accept", "report/file"]), payload=st.binary(max_size=1100))
@example("mark", b"\xed\xa0\x80")
@example("accept", b"")
def test_every_query_is_answered(listening: Daemon, other: zenoh.Session, key: str, payload: bytes) -> None:
    (reply,) = other.get(KEY.replace("mark", key), payload=payload, timeout=PATIENCE_S)
    assert reply.ok is not None or (reply.err is not None and reply.err.payload.to_string())


def test_who_asks_too_often_is_refused_until_that_is_answered(
    listening: Daemon, other: zenoh.Session
) -> None:
    replies: queue.SimpleQueue[zenoh.Reply] = queue.SimpleQueue()
    for number in range(200):
        other.get(KEY, replies.put, payload=f"flood {number}", timeout=PATIENCE_S)
    said = [replies.get(timeout=PATIENCE_S) for _ in range(200)]
    refused = {reply.err.payload.to_string() for reply in said if reply.err is not None}
    assert refused <= {f"too many marks at a time from {LOCAL}, {EACH} are the most; try again soon"}
    assert any(reply.ok for reply in said) and ask(other, KEY, "when it is over")[0].ok
