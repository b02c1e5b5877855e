"""A scenario on a bus in real time: understood by another process, never where another receiver is heard."""

import json
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import can
import pytest
from loopback import GROUP, PATIENCE_S, TEXT, free_port
from paths import ROOT

from tilth.cli import main
from tilth.logger.can import can_link
from tilth.logger.clock import Clock
from tilth.replay.discover import BusSurvey, listen
from tilth.schemas.decode import claim, encode, frames_of
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus, Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.wheel_angle import compile_sensor
from tilth.simulator.on_a_bus import Watch, play, stays_here, watch_of
from tilth.simulator.scenario import parse_scenario
from tilth.simulator.traffic import simulate

SCENARIO = ROOT / "examples" / "scenarios" / "demo.toml"
PROGRAM = [
    sys.executable,
    "-c",
    "import sys; from tilth.cli import main; sys.exit(main())",
]


@pytest.fixture(scope="module")
def machine() -> Machine:
    return parse_machine(TEXT)


@pytest.fixture(scope="module")
def sent(machine: Machine) -> list[Frame]:
    return list(simulate(machine, 1, 2.0, parse_scenario(SCENARIO.read_text())))


@contextmanager
def sending(port: int, *words: str) -> Iterator[subprocess.Popen[str]]:
    place = f"udp_multicast:{GROUP},port={port},hop_limit=0"
    command = [*PROGRAM, "simulate", str(SCENARIO), "--bus", place, "--json", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        yield process


def test_another_process_understands_what_is_sent(machine: Machine) -> None:
    port = free_port()
    bus = Bus(name="can0", interface="udp_multicast", channel=GROUP, options={"port": port, "hop_limit": 0})
    survey, received, looks = BusSurvey(), list[Frame](), [0, 0]

    def over() -> bool:
        """It has ended, and what it sent has been taken."""
        looks[:] = [
            len(received),
            looks[1] + 1 if process.poll() is not None and looks[0] == len(received) else 0,
        ]
        return looks[1] > 3

    with sending(port, "--seconds", "2.5") as process:
        for frame in listen([bus], PATIENCE_S, lambda kind, told: None, over):
            received.append(frame)
            survey.take(frame)
        assert process.stdout is not None
        output = json.loads(process.stdout.read())
    assert (process.returncode, output["stopped"], len(received)) == (0, "", output["frames"])
    found = survey.findings()
    assert {source.name for source in found.receivers} == {receiver.name for receiver in machine.receiver}
    wanted = list(simulate(machine, 1, 2.5, parse_scenario(SCENARIO.read_text())))
    wheel = compile_sensor(machine).can_id
    angles = [[f.data for f in rows if f.can_id == wheel] for rows in (received, wanted)]
    assert angles[0] == angles[1] and len(angles[0]) > 200
    assert (received[-1].t_ns - received[0].t_ns) * 1e-9 > 1.0  # in real time, if late


FIX = frames_of(129025, encode(129025, {"latitude_deg": 47.0, "longitude_deg": 8.0}), 99)[0]


def test_nothing_is_sent_where_a_receiver_is_heard(capsys: pytest.CaptureFixture[str]) -> None:
    port = free_port()
    done = threading.Event()

    def receiver() -> None:
        with can.Bus(interface="udp_multicast", channel=GROUP, port=port, hop_limit=0) as bus:
            while not done.wait(0.05):
                bus.send(can.Message(arbitration_id=FIX[0], data=FIX[1], is_extended_id=True))

    thread = threading.Thread(target=receiver)
    thread.start()
    place = f"udp_multicast:{GROUP},port={port},hop_limit=0"
    status = main(["simulate", str(SCENARIO), "--bus", place, "--seconds", "2", "--json"])
    done.set()
    thread.join()
    output = capsys.readouterr()
    assert (status, output.out) == (1, "")
    assert "a receiver is heard: address 99 sends 129025" in output.err and "nothing was sent" in output.err


def test_sending_stops_once_a_receiver_appears() -> None:
    port = free_port()
    with (
        can.Bus(interface="udp_multicast", channel=GROUP, port=port, hop_limit=0) as bus,
        sending(port, "--seconds", "60") as process,
    ):
        assert bus.recv(PATIENCE_S) is not None
        bus.send(can.Message(arbitration_id=FIX[0], data=FIX[1], is_extended_id=True))
        assert process.stdout is not None
        output = json.loads(process.stdout.read())
    assert process.returncode == 1 and "address 99 sends 129025" in output["stopped"]
    assert 0 < output["frames"] < 60_000


def other(name: str, frames: list[Frame], machine: Machine) -> tuple[int, bool, bytes]:
    claimed = next(f for f in frames if f.can_id >> 8 & 0x3FFFF == 0xEEFF)
    if name == "name":
        return 0x18EEFF55, True, claimed.data
    if name == "address":
        return 0x18FEF100 | claimed.can_id & 0xFF, True, bytes(8)
    if name == "own":
        return claimed.can_id, True, claimed.data
    if name == "other":
        return 0x18EEFF55, True, claim(0x1234)
    return {"fix": (FIX[0], True, FIX[1]), "j1939": (0x18FEF355, True, bytes(8)),
            "standard": (0x2B0, False, bytes(8)), "engine": (0x0CF00455, True, bytes(8))}[name]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("fix", "a receiver is heard"),
        ("j1939", "a receiver is heard"),
        ("name", "claims the NAME"),
        ("address", "another device has address"),
        ("own", ""),
        ("other", ""),
        ("engine", ""),
        ("standard", ""),
    ],
)
def test_what_forbids_to_send(name: str, reason: str, sent: list[Frame], machine: Machine) -> None:
    watch = watch_of(sent)
    for frame in sent:
        watch.sent(frame.t_ns, frame)
    output = watch.forbids("can0", *other(name, sent, machine))
    assert output.startswith(reason) if not reason else reason in output
    assert bool(output) == bool(reason)


def test_a_frame_of_ours_is_an_echo_only_once_and_only_so_long(sent: list[Frame]) -> None:
    watch, frame = watch_of(sent), sent[0]
    received = (frame.bus, frame.can_id, frame.extended, frame.data)
    assert watch.forbids(*received)
    watch.sent(0, frame)
    watch.sent(900_000_000, frame)
    assert [bool(watch.forbids(*received)) for _ in range(3)] == [False, False, True]
    watch.sent(1_000_000_000, frame)
    watch.sent(5_000_000_000, sent[1])
    assert watch.forbids(*received)


def test_an_identifier_of_11_bits_may_not_be_another_devices() -> None:
    frame = Frame(0, 0, "can0", 0x2B0, False, False, b"\0")
    watch = watch_of([frame])
    assert "0x2B0" in watch.forbids("can0", 0x2B0, False, b"\1")
    assert not watch.forbids("can1", 0x2B0, False, b"\1") and not watch.forbids("can0", 0x2B1, False, b"\1")


def test_a_bus_that_fails_ends_it_with_its_reason(sent: list[Frame]) -> None:
    place = Bus(name="can0", interface="virtual", channel="failing")
    clock = Clock()
    rows = [Frame(clock.t_ns(), 0, "can0", f.can_id, f.extended, False, f.data) for f in sent[:5]]
    with can.Bus(interface="virtual", channel="failing") as bus:
        bus.shutdown()
        with pytest.raises(can.CanError):
            bus.send(can.Message())
        done = play(iter(rows), {"can0": _Deaf(bus)}, Watch(set(), set(), set()), clock, {"can0": place})
    assert done.frames == 0 and "virtual failing" in done.stopped


class _Deaf(can.BusABC):
    """The bus, of which nothing is heard."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._bus.send(msg, timeout)

    def __del__(self) -> None:
        return


PLACES = (
    ("virtual:x", True),
    (f"udp_multicast:{GROUP},hop_limit=0", True),
    (f"udp_multicast:{GROUP}", False),  # one hop: to the whole local network
    (f"udp_multicast:{GROUP},hop_limit=3", False),
    ("socketcan:can0", False),
    ("socketcan:lo", False),
    ("slcan:/dev/ttyUSB0", False),
    ("socketcand:can0,host=127.0.0.1,port=29536", False),  # a wire may be behind it
    ("pcan:PCAN_USBBUS1", False),
)


@pytest.mark.parametrize(("place", "here"), PLACES)
def test_what_leaves_this_computer_wants_to_be_told_so(
    place: str, here: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    from tilth.cli.discover import parse_buses

    (bus,) = parse_buses([place])
    assert stays_here(bus) == here
    if not here:
        assert main(["simulate", str(SCENARIO), "--bus", place]) == 2
        output = capsys.readouterr().err
        assert "leaves this computer" in output and "--send" in output


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--out", "x.log", "--send"], "--send is of --bus"),
        (["--bus", "virtual:a", "--bus", "virtual:b"], "2 given, the machine file has 1: can0"),
        (["--bus", "virtual"], "INTERFACE:CHANNEL"),
        (["--bus", "virtuel:a"], 'did you mean "virtual"?'),
    ],
)
def test_wrong_use(words: list[str], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", str(SCENARIO), *words]) == 2
    assert expected in capsys.readouterr().err


def test_a_virtual_interface_is_told_by_the_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    """As it answers for vcan0, can0 and a bridge: the kind stands in IFLA_LINKINFO."""

    def attribute(number: int, data: bytes) -> bytes:
        return struct.pack("=HH", 4 + len(data), number) + data + bytes(-len(data) % 4)

    def answer(kind: bytes) -> bytes:
        body = bytes(16) + attribute(3, b"any\0") + attribute(18, attribute(1, kind))
        return struct.pack("=IHHII", 16 + len(body), 16, 0, 0, 0) + body

    for kind, virtual in ((b"vcan\0", True), (b"can\0", False), (b"slcan\0", False), (b"vcan2\0", False)):
        monkeypatch.setattr(can_link, "_answer", lambda name, kind=kind: answer(kind))
        assert can_link.is_virtual("any") == virtual
    monkeypatch.undo()
    assert not can_link.is_virtual("lo") and not can_link.is_virtual("none-such")
