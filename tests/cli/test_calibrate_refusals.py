"""What `tilth calibrate` refuses: a sentence, an exit status, and the old file as it was."""

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest
from logs import MACHINE, MACHINE_TEXT, OTHER_TEXT, write_candump, write_mcap

from tilth.cli import main
from tilth.estimator.calibration.drive import MOUNTS
from tilth.schemas.can_id import split
from tilth.schemas.flow import Frame
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.scenario import Fault, Scenario, parse_scenario
from tilth.simulator.simulate import SimulationInput, simulate_to
from tilth.simulator.traffic import simulate

pytestmark = pytest.mark.long


ROWS = parse_scenario("seconds = 70.0\nsteering = [[70.0, 0.0]]\nspeed = 3.0\n")
SHORT_S = 10.0
FLOATING = Scenario(faults=tuple(Fault(mount, 0.0, SHORT_S, "rtk_float") for mount in MOUNTS))
CLAIM = 60928
OLD = "# what was there before\n"


class Driven(NamedTuple):
    """Rows, as another program logs them: all other logs are made of it."""

    log: Path
    frames: list[Frame]


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Driven:
    frames = list(simulate(MACHINE, 3, ROWS.seconds, ROWS))
    return Driven(write_candump(tmp_path_factory.mktemp("rows") / "rows.log", frames), frames)


def _short(at: Path, rows: Driven) -> list[Path]:
    last_ns = rows.frames[0].t_ns + round(SHORT_S * 1e9)
    return [write_candump(at / "short.log", (frame for frame in rows.frames if frame.t_ns < last_ns))]


def _floating(at: Path, rows: Driven) -> list[Path]:
    return [write_candump(at / "floating.log", simulate(MACHINE, 3, SHORT_S, FLOATING))]


def _then_another(at: Path, rows: Driven) -> list[Path]:
    """In one log: the rig, and later, when it is away, one whose receivers have other addresses."""
    later_ns = 200 * 10**9
    others = (
        replace(frame, t_ns=frame.t_ns + later_ns, rx_ns=frame.rx_ns + later_ns, can_id=frame.can_id ^ 0x40)
        for frame in rows.frames
        if split(frame.can_id).pgn != CLAIM
    )
    return [write_candump(at / "both.log", (*rows.frames, *others))]


def _copied(log: Path, at: Path) -> Path:
    return Path(shutil.copy(log, at / "copy.log"))


def _of_two_files(at: Path, rows: Driven) -> list[Path]:
    """Two logs of Tilth's own, with the machine files of two rigs in them."""
    paths = [at / "one.mcap", at / "other.mcap"]
    for path, text in zip(paths, (MACHINE_TEXT, OTHER_TEXT), strict=True):
        simulate_to(
            SimulationInput(parse_machine(text), text, ROWS, "", 3, 2.0), path, lambda what, at_s: None
        )
    return paths


def _empty(at: Path, rows: Driven) -> list[Path]:
    path = at / "empty.log"
    path.touch()
    return [path]


def _prose(at: Path, rows: Driven) -> list[Path]:
    path = at / "prose.log"
    path.write_text("it rained\n")
    return [path]


def _only_rows(at: Path, rows: Driven) -> list[Path]:
    return [rows.log]


Make = Callable[[Path, Driven], list[Path]]
PART_TEXT = MACHINE_TEXT.replace("A00017000421E24", "A00017000421F24")
LONGER = MACHINE_TEXT.replace("position = [1.60, 0.0, 2.9]", "position = [3.60, 0.0, 2.9]")
NO_WHEEL = re.sub(r"(\[wheel_angle\][^\[]*?\nid = )\S+", r"\g<1>0x0CFF7777", MACHINE_TEXT)
CASES: dict[str, tuple[Make, str, int, str]] = {  # logs, machine file, exit status, sentence
    "rows only": (_only_rows, MACHINE_TEXT, 1, "the drive has rows only"),
    "too short": (_short, MACHINE_TEXT, 1, "less than a minute of driving"),
    "no RTK": (_floating, MACHINE_TEXT, 1, "implement_front, implement_rear had no RTK fix"),
    "two rigs in a log": (_then_another, MACHINE_TEXT, 1, "two rigs are in this: the receivers at"),
    "two machine files": (_of_two_files, MACHINE_TEXT, 1, "are of two rigs: by the machine files in them"),
    "twice the same time": (
        lambda at, rows: [rows.log, _copied(rows.log, at)], MACHINE_TEXT, 1, "copy.log begins before",
    ),
    "one log twice": (lambda at, rows: [rows.log, rows.log], MACHINE_TEXT, 1, "rows.log is given twice"),
    "a file of other devices": (_only_rows, OTHER_TEXT, 1, "none of the receivers of the machine file is in"),
    "who is there then": (_only_rows, OTHER_TEXT, 1, "come from other devices: address 28 on can0 (NAME A00"),
    "a part of its devices": (_only_rows, PART_TEXT, 1, "no position of tractor_front, tractor_rear is in"),
    "a file of other lengths": (_only_rows, LONGER, 1, "m closer than in the machine file: it is of another"),
    "a file of another wheel": (_only_rows, NO_WHEEL, 1, "no wheel angle is in the drive"),
    "nothing in it": (_empty, MACHINE_TEXT, 1, "empty.log: an empty file"),
    "no log": (_prose, MACHINE_TEXT, 2, "prose.log: not a log of CAN frames"),
    "not there": (lambda at, rows: [at / "none.log"], MACHINE_TEXT, 2, "none.log: no such file"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_it_is_said_why_and_the_old_file_stays(
    case: str, rows: Driven, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, text, status, sentence = CASES[case]
    logs, kept = tmp_path / "logs", tmp_path / "kept"
    logs.mkdir()
    kept.mkdir()
    (logs / "m.toml").write_text(text, encoding="utf-8")
    (kept / "m.toml").write_text(OLD, encoding="utf-8")
    words = ["--machine", str(logs / "m.toml"), "--out", str(kept / "m.toml"), "--yes"]
    words += ["--report", str(kept / "report.html")]
    assert main(["calibrate", *map(str, make(logs, rows)), *words]) == status
    said = capsys.readouterr()
    assert said.out == "" and sentence in said.err
    assert all(line.startswith("tilth calibrate: ") for line in said.err.splitlines())
    assert [path.name for path in kept.iterdir()] == ["m.toml"]
    assert (kept / "m.toml").read_text(encoding="utf-8") == OLD


def test_without_a_terminal_each_stage_is_a_line(
    rows: Driven, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    machine = tmp_path / "m.toml"
    machine.write_text(MACHINE_TEXT, encoding="utf-8")
    assert main(["calibrate", str(rows.log), "--machine", str(machine)]) == 1
    said = capsys.readouterr().err.splitlines()
    assert said[:2] == ["tilth calibrate: reading …", "tilth calibrate: looking at the drive …"]
    assert main(["calibrate", str(rows.log), "--machine", str(machine), "--json"]) == 1
    assert "…" not in capsys.readouterr().err


def test_a_log_that_is_cut_off_is_said(
    rows: Driven, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = write_mcap(tmp_path / "cut.mcap", rows.frames[:5000], finish=False)
    assert main(["calibrate", str(cut)]) == 1
    assert f"{cut}: cut off; replayed as far as it is whole\n" in capsys.readouterr().err


def test_two_machine_files_are_no_better_without_one_that_is_given(
    rows: Driven, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", *map(str, _of_two_files(tmp_path, rows))]) in (1, 2)
    assert "two rigs" in capsys.readouterr().err
