"""Copies are compared, resumed and noted; runs are listed and kept."""

import fcntl
import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
from stored_runs import NAME, drive, only, part

from tilth.cli import main
from tilth.logger.log.runs import may_go
from tilth.schemas.invocation import command


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
