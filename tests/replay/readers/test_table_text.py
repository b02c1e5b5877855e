"""Tables whose header names their columns: of SavvyCAN, CANedge, CL2000, Kvaser, BUSMASTER, and the like."""

import gzip
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_forms import EPOCH_S, busmaster, canedge, cl2000, drive, frame, kvaser, savvycan
from logs import SECOND, drained
from paths import shared

from tilth.replay.readers.any_log import frames, open_log
from tilth.replay.readers.log import NO_DATE, NO_ZONE, EmptyLog
from tilth.replay.readers.text import UNTIMED
from tilth.schemas.flow import Frame

T = EPOCH_S * SECOND
HALF = SECOND // 2


WRITERS: tuple[tuple[str, Callable[[Sequence[Frame]], bytes]], ...] = (
    ("SavvyCAN", savvycan),
    ("SavvyCAN", lambda f: savvycan(f, ";")),
    ("CANedge", canedge),
    ("CANedge", lambda f: canedge(f, ",")),
    ("CANedge", lambda f: canedge(f, "\t")),
    ("CL2000", cl2000),
    ("Kvaser Memorator", kvaser),
    ("Kvaser Memorator", lambda f: kvaser(f, "DEC")),
    ("BUSMASTER", busmaster),
)


@pytest.mark.parametrize(("form", "write"), WRITERS)
@pytest.mark.parametrize("change", [lambda c: c, lambda c: c.replace(b"\n", b"\r\n"), gzip.compress])
def test_what_is_written_is_read(
    form: str, write: Callable[[Sequence[Frame]], bytes], change: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    (tmp_path / "x").write_bytes(change(write(drive())))
    found, log = drained(tmp_path / "x")
    wanted = [replace(f, bus="can0") for f in drive()] if form == "CL2000" else drive()
    assert found == wanted
    assert (log.form, log.truncated, log.skipped) == (form, False, {})
    assert log.note == ("" if form in ("SavvyCAN", "CANedge") else NO_ZONE)


@given(st.permutations(range(12)), st.sampled_from(";,\t|"), st.booleans(), st.booleans())
@settings(max_examples=30, deadline=None)
def test_columns_may_be_in_any_order(
    tmp_path_factory: pytest.TempPathFactory, order: list[int], mark: str, prefixed: bool, quoted: bool
) -> None:
    lines = [line.split(";") for line in canedge(drive()).decode().splitlines()]
    if prefixed:
        lines[1:] = [[*line[:2], f"0x{line[2]}", *line[3:]] for line in lines[1:]]
    quote = '"' if quoted else ""
    text = "".join(mark.join(f"{quote}{line[at]}{quote}" for at in order) + "\n" for line in lines)
    path = tmp_path_factory.getbasetemp() / "columns.csv"
    path.write_text(text)
    found, log = drained(path)
    assert (found, log.skipped, log.truncated) == (drive(), {}, False)


GVRET = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
EDGE = "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;ESI;RTR;DataBytes\n"
KVASER = "        Time Chan   Identifier Flags        DLC  Data    Counter\n"
X = 0x18FEF31C
ROWS: tuple[tuple[str, str, Frame | str], ...] = (
    (GVRET, "166000000,18FEF31C,true,Rx,0,2,11,27,", frame(166 * SECOND, X, "1127")),
    (GVRET, "166000000,0x18FEF31C,TRUE,Tx,1,2,0x11,0x7,", frame(166 * SECOND, X, "1107", "can1")),
    (GVRET, "166000000,00000123,false,Rx,0,0,", frame(166 * SECOND, 0x123, "", extended=False)),
    (GVRET, "166000000,123,WAHR,Rx,0,1,11", frame(166 * SECOND, 0x123, "11")),  # a German spreadsheet's
    (GVRET, "166000000,123,FAUX,Rx,0,1,11", frame(166 * SECOND, 0x123, "11", extended=False)),
    (GVRET, "166.25,18FEF31C,1,Rx,0,1,11", frame(166_250_000_000, X, "11")),
    (GVRET, "166000000,418316060,true,Rx,0,3,255,0,17", frame(166 * SECOND, 0x18EEFF1C, "FF0011")),
    (GVRET, "166000000,98FEF31C,false,Rx,0,1,11", frame(166 * SECOND, X, "11")),
    (GVRET, "166000000,2000000C,true,Rx,0,1,11", frame(166 * SECOND, 12, "11", error=True)),
    (GVRET, "166000000,18FEF31C,true,Rx,0,12" + ",00" * 12, "can_fd_frame"),
    (GVRET, "166000000,18FEF31C,true,Rx,0,8,11,27,00", "unreadable_line"),
    (GVRET, "166000000,18FEF31C,perhaps,Rx,0,1,11", "unreadable_line"),
    (GVRET, "166000000,1FFFFFFFFF,true,Rx,0,1,11", "unreadable_line"),
    ("Time Stamp,ID,Extended,Bus,LEN,D1,D2\n", "5,18FEF31C,true,3,1,11,", frame(5000, X, "11", "can3")),
    (EDGE, "1700000000.000001;1;18FEF31C;1;2;2;0;0;0;0;0;1127", frame(T + 1000, X, "1127", "can1")),
    (EDGE, "1700000000.000001;9;123;0;2;2;0;0;0;0;1;", "remote_frame"),
    (EDGE, "1700000000;1;18FEF31C;1;9;12;0;1;1;0;0;" + "AA" * 12, "can_fd_frame"),
    (EDGE, "1700000000;1;18FEF31C;1;2;2;0;1;1;0;0;11 27", frame(T, X, "1127", "can1")),
    (EDGE, "2023-11-14T22:13:20.5Z;1;18FEF31C;1;1;1;0;0;0;0;0;11", frame(T + HALF, X, "11", "can1")),
    (EDGE, "2023-11-14 23:13:20,5+01:00;1;18FEF31C;1;1;1;0;0;0;0;0;11",
     frame(T + HALF, X, "11", "can1")),
    (EDGE, "2023/11/14 22:13:20;1;18FEF31C;1;1;1;0;0;0;0;0;11", frame(T, X, "11", "can1")),
    (EDGE, "14.11.2023 22:13:20,250;1;18FEF31C;1;1;1;0;0;0;0;0;11", frame(T + SECOND // 4, X, "11", "can1")),
    (EDGE, "20231114T221320250;1;18FEF31C;1;1;1;0;0;0;0;0;11", frame(T + SECOND // 4, X, "11", "can1")),
    (EDGE, "yesterday;1;18FEF31C;1;1;1;0;0;0;0;0;11", "unreadable_line"),
    (EDGE, "-5.0;1;18FEF31C;1;1;1;0;0;0;0;0;11", "negative_time_stamp"),
    (EDGE, "9999999999999.0;1;18FEF31C;1;1;1;0;0;0;0;0;11", "time_stamp_after_2262"),
    ("Time [ms],ID,DLC,Data\n", "1700000000000,18FEF31C,2,11 27", frame(T, X, "1127")),
    ("Time [ms],ID,DLC,Data\n", "1700000000000.5,18FEF31Cx,2,11,27", frame(T + 500_000, X, "1127")),
    ("timestamp_us;can_id;len;payload\n", "1700000000000000;18FEF31C;2;0x11 0x27", frame(T, X, "1127")),
    ("Time (s);ID;Length;Data\n", "1700000000,25;18FEF31C;2;11-27", frame(T + SECOND // 4, X, "1127")),
    ("epoch\tid\tlength\tdata\n", "1700000000000000000\t7FF\t1\t5", frame(T, 0x7FF, "05", extended=False)),
    ("time,id,len,data\n", "1700000000000,123,1,11", frame(T, 0x123, "11", extended=False)),
    ("Channel,ID,Length,Data\n", "can7,00000123,1,11", frame(0, 0x123, "11", "can7")),
    ("Time,Channel,ID,Flags,DLC,Data0,Data1\n", "0.5,2,18FEF31C,4,1,11,", frame(HALF, X, "11", "can2")),
    ("Time,Channel,ID,Flags,DLC,Data0,Data1\n", "0.5,2,18FEF31C,5,1,11,", "remote_frame"),
    (KVASER, "    0.500000  1    18FEF31Cx   Rx           2  11 27       5", frame(HALF, X, "1127", "can1")),
    (KVASER, "    0.500000  1    18FEF31C   x       2  11 27       5", frame(HALF, X, "1127", "can1")),
    (KVASER, "    0.500000  1    123    Tx   2  11 27       5",
     frame(HALF, 0x123, "1127", "can1", extended=False)),
    (KVASER, "    0.500000  1    123   2  11 27   5", frame(HALF, 0x123, "1127", "can1", extended=False)),
    (KVASER, "    0.500000  1    18FEF31Cx   Rx   R        2  RTR      5", "remote_frame"),
    (KVASER, "    0.500000  1    18FEF31Cx   Rx    FB      9  " + "00 " * 12 + "  5", "can_fd_frame"),
    (KVASER, "    0.500000  1    ErrorFrame    Rx        ERROR FRAME      5",
     frame(HALF, 0, "", "can1", error=True)),
    (KVASER, "    0.500000  Trigger (type=0x1, active=0x00, pre-trigger=0, post-trigger=-1)", "other_event"),
    (KVASER, "    -0.5  1    18FEF31Cx   Rx           2  11 27       5", "negative_time_stamp"),
    (KVASER, "2023-11-14 22:13:20.5  1    18FEF31Cx   Rx           2  11 27       5",
     frame(T + HALF, X, "1127", "can1")),
)  # fmt: skip


@pytest.mark.parametrize(("head", "row", "wanted"), ROWS)
def test_rows(head: str, row: str, wanted: Frame | str, tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text(f"{head}{row}\n\n# a remark\n{head}not a row of it\n{row}\n")
    log = open_log(path)
    try:
        found = list(log.records)
    except EmptyLog:
        found = []
    bad = {} if wanted != "unreadable_line" else {"unreadable_line": 2}
    assert found == ([wanted] * 2 if isinstance(wanted, Frame) else [])
    assert log.skipped == {"unreadable_line": 1 + bad.get("unreadable_line", 0)} | (
        {wanted: 2} if isinstance(wanted, str) and not bad else {}
    )


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "cp850"])
def test_microseconds_in_any_encoding(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes("Time (µs);ID;Length;Data\n5000;18FEF31C;1;11\n".encode(encoding))
    assert list(open_log(path).records) == [frame(5_000_000, X, "11")]


@pytest.mark.parametrize(("head", "row", "wanted"), [row for row in ROWS if isinstance(row[2], Frame)])
def test_a_last_row_that_lost_bytes_is_left_out(head: str, row: str, wanted: Frame, tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    for cut in range(1, len(row)):
        path.write_text(f"{head}{row}\n{row[:-cut]}")
        found, log = drained(path)
        assert found in ([wanted], [wanted] * 2)
        assert (len(found) == 2) != log.truncated


HEADS = (
    ("Memorator Binary logfile created at: 2023-11-14 22:13:20\n", T, NO_ZONE),
    ("Converted from Memorator Binary format at: 2023-11-14 22:13:20\n", 0, NO_DATE),
    ("", 0, NO_DATE),
)


@pytest.mark.parametrize(("head", "start", "note"), HEADS)
def test_when_a_memorator_was_started_is_in_its_head(
    head: str, start: int, note: str, tmp_path: Path
) -> None:
    (tmp_path / "x").write_text(
        f"  Kvaser Memorator Log\n  ===\n\n{head}\n{KVASER}=====\n 1.5 1 7FF 1 00 1\n"
    )
    found, log = drained(tmp_path / "x")
    assert [f.t_ns for f in found] == [start + 3 * SECOND // 2] and log.note == note


def test_a_calendar_line_of_a_memorator_dates_the_next_row_and_those_behind_it(tmp_path: Path) -> None:
    text = f"Kvaser Memorator Log\n{KVASER}DateTime: 2023-11-14 22:13:20\n 9.5 1 7FF 1 00 1\n"
    (tmp_path / "x").write_text(f"{text}DateTime: 2023-11-14 22:13:21\n 10.75 1 7FF 1 00 2\n")
    assert [f.t_ns - T for f in frames(tmp_path / "x")] == [0, 5 * SECOND // 4]


@pytest.mark.parametrize("base", ["HEX", "DEC"])
def test_a_memorator_without_its_head(base: str, tmp_path: Path) -> None:
    rows = drive()
    (tmp_path / "x").write_bytes(kvaser(rows, base, head=False))
    found, log = drained(tmp_path / "x")
    assert found == [replace(f, t_ns=f.t_ns - T, rx_ns=f.t_ns - T) for f in rows]
    assert log.form == "Kvaser Memorator" and log.note == NO_DATE


@pytest.mark.parametrize(
    ("mode", "times", "wanted"),
    [
        ("SYSTEM", ("22:13:20:5000", "23:59:59:0000", "00:00:01:0000"), (0.5, 6399.0, 6401.0)),
        ("ABSOLUTE", ("00:00:01:5000", "00:01:00:0000", "00:02:00:0000"), (1.5, 60.0, 120.0)),
        ("RELATIVE", ("00:00:01:5000", "00:00:00:5000", "00:01:00:0000"), (1.5, 2.0, 62.0)),
    ],
)
def test_what_times_of_busmaster_count_from(
    mode: str, times: tuple[str, ...], wanted: tuple[float, ...], tmp_path: Path
) -> None:
    head, _, _ = busmaster(drive()).decode().partition("22:13:20:0000")
    text = head.replace("SYSTEM", mode) + "".join(f"{time} Rx 1 0x7FF s 1 00\n" for time in times)
    (tmp_path / "x").write_text(
        text + "***END DATE AND TIME 15:11:2023 0:0:2:0***\n***[STOP LOGGING SESSION]***"
    )
    found, log = drained(tmp_path / "x")
    assert [(f.t_ns - T) / SECOND for f in found] == list(wanted) and not log.truncated and not log.skipped


def test_a_busmaster_log_in_decimal(tmp_path: Path) -> None:
    text = busmaster(drive()[:1]).decode().replace("***HEX***", "***DEC***").rpartition("22:13")[0]
    (tmp_path / "x").write_text(text + "22:13:20:0000 Rx 1 419361564 x 3 255 9 017 \n")
    assert list(frames(tmp_path / "x")) == [frame(T, X, "FF0911", "can1")]


def test_a_table_without_times_is_said(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("ID,Length,Data\n123,1,11\n")
    found, log = drained(tmp_path / "x")
    assert [f.t_ns for f in found] == [0] and UNTIMED in log.note


def test_days_of_a_cl2000_go_on_in_the_next_month(tmp_path: Path) -> None:
    head = "# Time: 20231231T235959\nTimestamp;Type;ID;Data\n"
    (tmp_path / "x").write_text(f"{head}31T235959500;0;7ff;00\n01T000000500;9;18fef31c;11\n")
    first, second = frames(tmp_path / "x")
    assert second.t_ns - first.t_ns == SECOND and second.extended and not first.extended


@pytest.mark.parametrize(
    ("name", "form", "start"),
    [
        ("11-savvycan.csv", "SavvyCAN", 166 * SECOND),
        ("12-canedge.csv", "CANedge", T),
        ("14-kvaser.txt", "Kvaser Memorator", 0),
    ],
)
def test_given_files(name: str, form: str, start: int) -> None:
    found, log = drained(shared(f"data/strangers/forms/{name}"))
    assert [f.t_ns - start for f in found] == [i * SECOND // 5 for i in range(6)]
    assert {f.can_id for f in found} == {0x18EEFF1C, 0x09F8011C} and all(f.extended for f in found)
    assert found[0].data == bytes.fromhex("1127000B009178C0")
    assert (log.form, log.truncated, log.skipped) == (form, False, {})
