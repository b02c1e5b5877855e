"""`tilth decode`: one line a message, the counts beside it, and one sentence for what is no log."""

import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from logs import MACHINE, MACHINE_FILE, MACHINE_TEXT, record
from loopback import PATIENCE_S
from paths import shared, shared_files

from tilth.cli import main
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.replay.readers.any_log import frames
from tilth.schemas.decode import Decoder, claim, encode, frames_of
from tilth.schemas.flow import Frame, Word
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.pgn_table import PGNS
from tilth.schemas.signals import SIGNALS
from tilth.simulator.traffic import simulate

HEAD = ("t_ns", "bus", "source", "name", "pgn")
FURTHER = {"title", "priority", "destination", "sid", "repeat", "reason", "dropped"} | {
    f"{key}_name" for key in ("manufacturer", "function", "device_class", "industry_group")
} | {group.key for row in PGNS for group in row.groups}  # fmt: skip
NAME = 0xA00017000421E240

Answer = Callable[..., tuple[int, str, str]]


@pytest.fixture
def answer(capsys: pytest.CaptureFixture[str]) -> Answer:
    def ask(*words: object) -> tuple[int, str, str]:
        status = main(["decode", *map(str, words)])
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return ask


def rows_of(out: str) -> list[dict[str, object]]:
    return [json.loads(line) for line in out.splitlines()]


def candump(path: Path, rows: list[tuple[float, int, bytes]], bus: str = "can0") -> Path:
    path.write_text("".join(f"({t:.6f}) {bus} {can_id:08X}#{data.hex()}\n" for t, can_id, data in rows))
    return path


def a_log(path: Path) -> Path:
    """A StarFire-like receiver that claims its address, two equal positions, and a wheel-angle sensor."""
    position = encode(65267, {"latitude_deg": 41.98, "longitude_deg": -93.64})
    rows = [
        (1700000000.0, 0x18EEFF1C, claim(NAME)),
        (1700000000.1, 0x18FEF31C, position),
        (1700000000.3, 0x18FEF31C, position),
        (1700000000.4, 0x18FF0B15, bytes.fromhex("01F4FFFFFFFFFFFF")),
        (1700000000.5, 0x18FEF31C, b"\xff" * 8),
        (1700000000.6, 0x18FF1234, bytes(8)),
    ]
    for k, (can_id, data) in enumerate(
        frames_of(129029, encode(129029, {"fix": "rtk_fixed", "hdop": 0.7}), 70)
    ):
        rows.append((1700000001.0 + k / 1000, can_id, data.ljust(8, b"\xff")))
    return candump(path, rows)


def test_lines_have_the_fixed_keys(answer: Answer, tmp_path: Path) -> None:
    status, out, err = answer("--json", a_log(tmp_path / "x.log"))
    rows = rows_of(out)
    assert status == 0
    assert all(tuple(row)[:5] == HEAD for row in rows)
    positions = [row for row in rows if row["pgn"] == 65267]
    assert [row.get("repeat") for row in positions] == [None, True, None]  # the last one holds nothing
    assert positions[0] == {
        "t_ns": 1700000000_100000000,
        "bus": "can0",
        "source": 28,
        "name": "A00017000421E240",
        "pgn": 65267,
        "title": "Vehicle Position",
        "priority": 6,
        "destination": 255,
        "latitude_deg": pytest.approx(41.98, abs=1e-7),
        "longitude_deg": pytest.approx(-93.64, abs=1e-7),
    }
    (fix,) = (row for row in rows if row["pgn"] == 129029)
    assert (fix["fix"], fix["hdop"], fix["name"], fix["t_ns"]) == (
        "rtk_fixed",
        0.7,
        None,
        1700000001_000000000,
    )
    lines = err.splitlines()
    assert lines[0] == f"tilth decode: 13 frames, {len(rows)} messages"
    assert "tilth decode: rejected not_available: the message says that it has no value: 1" in lines


def test_numbers_keep_their_full_precision(answer: Answer, tmp_path: Path) -> None:
    log = a_log(tmp_path / "x.log")
    decoder = Decoder()
    wanted = [message.values for frame in frames(log) for message in decoder.messages(frame)]
    found = [
        {word: value for word, value in row.items() if word in SIGNALS}
        for row in rows_of(answer("--json", log)[1])
    ]
    assert found == wanted


def test_the_machine_file_adds_its_wheel_angle_sensor(answer: Answer, tmp_path: Path) -> None:
    log = a_log(tmp_path / "x.log")
    without = rows_of(answer("--json", log)[1])
    assert not any("wheel_angle_rad" in row for row in without)
    _, out, err = answer("--json", "--machine", MACHINE_FILE, log)
    (row,) = (row for row in rows_of(out) if "wheel_angle_rad" in row)
    assert row["wheel_angle_rad"] == pytest.approx(math.radians(5.0))
    assert "bus" not in err


def test_bus_names_are_mapped(answer: Answer, tmp_path: Path) -> None:
    log = candump(tmp_path / "x.log", [(1.0, 0x18FF0B15, bytes.fromhex("01F4FFFFFFFFFFFF"))], bus="vcan7")
    _, out, err = answer("--json", "--machine", MACHINE_FILE, log)
    assert rows_of(out)[0]["bus"] == "can0" and "vcan7 is taken for can0" in err
    _, out, err = answer("--json", "--machine", MACHINE_FILE, "--bus", "vcan7=can0", log)
    assert rows_of(out)[0]["bus"] == "can0" and "taken" not in err
    assert answer("--json", "--bus", "vcan7=can0", log)[0] == 2
    assert rows_of(answer("--json", "--machine", MACHINE_FILE, "--bus", "vcan7=", log)[1]) == []


def test_a_log_of_ours_brings_its_machine_file(answer: Answer, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("r", 1, 0))
    rows: list[Frame] = list(simulate(MACHINE, 1, 3.0))
    for row in rows:
        writer.frame(row)
    writer.close()
    found = rows_of(answer("--json", path)[1])
    assert sum("wheel_angle_rad" in row for row in found) > 200
    assert {row["name"] for row in found if row["pgn"] == 129029} == {"C07891000B002711", "C07891000B002712"}
    assert {row["t_ns"] for row in found} <= {row.t_ns for row in rows}


def test_a_later_part_knows_who_has_which_address(answer: Answer, tmp_path: Path) -> None:
    live = record(tmp_path, list(simulate(MACHINE, 1, 6.0)), 3)
    _, out, err = answer("--json", *live.parts)
    alone = [answer("--json", part) for part in live.parts]
    assert out == "".join(found for _, found, _ in alone)
    last = [row for row in rows_of(alone[-1][1]) if row["pgn"] == 129029]
    assert {row["name"] for row in last} == {"C07891000B002711", "C07891000B002712"}
    assert "unidentified" not in alone[-1][2]
    for kind in ("rejected ", "not decoded: "):
        assert sum(counted(kind, e) for _, _, e in alone) == counted(kind, err) > 0


def counted(kind: str, err: str) -> int:
    """The sum of what the lines of a kind count."""
    lines = [line for line in err.splitlines() if line.startswith(f"tilth decode: {kind}")]
    return sum(int(line.rpartition(": ")[2]) for line in lines if "--help" not in line)


def test_a_state_of_another_machine_file_or_version_is_not_taken(answer: Answer, tmp_path: Path) -> None:
    rows = list(simulate(MACHINE, 1, 2.0))
    part = record(tmp_path, rows, 2).parts[1]
    machine_file = tmp_path / "m.toml"
    machine_file.write_text(MACHINE_TEXT.replace("mass = 9391.0", "mass = 9400.0"))
    status, out, err = answer("--json", "--machine", machine_file, part)
    assert status == 0 and "another version" not in err
    assert {row["name"] for row in rows_of(out) if row["pgn"] == 129029} == {None}
    path = tmp_path / "x.mcap"
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("r", 2, 0))
    writer.snapshot(rows[0].t_ns, '{"format": "of the year 2040"}')
    writer.frame(rows[0])
    writer.close()
    status, _, err = answer(path)
    assert status == 0 and "another version" in err


def test_a_line_for_a_person(answer: Answer, tmp_path: Path) -> None:
    status, out, _ = answer(a_log(tmp_path / "x.log"))
    assert status == 0
    line = next(line for line in out.splitlines() if "65267" in line)
    head = "2023-11-14 22:13:20.100000  can0      28 A00017000421E240   65267  Vehicle Position: "
    assert line.startswith(head + "latitude_deg=41.98")
    assert "(repeated)" in out
    assert any("65267  Vehicle Position: (not_available)" in line for line in out.splitlines())
    assert any("(John Deere, navigation)" in line for line in out.splitlines() if " 60928 " in line)


def test_it_says_what_it_did_not_decode(answer: Answer, tmp_path: Path) -> None:
    """By PGN with its name, and by source; a transfer by the message in it."""
    announced = bytes([32, 20, 0, 3, 255]) + (65260).to_bytes(3, "little")
    rows = [
        (1.0, 0x18EEFF1C, claim(NAME)),
        (1.1, 0x18FEEE00, bytes(8)),
        (1.2, 0x18FEEE00, bytes(8)),
        (1.3, 0x0CF00400, bytes(8)),
        (1.4, 0x18FFFF1C, b"\x51" + bytes(7)),  # a StarFire's, of a selector that no row reads
        (1.5, 0x1CECFF00, announced),
        *[(1.5 + k / 100, 0x1CEBFF00, bytes([k]) + bytes(7)) for k in (1, 2, 3)],
        (1.6, 0x1DFF1A23, bytes.fromhex("A00C41982023FFFF")),  # 130842 of Simrad, of 12 bytes
        (1.61, 0x1DFF1A23, bytes.fromhex("A1FFFFFFFFFFFFFF")),
        (1.7, 0x1DF00023, bytes(8)),
    ]
    status, out, err = answer("--json", candump(tmp_path / "x.log", rows))
    assert status == 0 and len(rows_of(out)) == 1
    collected = [line.removeprefix("tilth decode: ") for line in err.splitlines()]
    assert collected == [
        "12 frames, 1 messages",
        "not decoded: 11 frames (6 PGNs); --help lists what is decoded",
        "not decoded: 65260 Vehicle Identification: 4",
        "not decoded: 65262 Engine Temperature 1: 2",
        "not decoded: 130842 a manufacturer's own (fast packet): 2",
        "not decoded: 61444 Electronic Engine Controller 1: 1",
        "not decoded: 65535 a manufacturer's own (Proprietary B), of John Deere: 1",
        "not decoded: 126976 name not known here: 1",
        "not decoded from can0 address 0: 7",
        "not decoded from can0 address 35: 3",
        "not decoded from can0 address 28, A00017000421E240 (John Deere, navigation): 1",
    ]
    short = tmp_path / "short.log"
    short.write_text("(1.0) can0 204#00\n(1.1) can0 204#00\n")
    assert "not decoded: identifier 0x204 of 11 bits: 2" in answer("--json", short)[2]


def test_help_lists_what_is_decoded(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["decode", "--help"])
    output = capsys.readouterr().out
    for row in PGNS:
        assert f"{row.pgn} " in output and row.title in output
    assert set(SIGNALS) <= set(re.findall(r"\w+", output))


def test_a_value_that_is_dropped_is_shown_with_its_reason(answer: Answer, tmp_path: Path) -> None:
    """As a rudder at -105 deg; and a message in which nothing is available says so."""
    rows = [
        (1.0, 0x09F10D01, bytes.fromhex("00F8FF7F5EB8FFFF")),
        (1.1, 0x09F10D01, bytes.fromhex("FFFFFF7FFF7FFFFF")),
        (1.2, 0x09F10D01, bytes.fromhex("00F8FF7FFF7FFFFF")),
    ]
    log = candump(tmp_path / "x.log", rows)
    dropped, empty, no_angle = rows_of(answer("--json", log)[1])
    assert (no_angle["instance"], no_angle["reason"]) == (0, "not_available")
    assert dropped["dropped"] == {
        "wheel_angle_rad": {"value": pytest.approx(-1.8338), "reason": "out_of_range"}
    }
    assert (dropped["reason"], dropped["instance"], dropped["priority"]) == ("out_of_range", 0, 2)
    assert empty["reason"] == "not_available" and "dropped" not in empty
    text = answer(log)[1]
    assert "(wheel_angle_rad=-1.8338: out_of_range)" in text and text.count("out_of_range") == 1
    assert "Rudder: (not_available)" in text


def test_names_and_what_is_repeated_are_told(answer: Answer, tmp_path: Path) -> None:
    sky: list[dict[str, Word]] = [
        {"prn": 5, "status": "used", "elevation_rad": 0.5},
        {"prn": 66, "snr_db": 31.5},
    ]
    payload = encode(129540, {}, sid=7, groups={"sky": sky})
    frames = frames_of(129540, payload, 70)
    rows = [(1.0, 0x18EEFF1C, claim(NAME)), *[(2.0 + k / 1000, *frame) for k, frame in enumerate(frames)]]
    claimed, observed = rows_of(answer("--json", candump(tmp_path / "x.log", rows))[1])
    assert {key: claimed[key] for key in ("manufacturer", "manufacturer_name", "function_name")} == {
        "manufacturer": 33, "manufacturer_name": "John Deere", "function_name": "navigation",
    }  # fmt: skip
    assert (claimed["industry_group_name"], claimed["identity"]) == ("agriculture and forestry", 123456)
    assert (observed["sid"], observed["satellites_in_view"], observed["sky"]) == (7, 2, sky)


@pytest.mark.parametrize("path", shared_files("data/canboat"), ids=lambda path: path.name)
def test_recorded_logs(path: Path, answer: Answer) -> None:
    status, out, err = answer("--json", path)
    if status == 2:
        pytest.skip(err)  # a form that is not read
    rows = rows_of(out)
    assert status == 0
    assert f"{len(rows)} messages" in err
    for row in rows:
        assert tuple(row)[:5] == HEAD
        assert set(row) - set(HEAD) - FURTHER <= SIGNALS.keys()
        assert set(row) & (SIGNALS.keys() | {"dropped", "reason"}), "an empty row says why"
        assert row["name"] is None or len(str(row["name"])) == 16


def test_recorded_traffic_is_there() -> None:
    assert shared("data") and len(shared_files("data/canboat")) >= 7


def test_several_logs_and_what_is_wrong_with_some(answer: Answer, tmp_path: Path) -> None:
    log = a_log(tmp_path / "x.log")
    empty, image, cut = (tmp_path / name for name in ("empty.log", "x.png", "cut.log"))
    empty.touch()
    image.write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\r")
    cut.write_bytes(log.read_bytes()[:-5])
    for files, status, result in (
        ([log, empty], 1, "empty file; no frame is in it"),
        ([log, image, empty], 2, "not a log of CAN frames"),
        ([cut], 0, "cut off"),
        ([tmp_path], 2, "a folder"),
    ):
        found, out, err = answer("--json", *files)
        assert found == status
        assert result in err
        assert bool(out) == (files != [tmp_path])


def test_a_reader_that_has_had_enough_is_no_error(tmp_path: Path) -> None:
    rows = [
        (1.0 + i / 1000, 0x09F11205, bytes((i % 250, i % 100, 1, 255, 127, 255, 127, 252)))
        for i in range(20000)
    ]
    log = candump(tmp_path / "x.log", rows)
    read, write = os.pipe()
    command = [sys.executable, "-c", "import sys; from tilth.cli import main; sys.exit(main())"]
    with subprocess.Popen(
        [*command, "decode", "--json", log], stdout=write, stderr=subprocess.PIPE
    ) as process:
        os.close(write)
        with os.fdopen(read, "rb") as pipe:
            assert json.loads(pipe.readline())["pgn"] == 127250
        _, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err) == (0, b"")


def test_a_terminal_gets_a_summary(tmp_path: Path) -> None:
    """Each sender and message once; all lines where they are asked for."""
    path = a_log(tmp_path / "a.log")

    def shown(*words: str) -> str:
        end, terminal = os.openpty()
        done = subprocess.run(
            [sys.executable, "-m", "tilth.cli", "decode", str(path), *words], stdout=terminal, check=True,
            stderr=subprocess.DEVNULL, env={**os.environ, "COLUMNS": "200"},
        )  # fmt: skip
        os.close(terminal)
        os.set_blocking(end, False)
        assert done.returncode == 0
        return os.read(end, 1 << 16).decode()

    summary, lines = shown(), shown("--lines")
    assert "a second" in summary and "a second" not in lines
    assert lines.count("\n") > summary.count("\n") - 1
