"""CAN through an autopilot: another process that forwards while it is asked, over a UDP way that loses."""

import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import can
import pytest
from loopback import PATIENCE_S, free_port, numbered, until
from pymavlink.dialects.v20 import common

from tilth.logger.can.bus_opening import check_interface, open_port
from tilth.logger.can.buses import Buses
from tilth.logger.can.mavlink_bus import MavlinkBus
from tilth.logger.can.port import StampedBy
from tilth.logger.clock import OLDEST_NS, Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus
from tilth.schemas.sentences import notice_sentence

COUNT, GAP_S, FORGETS_S = 500, 0.005, 1.6  # an autopilot forgets after 5 s: this one sooner
# Forwards numbered frames while it is asked; tells how often it was, and what else it was told.
AUTOPILOT = f"""
import socket, struct, sys, time
from pymavlink.dialects.v20 import ardupilotmega as m
from tilth.schemas.sentences import notice_sentence
udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
udp.connect(("127.0.0.1", int(sys.argv[1])))
udp.setblocking(False)
class Out:
    def write(self, packed): udp.send(packed)
mav = m.MAVLink(Out(), 7, 1)
asked, last, i, others, beat = 0, float("-inf"), 0, 0, 0.0
while i < {COUNT}:
    now = time.monotonic()
    if now - beat > 0.2:
        mav.heartbeat_send(m.MAV_TYPE_GROUND_ROVER, m.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4)
        mav.wind_send(1.0, 2.0, 3.0)  # of its own dialect
        beat = now
    try:
        for one in mav.parse_buffer(udp.recv(2048)):
            if one.get_type() == "COMMAND_LONG" and (one.command, one.param1) == (m.MAV_CMD_CAN_FORWARD, 2.0):
                asked, last = asked + 1, now
                mav.command_ack_send(one.command, m.MAV_RESULT_ACCEPTED)
            else:
                others += 1
    except (BlockingIOError, ConnectionRefusedError):
        pass
    if now - last < {FORGETS_S}:
        mav.can_frame_send(0, 0, 1, 8, 0x98FF0001, struct.pack("<Q", i))
        mav.can_frame_send(0, 0, 0, 8, 0x98FF0001, bytes(8))  # of its other bus, which somebody else wanted
        i += 1
    time.sleep({GAP_S})
mav.heartbeat_send(m.MAV_TYPE_GROUND_ROVER, m.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4)
print(asked, others)
"""


class Way:
    """Carries datagrams between whoever sends to its port and another port; loses some on the way there."""

    def __init__(self, to: int, loses: Callable[[int], bool]) -> None:
        self._near, self._far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        for end in (self._near, self._far):  # a busy computer is late: what waits meanwhile is not lost
            end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._near.bind(("127.0.0.1", 0))
        self._far.connect(("127.0.0.1", to))
        self.port = int(self._near.getsockname()[1])
        self._loses = loses
        self._peer: tuple[str, int] | None = None
        self.dropped: list[int] = []  # number of a frame of bus 2, or -1
        self._threads = [threading.Thread(target=job, daemon=True) for job in (self._out, self._back)]
        for thread in self._threads:
            thread.start()

    def _out(self) -> None:
        codec = common.MAVLink(None)
        with suppress(OSError):
            for count in range(1 << 30):
                packed, self._peer = self._near.recvfrom(2048)
                if not packed:
                    return  # closed
                if self._loses(count):
                    message: Any = codec.decode(bytearray(packed))
                    ours = message.get_type() == "CAN_FRAME" and message.to_dict()["bus"] == 1
                    self.dropped.append(int.from_bytes(message.to_dict()["data"], "little") if ours else -1)
                    continue
                with suppress(ConnectionRefusedError):
                    self._far.send(packed)

    def _back(self) -> None:
        while True:
            try:
                packed = self._far.recv(2048)
            except ConnectionRefusedError:
                continue
            if not packed:
                return  # closed
            if self._peer is not None:
                self._near.sendto(packed, self._peer)

    def close(self) -> None:
        for end in (self._near, self._far):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)  # wakes who reads it
        for thread in self._threads:
            thread.join(PATIENCE_S)
        for end in (self._near, self._far):
            end.close()


@contextmanager
def bus_at(port: int) -> Iterator[MavlinkBus]:
    bus = can.Bus(channel=f"udpin:127.0.0.1:{port}", interface="mavlink", ignore_config=True)
    assert isinstance(bus, MavlinkBus)
    try:
        yield bus
    finally:
        bus.shutdown()


def test_the_daemon_reads_it_and_counts_what_the_way_loses() -> None:
    port = free_port()
    config = Bus(name="can0", interface="mavlink", channel=f"udpin:127.0.0.1:{port}", options={"can_bus": 2})
    check_interface(config)
    events: list[str] = []
    frames: list[Frame] = []
    buses = Buses([config], Clock(), lambda kind, told: events.append(notice_sentence(told)), open_port)
    (live,) = buses.live_buses

    def turn() -> None:
        frames.extend(buses.read(0.02))

    until(lambda: live.connection.port is not None, turn)
    way = Way(port, lambda count: count > 100 and count % 11 == 0)
    words = [sys.executable, "-c", AUTOPILOT, str(way.port)]
    autopilot = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    until(lambda: autopilot.poll() is not None, turn)
    requested, others = map(int, autopilot.communicate()[0].split())
    assert live.connection.port is not None

    def wanted() -> list[Frame]:
        return [frame for i, frame in enumerate(numbered(COUNT)) if i not in way.dropped]

    until(lambda: len(frames) == len(wanted()), turn)
    assert [(f.can_id, f.extended, f.data) for f in frames] == [
        (f.can_id, f.extended, f.data) for f in wanted()
    ]
    assert all(0 <= frame.t_ns - frame.rx_ns < OLDEST_NS for frame in frames)
    assert live.traffic.stamp is StampedBy.KERNEL
    until(
        lambda: live.connection.port is not None and live.connection.port.lost() >= len(way.dropped) - 1, turn
    )
    assert len(way.dropped) > 50 and len(way.dropped) - live.connection.port.lost() in (
        0,
        1,
    )  # the last may be one
    assert requested >= 2 and others == 0  # asked again and again, and nothing else
    buses.watch(Clock().t_ns() + 2_000_000_000)
    assert any("messages of the autopilot lost on the way" in text for text in events)
    assert live.traffic.lost == live.connection.port.lost()
    buses.close()
    way.close()


def _packed(make: Callable[[Any], Any], sequence: int = 0) -> bytes:
    codec: Any = common.MAVLink(None, 7, 1)
    codec.seq = sequence
    return bytes(make(codec).pack(codec))


def _frame(identifier: int, sequence: int) -> bytes:
    return _packed(lambda codec: codec.can_frame_encode(0, 0, 0, 3, identifier, bytes(8)), sequence)


@pytest.mark.parametrize(
    ("sequences", "lost"),
    [((1, 2, 3), 0), ((1, 4), 2), ((255, 0), 0), ((254, 1), 2), ((1, 3, 2, 4), 0), ((5, 5), 0)],
)
def test_losses_by_sequence_numbers(sequences: tuple[int, ...], lost: int) -> None:
    port = free_port()
    with bus_at(port) as bus, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        for sequence in sequences:
            udp.sendto(_frame(0x98FF0001, sequence), ("127.0.0.1", port))
            assert bus.recv(PATIENCE_S) is not None
        assert bus.messages_lost == lost


def test_rubbish_is_passed_over_and_flags_are_read() -> None:
    port = free_port()
    with bus_at(port) as bus, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        broken = bytearray(_frame(0x123, 1))
        broken[12] ^= 0xFF
        for packed in (b"", b"\xfd", b"rubbish" * 40, bytes(broken), _frame(0x123, 2), _frame(0x20000004, 3)):
            udp.sendto(packed, ("127.0.0.1", port))
        first, second = bus.recv(PATIENCE_S), bus.recv(PATIENCE_S)
        assert first is not None and second is not None
        assert (first.arbitration_id, first.is_extended_id, first.dlc) == (0x123, False, 3)
        assert second.is_error_frame
        with pytest.raises(can.CanOperationError, match="only listens"):
            bus.send(first)
        denied = common.MAV_RESULT_DENIED
        refusal = _packed(lambda codec: codec.command_ack_encode(common.MAV_CMD_CAN_FORWARD, denied))
        udp.sendto(refusal, ("127.0.0.1", port))
        with pytest.raises(can.CanOperationError, match="does not forward CAN 1: denied"):
            bus.recv(PATIENCE_S)


@pytest.mark.parametrize(
    ("channel", "options", "expected"),
    [
        ("can0", {}, "give udpout:HOST:PORT"),
        ("udpin:127.0.0.1:14550", {"can_bus": 0}, "can_bus = 0"),
    ],
)
def test_a_wrong_channel_is_told(channel: str, options: dict[str, int], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        MavlinkBus(channel, **options)
