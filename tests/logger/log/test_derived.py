"""What can be made again goes, the oldest first, as far as needed; nothing else ever does."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from logs import MACHINE, MACHINE_TEXT, write_candump

from tilth.analysis.runs.kept import caches
from tilth.analysis.runs.replayed import replayed
from tilth.logger.clock import Clock
from tilth.logger.log.derived import RECENT_S, Derived, reports_in
from tilth.logger.log.room import Room
from tilth.replay.kept_room import NoRoom
from tilth.replay.prepared import prepare
from tilth.schemas.machine_toml import MachineFile
from tilth.simulator.traffic import simulate

SIZE = 1000
HOUR_S = 3600.0
OURS = re.compile(r"[a-z]\d+\.(html|json)|sub/\d+\.npz")


def made(path: Path, hours: float, size: int = SIZE) -> Path:
    """Last written so many hours ago."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(size))
    at_s = Clock().t_ns() * 1e-9 - hours * HOUR_S
    os.utime(path, (at_s, at_s))
    return path


def left(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


@given(
    hours=st.lists(st.integers(0, 360_000).map(lambda s: s / 3600.0), min_size=1, max_size=8),
    most=st.integers(0, 10),
)
def test_the_oldest_go_as_far_as_needed(
    hours: list[float], most: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("derived")
    paths = [made(folder / f"a{k}.html", age) for k, age in enumerate(hours)]
    kept_log = made(folder / "field_20260101T000000Z_001.mcap", 1000.0)
    assert Derived(folder, OURS, most * SIZE, 0.0).make_room()
    gone = [age for path, age in zip(paths, hours, strict=True) if not path.exists()]
    stay = [age for path, age in zip(paths, hours, strict=True) if path.exists()]
    assert kept_log.exists() and all(age * HOUR_S >= RECENT_S for age in gone)
    assert not gone or not stay or min(gone) >= max(stay)
    old = [age for age in hours if age * HOUR_S > RECENT_S + 60]
    assert len(gone) >= min(len(old), len(hours) - most) and len(gone) <= max(0, len(hours) - most)


def test_a_report_goes_with_its_numbers_and_a_folder_with_all_of_it(tmp_path: Path) -> None:
    for name, hours in (("a1.html", 9), ("a1.json", 8), ("sub/1.npz", 7), ("sub/2.npz", 6), ("a2.html", 5)):
        made(tmp_path / name, hours)
    kept = Derived(tmp_path, OURS, 3.5 * SIZE, 0.0)
    assert kept.make_room() and left(tmp_path) == ["a2.html", "sub/1.npz", "sub/2.npz"]
    assert kept.make_room(SIZE) and left(tmp_path) == ["a2.html"] and not (tmp_path / "sub").exists()


def test_a_limit_that_cannot_be_met_is_told_and_costs_no_more_than_is_ours(tmp_path: Path) -> None:
    made(tmp_path / "a1.html", 5)
    made(tmp_path / "a2.html", 0.1)
    log = made(tmp_path / "a3.mcap", 5)
    kept = Derived(tmp_path, OURS, 1e9, 1e18)
    assert not kept.make_room() and left(tmp_path) == ["a2.html", log.name]
    assert re.search(r"only \d+ MB are free on its disk, and 1000000000000 MB are left alone", kept.no_room())
    assert not Derived(tmp_path / "none" / "yet", OURS, 1e9, 1e18).make_room()


def test_what_somebody_makes_stays_and_what_a_dead_one_left_goes(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as dead:
        dead.wait()
    name = "0123456789abcdef" * 2
    made(tmp_path / f"{name}.{os.getpid()}.part", 50)
    made(tmp_path / f"{name}.{dead.pid}.part", 50)
    made(tmp_path / "somebody's.mcap", 50)
    full = MACHINE.log.model_copy(update={"keep_free_megabytes": 1e12})
    assert not caches(tmp_path, full).make_room()
    assert left(tmp_path) == [f"{name}.{os.getpid()}.part", "somebody's.mcap"]


@pytest.mark.parametrize("when_full", ["stop", "delete_oldest"])
def test_where_the_log_needs_room_reports_go_and_no_log(when_full: str, tmp_path: Path) -> None:
    log = made(tmp_path / "rig_20260101T000000Z_001.mcap", 50)
    reports = reports_in(tmp_path, 0.0).folder
    for name in ("rig_report_1.html", "rig_report_1.json", "mine.html"):
        made(reports / name, 50)
    made(reports / "rig_report_2.html", 0.0)
    update = {"keep_free_megabytes": 1e12, "when_full": when_full}
    room = Room(tmp_path, MACHINE.log.model_copy(update=update), lambda kind, told: None)
    assert room.is_wanted(1e9, 10**10)
    room.make("current", None)
    assert left(tmp_path) == [f"reports/{name}" for name in ("mine.html", "rig_report_2.html")] + [log.name]


def test_a_log_is_not_replayed_to_a_disk_that_is_too_full(tmp_path: Path) -> None:
    log = write_candump(tmp_path / "x.log", simulate(MACHINE, 1, 0.5))
    full = MACHINE.log.model_copy(update={"keep_free_megabytes": 1e12})
    machine = MACHINE.model_copy(update={"log": full})
    old = made(tmp_path / "kept" / ("0" * 32 + ".fit"), 50)
    with pytest.raises(NoRoom, match="make room, or name another disk by XDG_CACHE_HOME"):
        replayed(log, MachineFile(machine, MACHINE_TEXT), {}, lambda done, of: None, print, tmp_path / "kept")
    assert not old.exists() and left(tmp_path / "kept") == []
    with pytest.raises(NoRoom):
        prepare([log], MachineFile(machine, MACHINE_TEXT), tmp_path / "kept" / "x_0123456789abcdef.mcap")
    assert left(tmp_path / "kept") == [] and log.exists()
