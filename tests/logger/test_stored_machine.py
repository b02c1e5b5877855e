"""A log whose own machine file is refused by now can still be read; only what estimates wants a right one."""

import json
from pathlib import Path

import pytest
from logs import MACHINE, MACHINE_FILE, MACHINE_TEXT, START_NS

from tilth.cli import main
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.schemas.machine_toml import MachineFile
from tilth.simulator.scenario import Scenario
from tilth.simulator.traffic import simulate

TEXT = MACHINE_TEXT.replace("a = 1.7\n", "a = 1700.0\n")
SENTENCE = "tractor.a = 1700 m: must be from 0.3 to 5; did you mean 1.7 (1700 mm)?"


@pytest.fixture
def old_log(tmp_path: Path) -> Path:
    path = tmp_path / f"{MACHINE.name}_20260101T000000Z_001.mcap"
    writer = LogWriter(path, MachineFile(MACHINE, TEXT), RunPart("run", 1, START_NS))
    for frame in simulate(MACHINE, 1, 2.0, Scenario(other_traffic=False)):
        writer.frame(frame)
    writer.close()
    return path


@pytest.mark.parametrize("words", [["decode"], ["decode", "--json"], ["verify"], ["recover"], ["discover"]])
def test_what_only_reads_does_not_mind(
    old_log: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert TEXT != MACHINE_TEXT
    assert main([*words, str(old_log)]) == 0
    out, err = capsys.readouterr()
    assert "1700 m" not in err and (out or err)
    if words == ["decode", "--json"]:
        rows = [json.loads(line) for line in out.splitlines()]
        assert any("wheel_angle_rad" in row for row in rows), "its own sensor is still known"


def test_the_runs_are_listed(old_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["logs", str(old_log.parent)]) == 0
    assert MACHINE.name in capsys.readouterr().out


def test_what_estimates_refuses_it_and_takes_another(
    old_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(old_log)]) == 2
    err = capsys.readouterr().err
    assert SENTENCE in err and "its own machine file" in err and "give --machine M.toml" in err
    assert len(err.splitlines()) == 1
    assert main(["replay", str(old_log), "--machine", str(MACHINE_FILE)]) == 0
    capsys.readouterr()
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(TEXT)
    for words in (
        ["check", str(wrong)],
        ["run", str(wrong), "--no-zenoh"],
        ["model", str(wrong)],
        ["replay", str(old_log), "--machine", str(wrong)],
    ):
        assert main(words) == 2
        err = capsys.readouterr().err
        assert SENTENCE in err and len(err.splitlines()) == 1


def test_what_is_rare_is_said_once(old_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rare = tmp_path / "rare.toml"
    rare.write_text(
        MACHINE_TEXT.replace("c = 2.1", "c = 1.0").replace(
            'interface = "socketcan"\nchannel = "can0"', 'interface = "virtual"\nchannel = "tilth-rare"'
        )
    )
    output = "the hitch stands ahead of the rear axle"
    assert main(["replay", str(old_log), "--machine", str(rare)]) == 0
    assert capsys.readouterr().err.count(output) == 1
    main(["run", str(rare), "--no-zenoh", "--plain", "--log", str(tmp_path / "logs"), "--seconds", "0.3"])
    assert capsys.readouterr().out.count(output) == 1
    main(["check", str(rare), "--seconds", "0.1"])
    assert f"WARNING  machine file: tractor.c = 1 m: rare, {output}" in capsys.readouterr().out
