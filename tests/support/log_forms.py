"""Writers of the forms of logs that nobody else here writes, after the forms' own documents."""

import base64
import io
import struct
import tempfile
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import mcap.writer
from logs import SECOND, messages, write_mcap, write_with_can

from tilth.replay.readers.any_log import frames
from tilth.schemas import can_id
from tilth.schemas.flow import Frame

EPOCH_S = 1_700_000_000


def frame(t_ns: int, can_id: int, data: str, bus: str = "can0", **more: bool) -> Frame:
    return Frame(t_ns, t_ns, bus, can_id, more.get("extended", True), more.get("error", False),
                 bytes.fromhex(data))  # fmt: skip


def drive(count: int = 30) -> list[Frame]:
    """Of two buses, both kinds of identifiers and every length; every 10 ms."""
    return [
        frame(EPOCH_S * SECOND + i * 10_000_000, 0x18FEF300 + i if i % 3 else 0x100 + i,
              bytes(range(i, i + i % 9)).hex(), f"can{1 + i % 2}", extended=bool(i % 3))
        for i in range(count)
    ]  # fmt: skip


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


def savvycan(captured: Sequence[Frame], mark: str = ",") -> bytes:
    """Times since 1970, µs."""
    head = mark.join(("Time Stamp", "ID", "Extended", "Dir", "Bus", "LEN", *(f"D{n}" for n in range(1, 9))))
    lines = [
        mark.join((str(f.t_ns // 1000), f"{f.can_id:08X}", str(f.extended).lower(), "Rx", f.bus[3:],
                   str(len(f.data)), *(f"{octet:02X}" for octet in f.data), ""))
        for f in captured
    ]  # fmt: skip
    return "".join(f"{line}\n" for line in (head, *lines)).encode()


def canedge(captured: Sequence[Frame], mark: str = ";") -> bytes:
    lines = ["TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;ESI;RTR;DataBytes"]
    lines += [
        f"{f.t_ns // SECOND}.{f.t_ns % SECOND // 1000:06d};{f.bus[3:]};{f.can_id:X};{f.extended:d};"
        f"{len(f.data)};{len(f.data)};0;0;0;0;0;{f.data.hex().upper()}"
        for f in captured
    ]
    return "".join(f"{line}\n" for line in lines).replace(";", mark).encode()


def cl2000(captured: Sequence[Frame]) -> bytes:
    """Its times have the day of the month and milliseconds; the head has the rest."""
    dates = [datetime.fromtimestamp(f.t_ns / SECOND, UTC) for f in captured]
    lines = ["# Logger type: CL2000", f"# Time: {dates[0]:%Y%m%dT%H%M%S}", '# Value separator: ";"']
    lines.append("Timestamp;Type;ID;Data")
    for f, date in zip(captured, dates, strict=True):
        stamp = f"{date:%dT%H%M%S}{date.microsecond // 1000:03d}"
        lines.append(f"{stamp};{f.extended:d};{f.can_id:x};{f.data.hex()}")
    return "".join(f"{line}\n" for line in lines).encode()


def kvaser(captured: Sequence[Frame], base: str = "HEX", head: bool = True) -> bytes:
    """As Kvaser's converter writes it; times since the date in its head."""
    digits = ("X", "02X") if base == "HEX" else ("d", "3d")
    first_ns = captured[0].t_ns // SECOND * SECOND
    lines = [
        "                              Kvaser Memorator Log",
        "                              ====================",
        "",
        f"Memorator Binary logfile created at: {datetime.fromtimestamp(first_ns // SECOND, UTC):%F %H:%M:%S}",
        "",
        "Settings:",
        f"   Format of data field: {base}",
        f"   Format of id field:   {base}",
        "   Timestamp Offset:     0.000000           s",
        "   CAN channel:          1 2",
        "",
        "        Time Chan   Identifier Flags        DLC  Data                           Counter",
        "=" * 86,
    ] * head  # fmt: skip
    for count, f in enumerate(captured):
        passed = f.t_ns - first_ns
        data = " ".join(f"{octet:{digits[1]}}" for octet in f.data)
        lines.append(
            f"{passed // SECOND:5d}.{passed % SECOND // 1000:06d}  {f.bus[3:]}  {f.can_id:{digits[0]}}"
            f"{'x' if f.extended else ' '}   Rx          {len(f.data):3d}  {data:31} {count + 1:12d}"
        )
    return "".join(f"{line}\n" for line in lines).encode()


def busmaster(captured: Sequence[Frame]) -> bytes:
    date = datetime.fromtimestamp(captured[0].t_ns // SECOND, UTC)
    lines = [
        "***BUSMASTER Ver 3.2.2***",
        "***PROTOCOL CAN***",
        "***NOTE: PLEASE DO NOT EDIT THIS DOCUMENT***",
        "***[START LOGGING SESSION]***",
        f"***START DATE AND TIME {date.day}:{date.month}:{date.year} {date:%H:%M:%S}:0***",
        "***HEX***",
        "***SYSTEM MODE***",
        "***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***",
    ]  # fmt: skip
    for f in captured:
        at = datetime.fromtimestamp(f.t_ns / SECOND, UTC)
        lines.append(
            f"{at:%H:%M:%S}:{at.microsecond // 100:04d} Rx {f.bus[3:]} 0x{f.can_id:03X} "
            f"{'x' if f.extended else 's'} {len(f.data)} {f.data.hex(' ').upper()} "
        )
    return "".join(f"{line}\n" for line in lines).encode()


DAYS_OF_1970 = 25569
TRC_VERSIONS = ("1.0", "1.1", "1.2", "1.3", "2.0", "2.1")


def trc(captured: Sequence[Frame], version: str = "1.2") -> bytes:
    """As PEAK's document has each version."""
    start_ns = captured[0].t_ns // SECOND * SECOND
    head = [f";$FILEVERSION={version}", f";$STARTTIME={start_ns / SECOND / 86400 + DAYS_OF_1970:.10f};"]
    date = datetime.fromtimestamp(start_ns // SECOND, UTC)
    head = (
        [";   C:\\TraceFile.trc", f";   Start time: {date:%d.%m.%Y %H:%M:%S}.000"]
        if version == "1.0"
        else head
    )
    columns = {"2.0": ";$COLUMNS=N,O,T,I,d,l,D", "2.1": ";$COLUMNS=N,O,T,B,I,d,R,L,D"}
    lines = [*head, *columns.get(version, "").split()]
    for n, f in enumerate(captured, 1):
        ms = (f.t_ns - start_ns) / 1e6
        identifier = f"{f.can_id:08X}" if f.extended else f"{f.can_id:04X}"
        data = f"{len(f.data)}  {f.data.hex(' ').upper()} "
        bus = f.bus[3:]
        lines.append({
            "1.0": f"{n:6d}) {ms:9.0f} {identifier} {data}",
            "1.1": f"{n:6d}) {ms:11.1f}  Rx     {identifier:>8}  {data}",
            "1.2": f"{n:6d}) {ms:13.3f} {bus}  Rx     {identifier:>8}  {data}",
            "1.3": f"{n:6d}) {ms:13.3f} {bus}  Rx     {identifier:>8} -  {data}",
            "2.0": f"{n:7d} {ms:13.3f} DT {identifier:>8} Rx {data}",
            "2.1": f"{n:7d} {ms:13.3f} DT {bus} {identifier:>8} Rx -  {data}",
        }[version])  # fmt: skip
    return "".join(f"{line}\r\n" for line in lines).encode()


def asc(
    captured: Sequence[Frame], date: str = "Tue Nov 14 10:13:20 pm 2023", zero_ns: int = EPOCH_S * SECOND
) -> bytes:
    """As CANalyzer writes it, in the language of its computer."""
    lines = [f"date {date}", "base hex  timestamps absolute", "internal events logged", "// version 9.0.0",
             f"Begin Triggerblock {date}", "   0.000000 Start of measurement"]  # fmt: skip
    for f in captured:
        passed = f.t_ns - zero_ns
        lines.append(
            f"{passed // SECOND:4d}.{passed % SECOND // 1000:06d} {int(f.bus[3:]) + 1}  {f.can_id:X}"
            f"{'x' * f.extended}       Rx   d {len(f.data)} {f.data.hex(' ').upper()}  Length = 270000"
        )
    return "".join(f"{line}\r\n" for line in [*lines, "End TriggerBlock"]).encode()


def signal_k(captured: Sequence[Frame]) -> bytes:
    """Signal K's log of a gateway that gives canboat's plain text."""
    rows = []
    for f in captured:
        head, ms = can_id.split(f.can_id), f.t_ns // 1_000_000
        data = f.data.hex(",")
        date = datetime.fromtimestamp(f.t_ns / SECOND, UTC)
        rows.append(
            f"{ms};A;{date:%Y-%m-%dT%H:%M:%S}.{ms % 1000:03d}Z,{head.priority},{head.pgn},{head.source},"
            f"{head.destination},{len(f.data)},{data}\n"
        )
    return "".join(rows).encode()


def cooked(captured: Sequence[Frame], link: int = 276, order: str = "<", host: str = "") -> bytes:
    """What `tcpdump -i any` writes; host: the byte order of identifiers, if not the file's."""
    content = pcap([], order, link=link)
    for f in captured:
        seconds, ns = divmod(f.t_ns, SECOND)
        number = int(f.bus[3:])
        plain = packet(f)
        body = struct.pack((host or order) + "I", int.from_bytes(plain[:4], "big")) + plain[4:]
        heads = {113: struct.pack(">HHH8sH", 0, 280, 0, bytes(8), 0x0C),
                 276: struct.pack(">HHIHBB8s", 0x0C, 0, number, 280, 0, 0, bytes(8))}  # fmt: skip
        body = heads[link] + body
        content += struct.pack(order + "IIII", seconds, ns // 1000, len(body), len(body)) + body
    return content


ROS2_FRAME = """std_msgs/Header header
uint32 id
bool is_rtr
bool is_extended
bool is_error
uint8 dlc
uint8[8] data
"""
ROS_HEADER = """================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def ros2_message(f: Frame, order: str = "<") -> bytes:
    """can_msgs/msg/Frame in CDR; rx_ns is its stamp."""
    frame_id = b"can0\0"
    body = struct.pack(order + "iII", f.rx_ns // SECOND, f.rx_ns % SECOND, len(frame_id)) + frame_id
    body += bytes(-len(body) % 4)
    body += struct.pack(order + "I???B", f.can_id, False, f.extended, f.error, len(f.data))
    return bytes([0, order == "<", 0, 0]) + body + f.data.ljust(8, b"\0")


def ros1_message(f: Frame) -> bytes:
    head = struct.pack("<IIII", 7, f.rx_ns // SECOND, f.rx_ns % SECOND, 4) + b"can0"
    flags = struct.pack("<I???B", f.can_id, False, f.extended, f.error, len(f.data))
    return head + flags + f.data.ljust(8, b"\0")


def ros(
    captured: Sequence[Frame],
    message: Callable[[Frame], bytes] = ros2_message,
    *,
    definition: str | bytes = ROS2_FRAME + ROS_HEADER,
    schema: tuple[str, str] = ("can_msgs/msg/Frame", "ros2msg"),
    encoding: str = "cdr",
    **options: Any,
) -> bytes:
    """An MCAP log with a topic for each bus, and one of something else."""
    out = io.BytesIO()
    writer = mcap.writer.Writer(out, **{"chunk_size": 512, **options})
    writer.start(profile="ros2")
    other = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    writer.add_message(writer.register_channel("/chatter", "cdr", other), 1, b"\0\1\0\0\1\0\0\0\0", 1)
    described = definition.encode() if isinstance(definition, str) else definition
    number = writer.register_schema(*schema, described)
    channels: dict[str, int] = {}
    for f in captured:
        if f.bus not in channels:
            channels[f.bus] = writer.register_channel(f"/{f.bus}", encoding, number)
        writer.add_message(channels[f.bus], f.t_ns, message(f), f.t_ns)
    writer.finish()
    return out.getvalue()


CUT = {
    "candump -l": text_of(rows()),
    "candump": terminal(rows()),
    "iKonvert": ikonvert(rows(longest=43)),
    "Actisense's N2K ASCII": n2k_ascii(rows(longest=43)),
    "EBL": ebl(rows(longest=43)),
    "pcap": pcap(rows()),
    "pcapng": pcapng(rows()),
    "SavvyCAN": savvycan(rows()),
    "CANedge": canedge(rows()),
    "CL2000": cl2000(rows()),
    "Kvaser Memorator": kvaser(rows()),
    "BUSMASTER": busmaster(rows()),
    "Signal K": signal_k(rows()),
    "tcpdump -i any": cooked(rows()),
    **{f"TRC {version}": trc(rows(), version) for version in TRC_VERSIONS},
    "ASC": asc(rows()),
    "MCAP of ROS": ros(rows()),
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
