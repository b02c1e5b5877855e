"""Lists of recorded runs: length, place, what was learned, what a person should know of their files."""

import gzip
from pathlib import Path

import pytest
from logs import MACHINE, MACHINE_TEXT, some_frames, write_mcap
from recorded_run import SECOND, START_NS, write_run

from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.replay.catalogue import has_results, listing, run_files
from tilth.replay.readers.log import ForeignLog
from tilth.schemas.flow import Status
from tilth.schemas.machine_toml import MachineFile

DAY = 86_400 * SECOND
CANDUMP = "(1700000000.000000) can0 18FF0001#1122\n"


def test_a_folder_has_its_runs_in_their_order_and_other_logs(tmp_path: Path) -> None:
    later = write_run(tmp_path, 5.0, start_ns=START_NS + DAY, parts=2)
    sooner = write_run(tmp_path, 5.0)
    (tmp_path / "candump-2023.log").write_text(CANDUMP)
    (tmp_path / "packed.log.gz").write_bytes(gzip.compress(CANDUMP.encode()))
    for name in ("notes.txt", "picture.bin", f"{MACHINE.name}_20261121T080000Z.json"):
        (tmp_path / name).write_text("not a log\n")
    found = run_files([tmp_path])
    assert [run.paths for run in found[:2]] == [tuple(sooner), tuple(later)]
    assert [run.name for run in found[:2]] == [
        f"{MACHINE.name}_20261121T080000Z",
        f"{MACHINE.name}_20261122T080000Z",
    ]
    assert [run.name for run in found[2:]] == ["candump-2023", "packed.log"]


def test_files_of_one_run_are_one_and_others_are_others(tmp_path: Path) -> None:
    one, two = write_run(tmp_path, 5.0, parts=2), write_run(tmp_path, 5.0, start_ns=START_NS + DAY)
    assert [run.paths for run in run_files([*one, *two])] == [tuple(one), tuple(two)]
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / one[0].name).write_bytes(one[0].read_bytes())
    names = [run.name for run in run_files([tmp_path, elsewhere])]
    assert len(names) == len(set(names)) == 3


def test_logs_of_replays_are_runs_of_their_own(tmp_path: Path) -> None:
    paths = [tmp_path / "one.mcap", tmp_path / "two.mcap"]
    for number, path in enumerate(paths):
        LogWriter(
            path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("replay", 1, START_NS + number * DAY)
        ).close()
    assert [run.name for run in run_files(paths)] == ["one", "two"]


def test_nothing_to_play_is_said(tmp_path: Path) -> None:
    with pytest.raises(ForeignLog, match="no run is in it"):
        run_files([tmp_path])
    with pytest.raises(ForeignLog, match="cannot be read"):
        run_files([tmp_path / "none"])
    (tmp_path / "words.bin").write_text("words\n")
    with pytest.raises(ForeignLog, match="not a log of CAN frames"):
        run_files([tmp_path / "words.bin"])


@pytest.mark.parametrize("finish", [True, False])
def test_a_listing_tells_length_place_and_what_was_learned(tmp_path: Path, finish: bool) -> None:
    write_run(tmp_path, 60.0, parts=2, finish=finish, note="clay, dry")
    (run,) = run_files([tmp_path])
    assert has_results(run.paths)
    row = listing(run)
    assert row.length_s == pytest.approx(60.0, abs=0.1)
    assert row.began == "2026-11-21T08:00:00Z" and row.machine == MACHINE.name
    assert (row.latitude_deg, row.longitude_deg) == (43.5, -83.4)
    assert list(row.notes) == ["clay, dry"]
    assert row.state == ("" if finish else "cut off: plays as far as it is whole")
    assert row.learned.parameters[0].value == pytest.approx(0.6 * 215e3, rel=0.05)
    statuses = [int(one.status) for one in row.learned.parameters]
    assert statuses.count(Status.ESTIMATED) == 5 and statuses[4] == Status.UNESTIMATED


def test_a_log_of_frames_tells_that_it_is_replayed_first(tmp_path: Path) -> None:
    write_run(tmp_path, 5.0, results=False)
    (tmp_path / "candump.log").write_text(CANDUMP)
    ours, theirs = run_files([tmp_path])
    assert not has_results(ours.paths) and not has_results(theirs.paths)
    assert "frames and no result" in listing(ours).state and listing(ours).length_s == 5.0
    row = listing(theirs)
    assert "another program" in row.state and row.length_s == 0 and not row.HasField("learned")
    (kept,) = write_run(tmp_path, 30.0, start_ns=START_NS + DAY)
    row = listing(theirs, kept)
    assert row.HasField("learned") and row.length_s == pytest.approx(30.0) and not row.state


def test_a_run_without_an_estimate_is_listed(tmp_path: Path) -> None:
    write_mcap(tmp_path / "frames.mcap", some_frames(100))
    (run,) = run_files([tmp_path])
    row = listing(run)
    assert run.name == "frames" and not row.HasField("learned") and not row.HasField("latitude_deg")


def test_two_replays_of_a_log_and_a_copy_of_a_part_are_runs_of_their_own(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.mcap" for name in ("one", "two")]
    for path in paths:
        LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("replay", 1, START_NS)).close()
    first, second = write_run(tmp_path, 10.0, parts=2)
    (tmp_path / "copy.mcap").write_bytes(first.read_bytes())
    found = run_files([*paths, first, second, tmp_path / "copy.mcap"])
    assert [run.paths for run in found] == [
        (paths[0],), (paths[1],), (first, second), (tmp_path / "copy.mcap",)
    ]  # fmt: skip
