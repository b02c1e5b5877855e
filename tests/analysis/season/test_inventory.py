"""Folders and sticks of logs: what is found there, and why some of it is not used."""

import os
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from logs import MACHINE, MACHINE_TEXT, OTHER_TEXT, SECOND, START_NS, some_frames, write_candump, write_mcap

from tilth.analysis.season import inventory
from tilth.analysis.season.inventory import RECOVERED, Inventory, take_inventory
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.schemas.machine_toml import MachineFile

DAEMONS = "0" * 31 + "1"  # an id of a run
FILE = MachineFile(MACHINE, MACHINE_TEXT)


def taken(*paths: Path, out: Path, given: MachineFile | None = None) -> Inventory:
    out.mkdir(exist_ok=True)
    return take_inventory([str(path) for path in paths], out, given, lambda what, done, of: None)


def part(path: Path, number: int, count: int = 50, run: str = DAEMONS) -> Path:
    writer = LogWriter(path, FILE, RunPart(run, number, START_NS))
    for frame in some_frames(count):
        writer.frame(frame)
    writer.close()
    return path


def test_parts_of_a_run_are_one_and_copies_and_halves_are_told_of(tmp_path: Path) -> None:
    logs, stick = tmp_path / "logs", tmp_path / "stick"
    logs.mkdir()
    (stick / "deep").mkdir(parents=True)
    second, first = part(logs / "a_002.mcap", 2, 80), part(logs / "a_001.mcap", 1, 90)
    shutil.copy(first, stick / "deep" / "copy.mcap")
    half = part(stick / "half.mcap", 2, 30)
    found = taken(logs, stick, out=tmp_path / "out")
    (run,) = found.runs
    assert [file.path for file in run.files] == [str(first), str(second)]
    why = dict(found.left_out)
    assert why[str(stick / "deep" / "copy.mcap")] == f"a copy of {first}"
    assert why[str(half)] == f"holds less of the same driving as {second}"


def test_runs_are_ordered_by_time_then_name_and_those_without_a_time_come_last(tmp_path: Path) -> None:
    for name, at_ns in (
        ("b", START_NS + SECOND),
        ("c", 5 * SECOND),
        ("a", START_NS + SECOND),
        ("z", START_NS),
    ):
        writer = LogWriter(tmp_path / f"{name}.mcap", FILE, RunPart(name, 1, at_ns))
        for k, frame in enumerate(some_frames(3, seed=ord(name))):
            writer.frame(replace(frame, t_ns=at_ns + k, rx_ns=at_ns + k))
        writer.close()
    found = taken(tmp_path, out=tmp_path / "out")
    assert [run.name for run in found.runs] == ["z", "a", "b", "c"]
    assert found.runs[-1].utc_ns is None


def test_a_cut_log_is_recovered_into_the_seasons_folder_and_stays_as_it_was(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "cut.mcap", some_frames(400), finish=False)
    path.write_bytes(path.read_bytes()[:-40])
    before = path.read_bytes()
    found = taken(path, out=tmp_path / "out")
    (file,) = found.runs[0].files
    assert path.read_bytes() == before
    assert Path(file.read_at).parent == tmp_path / "out" / RECOVERED and "cut off" in file.told
    assert not list((tmp_path / "out").rglob("*.part"))
    assert taken(path, out=tmp_path / "out").runs == found.runs


BAD: dict[str, tuple[Callable[[Path], object], str]] = {
    "zero mass": (
        lambda path: write_mcap(
            path, some_frames(9), text=re.sub("(?m)^mass = .*$", "mass = 0.0", MACHINE_TEXT)
        ),
        "machine file",
    ),
    "no log": (lambda path: path.write_text("a shopping list\n"), "not a log"),
    "nothing": (lambda path: path.touch(), "empty"),
    "cut at its head": (
        lambda path: path.write_bytes(write_mcap(path, some_frames(9)).read_bytes()[:30]),
        "all of it was cut off",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_a_bad_file_has_a_reason_and_the_rest_goes_on(what: str, tmp_path: Path) -> None:
    make, said = BAD[what]
    make(tmp_path / "bad.mcap")
    good = write_mcap(tmp_path / "good.mcap", some_frames(20))
    found = taken(tmp_path, out=tmp_path / "out")
    assert [run.files[0].path for run in found.runs] == [str(good)]
    ((path, why),) = found.left_out
    assert path == str(tmp_path / "bad.mcap") and said in why and len(why) < 300


def test_a_folder_that_cannot_be_read_has_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As root may read all, the system is asked to refuse."""
    write_mcap(tmp_path / "good.mcap", some_frames(20))
    (tmp_path / "locked").mkdir()
    walk = os.walk

    def refused(top: Path, onerror: Callable[[OSError], object]) -> Iterator[object]:
        yield from walk(top, onerror=onerror)
        onerror(PermissionError(13, "Permission denied", str(tmp_path / "locked")))

    monkeypatch.setattr(os, "walk", refused)
    found = taken(tmp_path, out=tmp_path / "out")
    assert len(found.runs) == 1
    assert found.left_out[0][0] == str(tmp_path / "locked") and "cannot be read" in found.left_out[0][1]


def test_what_lies_beside_logs_and_the_seasons_own_folder_are_passed_over(tmp_path: Path) -> None:
    write_mcap(tmp_path / "good.mcap", some_frames(20))
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8\xff")
    (tmp_path / "note.txt").write_text("hollow in row 3")
    out = tmp_path / "out"
    out.mkdir()
    write_mcap(out / "own.mcap", some_frames(30))
    found = taken(tmp_path, out=out)
    assert len(found.runs) == 1 and not found.left_out


def test_machines_are_kept_apart_and_a_log_of_others_takes_the_given_file(tmp_path: Path) -> None:
    write_mcap(tmp_path / "one.mcap", some_frames(20))
    write_mcap(tmp_path / "two.mcap", some_frames(21), text=OTHER_TEXT, run="other")
    write_candump(tmp_path / "three.log", some_frames(22))
    found = taken(tmp_path, out=tmp_path / "out")
    machines = {run.name: run.machine for run in found.runs}
    assert machines["one"] != machines["two"] and not machines["three"]
    found = taken(tmp_path, out=tmp_path / "out", given=FILE)
    assert {run.name: run.machine for run in found.runs}["three"] == FILE.sha256


def test_what_was_seen_is_not_read_again_unless_it_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_mcap(tmp_path / "one.mcap", some_frames(20))
    first = taken(path, out=tmp_path / "out")
    monkeypatch.setattr(inventory, "_look", lambda *args: pytest.fail("read again"))
    assert taken(path, out=tmp_path / "out").runs == first.runs
    monkeypatch.undo()
    path.unlink()
    write_mcap(path, some_frames(25))
    assert taken(path, out=tmp_path / "out").runs != first.runs
