"""Buses that fail: what is said, that it heals, and that it touches no other bus."""

import contextlib
import errno
import socket
import threading
import time

import can
import pytest
from listening import Listening, data_frame, virtual
from loopback import PATIENCE_S, free_port, until

from tilth.logger.can.bus_opening import open_port, why_not
from tilth.logger.can.buses import EMPTY_READS, SILENT_NS, SLOW, WORKED_NS, Buses
from tilth.logger.can.can_errors import BACK_NS
from tilth.logger.can.live_bus import BACK_OFF_MOST_NS, HANGING, RENEW_NS
from tilth.logger.can.port import LibraryPort, Port, Tally
from tilth.logger.clock import Clock
from tilth.logger.status import bus_status
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus
from tilth.schemas.sentences import notice_sentence

pytestmark = pytest.mark.usefixtures("watched_by_hand")


def test_a_missing_bus_is_said_once_and_tried_again_with_back_off(talker: can.BusABC) -> None:
    missing = Bus(name="gone", interface="socketcan", channel="nosuchcan0")
    listening = Listening(missing, virtual("v"))
    gone, _ = listening.live_buses
    assert gone.state == "failed"
    waits = []
    for _ in range(6):
        waits.append(round((gone.connection.back_off.retry_at_ns - listening.clock.t_ns()) * 1e-9 + 0.05, 1))
        listening.watch(ahead_ns=gone.connection.back_off.retry_at_ns - listening.clock.t_ns() - 10_000_000)
        assert not gone.connection.opening
        listening.watch(ahead_ns=gone.connection.back_off.retry_at_ns - listening.clock.t_ns())
        assert gone.connection.opening
        listening.settle()
    assert waits == pytest.approx([0.5, 1.0, 2.0, 4.0, 5.0, 5.0], abs=0.11)
    talker.send(data_frame())
    listening.until_frames(1)
    messages = [event for event in listening.events if "gone" in event]
    assert len(messages) == 1 and "nosuchcan0" in messages[0] and "; " in messages[0]
    listening.buses.close()


def test_silence_is_said_and_ends_with_the_next_frame(talker: can.BusABC) -> None:
    listening = Listening(virtual("v"))
    (live,) = listening.live_buses
    listening.watch(ahead_ns=SILENT_NS // 2)
    assert live.state == "open" and listening.events == []
    for _ in range(3):
        listening.watch(ahead_ns=SILENT_NS + 1)
    assert live.state == "silent" and listening.events == [
        "bus: v: silent, no frame for 1.5 s (silence 1), 0 until then"
    ]
    talker.send(data_frame())
    listening.until_frames(1)
    assert live.state == "open" and "heard again" in listening.events[1]
    listening.buses.close()


def test_a_bus_silent_for_long_is_opened_afresh(talker: can.BusABC) -> None:
    """Some die without an error: a deleted interface reads as silence for ever, also when it is back."""
    listening = Listening(virtual("v"))
    (live,) = listening.live_buses
    first = live.connection.port
    listening.watch(ahead_ns=RENEW_NS + 1)
    listening.settle()
    assert live.connection.port is not first and live.state == "silent" and live.connection.opened == 2
    listening.watch(ahead_ns=RENEW_NS + 1)  # not again so soon
    assert not live.connection.opening
    talker.send(data_frame())
    listening.until(lambda: live.state == "open")
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
    tcp, _ = listening.live_buses
    assert tcp.state == "open" and tcp.connection.descriptor is not None
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
        self.released.wait(PATIENCE_S)
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
    times = {
        "buses.WATCH_NS": 5,
        "buses.SLOW_NS": 50,
        "buses.GIVE_UP_NS": 100,
        "live_bus.BACK_OFF_MOST_NS": 10,
    }
    for name, milliseconds in times.items():
        monkeypatch.setattr(f"tilth.logger.can.{name}", milliseconds * 1_000_000)
    hanging = Hanging()
    events: list[str] = []
    configs = [Bus(name="hung", interface="pcan", channel="x"), virtual("v")]
    buses = Buses(configs, Clock(), lambda kind, told: events.append(notice_sentence(told)), hanging.open)
    hung, other = buses.live_buses
    frames: list[Frame] = []
    sent = 0

    def turn() -> None:
        nonlocal sent
        if other.connection.port is not None:
            talker.send(data_frame(sent))
            sent += 1
        frames.extend(buses.read(0.02))

    until(lambda: hung.problem == SLOW, turn)
    assert hung.state == "failed" and hung.outages.failures == 1
    until(
        lambda: hanging.opened == HANGING and not hung.connection.opening, turn
    )  # each begun beside those before
    for _ in range(20):
        turn()
    assert hanging.opened == HANGING
    hanging.released.set()  # the driver comes back: what was given up is closed, one more is used
    until(lambda: hung.connection.port is not None and hanging.closed == HANGING, turn)
    until(lambda: len(frames) == sent, lambda: frames.extend(buses.read(0.02)))
    buses.close()
    assert hung.outages.failures == 1 and hung.connection.opened == 1
    assert len([text for text in events if text.startswith(f"hung: {SLOW}")]) == 1


def test_a_port_that_hangs_in_closing_stops_nothing(talker: can.BusABC) -> None:
    """A serial line whose adapter is gone may wait for ever to send its last word."""
    released = threading.Event()

    class Stuck(LibraryPort):
        def close(self) -> None:
            released.wait(PATIENCE_S)
            super().close()

        def take(self, frames: list[Frame], most: int) -> int:
            raise OSError(errno.EIO, "Input/output error")

    def opener(config: Bus, clock: Clock, tally: Tally) -> Port:
        if config.name == "v":
            return open_port(config, clock, tally)
        return Stuck(can.Bus(interface="virtual", channel="tilth-stuck"), config, clock, tally)

    listening = Listening(virtual("stuck"), virtual("v"), opener=opener)
    stuck, _ = listening.live_buses
    listening.until(lambda: stuck.state == "failed")
    talker.send(data_frame())
    listening.until_frames(1)
    listening.watch(ahead_ns=BACK_OFF_MOST_NS)  # tried again although the old one is not closed yet
    listening.until(lambda: stuck.connection.opened == 2)
    released.set()
    listening.buses.close()


def test_an_error_of_the_driver_heals_and_is_counted(talker: can.BusABC) -> None:
    listening = Listening(virtual("v"))
    (live,) = listening.live_buses
    talker.send(data_frame(0))
    listening.until_frames(1)
    for failure in (1, 2):
        assert isinstance(live.connection.port, LibraryPort)
        live.connection.port.bus.shutdown()  # reading it raises from now on
        listening.until(lambda: live.state == "failed")
        listening.watch(ahead_ns=BACK_OFF_MOST_NS)
        listening.settle()
        talker.send(data_frame(failure))
        listening.until_frames(1 + failure)
        assert listening.events[-1].startswith("bus: v: works again after")
        assert listening.events[-1].endswith(f"(failure {failure}, opening {failure + 1})")
        assert f"it is tried again (failure {failure}, {failure} frames until then)" in listening.events[-2]
    assert live.outages.failures == 2 and live.problem == ""
    listening.buses.close()


@pytest.mark.parametrize("frames_between", [True, False])
def test_a_failure_shorter_than_a_status_period_is_an_event_and_a_count_in_every_later_status(
    talker: can.BusABC, frames_between: bool
) -> None:
    """Also where nobody sends in between, so that no frame tells that the bus works again."""
    listening = Listening(virtual("v"))
    (live,) = listening.live_buses
    talker.send(data_frame())
    listening.until_frames(1)
    for failure in (1, 2, 3):
        output = len([text for text in listening.events if "it is tried again" in text])
        before = bus_status(live, listening.clock.t_ns())
        assert (before.state, before.failures) == ("open", failure - 1) and output == failure - 1
        assert isinstance(live.connection.port, LibraryPort)
        live.connection.port.bus.shutdown()  # reading it raises from now on
        listening.until(lambda: live.state == "failed")
        listening.watch(ahead_ns=live.connection.back_off.retry_at_ns - listening.clock.t_ns())
        listening.settle()
        if frames_between:
            talker.send(data_frame(failure))
            listening.until_frames(1 + failure)
        else:
            listening.watch(ahead_ns=WORKED_NS)
        after = bus_status(live, listening.clock.t_ns())  # the next: all is well, and yet it is told
        assert (after.state, after.failures, after.reason) == ("open", failure, "")
        assert f"(failure {failure}, " in [text for text in listening.events if "tried again" in text][-1]
    listening.buses.close()


def test_one_that_opens_and_fails_at_once_again_and_again_is_one_failure_said_once(
    talker: can.BusABC,
) -> None:
    class Failing(LibraryPort):
        def take(self, frames: list[Frame], most: int) -> int:
            raise OSError(errno.EIO, "Input/output error")

    def opener(config: Bus, clock: Clock, tally: Tally) -> Port:
        return Failing(can.Bus(interface="virtual", channel="tilth-failing"), config, clock, tally)

    listening = Listening(virtual("failing"), opener=opener)
    (live,) = listening.live_buses
    for opened in (1, 2, 3, 4):
        listening.until(lambda: live.state == "failed" and not live.connection.opening)
        assert (live.connection.opened, live.outages.failures, len(listening.events)) == (opened, 1, 1)
        listening.watch(ahead_ns=BACK_OFF_MOST_NS)
        listening.settle()
    listening.buses.close()


def test_bus_off_is_said_shown_and_over_when_frames_come(talker: can.BusABC) -> None:
    listening = Listening(virtual("v"))
    (live,) = listening.live_buses
    bus_off = can.Message(arbitration_id=0x40, is_error_frame=True, is_extended_id=False, data=bytes(8))
    talker.send(bus_off)
    listening.until_frames(1)
    listening.watch()
    status = bus_status(live, listening.clock.t_ns())
    assert (status.controller, status.error_frames) == ("bus_off", 1) and "bus-off" in status.reason
    assert [(one.reason, one.count) for one in status.errors] == [("bus_off", 1)]
    talker.send(data_frame())
    listening.until_frames(2)
    listening.watch(ahead_ns=2 * BACK_NS)
    status = bus_status(live, listening.clock.t_ns())
    assert status.controller == "active" and status.reason == ""
    assert [event.split(",")[0] for event in listening.events] == [
        "bus: v: bus-off", "bus: v: the controller is error-active again (1 times"
    ]  # fmt: skip
    listening.buses.close()
