"""Runs are copied to a stick, compared and noted."""

import shutil
from pathlib import Path

import pytest
from logs import MACHINE
from stored_runs import NAME, only, part

from tilth.cli import main
from tilth.logger.log import offload
from tilth.logger.log.runs import may_go
from tilth.replay.survey import survey


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
