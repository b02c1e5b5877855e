"""Buses: real sockets, a second process that sends, failures of one that must not touch the others."""

import contextlib
import errno
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import can
import pytest
from loopback import GROUP, Sender, free_port, numbered, until

from tilth.logger import clock as clock_of_a_run
from tilth.logger.bus_opening import check_interface, open_port, why_not
from tilth.logger.buses import (
    ASK_NS,
    BACK_OFF_MOST_NS,
    BATCH,
    EMPTY_READS,
    HANGING,
    RENEW_NS,
    SILENT_NS,
    SLOW,
    Buses,
    Opener,
    Source,
)
from tilth.logger.can_errors import BACK_NS
from tilth.logger.clock import OLDEST_NS, Clock
from tilth.logger.port import LibraryPort, Port, Tally
from tilth.logger.receive_buffer import dropped
from tilth.logger.status import bus_status
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus, MachineError


def udp(name: str, port: int) -> Bus:
    return Bus(name=name, interface="udp_multicast", channel=GROUP, options={"port": port, "hop_limit": 0})


def virtual(name: str) -> Bus:
    return Bus(name=name, interface="virtual", channel=f"tilth-{name}")


class Listening:
    """Buses, opened or failed, with what they gave and reported."""

    def __init__(
        self, *configs: Bus, serve: Callable[[], None] = lambda: None, opener: Opener = open_port
    ) -> None:
        self.serve = serve
        self.events: list[str] = []
        self.stamps: list[str] = []  # events that tell who stamps the frames
        self.frames: list[Frame] = []
        self.clock = Clock()
        self.buses = Buses(configs, self.clock, self._report, opener)
        self.settle()

    def _report(self, kind: str, text: str) -> None:
        (self.stamps if "stamped by" in text else self.events).append(f"{kind}: {text}")

    @property
    def sources(self) -> list[Source]:
        return self.buses.sources

    def turn(self) -> None:
        self.serve()
        self.frames += self.buses.read(0.02)

    def until(self, condition: Callable[[], bool]) -> None:
        until(condition, self.turn)

    def until_frames(self, count: int) -> None:
        self.until(lambda: len(self.frames) == count)

    def settle(self) -> None:
        self.until(lambda: not any(source.opening for source in self.sources))

    def watch(self, ahead_ns: int = 0) -> None:
        """As if so much time had gone by."""
        self.buses.watch(self.clock.t_ns() + ahead_ns)


@pytest.fixture(autouse=True)
def watched_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time goes by as the tests say, however busy this computer is."""
    monkeypatch.setattr("tilth.logger.buses.WATCH_NS", 1 << 62)


@pytest.fixture
def talker() -> Iterator[can.BusABC]:
    """The other end of virtual("v")."""
    with can.Bus(interface="virtual", channel="tilth-v") as bus:
        yield bus


def data_frame(number: int = 0) -> can.Message:
    return can.Message(arbitration_id=0x18FF0001, is_extended_id=True, data=number.to_bytes(8, "little"))


def content(frame: Frame) -> tuple[str, int, bool, bytes]:
    return frame.bus, frame.can_id, frame.extended, frame.data


def test_two_buses_give_every_frame_in_order_with_its_stamps(sender: Sender) -> None:
    ports = [free_port(), free_port()]
    listening = Listening(udp("can0", ports[0]), udp("can1", ports[1]))
    sent = [replace(frame, bus=f"can{i % 2}") for i, frame in enumerate(numbered(2000))]
    sender.begin(ports, [(i % 2, frame, i / 5000) for i, frame in enumerate(sent)])
    listening.until_frames(len(sent))
    sender.finish()
    listening.buses.close()
    got = listening.frames
    for bus in ("can0", "can1"):
        assert [content(f) for f in got if f.bus == bus] == [content(f) for f in sent if f.bus == bus]
    times = [frame.t_ns for frame in got]
    assert times == sorted(times)
    assert all(0 <= frame.t_ns - frame.rx_ns < OLDEST_NS for frame in got)
    assert any(frame.rx_ns < frame.t_ns for frame in got) and listening.clock.bad_stamps == 0
    assert sorted(listening.stamps) == [
        f"bus: {name}: its frames are stamped by the kernel, on arrival" for name in ("can0", "can1")
    ]
    assert listening.events == [] and [source.lost for source in listening.sources] == [0, 0]


def test_what_waited_for_a_busy_loop_keeps_its_stamp(
    talker: can.BusABC, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clock_of_a_run, "OLDEST_NS", 20_000_000)
    listening = Listening(virtual("v"))
    listening.turn()
    talker.send(data_frame())
    sent_ns = listening.clock.t_ns()
    until(lambda: listening.clock.t_ns() > sent_ns + 50_000_000, lambda: None)
    listening.until_frames(1)
    (frame,) = listening.frames
    assert frame.rx_ns <= sent_ns < frame.t_ns - 50_000_000 and listening.clock.bad_stamps == 0
    listening.buses.close()


def test_a_stream_that_was_not_read_for_a_while_has_lost_nothing() -> None:
    """TCP counts packets that it sends again where a socket counts messages that are lost."""
    with (
        socket.create_server(("127.0.0.1", 0)) as listener,
        socket.create_connection(listener.getsockname()) as far,
        listener.accept()[0] as near,
    ):
        near.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        far.setblocking(False)
        far.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sent = 0
        with contextlib.suppress(BlockingIOError):
            while True:
                sent += far.send(bytes(2 if sent % 3 else 1000))
        assert sent > 100_000 and dropped(near) == 0
        while sent:
            sent -= len(near.recv(65536))


def test_what_the_kernel_drops_is_counted(sender: Sender) -> None:
    port = free_port()
    listening = Listening(udp("can0", port))
    (source,) = listening.sources
    assert source.descriptor is not None
    with socket.socket(fileno=source.descriptor) as handle:
        handle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        handle.detach()
    sender.begin([port], [(0, frame, 0.0) for frame in numbered(500)])
    sender.finish()
    while listening.buses.read(0.0):
        continue
    listening.watch(ahead_ns=ASK_NS)
    assert source.lost > 0 and source.frames + source.lost == 500
    assert listening.events == [
        f"bus: can0: {source.lost} frames lost in the kernel, the computer was busy ({source.lost} in all)"
    ]
    listening.buses.close()


def test_a_bus_with_much_to_say_does_not_keep_the_others_waiting(talker: can.BusABC) -> None:
    with can.Bus(interface="virtual", channel="tilth-w") as other:
        listening = Listening(virtual("v"), virtual("w"))
        for number in range(1000):
            talker.send(data_frame(number))
        other.send(data_frame(1234))
        first = listening.buses.read(0.0)
        assert [frame.bus for frame in first] == ["v"] * BATCH + ["w"]
        listening.until_frames(1000 - BATCH)
        listening.buses.close()


def test_error_remote_and_fd_frames(talker: can.BusABC) -> None:
    listening = Listening(virtual("v"))
    talker.send(
        can.Message(arbitration_id=0x204, is_error_frame=True, is_extended_id=False, data=b"\x00\x01")
    )
    talker.send(can.Message(arbitration_id=0x123, is_remote_frame=True, is_extended_id=False))
    talker.send(can.Message(arbitration_id=0x124, is_fd=True, data=bytes(12)))
    talker.send(data_frame())
    listening.until_frames(2)
    error, good = listening.frames
    assert error.error and error.can_id == 0x204 and not error.extended and error.data == b"\x00\x01"
    assert not good.error and good.extended
    (source,) = listening.sources
    tally = source.tally
    assert (tally.error_frames, tally.remote_frames, tally.fd_frames, source.frames) == (1, 1, 1, 2)
    listening.buses.close()


def test_a_bus_with_can_fd_frames_only_is_alive_and_said_to_be_so() -> None:
    port = free_port()
    listening = Listening(udp("fd", port))
    (source,) = listening.sources
    assert source.descriptor is not None
    with can.Bus(interface="udp_multicast", channel=GROUP, port=port, hop_limit=0) as other:
        for number in range(EMPTY_READS + 50):
            other.send(can.Message(arbitration_id=0x124, is_fd=True, data=bytes(12)))
            listening.until(lambda: source.tally.fd_frames > number)  # noqa: B023  # called at once
        assert source.state == "open" and source.reason == "" and listening.events == []
        source.usable_ns -= SILENT_NS
        other.send(can.Message(arbitration_id=0x124, is_fd=True, data=bytes(12)))
        listening.until(lambda: source.reason != "")
        assert source.state == "open" and source.reason.startswith("only CAN FD frames")
        assert listening.events == [f"bus: fd: {source.reason}"]
        other.send(data_frame())
        listening.until_frames(1)
    assert source.reason == "" and source.frames == 1 and source.opened == 1
    listening.buses.close()


def test_an_unknown_interface_is_a_fault_of_the_machine_file() -> None:
    with pytest.raises(MachineError, match=r'bus can0: interface = "socketcn" .* did you mean "socketcan"\?'):
        check_interface(Bus(name="can0", interface="socketcn", channel="can0"))
    with pytest.raises(MachineError, match=r"it knows .*udp_multicast"):
        Buses([Bus(name="can0", interface="zzz", channel="can0")], Clock(), lambda kind, text: None)


def test_a_missing_bus_is_said_once_and_tried_again_with_back_off(talker: can.BusABC) -> None:
    missing = Bus(name="gone", interface="socketcan", channel="nosuchcan0")
    listening = Listening(missing, virtual("v"))
    gone, _ = listening.sources
    assert gone.state == "failed"
    waits = []
    for _ in range(6):
        waits.append(round((gone.retry_ns - listening.clock.t_ns()) * 1e-9 + 0.05, 1))
        listening.watch(ahead_ns=gone.retry_ns - listening.clock.t_ns() - 10_000_000)
        assert not gone.opening
        listening.watch(ahead_ns=gone.retry_ns - listening.clock.t_ns())
        assert gone.opening
        listening.settle()
    assert waits == pytest.approx([0.5, 1.0, 2.0, 4.0, 5.0, 5.0], abs=0.11)
    talker.send(data_frame())
    listening.until_frames(1)
    said = [event for event in listening.events if "gone" in event]
    assert len(said) == 1 and "nosuchcan0" in said[0] and "; " in said[0]
    listening.buses.close()


def test_silence_is_said_and_ends_with_the_next_frame(talker: can.BusABC) -> None:
    listening = Listening(virtual("v"))
    (source,) = listening.sources
    listening.watch(ahead_ns=SILENT_NS // 2)
    assert source.state == "open" and listening.events == []
    for _ in range(3):
        listening.watch(ahead_ns=SILENT_NS + 1)
    assert source.state == "silent" and listening.events == [
        "bus: v: silent, no frame for 1.5 s (silence 1), 0 until then"
    ]
    talker.send(data_frame())
    listening.until_frames(1)
    assert source.state == "open" and "heard again" in listening.events[1]
    listening.buses.close()


def test_a_bus_silent_for_long_is_opened_afresh(talker: can.BusABC) -> None:
    """Some die without an error: a deleted interface reads as silence for ever, also when it is back."""
    listening = Listening(virtual("v"))
    (source,) = listening.sources
    first = source.port
    listening.watch(ahead_ns=RENEW_NS + 1)
    listening.settle()
    assert source.port is not first and source.state == "silent" and source.opened == 2
    listening.watch(ahead_ns=RENEW_NS + 1)  # not again so soon
    assert not source.opening
    talker.send(data_frame())
    listening.until(lambda: source.state == "open")
    listening.buses.close()


class Hub:
    """A socketcand server of one client at a time, in the test's own loop."""

    def __init__(self) -> None:
        self.port = free_port(socket.SOCK_STREAM)
        self.listener: socket.socket | None = None
        self.client: socket.socket | None = None
        self.heard = b""

    def live(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", self.port))
        self.listener.setblocking(False)

    def die(self) -> None:
        for one in (self.listener, self.client):
            if one is not None:
                one.close()
        self.listener = self.client = None

    def serve(self) -> None:
        if self.listener is None:
            return
        with contextlib.suppress(BlockingIOError):
            client, _ = self.listener.accept()
            if self.client is not None:
                self.client.close()
            self.client = client
            client.setblocking(False)
            client.sendall(b"< hi >")
        if self.client is not None:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                words = self.client.recv(4096)
                self.heard += words
                if words:
                    self.client.sendall(b"< ok >")

    def send(self, number: int) -> None:
        assert self.client is not None
        stamp = f"{time.clock_gettime(time.CLOCK_REALTIME):.6f}"
        self.client.sendall(f"< frame 18FF0001 {stamp} {number:016X} >".encode())


def test_a_server_that_dies_and_comes_back(talker: can.BusABC) -> None:
    """python-can gives neither an error nor a wait then: readable for ever, nothing to read."""
    hub = Hub()
    hub.live()
    where: dict[str, str | int | float | bool] = {"host": "127.0.0.1", "port": hub.port}
    config = Bus(name="tcp", interface="socketcand", channel="can0", options=where)
    listening = Listening(config, virtual("v"), serve=hub.serve)
    tcp, _ = listening.sources
    assert tcp.state == "open" and tcp.descriptor is not None
    wanted = 0
    for burst in range(90, 110):  # several in a packet, more than a batch, then nothing that wakes the loop
        for number in range(burst):
            hub.send(number)
        wanted += burst
        listening.until_frames(wanted)
    hub.die()
    for _ in range(2 * EMPTY_READS):
        listening.turn()
    assert tcp.state == "failed"
    talker.send(data_frame())
    listening.until(lambda: listening.frames[-1].bus == "v")

    listening.watch(ahead_ns=1_000_000_000)  # nobody answers: said at once, not after ten seconds
    listening.settle()
    assert tcp.state == "failed" and "start the server" in tcp.reason

    hub.live()
    listening.watch(ahead_ns=3_000_000_000)
    listening.settle()
    hub.send(2)
    listening.until(lambda: listening.frames[-1].bus == "tcp")
    assert listening.frames[-1].data == (2).to_bytes(8, "big")
    listening.buses.close()
    hub.die()
    assert hub.heard == b"< open can0 >< rawmode >" * 2  # it only listens
    assert [text.split(";")[0] for text in listening.events][:2] == [
        "bus: tcp: can0: the far side has hung up",
        "bus: tcp: socketcand can0: Connection refused",
    ]


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.ENODEV, "No such device"), "ip link"),
        (OSError(errno.EAFNOSUPPORT, "Address family not supported"), "kernel has no CAN"),
        (can.CanOperationError("Error receiving: Network is down", errno.ENETDOWN), "ip link set can7 up"),
        (TypeError("missing 1 required argument: 'host'"), "check interface, channel and options"),
        (ValueError(""), "ValueError"),
    ],
)
def test_an_error_becomes_a_sentence_with_what_to_do(error: Exception, words: str) -> None:
    text = why_not(error, Bus(name="x", interface="socketcan", channel="can7"))
    assert words in text and "can7" in text and "\n" not in text


class Hanging:
    """A device whose driver never comes back: neither from opening it nor from closing it."""

    def __init__(self) -> None:
        self.released = threading.Event()
        self.opened = 0
        self.closed = 0

    def open(self, config: Bus, clock: Clock, tally: Tally) -> Port:
        if config.interface == "virtual":
            return open_port(config, clock, tally)
        self.opened += 1
        self.released.wait(20)
        port = open_port(virtual("hanging"), clock, tally)
        end = port.close

        def close() -> None:
            self.closed += 1
            end()

        port.close = close  # type: ignore[method-assign]
        return port


def test_an_opening_that_hangs_is_said_and_begun_anew_and_no_other_bus_waits(
    talker: can.BusABC, monkeypatch: pytest.MonkeyPatch
) -> None:
    times = {"WATCH_NS": 5, "SLOW_NS": 50, "GIVE_UP_NS": 100, "BACK_OFF_MOST_NS": 10}  # ms
    for name, milliseconds in times.items():
        monkeypatch.setattr(f"tilth.logger.buses.{name}", milliseconds * 1_000_000)
    hanging = Hanging()
    events: list[str] = []
    configs = [Bus(name="hung", interface="pcan", channel="x"), virtual("v")]
    buses = Buses(configs, Clock(), lambda kind, text: events.append(text), hanging.open)
    hung, other = buses.sources
    frames: list[Frame] = []
    sent = 0

    def turn() -> None:
        nonlocal sent
        if other.port is not None:
            talker.send(data_frame(sent))
            sent += 1
        frames.extend(buses.read(0.02))

    until(lambda: hung.problem == SLOW, turn)
    assert hung.state == "failed" and hung.failures == 1
    until(lambda: hanging.opened == HANGING and not hung.opening, turn)  # each begun beside those before
    for _ in range(20):
        turn()
    assert hanging.opened == HANGING
    hanging.released.set()  # the driver comes back: what was given up is closed, one more is used
    until(lambda: hung.port is not None and hanging.closed == HANGING, turn)
    until(lambda: len(frames) == sent, lambda: frames.extend(buses.read(0.02)))
    buses.close()
    assert hung.failures == 1 and hung.opened == 1
    assert len([text for text in events if text.startswith(f"hung: {SLOW}")]) == 1


def test_a_port_that_hangs_in_closing_stops_nothing(talker: can.BusABC) -> None:
    """A serial line whose adapter is gone may wait for ever to send its last word."""
    released = threading.Event()

    class Stuck(LibraryPort):
        def close(self) -> None:
            released.wait(20)
            super().close()

        def take(self, frames: list[Frame], most: int) -> int:
            raise OSError(errno.EIO, "Input/output error")

    def opener(config: Bus, clock: Clock, tally: Tally) -> Port:
        if config.name == "v":
            return open_port(config, clock, tally)
        return Stuck(can.Bus(interface="virtual", channel="tilth-stuck"), config, clock, tally)

    listening = Listening(virtual("stuck"), virtual("v"), opener=opener)
    stuck, _ = listening.sources
    listening.until(lambda: stuck.state == "failed")
    talker.send(data_frame())
    listening.until_frames(1)
    listening.watch(ahead_ns=BACK_OFF_MOST_NS)  # tried again although the old one is not closed yet
    listening.until(lambda: stuck.opened == 2)
    released.set()
    listening.buses.close()


def test_an_error_of_the_driver_heals_and_is_counted(talker: can.BusABC) -> None:
    listening = Listening(virtual("v"))
    (source,) = listening.sources
    talker.send(data_frame(0))
    listening.until_frames(1)
    for failure in (1, 2):
        assert isinstance(source.port, LibraryPort)
        source.port.bus.shutdown()  # reading it raises from now on
        listening.until(lambda: source.state == "failed")
        listening.watch(ahead_ns=BACK_OFF_MOST_NS)
        listening.settle()
        talker.send(data_frame(failure))
        listening.until_frames(1 + failure)
        assert listening.events[-1].startswith("bus: v: works again after")
        assert listening.events[-1].endswith(f"(failure {failure}, opening {failure + 1})")
        assert f"it is tried again (failure {failure}, {failure} frames until then)" in listening.events[-2]
    assert source.failures == 2 and source.problem == ""
    listening.buses.close()


def test_bus_off_is_said_shown_and_over_when_frames_come(talker: can.BusABC) -> None:
    listening = Listening(virtual("v"))
    (source,) = listening.sources
    bus_off = can.Message(arbitration_id=0x40, is_error_frame=True, is_extended_id=False, data=bytes(8))
    talker.send(bus_off)
    listening.until_frames(1)
    listening.watch()
    status = bus_status(source, listening.clock.t_ns())
    assert (status.controller, status.error_frames) == ("bus_off", 1) and "bus-off" in status.reason
    assert [(one.reason, one.count) for one in status.errors] == [("bus_off", 1)]
    talker.send(data_frame())
    listening.until_frames(2)
    listening.watch(ahead_ns=2 * BACK_NS)
    status = bus_status(source, listening.clock.t_ns())
    assert status.controller == "active" and status.reason == ""
    assert [event.split(",")[0] for event in listening.events] == [
        "bus: v: bus-off", "bus: v: the controller is error-active again (1 times"
    ]  # fmt: skip
    listening.buses.close()
