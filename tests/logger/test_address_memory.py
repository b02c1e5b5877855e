"""A daemon that is restarted while driving knows its receivers: from before, or by where they are."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import can
import pytest
from logs import MACHINE
from loopback import PATIENCE_S, Sender, free_port, machine_text, records_of, rig, udp_bus, until
from restarted import SECOND, Followed, exchanged, from_s, right
from verified import verified

from tilth.logger import address_memory
from tilth.logger.clock import Clock
from tilth.logger.daemon import Daemon
from tilth.logger.display import NoDisplay
from tilth.logger.guarded_fold import GuardedFold
from tilth.replay.offline import replay
from tilth.schemas.channels import ADDRESSES_TOPIC
from tilth.schemas.flow import Frame, Mount
from tilth.schemas.identity import KnownAddress
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.proto import tilth_pb2 as pb

VIRTUAL = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-addresses"\n\n'


# ---- kept, and in the log ----


def test_what_is_kept_is_read_again(tmp_path: Path) -> None:
    clock, path = Clock(), tmp_path / "m.addresses.json"
    known = [
        KnownAddress("can0", 28, 0xA00017000421E240, Mount.TRACTOR_FRONT, clock.t_ns() - 5 * SECOND),
        KnownAddress("can1", 70, None, Mount.IMPLEMENT_FRONT, 0),
    ]
    path.write_text(address_memory.text_of(known, "one", clock))
    first, second = address_memory.read(path, "one", clock)
    assert abs(first.last_ns - known[0].last_ns) < 1_000_000 and second == known[1]
    assert [one.mount for one in address_memory.read(path, "other", clock)] == [None, None]
    plain = json.loads(path.read_text())
    path.write_text(json.dumps(plain | {"boot_id": "another start of the computer"}))
    assert [one.last_ns for one in address_memory.read(path, "one", clock)] == [0, 0]
    assert address_memory.read(tmp_path / "none.json", "one", clock) == []


DAMAGED: list[Callable[[Path], object]] = [
    lambda path: path.write_text(""),
    lambda path: path.write_text("[" * 100_000),
    lambda path: path.write_text('{"format": 1, "known": [{"bus": 3}]}'),
    lambda path: path.write_text(json.dumps({"format": 99})),
    lambda path: path.write_bytes(b"\xff" * 100),
    lambda path: path.write_bytes(b" " * 2_000_000),
    os.mkfifo,
    lambda path: path.mkdir(),
]


@pytest.mark.parametrize("damage", DAMAGED)
def test_whatever_lies_there_the_daemon_begins(damage: Callable[[Path], object], tmp_path: Path) -> None:
    machine, text = rig(tmp_path, VIRTUAL)
    damage(tmp_path / f"{machine.name}.addresses.json")
    daemon = Daemon(MachineFile(machine, text), tmp_path, None, NoDisplay(), keep=True)
    daemon.turn(0.0)
    assert daemon.close().log_files


def run_through(folder: Path, text: str, frames: Sequence[Frame]) -> tuple[Path, ...]:
    """One run of the daemon in this process."""
    daemon = Daemon(MachineFile(parse_machine(text), text), folder, None, NoDisplay(), keep=True)
    with can.Bus(interface="virtual", channel="tilth-addresses") as bus:
        until(lambda: daemon.parts.buses.live_buses[0].connection.port is not None, daemon.turn)
        for frame in frames:
            bus.send(can.Message(arbitration_id=frame.can_id, is_extended_id=True, data=frame.data))
            daemon.turn(0.0)
    return daemon.close().log_files


@pytest.mark.usefixtures("prepared")
def test_a_restarted_daemon_knows_its_receivers_live_and_in_replay(tmp_path: Path) -> None:
    machine, text = rig(tmp_path, VIRTUAL)
    run_through(tmp_path, text, from_s(0.0, 1.0))  # claims, and little else
    kept = tmp_path / f"{machine.name}.addresses.json"
    assert {row["mount"] for row in json.loads(kept.read_text())["known"]} >= {m.value for m in Mount}
    logs = run_through(tmp_path, text, from_s(20.0, 21.0))
    (head,) = records_of(logs[0], ADDRESSES_TOPIC, pb.Addresses)
    assert {one.mount for one in head.known} >= {mount.value for mount in Mount}
    summary = verified(logs, MachineFile(machine, text), 100)
    assert "unidentified" not in summary.rejected and "unknown_source" not in summary.rejected
    other = text.replace(
        "mass = 9391.0", "mass = 9390.0"
    )  # its state is of no use to that one, the NAMEs are
    for paths in (logs, logs[-1:]):
        assert "unidentified" not in replay(paths, MachineFile(parse_machine(other), other)).rejected


COMMAND = """
import sys
sys.modules["asammdf"] = None  # two seconds of import for reading files
from tilth.cli import main
raise SystemExit(main())
"""


@pytest.mark.long
@pytest.mark.parametrize("seconds", [1.5, 12.0, 26.5])
def test_the_real_daemon_killed_while_driving(seconds: float, tmp_path: Path) -> None:
    """Killed without a word; another one hears the rest of the drive, in which nobody claims an address."""
    port, logs = free_port(), tmp_path / "logs"
    text = machine_text(logs, udp_bus("can0", port))
    file = tmp_path / "m.toml"
    file.write_text(text)
    with Sender() as sender:
        for part, end in (([*from_s(0.0, 1.2), *from_s(seconds, seconds + 2.0)], signal.SIGKILL),
                          (from_s(seconds + 4.0, seconds + 7.0), signal.SIGTERM)):  # fmt: skip
            words = [sys.executable, "-c", COMMAND, "run", str(file)]
            daemon = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
            assert daemon.stdout is not None and daemon.stdout.readline().endswith("starting\n")
            assert "recording, 0.0 MB" in daemon.stdout.readline()
            at = [0.001 * i for i in range(len(part))]
            sender.begin([port], [(0, f, s) for f, s in zip(part, at, strict=True)])
            sender.finish()
            until(lambda: any(logs.glob("*.addresses.json")))
            daemon.send_signal(end)
            daemon.communicate(timeout=PATIENCE_S)
    first_part = min(logs.glob("*_001.mcap"), key=lambda path: path.stat().st_mtime)
    second = [path for path in sorted(logs.glob("*.mcap")) if path != first_part]
    summary = verified(second, MachineFile(parse_machine(text), text))
    assert "unidentified" not in summary.rejected and summary.poses > 5


@pytest.mark.long
@pytest.mark.parametrize("seconds", [1.0 + 1.0 * i for i in range(30)])
def test_killed_and_restarted_at_any_instant(seconds: float) -> None:
    """Through the fold: killed, and begun again with what was kept; in one power session, and after it."""
    first = GuardedFold(MACHINE)
    first.ready = False
    for frame in from_s(0.0, seconds):
        first.take(frame)
    known = first.known_addresses
    told = Followed(from_s(seconds + 1.0, seconds + 5.0), known)
    assert told.wrong == 0 and told.whole > 10 and "unidentified" not in told.state.rejected
    for before in (
        [replace(one, last_ns=0) for one in known],
        exchanged([right()[m] for m in Mount][::-1]),
        [],
    ):
        later = Followed(from_s(seconds + 1.0, seconds + 9.0), before)
        assert later.wrong == 0 and later.whole > 10
