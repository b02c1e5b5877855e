"""EBL and captures, record by record."""

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from log_forms import (
    CAPTURED,
    EPOCH_S,
    block,
    cooked,
    ebl,
    filetime,
    framed,
    mark,
    of_93,
    of_95,
    of_d0,
    pcap,
    pcapng,
    rows,
)
from logs import SECOND, drained

from tilth.replay.readers.any_log import frames
from tilth.replay.readers.log import ForeignLog
from tilth.schemas.decode import encode, frames_of
from tilth.schemas.flow import Frame


@pytest.mark.parametrize(
    ("message", "longest"), [(of_93, 43), (of_93, 8), (of_95, 8), (of_d0, 60), (of_d0, 8)]
)
@pytest.mark.parametrize("marked", [False, True])
def test_ebl(message: Callable[[Frame], bytes], longest: int, marked: bool, tmp_path: Path) -> None:
    wanted = rows(longest=longest)
    path = tmp_path / "x.bin"
    content = ebl(wanted, message)
    if marked:  # messages in marks of their own, without the stream's escapes and checksum
        content = ebl(wanted[:1], message) + b"".join(
            mark(3, filetime(f.t_ns)) + mark(7, message(f)) for f in wanted[1:]
        )
    path.write_bytes(content)
    found, log = drained(path)
    assert found == wanted
    assert (log.form, log.truncated, log.skipped) == ("EBL", False, {})


def test_the_gateways_own_milliseconds_give_rx_ns(tmp_path: Path) -> None:
    wanted = rows(30)
    late_ns = [(0, 15, 4)[i % 3] * 1_000_000 for i in range(30)]
    content = b"".join(
        mark(3, filetime(f.t_ns + late_ns[i])) + framed(of_93(f, 5000 + 1000 * i))
        for i, f in enumerate(wanted)
    )
    path = tmp_path / "x.ebl"
    path.write_bytes(content)
    found = list(frames(path))
    assert [f.t_ns - w.t_ns for f, w in zip(found, wanted, strict=True)] == late_ns
    assert max(abs(f.rx_ns - w.t_ns) for f, w in zip(found, wanted, strict=True)) < 500_000


EBL_BAD = (
    (framed(of_93(rows()[0]))[:-3] + b"\x7f\x10\x03", "damaged_message"),  # its checksum
    (b"\x10\x02\x93" + bytes(5000) + b"\x10\x03", "damaged_message"),  # no end of it
    (framed(bytes([0xA0, 3, 1, 2, 3])), "gateway_message"),
    (framed(bytes([0x94, 6, 2, 0, 0xEE, 1, 255, 0])), "gateway_message"),
    (b"\x1b\x01\x05\x00\x1b\x07", "damaged_mark"),
    (b"boot banner", ""),
)


@pytest.mark.parametrize(("bad", "reason"), EBL_BAD)
def test_damage_in_an_ebl_costs_only_itself(bad: bytes, reason: str, tmp_path: Path) -> None:
    wanted = rows()
    path = tmp_path / "x.ebl"
    path.write_bytes(ebl(wanted[:20]) + bad + ebl(wanted[20:]))
    found, log = drained(path)
    assert found == wanted
    assert log.skipped == ({reason: 1} if reason else {})


def test_an_ebl_of_a_later_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.ebl"
    path.write_bytes(mark(3, filetime(0)) + mark(1, (2000).to_bytes(4, "little")))
    with pytest.raises(ForeignLog, match=r"version 2\.000"):
        list(frames(path))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("unit_ns", [1, 1000])
def test_pcap(order: str, unit_ns: int, tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_bytes(pcap(CAPTURED, order, unit_ns))
    found, log = drained(path)
    assert found == [replace(f, bus="can0") for f in CAPTURED]
    assert (log.form, log.truncated, log.skipped) == ("pcap", False, {})


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("resolution", "offset_s"), [(9, 0), (6, 1000), (12, EPOCH_S - 9), (0x80 | 20, 0)])
def test_pcapng(order: str, resolution: int, offset_s: int, tmp_path: Path) -> None:
    path = tmp_path / "x.pcapng"
    path.write_bytes(pcapng(CAPTURED, order, resolution, offset_s) + pcapng(CAPTURED, "<"))
    found, log = drained(path)
    assert (log.form, log.truncated, log.skipped, len(found)) == ("pcapng", False, {}, 2 * len(CAPTURED))
    for f, wanted in zip(found, CAPTURED * 2, strict=True):
        assert abs(f.t_ns - wanted.t_ns) <= 1000
        assert (f.bus, f.can_id, f.extended, f.error, f.data) == (
            wanted.bus, wanted.can_id, wanted.extended, wanted.error, wanted.data,
        )  # fmt: skip


PACKETS = (
    (struct.pack(">IBBH", 0x98EEFF1C, 12, 4, 0) + bytes(12), "can_fd_frame"),
    (struct.pack(">IBBHI", 0x123, 0x81, 0, 9, 0) + bytes(12), "can_xl_frame"),
    (struct.pack(">IBBH", 0xD8EEFF1C, 8, 0, 0), "remote_frame"),
    (struct.pack(">IBBH", 0x98EEFF1C, 8, 0, 0) + bytes(5), "short_packet"),
    (b"\x98\xee", "short_packet"),
)


@pytest.mark.parametrize(("bad", "reason"), PACKETS)
def test_packets_that_are_no_frame(bad: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "x.pcap"
    path.write_bytes(pcap(CAPTURED[:3]) + struct.pack("<IIII", EPOCH_S, 0, len(bad), len(bad)) + bad)
    found, log = drained(path)
    assert (len(found), log.skipped, log.truncated) == (3, {reason: 1}, False)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("host", ["<", ">"])
@pytest.mark.parametrize("link", [113, 276])
def test_captures_of_all_interfaces(order: str, host: str, link: int, tmp_path: Path) -> None:
    """Identifiers are in the file's byte order, or in that of libraries that turn them round."""
    path = tmp_path / "x.pcap"
    path.write_bytes(cooked(CAPTURED, link, order, host))
    found, log = drained(path)
    names: dict[str, str] = (
        {"can0": "if0", "can1": "if1"} if link == 276 else dict.fromkeys(("can0", "can1"), "can0")
    )
    assert found == [replace(f, bus=names[f.bus]) for f in CAPTURED]
    assert (log.form, log.truncated, log.skipped) == ("pcap", False, {})
    in_blocks = pcapng(CAPTURED[:1]).replace(b"\xe3\0\0\0", struct.pack("<I", link))
    cooked_packet = cooked(CAPTURED[:1], link, "<")[40:]
    head = struct.pack(
        "<IIIII", 0, *divmod(CAPTURED[0].t_ns, 1 << 32), len(cooked_packet), len(cooked_packet)
    )
    path.write_bytes(in_blocks[: in_blocks.rindex(b"\x06\0\0\0")] + block("<", 6, head + cooked_packet))
    assert [f.can_id for f in frames(path)] == [CAPTURED[0].can_id]


def test_what_else_all_interfaces_carry_is_counted(tmp_path: Path) -> None:
    ethernet = struct.pack(">HHH8sH", 0, 1, 6, bytes(8), 0x0800) + bytes(40)
    path = tmp_path / "x.pcap"
    for packet, reason in ((ethernet, "other_packet"), (ethernet[:9], "short_packet")):
        record = struct.pack("<IIII", EPOCH_S, 0, len(packet), len(packet)) + packet
        path.write_bytes(cooked(CAPTURED[:3], 113) + record)
        found, log = drained(path)
        assert (len(found), log.skipped) == (3, {reason: 1})


def test_a_capture_of_something_else_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.pcap"
    for content in (pcap([], link=1), pcapng(CAPTURED).replace(b"\xe3\0\0\0", b"\x01\0\0\0")):
        path.write_bytes(content)
        with pytest.raises(ForeignLog, match="link type 1, not of SocketCAN"):
            list(frames(path))


def test_frames_of_a_fast_packet_are_as_they_were_sent(tmp_path: Path) -> None:
    pairs = frames_of(129029, encode(129029, {"satellites": 9, "fix": "gnss"}), 9, sequence=3)
    wanted = [Frame(EPOCH_S * SECOND, EPOCH_S * SECOND, "can0", i, True, False, d) for i, d in pairs]
    for name, content in (("x.ebl", ebl(wanted, of_95)), ("x.pcap", pcap(wanted))):
        (tmp_path / name).write_bytes(content)
        assert list(frames(tmp_path / name)) == wanted
