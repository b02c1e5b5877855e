"""Folders as cards, sticks and shares have them: read-only, without locks, full, with strange names."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from logs import some_frames, write_mcap
from loopback import machine_text, rig
from refused import refusing
from small_disk import READ_ONLY, TILTH, on_a_small_disk

from tilth.cli import main
from tilth.logger.daemon import Daemon
from tilth.logger.display import NoDisplay
from tilth.logger.log.runs import stored_runs
from tilth.replay.survey import survey
from tilth.schemas.flow import Event
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.sentences import event_sentence

NAME = "rig_20260301T080000Z"
OTHER = "rig_20260302T080000Z"
NO_LOCKS = ("flock", "EOPNOTSUPP")


class Told(NoDisplay):
    def __init__(self) -> None:
        self.events: list[Event] = []

    def event(self, event: Event) -> None:
        self.events.append(event)


def part(folder: Path, run: str, number: int, finish: bool = True) -> Path:
    folder.mkdir(exist_ok=True)
    return write_mcap(folder / f"{run}_{number:03d}.mcap", some_frames(300, number), finish=finish)


def test_a_card_that_is_read_only_is_copied_whole(tmp_path: Path) -> None:
    card, stick = tmp_path / "card", tmp_path / "stick"
    paths = [
        part(card, NAME, 1),
        part(card, NAME, 2),
        part(card, OTHER, 1),
        part(card, OTHER, 2, finish=False),
    ]
    before = {path.name: path.read_bytes() for path in paths}
    stick.mkdir()
    words: tuple[str | Path, ...] = (*TILTH, "offload", stick, "--log", card)
    for _ in range(2):
        done = on_a_small_disk(card, READ_ONLY, *words)
        assert done.status == 0 and done.out.count("2 files copied and compared") == 2
        (said,) = [line for line in done.err.splitlines() if "same disk" not in line]
        assert f"{card}: read-only file system; it cannot be noted there" in said
        assert {path.name: path.read_bytes() for path in stick.glob("*.mcap")} == before
    copied = {run.name: run.sidecar().copied for run in stored_runs(stick)}
    assert [sorted(copied[name]) for name in (NAME, OTHER)] == [sorted(before)[:2], sorted(before)[2:]]


@pytest.mark.parametrize("words", [("--keep", NAME), ("--release", NAME), ("--note", NAME, "clay")])
def test_what_cannot_be_noted_is_said_in_a_line(words: tuple[str, ...], tmp_path: Path) -> None:
    part(tmp_path, NAME, 1)
    done = on_a_small_disk(tmp_path, READ_ONLY, *TILTH, "logs", tmp_path, *words)
    assert done.status == 1 and NAME in done.out
    assert done.err == f"tilth logs: {tmp_path}: read-only file system; it cannot be noted there\n"


def test_one_run_that_cannot_be_read_hides_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    part(tmp_path, NAME, 1)
    part(tmp_path, OTHER, 1)
    (tmp_path / f"{NAME}.json").write_text("[" * 200_000)
    os.mkfifo(tmp_path / f"{OTHER}_002.mcap")
    os.mkfifo(tmp_path / f"{OTHER}.json")
    assert main(["logs", str(tmp_path), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["run"], row["frames"]) for row in rows] == [(NAME, 300), (OTHER, 300)]
    assert ["mend or remove it" in rows[0]["unreadable"][0], "is no file" in rows[1]["unreadable"][0]] == [
        1,
        1,
    ]
    assert main(["logs", str(tmp_path)]) == 0
    assert main(["offload", str(tmp_path / "none"), "--log", str(tmp_path)]) == 2
    stick = tmp_path / "stick"
    stick.mkdir()
    assert main(["offload", str(stick), "--log", str(tmp_path)]) == 1
    said = capsys.readouterr().err
    assert f"left: {NAME}" in said and f"left: {OTHER}" in said


# No locks


def without_locks(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*refusing(*NO_LOCKS), *map(str, (*TILTH, *words))], capture_output=True, text=True, check=False
    )


def test_without_locks_it_records_and_says_so(tmp_path: Path) -> None:
    machine, logs = tmp_path / "machine.toml", tmp_path / "logs"
    bus = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "none"\n\n'
    machine.write_text(machine_text(logs, bus))
    checked = without_locks("check", machine, "--seconds", "0.1", "--json")
    (note,) = [row for row in json.loads(checked.stdout)["checks"] if "no locks" in row["text"]]
    assert (note["what"], note["state"]) == ("log folder", "note")
    done = without_locks("run", machine, "--seconds", "1.5", "--plain", "--no-zenoh")
    assert done.stdout.count("has no locks") == 1 and "not recording" not in done.stdout
    (log,) = logs.glob("*.mcap")
    (read,) = survey([log])
    assert read.good and [event.text for event in read.events if "no locks" in event.text]


@pytest.mark.long
def test_without_locks_logs_are_read_and_finished_all_the_same(tmp_path: Path) -> None:
    whole, cut = part(tmp_path, NAME, 1), part(tmp_path, OTHER, 1, finish=False)
    os.utime(cut, (1e9, 1e9))
    assert without_locks("verify", whole).returncode == 0
    assert "unfinished" in without_locks("logs", tmp_path).stdout
    assert without_locks("replay", whole, "--out", tmp_path / "again.mcap").returncode == 0
    assert without_locks("recover", cut).returncode == 0
    assert survey([cut])[0].good


def test_without_locks_what_grows_is_not_finished(tmp_path: Path) -> None:
    """Also where the clock of a share is another one."""
    cut = part(tmp_path, NAME, 1, finish=False)
    grow = (
        "import os, sys, time\n"
        "while os.getppid() > 1:\n"
        "    with open(sys.argv[1], 'ab') as file: file.write(bytes(9))\n"
        "    os.utime(sys.argv[1], (1e9, 1e9)); time.sleep(0.3)\n"
    )
    with subprocess.Popen([sys.executable, "-c", grow, str(cut)]) as recorder:
        try:
            done = without_locks("recover", cut)
        finally:
            recorder.kill()
    assert done.returncode == 1 and "is being recorded" in done.stdout + done.stderr


# Names


def strange(folder: Path) -> Path:
    """A log with a name that is not UTF-8."""
    folder.mkdir(exist_ok=True)
    return part(folder, os.fsdecode(b"caf\xe9_20260301T080000Z"), 1)


COMMANDS: dict[str, tuple[str, ...]] = {
    "logs": ("logs", "FOLDER"),
    "logs as JSON": ("logs", "FOLDER", "--json"),
    "keep": ("logs", "FOLDER", "--keep", os.fsdecode(b"caf\xe9_20260301T080000Z")),
    "verify": ("verify", "LOG"),
    "verify as JSON": ("verify", "LOG", "--json"),
    "recover": ("recover", "LOG"),
    "offload": ("offload", "OUT", "--log", "FOLDER"),
    "decode": ("decode", "LOG"),
    "replay": ("replay", "LOG", "--out", "OUT/again.mcap"),
    "replay as JSON": ("replay", "LOG", "--json"),
    "export": ("export", "LOG", "--to", "csv", "--out", "OUT/csv"),
    "report": ("report", "LOG", "--out", "OUT/report.html"),
    "fit": ("fit", "LOG"),
    "compare": ("compare", "LOG", "LOG"),
    "calibrate": ("calibrate", "LOG", "--out", "OUT/machine.toml"),
    "discover": ("discover", "LOG", "--out", "OUT/draft.toml"),
}


@pytest.mark.parametrize("what", COMMANDS)
def test_a_name_that_is_not_utf8_ends_nothing(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = strange(tmp_path / "logs")
    (tmp_path / "out").mkdir()
    places = {"LOG": str(log), "FOLDER": str(log.parent)}
    words = [places.get(word, word).replace("OUT", str(tmp_path / "out")) for word in COMMANDS[what]]
    status = main(words)
    out, err = capsys.readouterr()
    assert status in (0, 1, 2) and "Traceback" not in err, err
    if "JSON" in what:
        assert os.fsdecode(b"caf\xe9") in json.dumps(json.loads(out), ensure_ascii=False) or what[0] == "r"


def test_one_that_was_left_unfinished_ends_no_run(tmp_path: Path) -> None:
    """What is said of it is an event, and an event is stored and published."""
    part(tmp_path, os.fsdecode(b"caf\xe9_20260301T080000Z"), 1, finish=False)
    machine, text = rig(tmp_path, '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "none"\n\n')
    told = Told()
    daemon = Daemon(MachineFile(machine, text), tmp_path, None, told)
    while not any(event.kind == "log" for event in told.events):
        daemon.turn(0.05)
    daemon.close()
    assert "finished now: 300 messages" in event_sentence(told.events[-1])
