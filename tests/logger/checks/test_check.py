"""`tilth check` and what it finds: each thing wrong in turn, on real buses, disks and sessions."""

import json
import os
import re
import socket
import subprocess
import sys
import threading
from argparse import ArgumentTypeError
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import can
import pytest
from logs import MACHINE, MACHINE_TEXT
from loopback import free_port, machine_text, rig, udp_bus
from paths import shared

from tilth.cli import duration, main
from tilth.logger.checks import check as check_module
from tilth.logger.checks.check import _configuration, _field_map, check
from tilth.logger.checks.finding import CheckFinding, Level
from tilth.logger.clock import Clock, Relation
from tilth.logger.machine_file import read_machine
from tilth.logger.warm_start_file import text_of
from tilth.replay.discover import BusSurvey
from tilth.replay.machine_draft import draft
from tilth.schemas.machine import MachineError
from tilth.schemas.machine_toml import parse_machine

VIRTUAL = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-check"\n\n'
OTHER = MACHINE.model_copy(update={"tractor": MACHINE.tractor.model_copy(update={"a": MACHINE.tractor.b})})
SECONDS = 0.4  # long enough that a busy computer hears the other thread


@pytest.fixture
def talking() -> Iterator[None]:
    """Somebody who sends on the virtual bus all the time."""
    stop = threading.Event()
    with can.Bus(interface="virtual", channel="tilth-check") as bus:

        def talk() -> None:
            while not stop.wait(0.005):
                bus.send(can.Message(arbitration_id=0x18FF0001, is_extended_id=True, data=b"x"))

        thread = threading.Thread(target=talk)
        thread.start()
        yield
        stop.set()
        thread.join()


def of(findings: list[CheckFinding], what: str) -> CheckFinding:
    (one,) = [finding for finding in findings if finding.what == what]
    return one


@pytest.mark.usefixtures("talking")
def test_all_is_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "m.toml"
    file.write_text(machine_text(tmp_path / "logs", VIRTUAL))
    assert main(["check", str(file), "--seconds", str(SECONDS)]) == 0
    out, err = capsys.readouterr()
    assert err == "" and "OK       bus can0: " in out and " frames in " in out
    assert "hours of recording" in out and not (tmp_path / "logs").exists()

    assert main(["check", str(file), "--json", "--seconds", str(SECONDS)]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["ok"] is True
    whats = [row["what"] for row in answer["checks"]]
    assert whats[:4] == ["configuration", "loads", "yaw inertia", "bus can0"]
    assert {"log folder", "disk", "clock", "zenoh"} <= set(whats)
    assert {row["state"] for row in answer["checks"]} <= {"ok", "note", "warning"}


def test_a_silent_bus_a_missing_one_and_a_folder_in_the_way(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "logs").write_text("in the way")
    missing = '[[bus]]\nname = "can9"\ninterface = "socketcan"\nchannel = "nosuchcan9"\n\n'
    file = tmp_path / "m.toml"
    file.write_text(machine_text(tmp_path / "logs" / "deep", udp_bus("can0", free_port()), missing))
    assert main(["check", str(file), "--json", "--seconds", str(SECONDS)]) == 1
    out, err = capsys.readouterr()
    answer = json.loads(out)
    found = {row["what"]: row for row in answer["checks"] if row["state"] == "problem"}
    assert answer["ok"] is False and err == "" and set(found) == {"bus can0", "bus can9", "log folder"}
    assert "silent" in found["bus can0"]["text"] and "nosuchcan9" in found["bus can9"]["text"]
    assert all(";" in row["text"] for row in found.values())  # each says what to do


@pytest.mark.usefixtures("talking")
def test_a_zenoh_port_that_is_taken_is_worth_a_note_and_a_wrong_one_is_a_problem(tmp_path: Path) -> None:
    machine, _ = rig(tmp_path, VIRTUAL)
    port = int(machine.zenoh.listen[0].rpartition(":")[2])
    with socket.create_server(("127.0.0.1", port)):
        taken = of(check(machine, tmp_path, SECONDS), "zenoh")
    assert taken.state == Level.NOTE and str(port) in taken.text
    wrong = machine.model_copy(update={"zenoh": machine.zenoh.model_copy(update={"listen": ["nonsense"]})})
    assert of(check(wrong, tmp_path, SECONDS), "zenoh").state == Level.PROBLEM
    assert of(check(machine, tmp_path, SECONDS), "zenoh").state == Level.OK
    wide = machine.model_copy(
        update={"zenoh": machine.zenoh.model_copy(update={"listen": [f"udp/0.0.0.0:{free_port()}"]})}
    )
    found = of(check(wide, tmp_path, SECONDS), "zenoh")
    assert found.state == Level.NOTE and "anybody on that network could read and answer" in found.text


@pytest.mark.usefixtures("talking")
def test_a_configuration_that_is_open_to_everybody_is_a_problem_until_it_is_said_to_be_meant(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`run` refuses it with the same words, before it opens a bus; without Zenoh it does not matter."""
    listen = {"endpoints": [f"tcp/0.0.0.0:{free_port(socket.SOCK_STREAM)}"]}
    scouting = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    (tmp_path / "router.json5").write_text(json.dumps({"listen": listen, "scouting": scouting}))
    file = tmp_path / "m.toml"
    text = re.sub(r"listen = .*", 'config = "router.json5"', machine_text(tmp_path / "logs", VIRTUAL))
    words = f"open to everybody on this network: it listens on {listen['endpoints'][0]} without keys"

    file.write_text(text)
    assert of(check(read_machine(file)[0], tmp_path, SECONDS), "zenoh").state == Level.PROBLEM
    assert main(["check", str(file), "--seconds", str(SECONDS)]) == 1
    assert words in " ".join(capsys.readouterr().out.split())
    assert main(["run", str(file), "--seconds", "0.1"]) == 2
    err = capsys.readouterr().err
    assert words in err and "open = true" in err and not (tmp_path / "logs").exists()

    file.write_text(text.replace("config =", "open = true\nconfig ="))
    found = of(check(read_machine(file)[0], tmp_path, SECONDS), "zenoh")
    assert found.state == Level.NOTE and words in found.text and "may read, mark and speak" in found.text


class OddClock(Clock):
    """The computer's clock says something else than at the start."""

    ahead_s = 0.0

    def relation(self) -> Relation:
        now = super().relation()
        return replace(now, realtime_ns=now.realtime_ns + int(self.ahead_s * 1e9))


@pytest.mark.parametrize(
    ("ahead_s", "state", "words"),
    [
        (0.0, Level.OK, "UTC"),
        (-1.7e9, Level.PROBLEM, "cannot be; set the clock"),  # no battery: it starts in 1970
        (5.0, Level.PROBLEM, "set anew while this check ran"),
    ],
)
@pytest.mark.usefixtures("talking")
def test_the_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ahead_s: float, state: str, words: str
) -> None:
    monkeypatch.setattr(check_module, "Clock", OddClock)
    monkeypatch.setattr(OddClock, "ahead_s", ahead_s)
    found = of(check(rig(tmp_path, VIRTUAL)[0], tmp_path, SECONDS), "clock")
    assert found.state == state and words in found.text


DBC = """VERSION ""
NS_ :
BS_:
BU_: Vector__XXX
BO_ 2566844949 WAS: 8 Vector__XXX
 SG_ Angle : 0|16@1- (0.01,0) [-90|90] "deg" Vector__XXX
"""
WHEEL = '[wheel_angle]\nbus = "can0"\ndbc = "was.dbc"\nsignal = "Angle"\n\n'


def test_a_dbc_file_is_found_beside_the_machine_file(tmp_path: Path) -> None:
    text = machine_text(tmp_path, VIRTUAL)
    text = text[: text.index("[wheel_angle]")] + WHEEL + text[text.index("[log]") :]
    file = tmp_path / "m.toml"
    file.write_text(text)
    with pytest.raises(MachineError, match=r"was\.dbc: the wheel_angle\.dbc cannot be read \(no such file"):
        read_machine(file)
    (tmp_path / "was.dbc").write_text(DBC)
    machine, same = read_machine(file)
    assert machine.wheel_angle.dbc_text == DBC and same == text
    file.write_bytes(b"\xff\xfe")
    with pytest.raises(MachineError, match="not UTF-8"):
        read_machine(file)


ANSI_DBC = DBC.replace('"deg"', '"°"') + 'CM_ SG_ 2566851349 Angle "Lenkwinkel der Vorderräder";\n'


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_files_as_windows_editors_save_them(encoding: str, end: str, tmp_path: Path) -> None:
    text = machine_text(tmp_path, VIRTUAL)
    text = text[: text.index("[wheel_angle]")] + WHEEL + text[text.index("[log]") :]
    file = tmp_path / "m.toml"
    mark = b"\xef\xbb\xbf" if encoding == "utf-8-sig" else b""
    file.write_bytes(mark + text.replace("\n", end).encode())
    (tmp_path / "was.dbc").write_bytes(ANSI_DBC.replace("\n", end).encode(encoding))
    machine, same = read_machine(file)
    assert machine.wheel_angle.dbc_text == ANSI_DBC and same == text
    file.write_bytes(text.replace("# ", "# ä", 1).encode("cp1252") + "# ä\n".encode("cp1252"))
    with pytest.raises(MachineError, match="not UTF-8 text; save it as UTF-8"):
        read_machine(file)
    for name in ("m.toml", "was.dbc"):
        file.write_text(text)
        (tmp_path / name).write_text(text, encoding="utf-16")
        with pytest.raises(MachineError, match=f"{name}: the .* is UTF-16, not UTF-8"):
            read_machine(file)


@pytest.mark.parametrize("name", ["machine-bom.toml", "degrees-cp1252.toml", "degrees-utf8-bom.toml"])
def test_given_files_of_windows_editors(name: str) -> None:
    machine, text = read_machine(shared(f"data/strangers/second/{name}"))
    assert machine.name == "jd7930-parker500" and text.startswith("# The")
    assert machine.wheel_angle.dbc is None or "Vorderräder" in (machine.wheel_angle.dbc_text or "")


def test_a_log_or_an_unfinished_draft_is_no_machine_file(tmp_path: Path) -> None:
    file = tmp_path / "some.mcap"
    file.write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(
        MachineError, match=r"a log, not a machine file; to read it: .*tilth replay .*some\.mcap"
    ):
        read_machine(file)
    file = tmp_path / "draft.toml"
    file.write_text(draft(BusSurvey().findings(), []))
    with pytest.raises(MachineError, match=r'line 9 and \d+ more still marked "FILL IN"'):
        read_machine(file)
    file.write_text("[machine]\nname = # FILL IN: a name\n")
    with pytest.raises(MachineError, match='line 2 still marked "FILL IN"'):
        read_machine(file)


@pytest.mark.parametrize("words", ["nan", "inf", "0", "-1", "x"])
def test_a_duration_is_a_number_above_zero(words: str) -> None:
    with pytest.raises((ArgumentTypeError, ValueError)):
        duration(words)
    assert duration("0.5") == 0.5


def test_a_reader_that_leaves_does_not_change_the_exit_status(tmp_path: Path) -> None:
    """As `tilth run … | true`: a run without a frame is 1 whether or not anybody reads its words."""
    file = tmp_path / "m.toml"
    file.write_text(machine_text(tmp_path / "logs", VIRTUAL))
    reading, writing = os.pipe()
    os.close(reading)
    code = 'import sys; sys.modules["asammdf"] = None; from tilth.cli import main; raise SystemExit(main())'
    words = [sys.executable, "-c", code, "run", str(file), "--no-zenoh", "--seconds", "0.2"]
    with os.fdopen(writing, "wb") as gone:
        ended = subprocess.run(
            words, stdout=gone, stderr=subprocess.PIPE, text=True, timeout=120, check=False
        )
    assert (ended.returncode, ended.stderr) == (1, "")


def test_what_a_scale_would_show_is_said_with_ballast() -> None:
    """Moments by hand: 600 kg, 1.2 m ahead of the front axle, load it with more than they weigh."""
    ballast = "[[tractor.ballast]]\nmass = 600\nahead_of_axle = 4.1\nheight = 0.9\n"
    bare, loaded = (
        next(found.text for found in _configuration(parse_machine(text)) if found.what == "loads")
        for text in (MACHINE_TEXT, f"{MACHINE_TEXT}\n{ballast}")
    )
    assert bare.startswith("tractor 9391 kg, implement 2127 kg; on a scale the front axle")
    assert loaded.startswith("tractor 9991 kg, implement 2127 kg (with 600 kg of ballast on the tractor)")
    front = [float(text.split("front axle stands at ")[1].split(" kg")[0]) for text in (bare, loaded)]
    assert front[1] - front[0] == pytest.approx(600 * 4.1 / 2.9, abs=1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "is not there"),
        ('{"type": "FeatureCollection", "features": []}', "is another kind of file"),  # a map for people
        ("[]", "is another kind of file"),
        ("not", "cannot be read"),
        (text_of(MACHINE, {}, 0), "holds no map"),
        (text_of(OTHER, {}, 0), "[tractor] of the machine file changed"),
    ],
)
def test_a_field_map_that_cannot_be_used_is_told_before_the_run(
    text: str | None, said: str, tmp_path: Path
) -> None:
    file = tmp_path / "field.json"
    if text is not None:
        file.write_text(text)
    estimation = MACHINE.estimation.model_copy(update={"field_map": str(file)})
    (found,) = _field_map(MACHINE.model_copy(update={"estimation": estimation}), Clock())
    assert found.state is Level.WARNING and said in found.text and "tilth map" in found.text
    assert list(_field_map(MACHINE, Clock())) == []
