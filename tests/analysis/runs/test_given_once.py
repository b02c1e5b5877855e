"""The same driving counts once, whatever the logs that hold it are called."""

import json
import shutil
from pathlib import Path

import pytest
from logs import MACHINE, MACHINE_TEXT, record, write_candump

from tilth.analysis.runs.given_once import GivenTwice
from tilth.analysis.runs.run import open_runs
from tilth.cli import main
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.schemas.machine_toml import MachineFile
from tilth.simulator.traffic import simulate

UUID = "0123456789abcdef" * 2


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs in two parts each, and replays of them."""
    folder = tmp_path_factory.mktemp("logs")
    for name, seed, copies in (("a", 3, ("again", "other", "first")), ("b", 4, ("again",))):
        record(folder, list(simulate(MACHINE, seed, 12.0)), 2, name)
        parts = [str(folder / f"{name}_{part:03d}.mcap") for part in (1, 2)]
        for out in copies:
            given = parts[:1] if out == "first" else parts
            assert main(["replay", *given, "--out", str(folder / f"{name}-{out}.mcap"), "--json"]) == 0
    shutil.copy(folder / "a_001.mcap", folder / "copy.mcap")
    return folder


@pytest.mark.parametrize("names", [
    ("a-again", "a-other"), ("a-again", "a_001"), ("a_002", "a-again"), ("a_001", "a_001"),
    ("a_001", "a_002", "copy"), ("a-first", "a_001"), ("b_001", "a-first", "a-first"),
])  # fmt: skip
@pytest.mark.parametrize("command", ["fit", "report"])
def test_the_same_driving_is_refused(
    names: tuple[str, ...], command: str, logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [command, *(str(logs / f"{name}.mcap") for name in names)]
    assert main([*words, *(["--out", str(tmp_path / "r.html")] if command == "report" else [])]) == 2
    err = capsys.readouterr().err
    assert "hold the same driving, which would count twice: give one of them" in err


@pytest.mark.parametrize(("names", "runs"), [
    (("a_001", "a_002", "b_001"), 2), (("a-again", "b-again"), 2), (("a-first", "a_002"), 2),
    (("a_002", "a_001"), 1),
])  # fmt: skip
def test_other_driving_is_not(names: tuple[str, ...], runs: int, logs: Path) -> None:
    found = open_runs([logs / f"{name}.mcap" for name in names])
    assert len(found) == runs
    for run in found:
        t_s = run.poses.t_s
        assert t_s.size and (t_s[1:] >= t_s[:-1]).all()


def test_drives_of_one_command_are_runs_of_their_own(tmp_path: Path) -> None:
    """As `tilth simulate` names them: the same seed and start, another scenario."""
    for name, seed in (("one", 3), ("two", 4)):
        writer = LogWriter(tmp_path / name, MachineFile(MACHINE, MACHINE_TEXT), RunPart("simulated-3", 1, 0))
        for frame in simulate(MACHINE, seed, 2.0):
            writer.frame(frame)
        writer.close()
    machine = (MACHINE, MACHINE_TEXT)
    assert len(open_runs([tmp_path / "one", tmp_path / "two"], machine=machine, cache=tmp_path / "kept")) == 2


@pytest.mark.parametrize("cut", [False, True])
def test_a_cut_copy_of_a_part_of_the_daemon_is_the_same(cut: bool, tmp_path: Path) -> None:
    frames = list(simulate(MACHINE, 3, 6.0))
    logs = []
    for name, count in (("one", len(frames)), ("two", len(frames) // 2 if cut else len(frames))):
        (tmp_path / name).mkdir()
        logs += record(tmp_path / name, frames[:count], 1, UUID).parts
    with pytest.raises(GivenTwice):
        open_runs(logs)


def test_foreign_logs_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "rig.toml").write_text(MACHINE_TEXT)
    log = write_candump(tmp_path / "x.log", simulate(MACHINE, 3, 3.0))
    words = ["fit", str(log), str(log), "--machine", str(tmp_path / "rig.toml"), "--json"]
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert "hold the same driving" in err and not out.strip() and json.dumps(out)
