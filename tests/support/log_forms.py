"""Writers of the forms of logs that nobody else here writes, after the forms' own documents."""

import base64
import struct
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from logs import SECOND, messages, write_mcap, write_with_can

from tilth.replay.readers.any_log import frames
from tilth.schemas import can_id
from tilth.schemas.flow import Frame

EPOCH_S = 1_700_000_000


def frame(t_ns: int, can_id: int, data: str, bus: str = "can0", **more: bool) -> Frame:
    return Frame(t_ns, t_ns, bus, can_id, more.get("extended", True), more.get("error", False),
                 bytes.fromhex(data))  # fmt: skip


def filetime(t_ns: int) -> bytes:
    return (t_ns // 100 + 116_444_736_000_000_000).to_bytes(8, "little")


def mark(tag: int, content: bytes) -> bytes:
    return b"\x1b\x01" + (bytes([tag]) + content).replace(b"\x1b", b"\x1b\x1b") + b"\x1b\n"


def summed(message: bytes) -> bytes:
    return message + bytes([-sum(message) % 256])


def framed(message: bytes) -> bytes:
    wire = b"\x10\x02" + summed(message).replace(b"\x10", b"\x10\x10") + b"\x10\x03"
    return wire.replace(b"\x1b", b"\x1b\x1b")


def of_93(f: Frame, stamp_ms: int = 0) -> bytes:
    head = can_id.split(f.can_id)
    body = struct.pack("<B3sBBIB", head.priority, head.pgn.to_bytes(3, "little"), head.destination,
                       head.source, stamp_ms, len(f.data)) + f.data  # fmt: skip
    return bytes([0x93, len(body)]) + body


def of_95(f: Frame, stamp_ms: int = 0) -> bytes:
    return bytes([0x95, 6 + len(f.data)]) + struct.pack("<HI", stamp_ms & 0xFFFF, f.can_id) + f.data


def of_d0(f: Frame, stamp_ms: int = 0) -> bytes:
    head = can_id.split(f.can_id)
    packed = f.can_id.to_bytes(4, "little")
    return (
        struct.pack("<BHBB", 0xD0, 13 + len(f.data), head.destination, head.source)
        + bytes([packed[1], packed[2], packed[3] & 3 | head.priority << 2, 0])
        + struct.pack("<I", stamp_ms)
        + f.data
    )


def ebl(rows: Sequence[Frame], message: Callable[[Frame], bytes] = of_93) -> bytes:
    head = mark(3, filetime(rows[0].t_ns)) + mark(1, (1002).to_bytes(4, "little"))
    return head + b"".join(mark(3, filetime(f.t_ns)) + framed(message(f)) for f in rows)


def rows(count: int = 40, longest: int = 8) -> list[Frame]:
    """Every byte value is among their data, those that must be written twice often."""
    return [
        frame(
            (EPOCH_S + i) * SECOND,
            can_id.join(i % 8, (127250, 59904, 129029)[i % 3], i, 255 if i % 3 != 1 else 0x10),
            bytes([0x10, 0x1B, 7 * i % 256, 0x1B, 0x10, 0x03, i, 0x0A, *range(longest)][:longest]).hex(),
        )
        for i in range(count)
    ]


def packet(f: Frame) -> bytes:
    flags = 0x80000000 * f.extended | 0x20000000 * f.error
    return struct.pack(">IBBH", f.can_id | flags, len(f.data), 0, 0) + f.data


def pcap(captured: Sequence[Frame], order: str = "<", unit_ns: int = 1000, link: int = 227) -> bytes:
    magic = 0xA1B2C3D4 if unit_ns == 1000 else 0xA1B23C4D
    content = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 262144, link)
    for f in captured:
        seconds, ns = divmod(f.t_ns, SECOND)
        body = packet(f)
        content += struct.pack(order + "IIII", seconds, ns // unit_ns, len(body), len(body)) + body
    return content


def block(order: str, kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    length = struct.pack(order + "I", 12 + len(body))
    return struct.pack(order + "I", kind) + length + body + length


def option(order: str, code: int, value: bytes) -> bytes:
    return struct.pack(order + "HH", code, len(value)) + value + bytes(-len(value) % 4)


def pcapng(captured: Sequence[Frame], order: str = "<", resolution: int = 9, offset_s: int = 0) -> bytes:
    """An interface for each bus."""
    names = list(dict.fromkeys(f.bus for f in captured))
    content = block(order, 0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1))
    for name in names:
        options = option(order, 2, name.encode()) + option(order, 9, bytes([resolution]))
        options += option(order, 14, struct.pack(order + "q", offset_s)) + option(order, 0, b"")
        content += block(order, 1, struct.pack(order + "HHI", 227, 0, 0) + options)
    per_s = 1 << (resolution & 0x7F) if resolution & 0x80 else 10**resolution
    for f in captured:
        units = (f.t_ns - offset_s * SECOND) * per_s // SECOND
        body = packet(f)
        head = struct.pack(
            order + "IIIII", names.index(f.bus), units >> 32, units & 0xFFFFFFFF, len(body), len(body)
        )
        content += block(order, 6, head + body)
    return content


CAPTURED = [
    frame(EPOCH_S * SECOND + 1000 * i, 0x18EEFF00 + i, "00112233"[: i % 5 * 2], ("can0", "can1")[i % 2])
    for i in range(20)
] + [
    frame(EPOCH_S * SECOND + 10**6, 0x88, "00" * 8, error=True),
    frame(EPOCH_S * SECOND, 0x7FF, "01", extended=False),
]


def text_of(captured: Sequence[Frame]) -> bytes:
    return b"".join(
        f"({f.t_ns // SECOND}.{f.t_ns % SECOND // 1000:06d}) {f.bus} {f.can_id:08X}#{f.data.hex()}\n".encode()
        for f in captured
    )


def ikonvert(captured: Sequence[Frame]) -> bytes:
    return b"".join(
        f"!PDGY,{h.pgn},{h.priority},{h.source},{h.destination},{f.t_ns // SECOND - EPOCH_S}.0,".encode()
        + base64.b64encode(f.data)
        + b"\r\n"
        for f, h in ((f, can_id.split(f.can_id)) for f in captured)
    )


def n2k_ascii(captured: Sequence[Frame]) -> bytes:
    return b"".join(
        f"A{i // 60:04d}{i % 60:02d}.000 {h.source:02X}{h.destination:02X}{h.priority} {h.pgn:05X} "
        f"{f.data.hex().upper()}\r\n".encode()
        for i, f, h in ((i, f, can_id.split(f.can_id)) for i, f in enumerate(captured))
    )


def terminal(captured: Sequence[Frame]) -> bytes:
    return b"".join(
        f" ({f.t_ns // SECOND}.000000)  can0  {f.can_id:08X}   [{len(f.data)}]  ".encode()
        + f"{f.data.hex(' ').upper()}\n".encode()
        for f in captured
    )


CUT = {
    "candump -l": text_of(rows()),
    "candump": terminal(rows()),
    "iKonvert": ikonvert(rows(longest=43)),
    "Actisense's N2K ASCII": n2k_ascii(rows(longest=43)),
    "EBL": ebl(rows(longest=43)),
    "pcap": pcap(rows()),
    "pcapng": pcapng(rows()),
}
WRITTEN = ("asc", "trc", "csv", "blf", "mcap")


@cache
def whole() -> dict[str, tuple[bytes, list[Frame]]]:
    """{name: content of a log, its 40 frames}"""
    contents = dict(CUT)
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for suffix in WRITTEN:
            path = Path(folder) / f"x.{suffix}"
            if suffix == "mcap":
                write_mcap(path, rows())
            else:
                write_with_can(path, messages(40))
            contents[suffix] = path.read_bytes()
        for name, content in contents.items():
            path = Path(folder) / "log"
            path.write_bytes(content)
            found[name] = (content, list(frames(path)))
    return found
