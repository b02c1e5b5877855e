"""Runs: what may be deleted, copies that can be trusted, lists, and logs that are read and checked whole."""

import fcntl
import json
import shutil
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from logs import MACHINE, MACHINE_TEXT, chunk_ends, some_frames, write_mcap
from loopback import numbered, rig, udp_bus

from tilth.cli import main
from tilth.logger.clock import LEAST_TIMES, Clock
from tilth.logger.log import offload
from tilth.logger.log.mcap_log import ClockReason, LogWriter, RunPart
from tilth.logger.log.run_log import Recording
from tilth.logger.log.runs import DAY_NS, Copied, Sidecar, StoredRun, may_go, stored_runs, unused_name
from tilth.replay.survey import survey
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Event
from tilth.schemas.invocation import command
from tilth.schemas.proto import tilth_pb2 as pb

NAME = "rig_20260301T080000Z"
NOW_NS = 1_772_352_000_000_000_000 + 40 * DAY_NS  # forty days later


def part(folder: Path, number: int = 1, name: str = NAME, finish: bool = True) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}_{number:03d}.mcap"
    return write_mcap(path, some_frames(300, number), finish=finish)


def only(folder: Path) -> StoredRun:
    (run,) = stored_runs(folder)
    return run


MAY = {  # keep, copied files of two, known time, expiry in days -> may it go
    "not copied": ((False, 0, True, None), False),
    "half copied": ((False, 1, True, None), False),
    "copied": ((False, 2, True, None), True),
    "copied, time unknown": ((False, 2, False, None), True),
    "copied and kept": ((True, 2, True, 1.0), False),
    "expired": ((False, 0, True, 30.0), True),
    "young": ((False, 0, True, 60.0), False),
    "expired by a clock that nobody confirms": ((False, 0, False, 30.0), False),
    "expired and kept": ((True, 0, True, 30.0), False),
}


@pytest.mark.parametrize("case", MAY)
def test_only_what_is_copied_or_expired_and_not_kept_may_go(case: str, tmp_path: Path) -> None:
    (keep, copied, known, days), expected = MAY[case]
    paths = [part(tmp_path, 1), part(tmp_path, 2)]
    run = only(tmp_path)
    run.write_sidecar(Sidecar(keep, [], {p.name: Copied(p.stat().st_size, "", "x") for p in paths[:copied]}))
    assert may_go(run, NOW_NS if known else None, days) == expected


def test_what_cannot_be_understood_is_never_deleted(tmp_path: Path) -> None:
    path = part(tmp_path)
    run = only(tmp_path)
    run.write_sidecar(Sidecar(False, [], {path.name: Copied(path.stat().st_size - 1, "", "x")}))
    assert not may_go(run, NOW_NS, None)  # it has changed since
    run.sidecar_path.write_text("{half a")
    assert not may_go(run, NOW_NS, 1.0)
    with pytest.raises(ValueError, match="mend or remove it"):
        run.sidecar()


def test_names_of_somebodys_own_are_runs_of_unknown_time(tmp_path: Path) -> None:
    for name in ("rig_99999999T999999Z", "rig_19700101T000010Z", NAME):
        part(tmp_path, name=name)
    (tmp_path / "notes.mcap").write_bytes(b"")
    assert [(run.name, run.started_ns > 0) for run in stored_runs(tmp_path)] == [
        ("rig_19700101T000010Z", False), ("rig_99999999T999999Z", False), (NAME, True)
    ]  # fmt: skip


def test_copies_are_compared_resumed_and_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(offload, "_BLOCK", 1000)
    logs, stick = tmp_path / "logs", tmp_path / "stick"
    paths = [part(logs, 1), part(logs, 2), part(logs, 3, finish=False)]
    stick.mkdir()
    content = paths[1].read_bytes()
    # An earlier copy was interrupted, and its last block is not what it should be.
    (stick / f"{paths[1].name}.partial").write_bytes(content[:2500] + bytes(300))
    arguments = ["offload", str(stick), "--log", str(logs)]
    assert main(arguments) == 0
    assert "3 files copied and compared, 0 there" in capsys.readouterr().out
    for path in paths:  # the third was finished before
        assert (stick / path.name).read_bytes() == path.read_bytes()
    assert not list(stick.glob("*.partial")) and (stick / f"{NAME}.json").exists()
    assert may_go(only(logs), None, None)
    assert main(arguments) == 0
    assert "0 files copied and compared, 3 there" in capsys.readouterr().out
    (stick / paths[0].name).unlink()
    assert main(arguments) == 0
    assert "1 file copied and compared, 2 there" in capsys.readouterr().out
    assert survey([stick / path.name for path in paths])[0].machine == MACHINE.name


def test_a_copy_that_is_not_the_same_is_no_copy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    logs, stick = tmp_path / "logs", tmp_path / "stick"
    path = part(logs)
    stick.mkdir()
    (stick / path.name).write_bytes(b"another file")
    arguments = ["offload", str(stick), "--log", str(logs)]
    assert main(arguments) == 1
    assert "another file of that name" in capsys.readouterr().err
    (stick / path.name).unlink()

    def bad_disk(source: object, target: object, length: int) -> None:
        target.write(bytes(100))  # type: ignore[attr-defined]

    monkeypatch.setattr(shutil, "copyfileobj", bad_disk)
    assert main(arguments) == 1
    assert "not what is read back" in capsys.readouterr().err
    assert list(stick.iterdir()) == [] and not may_go(only(logs), None, None)


def test_what_is_being_recorded_and_full_sticks_are_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    logs, stick = tmp_path / "logs", tmp_path / "stick"
    part(logs)
    stick.mkdir()
    with part(logs, 2, finish=False).open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert main(["offload", str(stick), "--log", str(logs)]) == 1
        out, err = capsys.readouterr()
        assert "is being recorded" in err and "1 file copied" in out and not may_go(only(logs), None, None)
        assert main(["logs", str(logs)]) == 0
        assert "recording, 1 of 2 copied" in capsys.readouterr().out
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    assert main(["offload", str(stick), "--log", str(logs)]) == 1
    assert "no room for" in capsys.readouterr().err
    for wrong in ([str(tmp_path / "none")], [str(stick), "--log", str(stick)], [str(stick), "--run", "x"]):
        assert main(["offload", "--log", str(logs), *wrong]) == 2


def drive(folder: Path, *, lost_rear: bool = False) -> list[Path]:
    """Two parts of a run with two sensors, statuses, a mark and a stepped clock."""
    folder.mkdir()
    clock, paths = Clock(), []
    rows = numbered(6000)
    for number in (1, 2):
        path = folder / f"{NAME}_{number:03d}.mcap"
        writer = LogWriter(path, MACHINE, MACHINE_TEXT, RunPart("id", number, rows[0].t_ns, "clay, dry"))
        writer.clocks(clock, ClockReason.START if number == 1 else ClockReason.NEW_FILE)
        for i, row in enumerate(rows[3000 * (number - 1) : 3000 * number], 3000 * (number - 1)):
            writer.frame(row)
            if i % 100 == 0 and not 1500 < i < 2700:
                writer.message("/gnss/tractor_front", row.t_ns, b"")
            if i % 10 == 0:
                writer.message("/measurement/wheel_angle", row.t_ns, b"")
            if i % 1000 == 999:
                status = pb.Status(t_ns=row.t_ns, uptime_s=1.0 + i * 1e-3)
                status.buses.add(name="can0", lost_frames=3 if lost_rear and i > 4000 else 0)
                status.receivers.add(mount="tractor_front", state="alive")
                status.receivers.add(mount="tractor_rear", state="lost" if lost_rear else "alive")
                status.wheel_angle.state = "alive"
                writer.message("/status", row.t_ns, status.SerializeToString())
        if number == 1:
            mark = Event(rows[2999].t_ns, "mark", "stone")
            writer.message("/event", mark.t_ns, CHANNEL["/event"].encode(mark))
            clock.offset_ns -= 5_000_000_000
            writer.clocks(clock, ClockReason.STEP)
        writer.close()
        paths.append(path)
    return paths


def test_a_log_is_read_whole_and_what_is_missing_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = drive(tmp_path / "logs", lost_rear=True)
    assert main(["verify", *map(str, paths)]) == 1
    output = capsys.readouterr().out
    for words in (
        "6000 at 1000.2/s, no gap", "tractor front", "1 gap: 1.2 s at 2026-09-21T14:13:21Z", "never heard",
        "dropped on can0: 3", "set by +5.0", "not confirmed by any receiver", "mark: stone", "clay, dry",
    ):  # fmt: skip
        assert words in output, (words, output)
    (found,) = survey(paths)
    assert found.coverage["/gnss/tractor_rear"].count == 0 and found.coverage["/can/can0"].count == 6000
    assert found.wrong == [] and found.steps_s == [pytest.approx(5.0, abs=0.1)] and found.backwards == 0
    assert main(["verify", "--json", str(paths[1]), str(paths[0])]) == 1  # the wrong way round
    fields = json.loads(capsys.readouterr().out)
    assert any("part 1 after part 2; give each once and in order" in what for what in fields[0]["wrong"])
    assert any("what was before it is not here" in what for what in fields[0]["wrong"])
    assert fields[0]["backwards"] == 1


def test_damage_and_cuts_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = drive(tmp_path / "logs")
    assert main(["verify", str(first), str(second)]) == 0
    assert "whole, nothing dropped" in capsys.readouterr().out
    content = bytearray(first.read_bytes())
    content[chunk_ends(bytes(content))[0] - 20] ^= 0xFF
    first.write_bytes(content)
    second.write_bytes(second.read_bytes()[:-100])
    assert main(["verify", str(first), str(second)]) == 1
    output = capsys.readouterr().out
    assert "_001.mcap: damaged at byte " in output and "tilth recover` finishes it" in output
    assert main(["recover", str(first), str(second)]) == 1
    assert first.read_bytes() == content
    assert main(["verify", str(second)]) == 1
    assert "part 2 comes first" in capsys.readouterr().out.splitlines()[-2]
    (tmp_path / "text.mcap").write_text("hello")
    assert main(["verify", str(tmp_path / "text.mcap")]) == 1
    assert main(["verify", str(tmp_path / "none.mcap")]) == 2


def test_runs_are_listed_kept_and_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "logs"
    drive(folder, lost_rear=True)
    part(folder, name="rig_20260302T080000Z", finish=False)
    assert main(["logs", str(folder)]) == 0
    head, first, second = capsys.readouterr().out.splitlines()
    assert head.split()[:2] == ["run", "began"]
    for words in (
        NAME,
        "2026-09-21T14:13:20Z",
        "0:00:06",
        "6000",
        "2/3",
        "tractor rear lost, mark 1",
        "clay",
    ):
        assert words in first, words
    assert f"unfinished: {command('recover')}" in second
    assert main(["logs", str(folder), "--keep", NAME, "--note", NAME, "soil samples taken"]) == 0
    assert 'keep, "clay, dry", "soil samples taken"' in capsys.readouterr().out
    assert main(["logs", str(folder), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert (
        rows[0]["keep"] and rows[0]["seconds"] == pytest.approx(6.0, abs=0.01) and rows[1]["unfinished"] == 1
    )
    assert main(["logs", str(folder), "--release", NAME]) == 0
    assert "keep" not in capsys.readouterr().out
    for wrong in (["--keep", "nobody"], [str(tmp_path / "none")]):
        assert main(["logs", *([str(folder)] if "--keep" in wrong else []), *wrong]) == 2


def test_a_computer_that_woke_in_1970_gives_logs_that_come_out_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Receivers tell the time after some seconds: names and times are right then, and nothing steps."""
    truth_ns = time.time_ns()
    behind_ns = truth_ns - 20_000_000_000  # this computer's clock began at 0:00:20 in 1970
    wall = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: wall() - behind_ns)
    folder = tmp_path / "logs"
    machine, text = rig(folder, udp_bus("can0", 1))
    clock = Clock()
    recording = Recording(folder, machine, text, clock, lambda *output: None, lambda: "{}")
    assert recording.files[0].name.startswith("jd7930-parker500_19700101T0000")
    t_ns = clock.t_ns()
    for number, frame in enumerate(numbered(4000, t_ns)):
        recording.frame(frame)
        if number == 2000:
            for k in range(LEAST_TIMES):
                clock.add_gnss_time(frame.t_ns + k, frame.t_ns + k + behind_ns)
        if number % 400 == 0:
            recording.tick(frame.t_ns)
    recording.close()
    names = sorted(path.name for path in folder.glob("*.mcap"))
    assert len(names) == 2 and all(unused_name(folder, "x", truth_ns)[2:10] in name for name in names)
    monkeypatch.undo()
    (found,) = survey(sorted(folder.glob("*.mcap")))
    assert found.good and found.coverage["/can/can0"].count == 4000 and found.by_gnss
    assert abs(found.first_ns + found.utc_minus_ns - truth_ns) < 5_000_000_000
    assert main(["logs", str(folder), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    today = unused_name(folder, "x", truth_ns)[2:10]
    assert row["began"][:10].replace("-", "") == today
    second = sorted(folder.glob("*.mcap"))[1]
    second.write_bytes(second.read_bytes()[:-100])
    assert main(["recover", str(second)]) == 0
    assert capsys.readouterr().out.replace("-", "").count(f" {today}T") == 2
