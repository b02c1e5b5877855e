"""Lists of runs and what is said of their files: by all parts, while they grow, beside others' files."""

import fcntl
import json
from pathlib import Path
from typing import Any

import pytest
from logs import MACHINE, MACHINE_TEXT
from loopback import numbered
from mcap.writer import Writer

from tilth.cli import main
from tilth.logger.clock import Clock
from tilth.logger.log.mcap_log import ClockReason, LogWriter, RunPart
from tilth.replay.survey import survey
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Event
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import in_words
from tilth.schemas.proto import tilth_pb2 as pb

NAME = "rig_20260301T080000Z"


def status(t_ns: int, state: str, **faults: int) -> bytes:
    result = pb.Status(t_ns=t_ns, uptime_s=1.0)
    result.buses.add(name="can0")
    result.receivers.add(mount="tractor_front", state=state)
    result.wheel_angle.state = state
    for reason, count in faults.items():
        result.faults.add(reason=reason, count=count)
    return result.SerializeToString()


def parts_of(folder: Path, *states: str, ends: ClockReason = ClockReason.END, **faults: int) -> list[Path]:
    """A run of a second a part; the state of its sensors at each one's end."""
    folder.mkdir(exist_ok=True)
    clock, rows, paths = Clock(), numbered(1000 * len(states)), []
    for number, state in enumerate(states, 1):
        path = folder / f"{NAME}_{number:03d}.mcap"
        writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("id", number, rows[0].t_ns))
        writer.clocks(clock, ClockReason.START if number == 1 else ClockReason.NEW_FILE)
        ours = rows[1000 * (number - 1) : 1000 * number]
        for row in ours[:-1]:
            writer.frame(row)
        writer.message("/status", ours[-1].t_ns, status(ours[-1].t_ns, state, **faults))
        writer.frame(ours[-1])
        writer.clocks(clock, ends if number == len(states) else ClockReason.ROTATION)
        writer.close()
        paths.append(path)
    return paths


def listed(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[dict[str, Any], str]:
    """The only run of a folder as programs and as people are told."""
    capsys.readouterr()
    assert main(["logs", str(folder), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert main(["logs", str(folder)]) == 0
    return row, capsys.readouterr().out.splitlines()[1]


def test_a_run_is_judged_by_all_its_parts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first one closes after a second where the clock is corrected: nobody has been heard by then."""
    healthy = tmp_path / "healthy"
    parts_of(healthy, "waiting", "alive", "alive")
    row, line = listed(healthy, capsys)
    assert (row["alive"], row["sensors"], row["lost"], row["frames"]) == (2, 2, [], 3000)
    assert "lost" not in line and "heard" not in line
    assert row["duration_s"] == row["seconds"] == pytest.approx(3.0, abs=0.01)
    (healthy / f"{NAME}_002.mcap").unlink()
    row, line = listed(healthy, capsys)
    assert row["missing_parts"] == [2] and "part 2 missing" in line
    assert row["duration_s"] == pytest.approx(3.0, abs=0.01)
    for state, word in (("lost", "lost"), ("no_data", "without data"), ("waiting", "never heard")):
        folder = tmp_path / state
        parts_of(folder, "alive", state)
        row, line = listed(folder, capsys)
        assert row["lost"] == ["tractor front", "wheel angle"] and f"wheel angle {word}" in line


def test_frames_that_no_longer_come_do_not_make_a_healthy_run_a_lost_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = parts_of(tmp_path / "logs", "alive", ends=ClockReason.ROTATION)
    t_ns = numbered(1)[0].t_ns + 60_000_000_000
    path = paths[0].with_name(f"{NAME}_002.mcap")
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("id", 2, t_ns))
    writer.message("/status", t_ns, status(t_ns, "lost"))
    writer.close()
    row, _ = listed(tmp_path / "logs", capsys)
    assert row["lost"] == [] and row["duration_s"] == pytest.approx(60.0, abs=0.01)


def test_a_clock_that_was_set_costs_nothing_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = parts_of(tmp_path / "logs", "alive", "alive", clock_stepped=1, not_published=7)
    assert main(["verify", *map(str, paths)]) == 0
    output = capsys.readouterr().out
    assert "whole, nothing dropped" in output and "not_published: 7" in output
    assert main(["verify", "--json", *map(str, paths)]) == 0
    (fields,) = json.loads(capsys.readouterr().out)
    assert fields["good"] and fields["duration_s"] == pytest.approx(2.0, abs=0.01)
    assert fields["began"] == "2026-09-21T14:13:20Z" and fields["heard"]["/can/can0"]["longest_gap_s"] == 0.0
    (lossy,) = survey(parts_of(tmp_path / "lossy", "alive", not_recorded=1))
    assert not lossy.good


def test_what_is_being_written_is_neither_unfinished_nor_damaged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "logs"
    done = parts_of(folder, "alive", ends=ClockReason.ROTATION)
    rows = numbered(2000)[1000:]
    path = folder / f"{NAME}_002.mcap"
    begun = folder / f"{NAME}_003.mcap"
    # As the recorder writes: what is flushed is in the file; and of the next one nothing is there yet.
    with path.open("xb", buffering=0) as stream, begun.open("xb") as just_begun:
        for file in (stream, just_begun):
            fcntl.flock(file, fcntl.LOCK_EX)
        writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("id", 2, rows[0].t_ns), stream)
        for frame in rows:
            writer.frame(frame)
        mark = Event(rows[-1].t_ns, "mark", in_words("stone"))
        writer.message("/event", mark.t_ns, CHANNEL["/event"].encode(mark))
        writer.message("/status", mark.t_ns, status(mark.t_ns, "alive"))
        writer.flush()
        row, line = listed(folder, capsys)
        assert row["recording"] and row["unfinished"] == 0 and line.endswith("recording")
        assert (row["frames"], row["alive"], row["events"]) == (2000, 2, {"mark": 1})
        assert row["duration_s"] == pytest.approx(2.0, abs=0.01)
        assert main(["verify", str(done[0]), str(path)]) == 0
        output = capsys.readouterr().out
        assert "being written" in output and "whole, nothing dropped" in output and "unfinished" not in output
        assert main(["verify", str(begun)]) == 0
        assert "is being written; nothing is in it yet" in capsys.readouterr().out
    row, line = listed(folder, capsys)  # as a power cut leaves it
    assert not row["recording"] and row["unfinished"] == 2 and row["frames"] == 2000
    assert "unfinished: " in line and "tilth recover" in line
    assert main(["verify", str(done[0]), str(path)]) == 1
    output = capsys.readouterr().out
    assert "002.mcap: was left unfinished; `" in output and "tilth recover` finishes it" in output


def test_other_files_in_the_folder_are_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "logs"
    parts_of(folder, "alive")
    foreign = folder / f"{NAME}_002.mcap"
    with foreign.open("wb") as stream:
        other = Writer(stream)
        other.start(profile="", library="somebody else")
        other.add_metadata("run", {"id": "x", "part": "half"})
        other.add_metadata("clock", {"t_ns": "?"})
        channel = other.register_channel("/status", "json", 0)
        other.add_message(channel, 1, b"\xff{}", 1)
        other.finish()
    (folder / f"{NAME}_003.mcap").write_text("hello")
    (folder / f"{NAME}_004.mcap").touch()
    row, line = listed(folder, capsys)
    assert (row["frames"], row["files"], row["unfinished"]) == (1000, 4, 1)
    assert row["no_log"] == [f"{NAME}_002.mcap", f"{NAME}_003.mcap"] and "002.mcap is no log of tilth" in line
    paths = sorted(map(str, folder.glob("*.mcap")))
    assert main(["verify", *paths]) == 1
    output = capsys.readouterr().out
    for words in (
        "002.mcap: is no log of tilth", "003.mcap: is no MCAP file",
        "004.mcap: is empty: nothing of it reached the disk", "whole, nothing dropped",
    ):  # fmt: skip
        assert words in output, (words, output)


def test_a_missing_end_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = parts_of(tmp_path / "logs", "alive", "alive")
    assert main(["verify", str(first), str(second), str(second)]) == 1
    assert "part 2 after part 2; give each once and in order" in capsys.readouterr().out
    assert main(["verify", str(first)]) == 0
    assert f"goes on in {second.name}, which was not read" in capsys.readouterr().out
    second.unlink()
    assert main(["verify", str(first)]) == 1
    assert "part 1 is not the last one; what comes after it is not here" in capsys.readouterr().out
