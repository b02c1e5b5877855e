"""Text of other tools and gateways: each form of line, and what others write and read of them."""

import base64
import json
import re
from pathlib import Path

import pytest
from log_forms import frame
from logs import MACHINE_FILE, SECOND, drained
from nmea2000 import NMEA2000Decoder
from nmea2000.encoder_formats import ENCODER_CLASSES
from nmea2000.input_formats import N2KFormat
from paths import shared

from tilth.cli import main
from tilth.replay.readers.any_log import KINDS, frames, readable
from tilth.replay.readers.log import NO_DATE, NO_ZONE, ForeignLog
from tilth.schemas import can_id
from tilth.schemas.bus_name import BUS_NAME
from tilth.schemas.decode import encode
from tilth.schemas.flow import Frame, Word

# Lines

CANDUMP_NS = 1436509053_762905000
LINES: tuple[tuple[str, Frame | str], ...] = (
    ("  can0  18EEFF1C   [8]  00 11 22 33 44 55 66 77", frame(0, 0x18EEFF1C, "0011223344556677")),
    ("  vcan0       123   [2]  01 02", frame(0, 0x123, "0102", "vcan0", extended=False)),
    ("  can0  18EEFF1C   [0] ", frame(0, 0x18EEFF1C, "")),
    (" (1436509053.762905)  can1  18EEFF1C   [3]  FC 00 FF", frame(CANDUMP_NS, 0x18EEFF1C, "FC00FF", "can1")),
    (" (1436509053.762905123)  can1  18EEFF1C   [1]  FC",
     frame(CANDUMP_NS + 123, 0x18EEFF1C, "FC", "can1")),
    (" (2015-07-10 06:17:33.762905)  can1  18EEFF1C   [3]  FC 00 FF",
     frame(CANDUMP_NS, 0x18EEFF1C, "FC00FF", "can1")),
    (" (003.000125)  can0  18EEFF1C   [1]  05", frame(3_000125000, 0x18EEFF1C, "05")),
    ("  can0  18EEFF1C   [4]  41 42 0A 44   'AB.D'", frame(0, 0x18EEFF1C, "41420A44")),
    ("  can0  RX - -  18EEFF1C   [1]  05", frame(0, 0x18EEFF1C, "05")),
    ("  can0  20000088   [8]  00 00 00 00 00 00 00 00   ERRORFRAME", frame(0, 0x88, "00" * 8, error=True)),
    ("\x1b[1;34m  can0\x1b[0m  18EEFF1C   [1]  05\x1b[0m", frame(0, 0x18EEFF1C, "05")),
    ("  can0  18EEFF1C   [8]  remote request", "remote_frame"),
    ("  can0  18EEFF1C  [12]  " + " ".join(["00"] * 12), "can_fd_frame"),
    ("  can0  18EEFF1C   [3]  FC 00", "unreadable_line"),
    ("<0x18eeff01> [8] 05 a0 be 1c 00 a0 a0 c0 ", frame(0, 0x18EEFF01, "05A0BE1C00A0A0C0")),
    ("<0x123> [1] 05", frame(0, 0x123, "05", extended=False)),
    ("<0x18eeff01> [8] 05 a0", "unreadable_line"),
    ("2026-08-09T13:42:55.841473308-07:00,6,126720,7,10,2,a3,99",
     frame(1786308175_841473308, 0x19EF0A07, "A399")),
    ("2026-08-09T13:42:55+0530,6,127250,7,255,1,a3", frame(1786263175_000000000, 0x19F11207, "A3")),
    ("2026-08-09 23:42:55,5+02,6,127250,7,255,1,a3", frame(1786311775_500000000, 0x19F11207, "A3")),
    ("2020-08-22T13:52:36.981Z,0,16712965,255,0,0", "gateway_message"),
    ("A173321.107 23FF7 1F513 012F3070002F30709F",
     frame(63201_107000000, 0x1DF51323, "012F3070002F30709F")),
    ("A173321 23FF7 1F119 01 02 03", frame(63201_000000000, 0x1DF11923, "010203")),
    ("A000159.990 CCFF7 0FF63 3B9F0000000002FF", frame(119_990000000, 0x1CFF63CC, "3B9F0000000002FF")),
    ("A173321.107 00FF6 0EA00 14F001", frame(63201_107000000, 0x18EAFF00, "14F001")),
    ("A173321.107 23FF7 1F513 012F3", "unreadable_line"),
    ("!PDGY,127250,2,3,255,482.36,3C20AAAAAAE=", frame(482_036000000, 0x09F11203, "DC2DB40000000001")),
    ("!PDGY,127250,2,3,255,482.117,3C20AAAAAAE=", frame(482_117000000, 0x09F11203, "DC2DB40000000001")),
    ("!PDGY,127250,2,3,255,482.117,3C20AA=AAE=", "unreadable_line"),
    ("!PDGY,127250,2,3,255,485.564,Ai20AAAAAAE=$PDGY,000000,3,,5,485,1,0", "unreadable_line"),
    ("$PDGY,000000,3,,5,484,1,0", "gateway_message"),
    ("!PDGY,59904,255,FPAB", "gateway_message"),
    ("1471172400153;A;2020-08-22T13:52:36.981Z,2,127250,0,255,2,a3,99",
     frame(1598104356_981000000, 0x09F11200, "A399")),
    ("1471172400153;N;$GPRMC,225446,A,4916.45,N,12311.12,W,000.5,054.7,191194,020.3,E*68", "other_event"),
    ('1471172400153;I;{"updates":[]}', "other_event"),
    ("1471172400153;A;hello", "unreadable_line"),
    ("0001-01-01T00:00:00Z,2,127250,0,255,1,00", "negative_time_stamp"),
    ("9999-12-31T23:59:59.999Z,2,127250,0,255,1,00", "time_stamp_after_2262"),
    ("0000-01-01T00:00:00Z,2,127250,0,255,1,00", "unreadable_line"),
    ("(9999999999.999999) can0 18EEFF1C#00", "time_stamp_after_2262"),
)  # fmt: skip


@pytest.mark.parametrize(("line", "wanted"), LINES)
def test_lines(line: str, wanted: Frame | str, tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_bytes(b"(0.0) can9 001#00\n" + line.encode() + b"\r\n")
    found, log = drained(path)
    assert found[1:] == ([wanted] if isinstance(wanted, Frame) else [])
    assert log.skipped == ({} if isinstance(wanted, Frame) else {wanted: 1})


def test_a_log_of_signal_k_may_begin_with_what_is_no_frame(tmp_path: Path) -> None:
    path = tmp_path / "skserver-raw_2016-07-16T12.log"
    line = "1471172400153;A;2020-08-22T13:52:36.981Z,2,127250,0,255,2,a3,99"
    path.write_text(f"1471172400100;N;$GPGGA,1,2*00\n{line}\n")
    found, log = drained(path)
    assert (len(found), log.form, log.skipped) == (1, "Signal K", {"other_event": 1})


@pytest.mark.parametrize(
    ("line", "note"),
    [
        ("2020-08-22T13:52:36.981Z,2,127250,0,255,1,a3", ""),
        ("2020-08-22-13:52:36.981,2,127250,0,255,1,a3", NO_ZONE),
        ("14:23:39.128 R 0DF20D4B 01", NO_DATE),
        (" (2015-07-10 06:17:33.762905)  can1  18EEFF1C   [1]  FC", NO_ZONE),
        (" (003.000125)  can0  18EEFF1C   [1]  05", NO_DATE),
        ("(1436509053.762905) can1 18EEFF1C#FC", ""),
    ],
)
def test_what_a_log_does_not_know_of_its_times_is_said(line: str, note: str, tmp_path: Path) -> None:
    (tmp_path / "x").write_text(f"{line}\n" * 3)
    assert drained(tmp_path / "x")[1].note == note


@pytest.mark.parametrize("name", ["/dev/ttyUSB0@115200", "vcan:0", "Ω", "//", "-", 'a"b', "x" * 300, "can0"])
def test_buses_have_names_that_a_machine_file_can_give(name: str, tmp_path: Path) -> None:
    (tmp_path / "x").write_text(f"(1.0) {name} 123#00\n(1.0) {name}! 123#00\n(1.0) {name}? 123#00\n")
    found = [f.bus for f in frames(tmp_path / "x")]
    assert len(set(found)) == 3 and all(re.fullmatch(BUS_NAME, bus) for bus in found)
    assert found[0] == name or not re.fullmatch(BUS_NAME, name)


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_text_in_utf_16_is_refused_by_name(encoding: str, tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes("\ufeff(1.0) can0 123#00\n".encode(encoding))
    with pytest.raises(ForeignLog, match=r"UTF-16.*save it as UTF-8"):
        list(frames(tmp_path / "x"))


def test_stamps_since_the_line_before_add_up_and_those_since_the_first_do_not(tmp_path: Path) -> None:
    passed = (0.0, 0.1, 0.02, 0.1, 0.02)
    path = tmp_path / "x.txt"
    path.write_text("".join(f" ({s:010.6f})  can0  18EEFF1C   [1]  05\n" for s in passed))
    assert [f.t_ns for f in frames(path)] == [round(sum(passed[: i + 1]) * 1e9) for i in range(5)]
    path.write_text("".join(f" ({s:010.6f})  can0  18EEFF1C   [1]  05\n" for s in sorted(passed)))
    assert [f.t_ns for f in frames(path)] == [round(s * 1e9) for s in sorted(passed)]


def test_a_time_of_day_after_a_date_with_a_zone_belongs_to_that_day_of_utc(tmp_path: Path) -> None:
    path = tmp_path / "x.raw"
    path.write_text("2026-08-09T23:42:55-07:00,6,127250,7,255,1,a3\n06:43:00.000 R 09F11207 00\n")
    first, second = frames(path)
    assert second.t_ns - first.t_ns == 5 * SECOND


def test_lines_without_stamps_are_said(tmp_path: Path) -> None:
    path = tmp_path / "x.txt"
    path.write_text("  can0  18EEFF1C   [1]  05\n" * 3)
    found, log = drained(path)
    assert [f.t_ns for f in found] == [0, 0, 0] and "no time stamps" in log.note


def test_what_explains_an_error_frame_is_no_line(tmp_path: Path) -> None:
    path = tmp_path / "x.txt"
    path.write_text("  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME\n\tcontroller-problem{}\n")
    assert [f.error for f in frames(path)] == [True]
    assert drained(path)[1].skipped == {}


# What others write


def frames_of_text() -> list[tuple[int, int, int, bytes]]:
    """(PGN, source, SID, payload), one of them a fast packet."""
    found = []
    for i in range(9):
        found.append(
            (127250, 3, i, encode(127250, {"heading_rad": 0.1 * i, "heading_reference": "true"}, sid=i))
        )
        found.append((129025, 9, i, encode(129025, {"latitude_deg": 47.0 + i, "longitude_deg": 8.0})))
    words: dict[str, Word] = {
        "latitude_deg": 47.5,
        "longitude_deg": 8.5,
        "satellites": 19,
        "hdop": 0.7,
        "fix": "rtk_fixed",
    }
    found.append((129029, 9, 5, encode(129029, words, sid=5)))
    return found


ASSEMBLED = (N2KFormat.N2K_ASCII, N2KFormat.BASIC_STRING, N2KFormat.PDGY)
SINGLE = (N2KFormat.CANDUMP1, N2KFormat.CANDUMP2, N2KFormat.CANDUMP3, N2KFormat.CAN_FRAME_ASCII_RAW)


@pytest.mark.parametrize("form", [*ASSEMBLED, *SINGLE])
def test_what_nmea2000_writes(form: N2KFormat, tmp_path: Path) -> None:
    decoder = NMEA2000Decoder(bound_format=N2KFormat.BASIC_STRING)
    encoder = ENCODER_CLASSES[form]()
    lines: list[str] = []
    wanted: list[tuple[int, bytes]] = []
    for pgn, source, _, payload in frames_of_text():
        octets = ",".join(f"{octet:02x}" for octet in payload)
        decoded = decoder.decode(f"2020-01-01T00:00:00.000Z,3,{pgn},{source},255,{len(payload)},{octets}")
        assert decoded is not None
        written = encoder.encode(decoded)
        lines += [written] if isinstance(written, str) else [str(line) for line in written]
        wanted.append((can_id.join(3, pgn, source), payload))
    path = tmp_path / "x.txt"
    path.write_text("".join(line.rstrip() + "\n" for line in lines))
    found, log = drained(path)
    assert (log.skipped, log.truncated) == ({}, False)
    if form in SINGLE:
        found_long = [f for f in found if can_id.split(f.can_id).pgn == 129029]
        assert b"".join(f.data[1:] for f in found_long)[1:44] == wanted[-1][1]
        found, wanted = [f for f in found if f not in found_long], wanted[:-1]
    assert [(f.can_id, f.data) for f in found] == wanted


def test_values_of_recorded_ebl_and_ikonvert_are_what_nmea2000_reads() -> None:
    """The frame of every line, by another's reader of the form."""
    path = shared("data/canboat/ikonvert.log")
    found = iter(frames(path))
    compared = 0
    for line in path.read_text(errors="replace").splitlines():
        parts = line.split(",")
        if line.startswith("!PDGY,") and len(parts) == 7 and "$" not in line and line.count("!") == 1:
            try:
                payload = base64.b64decode(parts[6], validate=True)
            except ValueError:
                continue
            f = next(found)
            head = can_id.split(f.can_id)
            assert (head.pgn, head.priority, head.source) == tuple(map(int, parts[1:4])) and f.data == payload
            compared += 1
    assert compared > 8900 and next(found, None) is None


def test_the_sentence_on_what_is_read_lists_every_kind(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"prose\n")
    with pytest.raises(ForeignLog) as caught:
        list(frames(path))
    assert str(caught.value).endswith(readable())
    for kind in KINDS:
        assert (kind.listed or kind.name) in readable()
    for word in (
        "MCAP",
        "candump -l",
        "iKonvert",
        "N2K ASCII",
        "EBL",
        "pcapng",
        "gateway",
        "BLF",
        "TRC",
        "MF4",
    ):
        assert word.lower() in readable().lower().replace(".mcap", "mcap")


PLAIN_CANDUMP = (
    "  can0  09F1120C   [8]  FF 00 00 FF 7F FF 7F FD\n  can0  15FD0723   [8]  FF C0 D9 6F FF 7F FF FF\n"
)


@pytest.mark.parametrize(
    "words", [["decode"], ["discover"], ["replay", "--machine", str(MACHINE_FILE), "--json"]]
)
def test_a_log_without_stamps_goes_through_every_command(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.txt"
    path.write_text(PLAIN_CANDUMP * 200)
    assert main([words[0], str(path), *words[1:]]) == 0
    frames_of_text = capsys.readouterr()
    assert "Traceback" not in frames_of_text.err
    assert words[0] == "discover" or "no time stamps" in frames_of_text.err
    if words[0] == "replay":
        assert json.loads(frames_of_text.out)["poses"] == 0
