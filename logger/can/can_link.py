"""Asks the kernel for the bit rate, state and restart time of a CAN interface's controller.

Error frames report only changes of state, and only to a socket that is open at that instant.
"""

import socket
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass

# linux/rtnetlink.h, linux/if_link.h, linux/can/netlink.h
_GETLINK = 18
_NEWLINK = 16
_REQUEST = 1
_IFNAME = 3
_LINKINFO = 18
_INFO_KIND, _INFO_DATA = 1, 2
_BITTIMING, _STATE, _RESTART_MS = 1, 4, 6
_HEADER = struct.Struct("=IHHII")  # length, type, flags, sequence, port
_INTERFACE = struct.Struct("=BxHiII")  # struct ifinfomsg
_ATTRIBUTE = struct.Struct("=HH")  # length with itself, type
_TYPE_BITS = 0x3FFF
_ANSWER_BYTES = 65536
_WAIT_S = 0.2


@dataclass(frozen=True, slots=True)
class CanLink:
    """bitrate: bit/s, 0 where none is set. state: as in can_errors.STATES. restart_ms: 0 for never."""

    bitrate: int
    state: int
    restart_ms: int


def ask(interface: str) -> CanLink | None:
    """None where the kernel does not say: no CAN controller (vcan has none), no such interface."""
    answer = _answer(interface)
    return None if answer is None else parse(answer)


def is_virtual(interface: str) -> bool:
    """Whether no wire is behind an interface: a vcan."""
    answer = _answer(interface)
    return answer is not None and _info(answer).get(_INFO_KIND, b"").rstrip(b"\0") == b"vcan"


def _answer(interface: str) -> bytes | None:
    """What the kernel says of an interface; None where it says nothing."""
    name = interface.encode()[:15] + b"\0"
    attribute = _ATTRIBUTE.pack(_ATTRIBUTE.size + len(name), _IFNAME) + name + b"\0" * (-len(name) % 4)
    body = _INTERFACE.pack(socket.AF_UNSPEC, 0, 0, 0, 0) + attribute
    header = _HEADER.pack(_HEADER.size + len(body), _GETLINK, _REQUEST, 1, 0)
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_CLOEXEC, 0) as one:
            one.settimeout(_WAIT_S)
            one.send(header + body)
            return one.recv(_ANSWER_BYTES)
    except OSError:
        return None


def parse(answer: bytes) -> CanLink | None:
    """The link of a RTM_NEWLINK message, None where that tells of no CAN controller."""
    found = dict(_attributes(_info(answer).get(_INFO_DATA, b"")))
    numbers = {kind: int.from_bytes(found[kind][:4], sys.byteorder) for kind in found}
    if _STATE not in numbers:
        return None
    return CanLink(numbers.get(_BITTIMING, 0), numbers[_STATE], numbers.get(_RESTART_MS, 0))


def _info(answer: bytes) -> dict[int, bytes]:
    """What a RTM_NEWLINK message says of the kind of link, {} where it is none."""
    if len(answer) < _HEADER.size or _HEADER.unpack_from(answer)[1] != _NEWLINK:
        return {}
    links = dict(_attributes(answer[_HEADER.size + _INTERFACE.size :]))
    return dict(_attributes(links.get(_LINKINFO, b"")))


def _attributes(data: bytes) -> Iterator[tuple[int, bytes]]:
    while len(data) >= _ATTRIBUTE.size:
        length, kind = _ATTRIBUTE.unpack_from(data)
        if length < _ATTRIBUTE.size:
            return
        yield kind & _TYPE_BITS, data[_ATTRIBUTE.size : length]
        data = data[length + -length % 4 :]
