"""The one frame that may be sent: where the machine file allows it, once, when the bus is opened."""

import os
import socket

import can
import pytest
from logs import MACHINE_TEXT
from loopback import PATIENCE_S

from tilth.logger.can import claim_request, slcan, socketcan
from tilth.logger.can.bus_opening import open_port
from tilth.logger.can.port import Tally
from tilth.logger.clock import Clock
from tilth.schemas.machine import Bus, MachineError
from tilth.schemas.machine_toml import parse_machine


def bus(interface: str, channel: str, allowed: bool, **options: str | int | float | bool) -> Bus:
    return Bus(name="can0", interface=interface, channel=channel, request_claims=allowed, options=options)


@pytest.mark.parametrize("allowed", [True, False])
def test_it_asks_everybody_for_their_names_where_that_is_allowed(allowed: bool) -> None:
    with can.Bus(interface="virtual", channel="asked") as other:
        port = open_port(bus("virtual", "asked", allowed), Clock(), Tally())
        message = other.recv(PATIENCE_S if allowed else 0.0)
        port.close()
        assert (message is not None) == allowed and port.note == ""
        if message is not None:
            assert (message.arbitration_id, bytes(message.data)) == (0x18EAFFFE, b"\x00\xee\x00")
            assert message.is_extended_id and other.recv(0.0) is None


@pytest.mark.parametrize("allowed", [True, False])
def test_an_slcan_adapter_is_opened_for_sending_only_then(allowed: bool) -> None:
    master, slave = os.openpty()
    config = bus("slcan", os.ttyname(slave), allowed, sleep_after_open=0.0)
    port = slcan.open_slcan(config, Clock(), Tally())
    said, end = b"", b"EE00\r" if allowed else b"L\r"
    while not said.endswith(end):  # a pty may give it in pieces
        said += os.read(master, 1000)
    port.close()
    os.close(master)
    os.close(slave)
    assert (b"T18EAFFFE300EE00\r" in said) == allowed
    assert (b"\rO\r" in said, b"\rL\r" in said) == (allowed, not allowed)


def test_a_frame_of_socketcan_holds_it() -> None:
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with one, other:
        socketcan.ask_for_claims(one)
        identifier, length, data = socketcan.CAN_FRAME.unpack(other.recv(100))
    assert identifier == claim_request.IDENTIFIER | socketcan.EXTENDED
    assert (length, data) == (3, b"\x00\xee\x00" + bytes(5))


def test_where_it_cannot_be_sent_the_bus_is_heard_all_the_same() -> None:
    def fails() -> None:
        raise OSError(100, "network is down")

    assert claim_request.ask(fails).startswith("devices could not be asked for their NAMEs")
    text = MACHINE_TEXT.replace('interface = "socketcan"', 'interface = "mavlink"\nrequest_claims = true')
    with pytest.raises(MachineError, match="an autopilot's bus is only listened to"):
        parse_machine(text)
