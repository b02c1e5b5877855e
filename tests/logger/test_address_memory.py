"""A daemon that is restarted while driving knows its receivers: from before, or by where they are."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import permutations
from pathlib import Path

import can
import pytest
from logs import MACHINE
from loopback import PATIENCE_S, Sender, free_port, machine_text, records_of, rig, udp_bus, until

from tilth.estimator import fold
from tilth.estimator.snapshot import restore, snapshot
from tilth.logger import address_memory
from tilth.logger.clock import Clock
from tilth.logger.daemon import Daemon
from tilth.logger.display import NoDisplay
from tilth.logger.guarded_fold import GuardedFold
from tilth.replay.compare import Comparison
from tilth.replay.offline import ReplayOutputs, replay
from tilth.schemas.can_id import split
from tilth.schemas.channels import ADDRESSES_TOPIC
from tilth.schemas.flow import Event, Frame, Mount, Pose
from tilth.schemas.identity import KnownAddress
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.simulator.traffic import simulate

SECOND = 1_000_000_000
VIRTUAL = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-addresses"\n\n'
NAMES = {receiver.mount: receiver.name for receiver in MACHINE.receiver}


@cache
def drive() -> tuple[Frame, ...]:
    """Forty seconds, address claims at the beginning."""
    return tuple(simulate(MACHINE, 5, 40.0))


@cache
def right() -> dict[Mount, int]:
    """Where the receivers stand in it."""
    state = fold.initial(MACHINE)
    for frame in drive()[:2000]:
        state.decoder.measurements(frame)
    return {known.mount: known.source for known in state.decoder.addresses.known() if known.mount is not None}


def from_s(seconds: float, until_s: float = 99.0) -> list[Frame]:
    """That part of the drive."""
    t_ns = drive()[0].t_ns
    return [f for f in drive() if seconds <= (f.t_ns - t_ns) * 1e-9 < until_s]


def exchanged(sources: Sequence[int], last_ns: int = 0) -> list[KnownAddress]:
    """That the receivers, in the order of Mount, have these addresses."""
    return [
        KnownAddress("can0", source, NAMES[mount], mount, last_ns)
        for mount, source in zip(Mount, sources, strict=True)
    ]


class Told:
    """What a fold makes of frames."""

    def __init__(
        self, frames: Sequence[Frame], known: Sequence[KnownAddress] = (), ready: bool = False
    ) -> None:
        self.state = fold.initial(MACHINE)
        self.state.ready = ready
        fold.recall(self.state, known)
        self.events: list[str] = []
        self.whole = 0  # poses of both bodies
        self.wrong = 0  # of them with a receiver in another's place
        self.first_s: float | None = None
        self.frames = frames
        for frame in frames:
            self.take(frame)

    def take(self, frame: Frame) -> None:
        for publication in fold.step(self.state, frame):
            value = publication.value
            if isinstance(value, Event):
                self.events.append(f"{value.kind}: {value.text}")
            if isinstance(value, Pose) and None not in (value.tractor.heading, value.implement.heading):
                known = self.state.decoder.addresses.known()
                here = {one.mount: one.source for one in known if one.mount is not None}
                self.whole += 1
                self.wrong += here != right()
                if self.first_s is None:
                    self.first_s = (frame.t_ns - self.frames[0].t_ns) * 1e-9

    def said(self, text: str) -> bool:
        return any(event.startswith("addresses: ") and text in event for event in self.events)


@pytest.mark.parametrize("seconds", [3.0, 17.3, 30.0])
def test_without_any_knowledge_receivers_are_recognised_by_where_they_are(seconds: float) -> None:
    told = Told(from_s(seconds, seconds + 8.0))
    assert told.wrong == 0 and told.whole > 15
    assert told.first_s is not None and told.first_s < 4.5  # five metres, and the lag of positions
    assert told.said("recognised by where they are")


def test_what_was_known_is_used_at_once_within_one_power_session() -> None:
    frames = from_s(20.0, 22.0)
    told = Told(frames, exchanged([right()[m] for m in Mount], frames[0].t_ns - 20 * SECOND))
    assert told.wrong == 0 and told.first_s is not None and told.first_s < 1.2
    assert told.said("was silent for 20 s: receivers have the addresses that they had")


@pytest.mark.parametrize("order", list(permutations(range(4))), ids=str)
def test_exchanged_addresses_give_no_wrong_pose(order: tuple[int, ...]) -> None:
    """Four alike receivers settle their addresses anew at each power-up."""
    now = [right()[mount] for mount in Mount]
    before = [now[i] for i in order]
    frames = from_s(20.0, 27.0)
    told = Told(frames, exchanged(before))
    assert told.wrong == 0 and told.whole > 10
    assert told.said("other addresses than before" if before != now else "the addresses that they had before")
    # The same where it was taken for one power session.
    quick = Told(from_s(20.0, 30.0), exchanged(before, frames[0].t_ns - 20 * SECOND))
    assert quick.wrong == 0 and quick.whole > 10
    assert quick.said("may not have the addresses") == (before != now)


def test_a_claim_always_wins() -> None:
    frames = list(drive()[: next(i for i, f in enumerate(drive()) if f.t_ns - drive()[0].t_ns > 4 * SECOND)])
    now = [right()[mount] for mount in Mount]
    told = Told(frames, exchanged(now[::-1], frames[0].t_ns - 20 * SECOND))
    assert told.wrong == 0 and told.whole > 10 and not told.said("by where they are")


def test_a_search_goes_on_from_a_stored_state() -> None:
    frames = from_s(20.0, 25.0)
    told, again = Told([]), Told([])
    for i, frame in enumerate(frames):
        if i % 500 == 0:
            again.state = restore(MACHINE, snapshot(again.state))
        told.frames = again.frames = frames
        told.take(frame)
        again.take(frame)
    assert told.whole > 5 and (told.whole, told.events) == (again.whole, again.events)


@pytest.mark.parametrize("wheel", [True, False])
def test_a_rig_in_reverse_is_not_taken_for_one_that_goes_forwards(wheel: bool) -> None:
    """The drive backwards in time: all that moves goes backwards. Without wheel angles it stays open."""
    frames = from_s(10.0, 35.0)
    end_ns = frames[0].t_ns + frames[-1].t_ns
    turned = []
    for frame in reversed(frames):
        pgn = split(frame.can_id).pgn
        if pgn in (65267, 129025) or (wheel and pgn == 65291):
            t_ns = end_ns - frame.t_ns
            turned.append(Frame(t_ns, t_ns, "can0", frame.can_id, True, False, frame.data))
    told = Told(turned)
    here = {k.mount: k.source for k in told.state.decoder.addresses.known() if k.mount is not None}
    assert here == (right() if wheel else here) and (not here or here == right())


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
    daemon = Daemon(machine, text, tmp_path, None, NoDisplay(), keep=True)
    daemon.turn(0.0)
    assert daemon.close().log_files


def run_through(folder: Path, text: str, frames: Sequence[Frame]) -> tuple[Path, ...]:
    """One run of the daemon in this process."""
    daemon = Daemon(parse_machine(text), text, folder, None, NoDisplay(), keep=True)
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
    comparison = Comparison()
    summary = replay(logs, machine, text, outputs=ReplayOutputs(comparison=comparison))
    assert comparison.compared > 100 and not comparison.difference
    assert "unidentified" not in summary.rejected and "unknown_source" not in summary.rejected
    other = text.replace(
        "mass = 9391.0", "mass = 9390.0"
    )  # its state is of no use to that one, the NAMEs are
    for paths in (logs, logs[-1:]):
        assert "unidentified" not in replay(paths, parse_machine(other), other).rejected


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
            assert daemon.stdout is not None and "recording, 0.0 MB" in daemon.stdout.readline()
            at = [0.001 * i for i in range(len(part))]
            sender.begin([port], [(0, f, s) for f, s in zip(part, at, strict=True)])
            sender.finish()
            until(lambda: any(logs.glob("*.addresses.json")), lambda: time.sleep(0.05))
            daemon.send_signal(end)
            daemon.communicate(timeout=PATIENCE_S)
    first_part = min(logs.glob("*_001.mcap"), key=lambda path: path.stat().st_mtime)
    second = [path for path in sorted(logs.glob("*.mcap")) if path != first_part]
    comparison = Comparison()
    machine = parse_machine(text)
    summary = replay(second, machine, text, outputs=ReplayOutputs(comparison=comparison))
    assert not comparison.difference
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
    told = Told(from_s(seconds + 1.0, seconds + 5.0), known)
    assert told.wrong == 0 and told.whole > 10 and "unidentified" not in told.state.rejected
    for before in (
        [replace(one, last_ns=0) for one in known],
        exchanged([right()[m] for m in Mount][::-1]),
        [],
    ):
        later = Told(from_s(seconds + 1.0, seconds + 9.0), before)
        assert later.wrong == 0 and later.whole > 10
