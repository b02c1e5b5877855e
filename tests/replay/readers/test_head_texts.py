"""ASC and TRC: dates of any language, lines of every kind and version."""

import time
from dataclasses import replace
from pathlib import Path

import pytest
from log_forms import EPOCH_S, TRC_VERSIONS, asc, drive, frame, trc
from logs import SECOND, drained
from paths import shared

from tilth.replay.readers.any_log import frames
from tilth.replay.readers.log import NO_DATE, NO_ZONE, EmptyLog
from tilth.replay.readers.written_dates import utc_ns
from tilth.schemas.flow import Frame

T = EPOCH_S * SECOND
LATER = T + SECOND // 2
AFTERNOON = 1_791_212_773_191_000_000  # 5 October 2026, 15:06:13.191

DATES = (
    "Mon Oct 5 15:06:13.191 2026",
    "Mon Oct 5 15:06:13.191 pm 2026",
    "Mon Oct 5 03:06:13.191 pm 2026",
    "Mon Oct 5 3:06:13.191 PM 2026",
    "Mon Oct  5 03:06:13.191pm 2026",
    "Mon, Oct 5, 2026 03:06:13.191 p.m.",
    "Mit Okt 5 03:06:13.191 nachm 2026",
    "Mo. Okt. 5 03:06:13.191 nachm. 2026",
    "Mo 5. Oktober 2026 15:06:13,191",
    "lun. oct. 5 15:06:13.191 2026",
    "lundi 5 octobre 2026 15:06:13.191",
    "lun ott 5 15:06:13.191 2026",
    "lun. oct. 5 03:06:13.191 p. m. 2026",
    "seg out 5 15:06:13.191 2026",
    "ma okt. 5 15:06:13.191 2026",
    "2026-10-05 15:06:13.191",
    "05.10.2026 15:06:13.191",
    "5/10/2026 15:06:13.191.0",
    "5:10:2026 15:6:13:191",
)
MONTHS = (
    "Jan Feb Mar Apr May Jun Jul Aug Sep Oct Nov Dec",
    "Jan Feb Mär Apr Mai Jun Jul Aug Sep Okt Nov Dez",
    "Jän Feb Mrz Apr Mai Juni Juli Aug Sept Okt Nov Dez",
    "janv. févr. mars avr. mai juin juil. août sept. oct. nov. déc.",
    "gen feb mar apr mag giu lug ago set ott nov dic",
    "ene. feb. mar. abr. may. jun. jul. ago. sept. oct. nov. dic.",
    "jan fev mar abr mai jun jul ago set out nov dez",
    "jan. feb. mrt. apr. mei jun. jul. aug. sep. okt. nov. dec.",
)
WEEKDAYS = ("Tue", "Die", "mar.", "mar", "ma", "Sam", "dom.", "dim.")


@pytest.mark.parametrize("text", DATES)
def test_dates(text: str) -> None:
    assert utc_ns(text) == AFTERNOON


@pytest.mark.parametrize("months", MONTHS)
@pytest.mark.parametrize("damage", [str, lambda t: t.encode().decode("cp1252", "replace"),
                                    lambda t: t.encode("cp1252").decode("utf-8", "replace")])  # fmt: skip
def test_every_month_of_every_language(months: str, damage: type[str]) -> None:
    for number, month in enumerate(months.split(), 1):
        for weekday in WEEKDAYS:
            found = time.gmtime(utc_ns(damage(f"{weekday} {month} 3 01:02:03 2026")) / SECOND)
            assert found[:6] == (2026, number, 3, 1, 2, 3)


@pytest.mark.parametrize(("clock", "hour"), [("12:00:00 am", 0), ("12:00:00 pm", 12), ("11:00:00 vorm", 11),
                                            ("12:30:00 nachm", 12), ("00:00:00 am", 0)])  # fmt: skip
def test_noon_and_midnight(clock: str, hour: int) -> None:
    assert utc_ns(f"Mon Oct 5 {clock} 2026") // SECOND // 3600 % 24 == hour


@pytest.mark.parametrize("text", ["", "Mon Oct 5 2026", "Mon Xyz 5 01:02:03 2026", "Mon Oct 35 01:02:03 2026",
                                  "Mon Oct 5 25:02:03 2026", "Mon jui 5 01:02:03 2026"])  # fmt: skip
def test_what_is_no_date(text: str) -> None:
    with pytest.raises(ValueError):
        utc_ns(text)


# ASC


ASC_DATES = (
    "Tue Nov 14 10:13:20 pm 2023",
    "Tue Nov 14 22:13:20.000 2023",
    "Die Nov 14 22:13:20.000 nachm 2023",
    "mar. nov. 14 22:13:20.000 2023",
)


@pytest.mark.parametrize("date", ASC_DATES)
def test_an_asc_log(date: str, tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(asc(drive(20), date))
    found, log = drained(tmp_path / "x")
    assert (found, log.form, log.truncated, log.skipped, log.note) == (drive(20), "ASC", False, {}, NO_ZONE)


def test_an_asc_date_that_cannot_be_read_is_said_and_costs_no_frame(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(asc(drive(20), "Tue Elfter 14 22:13:20 2023"))
    found, log = drained(tmp_path / "x")
    assert [f.t_ns for f in found] == [f.t_ns - T for f in drive(20)]
    assert log.note == f'its date "Tue Elfter 14 22:13:20 2023" cannot be read; {NO_DATE}'


HEAD = "date Tue Nov 14 22:13:20 2023\nbase hex  timestamps absolute\nno internal events logged\n"
ASC_LINES: tuple[tuple[str, Frame | str | None], ...] = (
    ("0.5 1  18FEF31Cx  Rx   d 2 11 27", frame(LATER, 0x18FEF31C, "1127")),
    ("0.5 1  123  Tx   d 0", frame(LATER, 0x123, "", extended=False)),
    ("0.5 1  18FEF31Cx  Rx   r", "remote_frame"),
    ("0.5 1  18FEF31Cx  Rx   r 8", "remote_frame"),
    ("0.5 2  ErrorFrame  ECC: 10100010", frame(LATER, 0, "", "can1", error=True)),
    ("0.5 CANFD  1 Rx  18FEF31Cx  name  1 0 2 2 11 27 130000 130 200000", frame(LATER, 0x18FEF31C, "1127")),
    ("0.5 CANFD  2 Rx  123  0 0 2 2 11 27 130000", frame(LATER, 0x123, "1127", "can1", extended=False)),
    ("0.5 CANFD  1 Rx  18FEF31Cx  1 0 9 12 " + "11 " * 12, "can_fd_frame"),
    ("0.5 1  18FEF31Cx  Rx   d f 11 27 11 27 11 27 11 27", frame(LATER, 0x18FEF31C, "1127" * 4)),
    ("0.5 1  18FEF31Cx  Rx   d 8 11 27", "unreadable_line"),
    ("0.5 1  18FEF31Cx  TxRq   d 2 11 27", "other_event"),
    ("0.5 1  Statistic: D 0 R 0 XD 10 XR 0 E 0 O 0 B 3.1%", "other_event"),
    ("0.5 CAN 1 Status:chip status error active", "other_event"),
    ("0.5 J1939TP FEE3p 6 0 0 - Rx d 23 11 22", "other_event"),
    ("0.5 1  EngineSpeed  Rx   d 2 11 27", "unreadable_line"),
    ("0.000000 Start of measurement", None),
    ("// a remark", None),
    ("previous log file: x.asc", "unreadable_line"),
)  # fmt: skip


@pytest.mark.parametrize(("line", "wanted"), ASC_LINES)
def test_lines_of_asc(line: str, wanted: Frame | str | None, tmp_path: Path) -> None:
    (tmp_path / "x").write_text(f"{HEAD}{line}\n 9.0 1 7FF Rx d 0\n")
    (*found, _), log = drained(tmp_path / "x")
    assert found == ([wanted] if isinstance(wanted, Frame) else [])
    assert log.skipped == ({wanted: 1} if isinstance(wanted, str) else {})


def test_asc_in_decimal(tmp_path: Path) -> None:
    (tmp_path / "x").write_text(f"{HEAD.replace('hex', 'dec')} 0.5 1 419361564x Rx d 3 255 0 17\n")
    assert list(frames(tmp_path / "x")) == [frame(LATER, 0x18FEF31C, "FF0011")]


def test_what_trigger_blocks_count_from(tmp_path: Path) -> None:
    """A block whose times begin anew has its own date; one that goes on counts from the start."""
    line = "{} 1 7FF Rx d 0\n"
    first = f"{HEAD}Begin Triggerblock Tue Nov 14 22:15:00 2023\n{line.format(100.0)}End TriggerBlock\n"
    again = f"Begin Triggerblock Tue Nov 14 22:16:40 2023\n{line.format(200.0)}End TriggerBlock\n"
    anew = f"Begin Triggerblock Tue Nov 14 22:30:00 2023\n{line.format(0.5)}End TriggerBlock"
    (tmp_path / "x").write_text(first + again + anew)
    found, log = drained(tmp_path / "x")
    assert [(f.t_ns - T) / SECOND for f in found] == [100.0, 200.0, 1000.5] and not log.truncated


@pytest.mark.parametrize(
    ("name", "first", "count"),
    [
        ("forms/01-busmaster.asc", 1_638_789_674_808_200_000, 6),
        ("second/01-asc-24h-pm.asc", AFTERNOON + 100_000_000, 4),
        ("second/01b-asc-nachm.asc", AFTERNOON + 100_000_000, 4),
        ("second/01c-asc-fr.asc", AFTERNOON + 100_000_000, 4),
    ],
)
def test_given_asc_files(name: str, first: int, count: int) -> None:
    found, log = drained(shared(f"data/strangers/{name}"))
    assert (len(found), found[0].t_ns, found[0].can_id) == (count, first, 0x18EEFF1C)
    assert (log.truncated, log.skipped, log.note) == (False, {}, NO_ZONE)


@pytest.mark.parametrize(
    ("date", "first"), [("Mon Dec 6 11:21:13 am 2021", 40874.8), ("Mon Dec 6 11:21:13 pm 2021", 84074.8)]
)
def test_busmasters_asc_counts_from_midnight_and_nobody_elses_does(
    date: str, first: float, tmp_path: Path
) -> None:
    midnight = 1_638_748_800
    path = tmp_path / "x.asc"
    path.write_text(
        f"date {date}\nbase hex  no internal events logged\n// version 7.1.0\n{first} 1 7FF Rx d 0\n"
    )
    assert [f.t_ns / SECOND - midnight for f in frames(path)] == pytest.approx([first])
    path.write_text(f"date {date}\nbase hex  timestamps absolute\n// version 7.1.0\n0.5 1 7FF Rx d 0\n")
    assert [f.t_ns / SECOND - midnight for f in frames(path)] == pytest.approx([first - 1.3])


# TRC


@pytest.mark.parametrize("version", TRC_VERSIONS)
def test_every_version_of_trc(version: str, tmp_path: Path) -> None:
    (tmp_path / "x.dat").write_bytes(trc(drive(20), version))
    found, log = drained(tmp_path / "x.dat")
    wanted = drive(20) if version in ("1.2", "1.3", "2.1") else [replace(f, bus="can1") for f in drive(20)]
    for one, other in zip(found, wanted, strict=True):
        assert abs(one.t_ns - other.t_ns) <= 10_000  # the date has ten digits of a day
        assert replace(one, t_ns=0, rx_ns=0) == replace(other, t_ns=0, rx_ns=0)
    assert (log.form, log.truncated, log.skipped, log.note) == ("TRC", False, {}, NO_ZONE)


TRC_LINES = {
    "1.0": (("  2)      1842 0008 4 ERROR 00 19 08 08", "other_event"),
            ("  3)      1843 FFFFFFFF 4 00 00 00 04 ------BUSLIGHT", "other_event"),
            ("  4)      1844 0100 3 RTR", "remote_frame")),
    "1.1": (("     5)      1346.8  Warng  FFFFFFFF  4  00 00 00 04  BUSLIGHT", "other_event"),
            ("     6)      1349.2  Error      0008  4  00 19 08 08", "other_event"),
            ("     7)      1352.7  Rx         0100  3  RTR", "remote_frame"),
            ("     8)      1352.7  Rx         0100  8  00 01", "unreadable_line")),
    "1.2": (("     5)      1346.834  1  Warng  FFFFFFFF  4  00 00 00 04  BUSLIGHT", "other_event"),
            ("     6)      1349.222  1  Error      0008  4  00 19 08 08", "other_event"),
            ("     7)      1352.743  1  Rx         -100  1  00", "unreadable_line"),
            ("     7)      1352.743  1  Rx         0100  -1  00 00", "unreadable_line"),
            ("     7)      1352.743  1  Rx         0100  3  RTR", "remote_frame")),
    "1.3": (("     3)      1346.834 1  Warng FFFFFFFF -  4    00 00 00 04 BUSLIGHT", "other_event"),
            ("     4)      1349.222 1  Error     0008 -  4    00 19 08 08", "other_event"),
            ("     5)      1352.743 1  Event User-defined event", "other_event"),
            ("     6)      1352.743 1  Rx        0100 -  3    RTR", "remote_frame"),
            ("     7)      1352.743 1  Rx    10062123 -  9    D2 AF AA 88 18 80 01 02 03", "can_fd_frame")),
    "2.0": (("     5    1334.416 FD     0500 Tx 12 01 02 03 04 05 06 07 08 09 0A 0B 0C", "can_fd_frame"),
            ("     6    1334.522 ER          Rx    04 00 02 00 00", "other_event"),
            ("     7    1334.531 ST          Rx    00 00 00 08", "other_event"),
            ("     8    1334.643 EC          Rx    02 02", "other_event"),
            ("    10    1336.543 RR     0100 Rx 3", "remote_frame"),
            ("    11    1336.543 XX     0100 Rx 1  00", "unreadable_line")),
    "2.1": (("     5    1334.416 FB 1      0500 Tx -  9 01 02 03 04 05 06 07 08 09 0A 0B 0C", "can_fd_frame"),
            ("     6    1334.522 ER 1         - Rx -  5 04 00 02 00 00", "other_event"),
            ("    10    1336.543 RR 1      0100 Rx -  3", "remote_frame"),
            ("    11    1336.543 EV 1 User-defined event for bus 1", "other_event")),
}  # fmt: skip


@pytest.mark.parametrize(
    ("version", "line", "reason"), [(v, *row) for v, lines in TRC_LINES.items() for row in lines]
)
def test_rows_of_trc_that_are_no_frame(version: str, line: str, reason: str, tmp_path: Path) -> None:
    content = trc(drive(20), version)
    (tmp_path / "x.trc").write_bytes(content + line.encode() + b"\r\n")
    found, log = drained(tmp_path / "x.trc")
    assert (len(found), log.skipped, log.truncated) == (20, {reason: 1}, False)


@pytest.mark.parametrize("start", ["", ";$STARTTIME=soon\n", ";$STARTTIME=1e300\n"])
def test_a_trace_without_a_start_time_is_said(start: str, tmp_path: Path) -> None:
    (tmp_path / "x").write_text(f";$FILEVERSION=1.1\n{start}     1)      1059.9  Rx         0300  1  00\n")
    found, log = drained(tmp_path / "x")
    assert [f.t_ns for f in found] == [1_059_900_000] and NO_DATE in log.note
    assert ("cannot be read" in log.note) == bool(start)


def test_the_given_trace() -> None:
    found, log = drained(shared("data/strangers/second/25-trc12.trc"))
    assert [f.bus for f in found] == ["can1", "can1", "can2"] and log.skipped == {}
    assert [f.t_ns - found[0].t_ns for f in found] == [0, 100_300_000, 200_900_000]


def test_a_trace_of_nothing_but_events_has_no_frame(tmp_path: Path) -> None:
    (tmp_path / "x").write_text(f";$FILEVERSION=1.1\n{TRC_LINES['1.1'][0][0]}\n")
    with pytest.raises(EmptyLog):
        list(frames(tmp_path / "x"))
