"""Buses: real sockets, a second process that sends, every frame in its order with its stamps."""

import contextlib
import socket
from dataclasses import replace

import can
import pytest
from listening import Listening, data_frame, udp, virtual
from loopback import GROUP, Sender, free_port, numbered, until

from tilth.logger import clock as clock_of_a_run
from tilth.logger.can.bus_opening import check_interface
from tilth.logger.can.buses import ASK_NS, BATCH, EMPTY_READS, SILENT_NS, Buses
from tilth.logger.can.receive_buffer import dropped
from tilth.logger.clock import OLDEST_NS, Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus, MachineError

pytestmark = pytest.mark.usefixtures("watched_by_hand")


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
    assert listening.events == [] and [live.traffic.lost for live in listening.live_buses] == [0, 0]


def test_what_waited_for_a_busy_loop_keeps_its_stamp(
    talker: can.BusABC, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clock_of_a_run, "OLDEST_NS", 20_000_000)
    listening = Listening(virtual("v"))
    listening.turn()
    talker.send(data_frame())
    sent_ns = listening.clock.t_ns()
    until(lambda: listening.clock.t_ns() > sent_ns + 50_000_000)
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


def test_what_the_kernel_drops_is_counted(sender: Sender) -> None:
    port = free_port()
    listening = Listening(udp("can0", port))
    (live,) = listening.live_buses
    assert live.connection.descriptor is not None
    with socket.socket(fileno=live.connection.descriptor) as handle:
        handle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        handle.detach()
    sender.begin([port], [(0, frame, 0.0) for frame in numbered(500)])
    sender.finish()
    port_of = live.connection.port
    assert port_of is not None
    until(lambda: live.traffic.frames + port_of.lost() == 500, listening.turn)
    listening.watch(ahead_ns=ASK_NS)
    lost = live.traffic.lost
    assert lost > 0 and live.traffic.frames + lost == 500
    assert listening.events == [
        f"bus: can0: {lost} frames lost in the kernel, the computer was busy ({lost} in all)"
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
    (live,) = listening.live_buses
    tally = live.tally
    assert (tally.error_frames, tally.remote_frames, tally.fd_frames, live.traffic.frames) == (1, 1, 1, 2)
    listening.buses.close()


def test_a_bus_with_can_fd_frames_only_is_alive_and_said_to_be_so() -> None:
    port = free_port()
    listening = Listening(udp("fd", port))
    (live,) = listening.live_buses
    assert live.connection.descriptor is not None
    with can.Bus(interface="udp_multicast", channel=GROUP, port=port, hop_limit=0) as other:
        for number in range(EMPTY_READS + 50):
            other.send(can.Message(arbitration_id=0x124, is_fd=True, data=bytes(12)))
            listening.until(lambda: live.tally.fd_frames > number)  # noqa: B023  # called at once
        assert live.state == "open" and live.reason == "" and listening.events == []
        live.traffic.usable_ns -= SILENT_NS
        other.send(can.Message(arbitration_id=0x124, is_fd=True, data=bytes(12)))
        listening.until(lambda: live.reason != "")
        assert live.state == "open" and live.reason.startswith("only CAN FD frames")
        assert listening.events == [f"bus: fd: {live.reason}"]
        other.send(data_frame())
        listening.until_frames(1)
    assert live.reason == "" and live.traffic.frames == 1 and live.connection.opened == 1
    listening.buses.close()


def test_an_unknown_interface_is_a_fault_of_the_machine_file() -> None:
    with pytest.raises(MachineError, match=r'bus can0: interface = "socketcn" .* did you mean "socketcan"\?'):
        check_interface(Bus(name="can0", interface="socketcn", channel="can0"))
    with pytest.raises(MachineError, match=r"it knows .*udp_multicast"):
        Buses([Bus(name="can0", interface="zzz", channel="can0")], Clock(), lambda kind, told: None)
