"""The raw-socket source, through a datagram socket of loopback that stands in for AF_CAN: the same code.

What only a kernel with CAN can show is in tests/vm/.
"""

import socket
import struct
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from loopback import until

from tilth.logger import clock as clock_of_a_run
from tilth.logger.can import can_link, socketcan
from tilth.logger.can.port import Tally
from tilth.logger.can.receive_buffer import RECEIVE_BYTES
from tilth.logger.can.socketcan import CAN_FRAME, ERROR, EXTENDED, REMOTE, SocketCanPort
from tilth.logger.clock import Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus

CONFIG = Bus(name="can0", interface="socketcan", channel="can0")
FUZZED = 20_000
SOAKED = 1_000_000  # a step of .ci/run


class Wire:
    """A port and the other end of its wire."""

    def __init__(self) -> None:
        near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        near.bind(("127.0.0.1", 0))
        self.far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.far.connect(near.getsockname())
        self.near = near
        self.clock = Clock()
        self.tally = Tally()
        self.port = SocketCanPort(near, self.clock, self.tally, CONFIG)
        self.frames: list[Frame] = []
        until(self._stamps_are_on)

    def _stamps_are_on(self) -> bool:
        """Whether the kernel stamps on arrival yet; it begins a little after it is asked to."""
        self.send(0)
        sent_ns = self.clock.t_ns()
        self.take()
        return bool(self.frames) and self.frames.pop().rx_ns < sent_ns

    def send(self, flagged: int, data: bytes = b"") -> None:
        self.far.send(CAN_FRAME.pack(flagged, len(data), data))

    def take(self, most: int = 1000) -> int:
        return self.port.take(self.frames, most)

    def take_all(self, count: int) -> None:
        """The kernel of a busy computer brings what was sent a little later."""
        taken = [0]
        until(lambda: taken[0] >= count, lambda: taken.append(taken.pop() + self.take()))
        assert taken == [count] and self.take() == 0

    def close(self) -> None:
        self.port.close()
        self.far.close()


@pytest.fixture
def wire() -> Iterator[Wire]:
    wire = Wire()
    yield wire
    wire.close()


def test_each_kind_of_frame(wire: Wire) -> None:
    wire.send(0x18FF0001 | EXTENDED, bytes(range(8)))
    wire.send(0x123, b"\x01")
    wire.send(0x7FF)
    wire.send(0x123 | REMOTE)
    wire.send(0x004 | ERROR, b"\x00\x01" + bytes(6))
    wire.far.send(bytes(72))  # CAN FD
    wire.far.send(b"no frame")
    wire.take_all(7)
    assert [(f.can_id, f.extended, f.error, f.data) for f in wire.frames] == [
        (0x18FF0001, True, False, bytes(range(8))),
        (0x123, False, False, b"\x01"),
        (0x7FF, False, False, b""),
        (0x004, False, True, b"\x00\x01" + bytes(6)),
    ]
    tally = wire.tally
    assert (tally.error_frames, tally.remote_frames, tally.fd_frames, tally.garbled) == (1, 1, 1, 1)
    assert tally.health.counts == {"overrun": 1}


def test_what_waited_when_the_interface_failed_is_read_before_that_is_said() -> None:
    """The kernel tells the error first, whatever waits; here that of a far side that is gone and back."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as near:
        near.bind(("127.0.0.1", 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far:
            far.bind(("127.0.0.1", 0))
            address = far.getsockname()
        near.connect(address)
        port = SocketCanPort(near, Clock(), Tally(), CONFIG)
        near.send(b"nobody is there")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far:
            far.bind(address)
            for number in range(50):
                far.sendto(CAN_FRAME.pack(number, 0, b""), near.getsockname())
        frames: list[Frame] = []
        assert port.take(frames, 32) == 32  # the error took one turn
        with pytest.raises(ConnectionRefusedError):
            port.take(frames, 32)
        assert [frame.can_id for frame in frames] == list(range(50))


def test_the_stamp_is_the_kernels_and_on_the_clock_of_the_run(wire: Wire) -> None:
    before_ns = wire.clock.t_ns()
    for number in range(100):
        wire.send(number)
    after_ns = wire.clock.t_ns()
    until(lambda: len(wire.frames) == 100, lambda: wire.take(60))
    assert [frame.can_id for frame in wire.frames] == list(range(100))
    stamps = [frame.rx_ns for frame in wire.frames]
    assert stamps == sorted(stamps) and before_ns - 1000 < stamps[0] and stamps[-1] < after_ns + 1000
    assert all(frame.rx_ns <= frame.t_ns for frame in wire.frames) and wire.frames[0].t_ns > after_ns
    assert wire.port.stamp == "kernel" and wire.clock.bad_stamps == 0


def test_what_waited_for_a_busy_loop_keeps_its_stamp(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (clock_of_a_run, socketcan):
        monkeypatch.setattr(module, "OLDEST_NS", 20_000_000)
    assert wire.take() == 0
    wire.send(1)
    sent_ns = wire.clock.t_ns()
    until(lambda: wire.clock.t_ns() > sent_ns + 50_000_000)
    wire.take_all(1)
    (frame,) = wire.frames
    assert frame.rx_ns <= sent_ns < frame.t_ns - 50_000_000 and wire.clock.bad_stamps == 0


def test_the_buffer_is_of_megabytes_and_what_it_loses_is_counted_exactly(wire: Wire) -> None:
    assert wire.near.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= RECEIVE_BYTES and not wire.port.note
    wire.near.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 20_000)
    for number in range(500):
        wire.send(number)
    until(lambda: wire.port.lost() + len(wire.frames) == 500, wire.take)
    assert wire.port.lost() > 0
    for number in range(500):  # the next frames say so themselves, and are none the worse for it
        wire.send(number)
        wire.take()
    until(lambda: wire.port.lost() + len(wire.frames) == 1000, wire.take)
    assert [frame.can_id for frame in wire.frames[-500:]] == list(range(500))


class Scripted:
    """A socket that gives what it is told, where no device here can: an adapter's stamps."""

    def __init__(self, rows: Sequence[tuple[bytes, list[tuple[int, int, bytes]]]]) -> None:
        self._rows = iter(rows)

    def fileno(self) -> int:
        return -1

    def setblocking(self, flag: bool) -> None:
        return

    def setsockopt(self, level: int, option: int, value: int) -> None:
        return

    def getsockopt(self, level: int, option: int, size: int = 0) -> int:
        return RECEIVE_BYTES

    def recvmsg(self, size: int, control: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, None]:
        for packed, ancillary in self._rows:
            return packed, ancillary, 0, None
        raise BlockingIOError


def stamped(clock: Clock, arrival_ns: int, adapter_ns: int | None) -> list[tuple[int, int, bytes]]:
    """Control messages as the kernel gives them: when it arrived (t_ns), what the adapter's clock said."""
    seconds, nanoseconds = divmod(arrival_ns + clock.wall_ahead_ns(), 1_000_000_000)
    rows = [(socket.SOL_SOCKET, 35, struct.pack("@2l", seconds, nanoseconds))]
    if adapter_ns is not None:
        rows.append(
            (socket.SOL_SOCKET, 37, struct.pack("@6l", 0, 0, 0, 0, *divmod(adapter_ns, 1_000_000_000)))
        )
    return rows


def test_an_adapters_own_stamps_come_first() -> None:
    """Its clock began at another time and runs 50 ppm fast; frames reach the kernel up to 2 ms late."""
    rng = np.random.default_rng(5)
    clock, tally = Clock(), Tally()
    begin_ns = clock.t_ns() - 4_500_000_000
    heard_ns = begin_ns + np.cumsum(rng.integers(500_000, 3_000_000, 2000))
    late_ns = rng.integers(20_000, 2_000_000, 2000)
    rows = [
        (
            CAN_FRAME.pack(i, 0, b""),
            stamped(clock, int(t + late), 77_000 + int((t - begin_ns) * (1 + 50e-6))),
        )
        for i, (t, late) in enumerate(zip(heard_ns, late_ns, strict=True))
    ]
    port = SocketCanPort(Scripted(rows), clock, tally, CONFIG)  # type: ignore[arg-type]
    frames: list[Frame] = []
    port.take(frames, 2000)
    assert port.stamp == "adapter" and len(frames) == 2000 and clock.bad_stamps == 0
    error_ns = np.array([frame.rx_ns for frame in frames]) - heard_ns
    assert np.abs(error_ns[100:]).max() < 100_000  # the kernel's would be 2 ms apart
    assert all(f.rx_ns <= t + late + 2000 for f, t, late in zip(frames, heard_ns, late_ns, strict=True))


def test_an_adapter_that_does_not_stamp_every_frame_is_not_trusted_with_any() -> None:
    clock, tally = Clock(), Tally()
    t_ns = clock.t_ns() - 1_000_000
    error = CAN_FRAME.pack(0x204 | ERROR, 8, b"\x00\x04")  # the driver's own frames have no such stamp
    rows = [
        (CAN_FRAME.pack(1, 0, b""), stamped(clock, t_ns, 5)),
        (error, stamped(clock, t_ns + 10_000, None)),
        (CAN_FRAME.pack(2, 0, b""), stamped(clock, t_ns + 20_000, 12_005)),
        (CAN_FRAME.pack(3, 0, b""), stamped(clock, t_ns + 30_000, None)),
        (CAN_FRAME.pack(4, 0, b""), stamped(clock, t_ns + 40_000, 22_005)),
    ]
    port = SocketCanPort(Scripted(rows), clock, tally, CONFIG)  # type: ignore[arg-type]
    frames: list[Frame] = []
    messages = []
    while port.take(frames, 1):
        messages.append(port.stamp)
    assert messages == ["adapter"] * 3 + ["kernel"] * 2
    assert [f.rx_ns - t_ns for f in frames] == pytest.approx([0, 10_000, 12_000, 30_000, 40_000], abs=1500)


def mutated(rng: np.random.Generator, count: int) -> Iterator[bytes]:
    """Frames with bits flipped, cut, made longer; pure noise."""
    rows = rng.integers(0, 256, (count, 16), dtype=np.uint8)
    rows[:, 4] %= 9  # the kernel's own promise: never a length over 8
    noise = rows.tobytes()
    for at in range(0, len(noise), 16):
        packed = noise[at : at + 16]
        how, much = packed[15] % 8, packed[14]
        yield packed[: much % 17] if how == 0 else packed * (much % 6) if how == 1 else packed


def fuzz(wire: Wire, count: int) -> None:
    taken = 0
    batch = 0
    for data in mutated(np.random.default_rng(count), count):
        wire.far.send(data)
        batch += 1
        if batch == 500:
            taken += wire.take()
            batch = 0
    wire.take_all(count - taken)
    tally = wire.tally
    others = tally.remote_frames + tally.fd_frames + tally.garbled
    assert len(wire.frames) + others == count and wire.port.lost() == 0
    assert all(len(frame.data) <= 8 and frame.can_id <= 0x1FFFFFFF for frame in wire.frames)
    assert all(text for text in tally.health.news(wire.clock.t_ns(), traffic=True))


@pytest.mark.parametrize("count", [FUZZED, pytest.param(SOAKED, marks=pytest.mark.soak)])
def test_mutated_frames_are_taken_or_counted(wire: Wire, count: int) -> None:
    fuzz(wire, count)


def attribute(kind: int, data: bytes) -> bytes:
    return struct.pack("=HH", 4 + len(data), kind) + data + bytes(-len(data) % 4)


def newlink(*data: bytes) -> bytes:
    info = attribute(18 | 0x8000, attribute(1, b"can\0") + attribute(2, b"".join(data)))
    return struct.pack("=IHHII", 0, 16, 0, 1, 0) + bytes(16) + attribute(3, b"can0\0") + info


@pytest.mark.parametrize(
    ("answer", "link"),
    [
        (
            newlink(
                attribute(1, struct.pack("=8I", 500_000, *[0] * 7)),
                attribute(4, struct.pack("=I", 2)),
                attribute(6, struct.pack("=I", 100)),
            ),
            can_link.CanLink(bitrate=500_000, state=2, restart_ms=100),
        ),
        (newlink(attribute(4, struct.pack("=I", 4))), can_link.CanLink(bitrate=0, state=4, restart_ms=0)),
        (newlink(), None),  # vcan
        (struct.pack("=IHHIIi", 20, 2, 0, 1, 0, -19), None),  # no such interface
        (b"", None),
    ],
)
def test_what_the_kernel_says_of_a_controller(answer: bytes, link: can_link.CanLink | None) -> None:
    assert can_link.parse(answer) == link


def test_an_interface_that_is_no_can_controller_says_nothing() -> None:
    assert can_link.ask("lo") is None and can_link.ask("no such thing at all") is None
