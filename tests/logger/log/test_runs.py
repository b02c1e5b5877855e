"""Runs: what may be deleted, copies that can be trusted, lists, and logs that are read and checked whole."""

import json
import time
from pathlib import Path

import pytest
from loopback import numbered, rig, udp_bus
from stored_runs import NAME, only, part

from tilth.cli import main
from tilth.logger.clock import LEAST_TIMES, Clock
from tilth.logger.log.run_log import Recording
from tilth.logger.log.runs import DAY_NS, Copied, Sidecar, may_go, stored_runs, unused_name
from tilth.replay.survey import survey
from tilth.schemas.machine_toml import MachineFile

NOW_NS = 1_772_352_000_000_000_000 + 40 * DAY_NS  # forty days later


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
    recording = Recording(folder, MachineFile(machine, text), clock, lambda *output: None, lambda: "{}")
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
