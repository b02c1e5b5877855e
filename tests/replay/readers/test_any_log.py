"""Every kind of log gives its frames in file order with its own stamps, whole, cut, damaged or foreign."""

import gzip
import os
import sqlite3
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from logs import SECOND, drained, messages, write_mcap, write_with_can
from paths import shared

from tilth.replay.readers.any_log import frames, open_log
from tilth.replay.readers.log import NO_ZONE, EmptyLog, ForeignLog
from tilth.schemas.flow import Frame

# file, frames, first and last t_ns, buses, lines that are none
RECORDED: tuple[tuple[str, int, int, int, set[str], dict[str, int]], ...] = (
    ("candumpSample3.txt", 2368, 1502984866_421964000, 1502984883_826292000, {"slcan0"}, {}),
    ("furuno-fap7011c-autopilot-maneuvers.raw", 24226, 1628250330_505000000, 1628250501_707000000, {"can0"},
     {}),
    ("furuno-fap7011c-autopilot-off-then-on.raw", 469, 1628355997_249000000, 1628356000_899000000, {"can0"},
     {}),
    ("raymarine-ev1.raw", 23535, 1708146949_768000000, 1708146949_824000000, {"can0"},
     {"gateway_message": 260}),
    ("simulator2.raw", 1784, 51819_128000000, 51830_159000000, {"can0"}, {}),
    ("susteranna-actisense-serial.raw", 10293, 1460220069_078000000, 1460220100_053000000, {"can0"},
     {"gateway_message": 2}),
    ("actisense1.ebl", 14, 1745600721993000000, 1745600721993000000, {"can0"}, {}),
    ("actisense-523.rx.ebl", 385, 1745234337495231700, 1745234350994440500, {"can0"},
     {"gateway_message": 14}),
    ("boatkit-fusion-menu.raw", 5, 1786308175841473308, 1786308180416360755, {"can0"}, {}),
    ("can0-1.pcap", 49928, 1669809629672944000, 1669809689868569000, {"can0"}, {}),
    ("candumpSample1.txt", 6026, 0, 0, {"can0"}, {"unreadable_line": 1}),
    ("ikonvert.log", 8923, 481706000000, 798565000000, {"can0"},
     {"gateway_message": 270, "unreadable_line": 25}),
    ("sample-YDWG02.txt", 31, 78935425000000, 78939443000000, {"can0"}, {}),
    ("sample3_PCAN-View.trc", 12274, 1434910267294597000, 1434910345531297000, {"can1"}, {}),
    ("susteranna2020.raw", 6087, 1598104356_949000000, 1598104382_698000000, {"can0"},
     {"gateway_message": 17}),
)  # fmt: skip


# Recorded traffic


@pytest.mark.parametrize(("name", "count", "first", "last", "buses", "skipped"), RECORDED)
def test_recorded_logs(
    name: str, count: int, first: int, last: int, buses: set[str], skipped: dict[str, int]
) -> None:
    found, log = drained(shared(f"data/canboat/{name}"))
    assert (len(found), found[0].t_ns, found[-1].t_ns) == (count, first, last)
    assert {frame.bus for frame in found} == buses
    assert (log.truncated, log.skipped) == (False, skipped)
    assert all(0 <= frame.t_ns - frame.rx_ns < 100_000_000 and frame.extended for frame in found)
    assert log.form == "EBL" or all(frame.rx_ns == frame.t_ns for frame in found)


def test_assembled_messages_are_one_frame_with_long_data() -> None:
    path = shared("data/canboat/susteranna-actisense-serial.raw")
    long = [frame for frame in frames(path) if len(frame.data) > 8]
    assert {len(frame.data) for frame in long if frame.can_id >> 8 & 0x3FFFF == 129029} == {43}


def test_pysobus_frames_as_candump(tmp_path: Path) -> None:
    source = shared("data/pysobus/jd.txt")
    rows = [line.split("\t") for line in source.read_text().splitlines()]
    path = tmp_path / "jd.log"
    path.write_text("".join(f"({stamp}) can0 {text[:8]}#{text[8:]}\n" for stamp, text, *_ in rows))
    found = list(frames(path))
    assert [frame.can_id << 64 | int.from_bytes(frame.data, "big") for frame in found] == [
        int(text, 16) for _, text, *_ in rows
    ]
    assert found[0].t_ns == 1433426120_480000000


# Text, line by line


def frame(t_ns: int, bus: str, can_id: int, data: str, extended: bool = True, error: bool = False) -> Frame:
    return Frame(t_ns, t_ns, bus, can_id, extended, error, bytes.fromhex(data))


LINES = (
    ("(1502984866.421964) slcan0 09F112CC#FF725AFF7FFF7FFD",
     frame(1502984866_421964000, "slcan0", 0x09F112CC, "FF725AFF7FFF7FFD")),
    ("(0000000001.5) vcan0 123#0102 R", frame(1_500000000, "vcan0", 0x123, "0102", extended=False)),
    ("(1.000000001) can1 20000080#0000000000000000", frame(1_000000001, "can1", 0x80, "00" * 8, error=True)),
    ("(1.0) can1 18EEFF1C#", frame(SECOND, "can1", 0x18EEFF1C, "")),
    ("(1.0) can1 18EEFF1C#0011223344556677_B", frame(SECOND, "can1", 0x18EEFF1C, "0011223344556677")),
    ("(1.0) can1 18EEFF1C##10102", frame(SECOND, "can1", 0x18EEFF1C, "0102")),
    ("(1.0) can1 18EEFF1C##1" + "00" * 12, "can_fd_frame"),
    ("(1.0) can1 18EEFF1C#R8", "remote_frame"),
    ("(1.0) can1 18EEFF1C#123", "unreadable_line"),
    ("2021-08-06-11:45:30.505,2,127237,5,255,8,80,15,00,40,1f,ff,7f,ff",
     frame(1628250330_505000000, "can0", 0x09F10505, "801500401fff7fff")),
    ("2016-04-09T16:41:09.5Z,6,60928,0,255,2,01,02", frame(1460220069_500000000, "can0", 0x18EEFF00, "0102")),
    ("2016-04-09T16:41:09Z,3,126208,32,36,0", frame(1460220069_000000000, "can0", 0x0DED2420, "")),
    ("2016-04-09T16:41:09.078Z,0,262161,0,0,2,01,02", "gateway_message"),
    ("2016-04-09T16:41:09.078Z,2,127250,0,255,3,01,02", "unreadable_line"),
    ("2016-13-09T16:41:09.078Z,2,127250,0,255,2,01,02", "unreadable_line"),
    ("14:23:39.128 R 0DF20D4B 01 00 54 FA", frame(51819_128000000, "can0", 0x0DF20D4B, "010054FA")),
    ("hello", "unreadable_line"),
    ("(1e9) can0 123#00", "unreadable_line"),
)  # fmt: skip


@pytest.mark.parametrize(("line", "wanted"), LINES)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_lines(line: str, wanted: Frame | str, end: str, tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_bytes(b"# a comment\n\n(0.0) can9 001#00\n" + line.encode() + end.encode())
    found, log = drained(path)
    assert found[1:] == ([wanted] if isinstance(wanted, Frame) else [])
    assert log.skipped == ({} if isinstance(wanted, Frame) else {wanted: 1})
    assert not log.truncated


def test_time_of_day_goes_on_after_midnight_and_only_then(tmp_path: Path) -> None:
    times = ("23:59:59.900", "00:00:00.100", "00:00:00.050", "12:00:00", "11:59:00.000")
    path = tmp_path / "x.raw"
    path.write_text("".join(f"{time} R 18EEFF1C 00\n" for time in times))
    day = 86400.0
    wanted = [day - 0.1, day + 0.1, day + 0.05, day + 43200, day + 43140]
    assert [frame.t_ns / SECOND for frame in frames(path)] == pytest.approx(wanted)


def test_time_of_day_among_dated_lines_belongs_to_their_date(tmp_path: Path) -> None:
    path = tmp_path / "x.raw"
    dated = "1970-01-03T23:59:59.500Z,2,127250,0,255,1,00\n"
    path.write_text(f"{dated}00:00:01.000 R 09F1120C 00\n1970-01-04-00:00:02,2,127250,0,255,1,00\n")
    assert [frame.t_ns for frame in frames(path)] == [s * SECOND // 2 for s in (518399, 518402, 518404)]


def test_a_clock_that_steps_leaves_the_order_of_the_file(tmp_path: Path) -> None:
    stamps = (100.0, 100.1, 40.0, 40.1, 1e9, 1e9 - 5.0)
    text = tmp_path / "x.log"
    text.write_text("".join(f"({stamp:.6f}) can0 18EEFF{i:02X}#00\n" for i, stamp in enumerate(stamps)))
    found = list(frames(text))
    assert [frame.t_ns for frame in found] == [round(stamp * 1e6) * 1000 for stamp in stamps]
    assert list(frames(write_mcap(tmp_path / "x.mcap", found))) == found


@pytest.mark.parametrize("cut", range(1, 50))
def test_a_text_log_cut_in_its_last_line(cut: int, tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    whole = b"(1.000000) can0 18EEFF1C#0011223344556677\n" * 3
    path.write_bytes(whole[:-cut])
    found, log = drained(path)
    lines = -(-cut // 42)
    bytes_lost = cut > 1 if lines == 1 else cut - 42 > 1
    retained = 3 - lines + (not bytes_lost)
    assert len(found) == retained
    assert all(frame.data == bytes.fromhex("0011223344556677") for frame in found)
    assert log.truncated == (bytes_lost and cut % 42 != 0)


# What python-can reads


_TOLD = ("can0", "can1")  # what the buses of channels 0 and 1 are called
BUSES = {
    "asc": _TOLD, "asc.gz": _TOLD, "blf": _TOLD, "log": _TOLD, "mf4": _TOLD,
    "trc": ("can1", "can2"), "csv": ("can0", "can0"), "db": ("can0", "can0"),
}  # fmt: skip


@pytest.mark.parametrize("suffix", BUSES)
def test_formats_of_python_can(suffix: str, tmp_path: Path) -> None:
    rows = messages(300)
    found, log = drained(write_with_can(tmp_path / f"x.{suffix}", rows))
    assert len(found) == len(rows)
    for frame, row in zip(found, rows, strict=True):
        assert abs(frame.t_ns - round(row.timestamp * 1e6) * 1000) <= 1000  # a writer's own rounding
        assert frame.t_ns % 1000 == 0
        assert frame.bus == BUSES[suffix][row.channel == 1]
        assert (frame.can_id, frame.extended, frame.data) == (
            row.arbitration_id,
            row.is_extended_id,
            bytes(row.data),
        )
    assert (log.truncated, log.skipped) == (False, {})


def test_the_content_tells_the_kind_not_the_name(tmp_path: Path) -> None:
    path = write_with_can(tmp_path / "x.blf", messages(5)).rename(tmp_path / "x.txt")
    found, log = drained(path)
    assert (len(found), log.form) == (5, "BLF")


@pytest.mark.parametrize("suffix", ["asc", "trc", "csv", "blf"])
def test_cut_logs_of_python_can_give_what_is_whole(suffix: str, tmp_path: Path) -> None:
    whole = write_with_can(tmp_path / f"whole.{suffix}", messages(60))
    wanted = list(frames(whole))
    content = whole.read_bytes()
    rng = np.random.default_rng(3)
    path = tmp_path / f"cut.{suffix}"
    cuts = rng.integers(len(content) * 2 // 3, len(content), 40).tolist()
    for cut in (*range(len(content) - 90, len(content)), *cuts):  # the last line byte by byte
        path.write_bytes(content[:cut])
        found, log = drained(path)
        assert found == wanted[: len(found)]
        at_line_end = suffix != "blf" and b"\n" in content[cut - 1 : cut + 1].replace(b"\r", b"\n")
        assert log.truncated or at_line_end or len(found) == len(wanted), content[cut - 60 : cut]


@pytest.mark.parametrize(
    ("suffix", "bad"),
    [
        ("asc", b" 1.0 1 EngineSpeed Rx d 8 00 11 22 33 44 55 66 77\n"),
        ("trc", b"      9         1.000 DT  1 18ZZF300 Rx -  8    00 01 02 03 04 05 06 07\n"),
        ("csv", b"1.0,zz,1,0,0,8,AAAA\n"),
    ],
)
def test_an_unreadable_line_costs_only_itself(suffix: str, bad: bytes, tmp_path: Path) -> None:
    path = write_with_can(tmp_path / f"x.{suffix}", messages(20))
    wanted = list(frames(path))
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:-6], bad, *lines[-6:]]))
    found, log = drained(path)
    assert found == wanted
    assert (log.truncated, log.skipped) == (False, {"unreadable_line": 1})


def test_an_asc_log_of_stamps_between_frames_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.asc"
    path.write_text("base hex  timestamps relative\ninternal events logged\n 0.5 1  18EEFF1Cx Rx d 1 00\n")
    with pytest.raises(ForeignLog, match="absolute"):
        list(frames(path))


def test_a_cut_mf4_is_refused_in_one_sentence(tmp_path: Path) -> None:
    path = write_with_can(tmp_path / "x.mf4", messages(20))
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(ForeignLog, match="index is missing"):
        list(frames(path))


ZONES = ("UTC", "America/New_York", "Asia/Kolkata", "Australia/Lord_Howe")


@pytest.mark.parametrize("suffix", ["asc", "trc", "blf", "mf4"])
def test_the_readers_zone_changes_nothing(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_with_can(tmp_path / f"x.{suffix}", messages(20))
    found = []
    try:
        for zone in ZONES:
            monkeypatch.setenv("TZ", zone)
            time.tzset()
            found.append(drained(path))
    finally:
        monkeypatch.undo()
        time.tzset()
    assert all(rows == found[0][0] for rows, _ in found)
    assert {log.note for _, log in found} == {NO_ZONE}


@pytest.mark.parametrize(
    ("flags", "minutes", "note"), [(1, 0, NO_ZONE), (0, 0, ""), (2, 90, ""), (3, 90, "")]
)
def test_the_start_of_an_mf4_in_local_time_or_with_its_zone(
    flags: int, minutes: int, note: str, tmp_path: Path
) -> None:
    """As the header's block has it: ns, minutes of zone and of summer time, flags."""
    content = bytearray(write_with_can(tmp_path / "x.mf4", messages(20)).read_bytes())
    start = content.index(b"##HD") + 24 + 8 * 6
    told_ns = 1_700_000_000 * SECOND
    (since_ns,) = struct.unpack_from("<q", content, start)  # the writer's own start, of its clock
    since_ns = told_ns - since_ns  # of the first message
    content[start : start + 13] = struct.pack("<QhhB", told_ns, minutes - 60, 60, flags)
    (tmp_path / "x.mf4").write_bytes(content)
    found, log = drained(tmp_path / "x.mf4")
    wanted_ns = told_ns + since_ns - (minutes * 60 * SECOND if flags == 3 else 0)
    assert abs(found[0].t_ns - wanted_ns) <= 2000
    assert log.note == note


def test_the_given_mf4_in_local_time() -> None:
    found, log = drained(shared("data/strangers/second/18-python-can.mf4"))
    assert (len(found), found[0].t_ns, log.note) == (800, 1777881599_900959000, NO_ZONE)


# What is no log

FOREIGN = (
    ("image.png", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(100)),
    ("traffic.pcap", b"\xd4\xc3\xb2\xa1\x02\x00\x04\x00" + bytes(12) + b"\x01\x00\x00\x00"),
    ("notes.txt", b"hello world\nthis is no log\n"),
    ("x.mcap", b"not an mcap file at all"),
    ("x.gz", b"\x1f\x8b\x08\x00broken"),
    ("x.gz", gzip.compress(b"hello world", mtime=0)),
    ("x.mcap.gz", gzip.compress(b"\x89MCAP0\r\n" + bytes(20), mtime=0)),
    ("random.bin", bytes(range(256)) * 4),
    ("x.mf4", b"MDF     4.10    " + bytes(100)),
    ("x.db", b"SQLite format 3\0" + bytes(100)),
)


@pytest.mark.parametrize(("name", "content"), FOREIGN)
def test_foreign_files(name: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ForeignLog) as caught:
        list(frames(path))
    text = str(caught.value)
    assert text.startswith(str(path)) and "\n" not in text
    assert "candump" in text or "unpack" in text
    assert ForeignLog.status == 2


def test_a_database_of_something_else(tmp_path: Path) -> None:
    path = tmp_path / "x.db"
    connection = sqlite3.connect(path)
    connection.execute("create table birds (name text)")
    connection.commit()
    connection.close()
    with pytest.raises(ForeignLog, match="python-can did not write"):
        list(frames(path))


@pytest.mark.parametrize("name", ["folder", "missing.log"])
def test_what_cannot_be_opened(name: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(ForeignLog, match=r"folder|no such file"):
        open_log(tmp_path / name)


def test_a_pipe_is_told_before_it_is_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ForeignLog, match="a pipe or a device; give a file"):
        open_log(tmp_path / "pipe")


@pytest.mark.parametrize("content", [b"", b"\n\n", b"# only a comment\n"])
def test_empty_files(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_bytes(content)
    with pytest.raises(EmptyLog):
        list(frames(path))
    assert EmptyLog.status == 1


def test_logs_without_a_frame(tmp_path: Path) -> None:
    for path in (write_mcap(tmp_path / "x.mcap", []), write_with_can(tmp_path / "x.csv", [])):
        with pytest.raises(EmptyLog):
            list(frames(path))
