"""What systemd hears of the daemon, through a socket such as systemd's own."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from loopback import PATIENCE_S, answers, numbered, rig, session, until

from tilth.logger.daemon import Daemon
from tilth.logger.display import NoDisplay
from tilth.logger.status import health_of
from tilth.logger.supervisor import Supervisor, of_environment
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto import tilth_pb2 as pb

VIRTUAL = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-supervisor"\n\n'


class Systemd:
    """Hears what it is told."""

    def __init__(self, address: str) -> None:
        self.told = address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self._socket.setblocking(False)

    def received(self) -> list[str]:
        """All that has come and was not heard yet."""
        words = []
        while True:
            try:
                words.append(self._socket.recv(4096).decode())
            except BlockingIOError:
                return words

    def close(self) -> None:
        self._socket.close()


@pytest.fixture(params=["path", "abstract"])
def systemd(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Systemd]:
    name = {"path": str(tmp_path / "notify"), "abstract": f"@tilth-{os.getpid()}-{tmp_path.name}"}
    one = Systemd(name[request.param])
    yield one
    one.close()


def test_the_loop_itself_says_that_it_lives(systemd: Systemd) -> None:
    supervisor = Supervisor({"NOTIFY_SOCKET": systemd.told, "WATCHDOG_USEC": "8000000"})
    assert systemd.received() == []  # nothing before the first turn
    for t_ns in (10, 11, 2_000_000_009, 2_000_000_010):
        supervisor.turned(t_ns)
    assert systemd.received() == ["READY=1", "WATCHDOG=1", "WATCHDOG=1"]
    supervisor.status("one\nline, whatever \0 the words")
    assert systemd.received() == ["STATUS=one line, whatever \0 the words"]
    supervisor.stopping()
    assert systemd.received() == ["STOPPING=1"] and supervisor.failures == 0
    supervisor.close()


@pytest.mark.parametrize(
    ("environment", "beats"),
    [
        ({"WATCHDOG_USEC": "1000"}, True),
        ({"WATCHDOG_USEC": "1000", "WATCHDOG_PID": str(os.getpid())}, True),
        ({"WATCHDOG_USEC": "1000", "WATCHDOG_PID": str(os.getpid() + 1)}, False),
        ({"WATCHDOG_USEC": "often"}, False),
        ({"WATCHDOG_USEC": "-1"}, False),
        ({}, False),
    ],
)
def test_only_whom_systemd_watches_beats(environment: dict[str, str], beats: bool, tmp_path: Path) -> None:
    systemd = Systemd(str(tmp_path / "notify"))
    supervisor = Supervisor({"NOTIFY_SOCKET": systemd.told, **environment})
    supervisor.turned(1)
    assert ("WATCHDOG=1" in systemd.received()) is beats
    supervisor.close()
    systemd.close()


def test_nobody_there_and_nobody_who_listens_costs_nothing_but_a_count(tmp_path: Path) -> None:
    for result in ("", "not/absolute"):
        silent = Supervisor({"NOTIFY_SOCKET": result, "WATCHDOG_USEC": "1000"})
        silent.turned(1)
        assert silent.failures == 0
    gone = Supervisor({"NOTIFY_SOCKET": str(tmp_path / "nobody"), "WATCHDOG_USEC": "1000"})
    gone.turned(1)
    assert gone.failures == 2  # READY and WATCHDOG
    deaf = Systemd(str(tmp_path / "deaf"))
    supervisor = Supervisor({"NOTIFY_SOCKET": deaf.told})
    until(lambda: supervisor.failures > 0, lambda: supervisor.status("x"))  # its queue is full; no wait
    deaf.received()
    supervisor.turned(1)
    assert deaf.received() == ["READY=1"]
    gone.turned(2)  # READY is said again until it is heard
    assert gone.failures == 3
    supervisor.close()
    gone.close()
    deaf.close()


def test_what_this_process_starts_does_not_speak_for_it() -> None:
    environment = {"NOTIFY_SOCKET": "@x", "WATCHDOG_USEC": "1", "WATCHDOG_PID": "1", "HOME": "/root"}
    of_environment(environment).close()
    assert environment == {"HOME": "/root"}


def test_a_run_is_ready_beats_tells_and_stops_and_a_hung_one_falls_silent(tmp_path: Path) -> None:
    systemd = Systemd(str(tmp_path / "notify"))
    machine, text = rig(tmp_path, VIRTUAL)
    supervisor = Supervisor({"NOTIFY_SOCKET": systemd.told, "WATCHDOG_USEC": "40000"})
    daemon = Daemon(MachineFile(machine, text), tmp_path, None, NoDisplay(), supervisor=supervisor)
    assert systemd.received() == []
    words: list[str] = []
    with can.Bus(interface="virtual", channel="tilth-supervisor") as bus:
        frame = numbered(1)[0]
        bus.send(can.Message(arbitration_id=frame.can_id, is_extended_id=True, data=frame.data))

        def turn() -> None:
            daemon.turn()
            words.extend(systemd.received())

        until(lambda: words.count("WATCHDOG=1") > 5, turn)
        # No thread beats in its place: while the loop does not come round, nothing is said.
        until(lambda: daemon.uptime_s > 0.5, lambda: words.extend(systemd.received()))
        beaten = words.count("WATCHDOG=1")
        until(lambda: daemon.uptime_s > 0.6, lambda: words.extend(systemd.received()))
        assert words.count("WATCHDOG=1") == beaten
        summary = daemon.close()
    words += systemd.received()
    assert summary.recorded == summary.frames == 1
    collected = [word for word in words if word.startswith("STATUS=")]
    assert "READY=1" in words[:2] and collected[-1].startswith("STATUS=recording, 0.0 MB, 1 frames")
    assert words.index("STOPPING=1") < len(words) - words[::-1].index(collected[-1])
    systemd.close()


@pytest.mark.parametrize(
    ("status", "health"),
    [
        (pb.Status(recording=True), "good"),
        (pb.Status(recording=True, problems=["a receiver is lost"]), "degraded"),
        (pb.Status(recording=False, problems=["the disk is full"]), "bad"),
    ],
)
def test_health_in_a_word(status: pb.Status, health: str) -> None:
    assert health_of(status) == health


def test_the_heartbeat_on_zenoh_counts_what_went_wrong(tmp_path: Path) -> None:
    machine, text = rig(tmp_path, VIRTUAL)
    (tmp_path / "logs").write_text("no folder")
    daemon = Daemon(MachineFile(machine, text), tmp_path / "logs", "", NoDisplay(), supervisor=Supervisor({}))
    key = f"tilth/{machine.name}/status"
    with (
        can.Bus(interface="virtual", channel="tilth-supervisor") as bus,
        session(machine.zenoh.listen) as other,
    ):

        def last_status() -> pb.Status:
            daemon.turn()
            return pb.Status.FromString(answers(other, key).get(key, (b"", ""))[0])

        until(lambda: any(one.state == "open" for one in last_status().buses))
        for frame in numbered(3):
            bus.send(can.Message(arbitration_id=frame.can_id, is_extended_id=True, data=frame.data))
        until(lambda: sum(row.count for row in last_status().faults) == 3)
        status = last_status()
    daemon.close()
    assert status.health == "bad" and not status.recording
    assert status.frames == 3 and {row.reason: row.count for row in status.faults} == {"not_recorded": 3}
    assert 0.0 < status.longest_turn_s < PATIENCE_S
