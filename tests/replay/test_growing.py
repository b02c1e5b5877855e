"""A log that is still being written gives each frame once, wherever its end is at the moment."""

import os
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from kinematic_drive import MACHINE
from logs import chunk_ends, write_candump, write_mcap
from mcap.opcode import Opcode
from paths import MACHINE_FILE, ROOT

from tilth.cli import main
from tilth.logger.log.mcap_file import HEAD, RecordPlace, walk
from tilth.logger.log.recovery import finish
from tilth.replay.growing import LOST, FollowedLogs, GrowingLog, opening_machine
from tilth.replay.readers.any_log import frames
from tilth.replay.readers.log import EmptyLog
from tilth.schemas.can_id import split
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Frame, Measurement

TEXT = MACHINE_FILE.read_text(encoding="utf-8")
RUNS = tuple(f"jd7930-parker500_{stamp}Z" for stamp in ("20261121T080000", "20261121T090000"))
LONG_AGO = "jd7930-parker500_20261120T080000Z"
NO_TIME = tuple(f"jd7930-parker500_{stamp}Z" for stamp in ("19700101T000001", "19700101T000002"))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    to = tmp_path_factory.mktemp("growing") / "drive.mcap"
    scenario = ROOT / "examples" / "scenarios" / "calibration_drive.toml"
    words = ["--seconds", "8", "--out", str(to), "--machine", str(MACHINE_FILE)]
    assert main(["simulate", str(scenario), *words]) == 0
    return to


@pytest.mark.parametrize("seed", range(8))
def test_portions_give_what_the_whole_gives(log: Path, tmp_path: Path, seed: int) -> None:
    data, growing = log.read_bytes(), tmp_path / "growing.mcap"
    cuts = np.sort(np.random.default_rng(seed).integers(100, len(data), 12)).tolist()
    growing.write_bytes(data[: cuts[0]])
    following = GrowingLog(growing)
    found: list[Frame] = []
    for begin, end in zip(cuts, [*cuts[1:], len(data)], strict=True):
        found += following.frames()
        with growing.open("ab") as file:
            file.write(data[begin:end])
        growing = growing.rename(tmp_path / f"{end}.mcap")  # it stays open
    found += following.frames()
    assert found == list(frames(log)) and following.finished and not following.skipped
    assert list(following.frames()) == []


def test_the_machine_file_is_at_the_beginning(log: Path, tmp_path: Path) -> None:
    assert opening_machine(log) == MACHINE_FILE.read_text(encoding="utf-8")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[:60])
    assert opening_machine(cut) is None
    with pytest.raises(EmptyLog, match="nothing is in it yet"):
        FollowedLogs(MACHINE, [], {}, cut)


def test_a_log_of_before_counts_once(log: Path) -> None:
    followed = FollowedLogs(MACHINE, [log], {}, log)
    once = list(followed.measurements())
    assert once and list(followed.measurements()) == [] and followed.paths == [log]
    followed.close()
    without = FollowedLogs(MACHINE, [], {}, log)
    assert list(without.measurements()) == once
    without.close()


def _measured(rows: Sequence[Frame]) -> list[Measurement]:
    decoder = Decoder(MACHINE)
    return [one for row in rows for one in decoder.measurements(row)]


def test_parts_and_a_daemon_that_is_started_again_go_on(log: Path, tmp_path: Path) -> None:
    rows = list(frames(log))
    cuts = [len(rows) * k // 4 for k in range(5)]
    parts = [rows[first:last] for first, last in pairwise(cuts)]
    first, second, anew, named = (
        tmp_path / name
        for name in (f"{RUNS[0]}_001.mcap", f"{RUNS[0]}_002.mcap", f"{RUNS[1]}_001.mcap", "by-hand.mcap")
    )
    write_mcap(first, parts[0])
    followed = FollowedLogs(MACHINE, [], {}, first)
    found = list(followed.measurements())
    write_mcap(second, parts[1], finish=False)  # killed
    followed.rescan()
    found += followed.measurements()
    followed.writes(write_mcap(anew, parts[2]))
    found += followed.measurements()
    followed.writes(write_mcap(named, parts[3]))
    found += followed.measurements()
    assert found == _measured(rows) and followed.paths == [first, second, anew, named]
    assert followed.notes == [] and list(followed.measurements()) == []
    followed.close()


def test_what_is_of_another_rig_or_of_another_day_does_not_count(log: Path, tmp_path: Path) -> None:
    rows = list(frames(log))[:200]
    here = write_mcap(tmp_path / f"{RUNS[1]}_001.mcap", rows)
    other = TEXT.replace('name = "jd7930-parker500"', 'name = "mt700"', 1)
    write_mcap(tmp_path / f"{RUNS[0]}_001.mcap", rows, text=other)
    write_mcap(tmp_path / f"{RUNS[0]}_002.mcap", rows, text=TEXT + "# surveyed since\n")
    write_mcap(tmp_path / f"{LONG_AGO}_001.mcap", rows)
    followed = FollowedLogs(MACHINE, [], {}, here)
    assert followed.paths == [here] and list(followed.measurements()) == _measured(rows)
    assert followed.notes == [
        f"{RUNS[0]}_001.mcap does not count: it is of another rig, mt700.",
        f"{RUNS[0]}_002.mcap does not count: it was written with another machine file. To go on with that "
        "one, start this command anew.",
    ]
    followed.rescan()
    assert len(followed.notes) == 2
    followed.close()


def test_an_earlier_log_without_the_rig_does_not_count(log: Path, tmp_path: Path) -> None:
    """As long as it is the last one, the receivers may still say their NAMEs."""
    rows = list(frames(log))
    unnamed = [row for row in rows if split(row.can_id).pgn != 60928]
    given = write_candump(tmp_path / "given.log", unnamed)
    before = write_mcap(tmp_path / f"{RUNS[0]}_001.mcap", unnamed)
    followed = FollowedLogs(MACHINE, [given], {}, before)
    assert not any(one.origin.mount for one in followed.measurements())
    assert followed.paths == [before]
    followed.writes(write_mcap(tmp_path / f"{RUNS[1]}_001.mcap", rows))
    for _ in range(2):
        list(followed.measurements())
        assert followed.paths == [tmp_path / f"{RUNS[1]}_001.mcap"]
        assert followed.notes == [
            f"{path.name} does not count: none of the machine file's receivers is heard in it."
            for path in (given, before)
        ]
    followed.close()


def test_without_the_time_only_what_the_daemon_names_counts(log: Path, tmp_path: Path) -> None:
    """The clock of a computer without a battery; then the time is known, and the file gets its right name."""
    rows = list(frames(log))[:200]
    here = write_mcap(tmp_path / f"{NO_TIME[1]}_001.mcap", rows)
    for run in (NO_TIME[0], LONG_AGO):
        write_mcap(tmp_path / f"{run}_001.mcap", rows)
    followed = FollowedLogs(MACHINE, [], {}, here)
    assert followed.paths == [here]
    here = here.rename(tmp_path / f"{RUNS[1]}_001.mcap")
    earlier = write_mcap(tmp_path / f"{RUNS[0]}_001.mcap", rows)
    followed.writes(here)
    assert sorted(followed.paths) == [earlier, here]
    followed.close()


@pytest.mark.parametrize("number", [0, 1, -1])
def test_a_damaged_chunk_costs_only_itself(log: Path, tmp_path: Path, number: int) -> None:
    path = write_mcap(tmp_path / f"{RUNS[0]}_001.mcap", list(frames(log))[:2000])
    whole = _drained(path)
    data = bytearray(path.read_bytes())
    ends = chunk_ends(bytes(data))
    assert len(ends) > 5
    data[ends[number] - 20] ^= 0xFF
    path.write_bytes(data)
    followed = FollowedLogs(MACHINE, [], {}, path)
    assert list(followed.measurements())
    assert followed.notes == [f"{path.name}: damaged and left out: 1. All else counts."]
    followed.close()
    growing = GrowingLog(path)
    left = list(growing.frames())
    assert growing.skipped == {"damaged_chunk": 1} and growing.finished
    gone = [row for row in whole if row not in left]
    assert 0 < len(gone) <= len(whole) // 4 and [row for row in whole if row not in gone] == left


def _drained(path: Path) -> list[Frame]:
    growing = GrowingLog(path)
    found = list(growing.frames())
    growing.close()
    return found


def _places(path: Path, opcode: int) -> list[RecordPlace]:
    with path.open("rb") as file:
        return [place for place in walk(file, path.stat().st_size) if place.opcode == opcode]


def _with_length(path: Path, place: RecordPlace, length: int) -> bytes:
    """The file's bytes, that record's length damaged."""
    data = bytearray(path.read_bytes())
    HEAD.pack_into(data, place.start, place.opcode, length)
    return bytes(data)


@pytest.mark.parametrize("opcode", [Opcode.CHUNK, Opcode.MESSAGE_INDEX])
@pytest.mark.parametrize("change", [1 << 62, 1 << 30, 3000, 7, -5])
def test_a_damaged_length_stops_nothing(log: Path, tmp_path: Path, opcode: int, change: int) -> None:
    """Of a record in the middle, met while the log grows: what comes behind it is read once it is there."""
    path = write_mcap(tmp_path / "whole.mcap", list(frames(log))[:2000])
    places, chunks = _places(path, opcode), _places(path, Opcode.CHUNK)
    place, almost = places[len(places) // 2], chunks[-2].end
    damaged = _with_length(path, place, place.end - place.body + change)
    growing = tmp_path / "growing.mcap"
    growing.write_bytes(path.read_bytes()[:almost])
    whole, until = _drained(path), _drained(growing)
    growing.write_bytes(damaged[: place.start])
    following, found = GrowingLog(growing), list[Frame]()
    for end in (place.end, *(one.end for one in chunks if place.end < one.end <= almost), len(damaged)):
        found += following.frames()
        with growing.open("ab") as file:
            file.write(damaged[growing.stat().st_size : end])
        if end == almost:
            found += following.frames()
            assert found[-1] == until[-1]
    found += following.frames()
    gone = [row for row in whole if row not in found]
    assert [row for row in whole if row not in gone] == found and following.finished
    assert not gone and following.skipped.get("damaged_chunk", 0) <= 1  # a chunk is known by its content


@pytest.mark.parametrize("opcode", [Opcode.CHUNK, Opcode.METADATA, Opcode.DATA_END])
def test_a_damaged_length_at_the_end_is_not_waited_for(log: Path, tmp_path: Path, opcode: int) -> None:
    """Of the last record of its kind in a part: its run goes on in the next one, and it is said."""
    rows = list(frames(log))[:2000]
    path, after = (tmp_path / f"{RUNS[0]}_00{part}.mcap" for part in (1, 2))
    write_mcap(path, rows[:1000])
    path.write_bytes(_with_length(path, _places(path, opcode)[-1], 1 << 40))
    kept = _drained(path)
    assert kept == rows[: len(kept)]
    assert len(kept) == 1000
    followed = FollowedLogs(MACHINE, [], {}, write_mcap(after, rows[1000:]))
    assert list(followed.measurements()) == _measured([*kept, *rows[1000:]])
    told = [] if opcode == Opcode.CHUNK else [f"{path.name}: damaged and left out: 1. All else counts."]
    assert followed.notes == told
    followed.close()


def test_a_record_that_is_half_written_is_waited_for(log: Path, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "whole.mcap", list(frames(log))[:1000])
    whole, data = _drained(path), path.read_bytes()
    place = _places(path, Opcode.CHUNK)[2]
    growing = tmp_path / "growing.mcap"
    growing.write_bytes(data[: place.start + 1])
    following = GrowingLog(growing)
    found = list(following.frames())
    for end in (place.body, place.body + 200, place.end - 1):
        with growing.open("ab") as file:
            file.write(data[growing.stat().st_size : end])
        assert list(following.frames()) == [] and not following.skipped
    with growing.open("ab") as file:
        file.write(data[place.end - 1 :])
    assert found + list(following.frames()) == whole and not following.skipped and following.finished


def test_a_damaged_first_chunk_is_made_up_for_at_the_end(log: Path, tmp_path: Path) -> None:
    """It says which frames are of which bus; so does the index at the end of the file."""
    rows = list(frames(log))[:1000]
    path = write_mcap(tmp_path / f"{RUNS[0]}_001.mcap", rows)
    first, *_, last = _places(path, Opcode.CHUNK)
    data = bytearray(path.read_bytes())
    data[first.end - 20] ^= 0xFF
    path.write_bytes(data[: last.end])
    followed = FollowedLogs(MACHINE, [], {}, path)
    assert list(followed.measurements()) == []
    assert followed.notes == [
        f"{path.name}: its beginning is damaged, where it is said which frames are of which bus. What "
        "follows counts once this file has ended."
    ]
    with path.open("ab") as file:
        file.write(data[last.end :])
    kept = rows[len(rows) - len(_drained(path)) :]
    assert list(followed.measurements()) == _measured(kept) and 900 < len(kept) < 1000
    assert followed.notes == [f"{path.name}: damaged and left out: 1. All else counts."]
    followed.close()


def test_a_part_without_its_machine_file_is_named(log: Path, tmp_path: Path) -> None:
    rows = list(frames(log))[:1000]
    path, here = (tmp_path / f"{RUNS[0]}_00{part}.mcap" for part in (1, 2))
    write_mcap(path, rows[:500])
    path.write_bytes(_with_length(path, _places(path, Opcode.METADATA)[0], 1 << 40))
    followed = FollowedLogs(MACHINE, [], {}, write_mcap(here, rows[500:]))
    assert followed.paths == [here] and list(followed.measurements()) == _measured(rows[500:])
    followed.rescan()
    assert followed.notes == [
        f"{path.name} does not count: it is damaged at its beginning, where its machine file stood."
    ]
    followed.close()


@pytest.mark.parametrize("lose", [lambda path: os.truncate(path, 300), lambda path: path.write_bytes(b"x")])
def test_a_log_that_is_overwritten_is_named_and_costs_nothing_before(
    lose: Callable[[Path], object], log: Path, tmp_path: Path
) -> None:
    path = tmp_path / f"{RUNS[0]}_001.mcap"
    path.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    logs = FollowedLogs(MACHINE, [], {}, path)
    before = len(list(logs.measurements()))
    lose(path)
    assert before > 100 and list(logs.measurements()) == []
    assert logs.notes == [LOST.format(path.name)]


def test_a_part_that_is_finished_meanwhile_counts_once(log: Path, tmp_path: Path) -> None:
    """A copy takes its place, with another inode."""
    rows = list(frames(log))[:1000]
    path = write_mcap(tmp_path / f"{RUNS[0]}_001.mcap", rows[:500], finish=False)
    followed = FollowedLogs(MACHINE, [], {}, write_mcap(tmp_path / f"{RUNS[0]}_002.mcap", rows[500:]))
    found = list(followed.measurements())
    finish(path)
    followed.rescan()
    assert [*found, *followed.measurements()] == _measured(rows)
    followed.close()
