"""Captures of network tools: pcap and pcapng of SocketCAN, of one interface or of all (`tcpdump -i any`).

A packet is an identifier with flags as linux/can.h has them but most significant byte first, a length, a byte
of flags, two of nothing, and the data. Of all interfaces, a head is before it (LINUX_SLL, LINUX_SLL2), and
the identifier is in the byte order of the computer that wrote the file. Stamps are the capture's own.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, Final

from tilth.replay.readers.log import OpenLog, OtherKind, stamp_fault
from tilth.schemas.flow import Frame

PCAP: Final = {  # how a file begins -> byte order, ns of a unit of its stamps
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
PCAPNG: Final = b"\x0a\x0d\x0d\x0a"

SOCKETCAN: Final = 227  # link type
COOKED: Final = {113: (14, None, 16), 276: (0, 4, 20)}  # -> where: protocol, interface; bytes of its head
_LINKS: Final = (SOCKETCAN, *COOKED)
_NOT_OF_CAN: Final = f"not of SocketCAN ({SOCKETCAN}) or of all interfaces ({', '.join(map(str, COOKED))})"
_CAN_PROTOCOLS: Final = (0x0C, 0x0D, 0x0E)  # CAN, CAN FD, CAN XL
_LINK_TYPE: Final = 0xFFFF  # its bits of a pcap's last word
_MOST: Final = 1 << 24  # bytes of one packet or block; more is damage
_PACKET: Final = struct.Struct(">IBB")
_REMOTE, _ERROR, _EXTENDED = 0x40000000, 0x20000000, 0x80000000
_XL: Final = 0x80  # flag where other frames have their length

_SECTION, _INTERFACE, _OLD_PACKET, _SIMPLE_PACKET, _PACKET_BLOCK = 0x0A0D0D0A, 1, 2, 3, 6
_NAME, _RESOLUTION, _OFFSET = 2, 9, 14  # options of an interface
_BYTE_ORDER: Final = b"\x4d\x3c\x2b\x1a"  # how a section begins that has its least significant byte first


def pcap(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """Frames of a pcap file. Raises OtherKind for another link type."""
    header = stream.read(24)
    order, unit_ns = PCAP[header[:4]]
    if len(header) < 24:
        log.truncated = True
        return
    (link,) = struct.unpack_from(order + "I", header, 20)
    link &= _LINK_TYPE
    if link not in _LINKS:
        raise OtherKind(f"{log.path}: a capture of link type {link}, {_NOT_OF_CAN}")
    packets = _Packets()
    for stamp_ns, packet in _records(log, stream, order, unit_ns):
        yield from _usable(log, packets.frame(link, order, packet, stamp_ns, "can0"))


def _records(log: OpenLog, stream: BinaryIO, order: str, unit_ns: int) -> Iterator[tuple[int, bytes]]:
    """(ns, packet) up to the end, or to what is no record: sets log.truncated."""
    record = struct.Struct(order + "IIII")
    while head := stream.read(record.size):
        log.truncated = True  # until it is known to be whole
        if len(head) < record.size:
            return
        seconds, units, length, _ = record.unpack(head)
        if not 0 < length <= _MOST:
            return
        packet = stream.read(length)
        if len(packet) < length:
            return
        log.truncated = False
        yield seconds * 1_000_000_000 + units * unit_ns, packet


def _usable(log: OpenLog, found: Frame | str) -> Iterator[Frame]:
    if isinstance(found, Frame):
        yield found
    else:
        log.skip(found)


@dataclass(slots=True)
class _Packets:
    """Finds the frames in packets of any of the _LINKS, most of which are alike."""

    turned: int = 0  # more identifiers were in the other byte order than the file's: some libraries do that

    def frame(self, link: int, order: str, packet: bytes, t_ns: int, bus: str) -> Frame | str:
        """The frame of a packet, or why it is none."""
        if link == SOCKETCAN:
            return _frame(packet, t_ns, bus)
        protocol_at, interface_at, size = COOKED[link]
        if len(packet) < size + 4:
            return "short_packet"
        if int.from_bytes(packet[protocol_at : protocol_at + 2], "big") not in _CAN_PROTOCOLS:
            return "other_packet"
        if interface_at is not None:
            bus = f"if{int.from_bytes(packet[interface_at : interface_at + 4], 'big')}"
        identifier, rest = packet[size : size + 4], packet[size + 4 :]
        both = (identifier[::-1], identifier) if order == "<" else (identifier, identifier[::-1])
        straight, turned = map(_is_identifier, both)
        self.turned += turned - straight
        return _frame(both[self.turned > 0 if straight == turned else turned] + rest, t_ns, bus)


def _is_identifier(octets: bytes) -> bool:
    """Whether these, most significant first, may be an identifier with its flags."""
    number = int.from_bytes(octets, "big")
    return bool(number & (_EXTENDED | _ERROR)) or number & ~_REMOTE <= 0x7FF


def _frame(packet: bytes, t_ns: int, bus: str) -> Frame | str:
    """The frame of a packet, or why it is none that a decoder wants."""
    if len(packet) < 8:
        return "short_packet"
    flagged, length, _ = _PACKET.unpack_from(packet)
    if length & _XL:
        return "can_xl_frame"
    if flagged & _REMOTE and not flagged & _ERROR:
        return "remote_frame"
    if length > 8:
        return "can_fd_frame"
    data = packet[8 : 8 + length]
    if len(data) < length:
        return "short_packet"
    extended = bool(flagged & (_EXTENDED | _ERROR))
    identifier = flagged & (0x1FFFFFFF if extended else 0x7FF)
    return stamp_fault(t_ns) or Frame(t_ns, t_ns, bus, identifier, extended, bool(flagged & _ERROR), data)


@dataclass(frozen=True, slots=True)
class _Interface:
    link: int
    bus: str
    per_s: int = 1_000_000  # units of its stamps
    offset_s: int = 0


@dataclass(slots=True)
class _CaptureSection:
    """Interfaces defined so far in a section of a pcapng file."""

    order: str = "<"
    interfaces: list[_Interface] = field(default_factory=list)
    links: set[int] = field(default_factory=set)  # of the whole file
    packets: _Packets = field(default_factory=_Packets)


def pcapng(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """Frames of a pcapng file, whose sections may have several interfaces."""
    section = _CaptureSection()
    while (block := _block(log, stream, section)) is not None:
        kind, body = block
        if kind == _INTERFACE and len(body) >= 8:
            _add_interface(section, body)
        elif kind in (_OLD_PACKET, _SIMPLE_PACKET, _PACKET_BLOCK):
            yield from _usable(log, _packet(section, kind, body))
    if section.links and not section.links.intersection(_LINKS):
        links = ", ".join(map(str, sorted(section.links)))
        raise OtherKind(f"{log.path}: a capture of link type {links}, {_NOT_OF_CAN}")


def _block(log: OpenLog, stream: BinaryIO, section: _CaptureSection) -> tuple[int, bytes] | None:
    """The next block's kind and body; None at the end, sets log.truncated where that is not a block's."""
    head = stream.read(8)
    if not head:
        return None
    log.truncated = True  # until it is known to be whole
    if head[:4] == PCAPNG:
        head += stream.read(4)
        section.order = "<" if head[8:] == _BYTE_ORDER else ">"
        section.interfaces.clear()
    if len(head) < 8:
        return None
    kind, length = struct.unpack_from(section.order + "II", head)
    if not 12 <= length <= _MOST or length % 4:
        return None
    rest = stream.read(length - len(head))
    if len(rest) < length - len(head) or rest[-4:] != head[4:8]:  # its length stands at both of its ends
        return None
    log.truncated = False
    return kind, head[8:] + rest[:-4]


def _add_interface(section: _CaptureSection, body: bytes) -> None:
    (link,) = struct.unpack_from(section.order + "H", body)
    options = _options(section.order, body)
    name = options.get(_NAME, b"").split(b"\0")[0].decode("utf-8", "replace")
    resolution = options.get(_RESOLUTION, b"\x06")[0]
    per_s = 1 << (resolution & 0x7F) if resolution & 0x80 else 10**resolution
    offset = options.get(_OFFSET, b"")
    offset_s = struct.unpack(section.order + "q", offset)[0] if len(offset) == 8 else 0
    bus = name or f"can{len(section.interfaces)}"
    section.interfaces.append(_Interface(link, bus, per_s, offset_s))
    section.links.add(link)


def _options(order: str, body: bytes) -> dict[int, bytes]:
    """{code: value} behind the 8 bytes that every interface has; none of them is empty."""
    found: dict[int, bytes] = {}
    at = 8
    while at + 4 <= len(body):
        code, length = struct.unpack_from(order + "HH", body, at)
        value = body[at + 4 : at + 4 + length]
        if value:
            found.setdefault(code, value)
        at += 4 + length + -length % 4
    return found


def _packet(section: _CaptureSection, kind: int, body: bytes) -> Frame | str:
    if kind == _SIMPLE_PACKET:
        return "packet_without_time"
    layout = section.order + ("IIIII" if kind == _PACKET_BLOCK else "HHIIII")
    if len(body) < struct.calcsize(layout):
        return "short_packet"
    number, *_, high, low, length, _ = struct.unpack_from(layout, body)
    if number >= len(section.interfaces):
        return "packet_of_no_interface"
    interface = section.interfaces[number]
    if interface.link not in _LINKS:
        return "other_link_type"
    at = struct.calcsize(layout)
    units = high << 32 | low
    t_ns = interface.offset_s * 1_000_000_000 + units * 1_000_000_000 // interface.per_s
    packet = body[at : at + length]
    return section.packets.frame(interface.link, section.order, packet, t_ns, interface.bus)
