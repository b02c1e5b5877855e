"""What a virtual tractor drove is known for it, wherever the log goes and whatever tells of it."""

import ast
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from logs import MACHINE, MACHINE_TEXT, START_NS, record, write_candump
from one_recording import Recorder
from paths import ROOT

from tilth.cli import main
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.replay.catalogue import listing, run_files
from tilth.replay.glance import glance
from tilth.replay.simulated import REPLAY, SAID, TRUTH, simulated_by
from tilth.schemas.machine_toml import MachineFile
from tilth.simulator.traffic import simulate

FRAMES = list(simulate(MACHINE, 5, 3.0))
Log = Callable[[Path], Path]


def written(path: Path, run: RunPart, metadata: dict[str, dict[str, str]], finish: bool = True) -> Path:
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), run)
    for name, row in metadata.items():
        writer.metadata(name, row)
    for frame in FRAMES[:400]:
        writer.frame(frame)
    if finish:
        writer.close()
    else:
        writer.flush()
        writer.abandon()
    return path


def candump_with_truth(path: Path) -> Path:
    path = write_candump(path.with_suffix(".log"), FRAMES[:50])
    path.with_name(path.name + TRUTH).write_text("{}")
    return path


MARKED: dict[str, tuple[Log, str]] = {
    "now": (lambda p: written(p, RunPart("r", 1, START_NS, simulated="some rig"), {}), "some rig"),
    "simulate, before": (
        lambda p: written(p, RunPart("r", 1, START_NS), {"simulated": {"seed": "1"}}),
        "tilth simulate",
    ),
    "demo, before": (lambda p: written(p, RunPart("r", 1, START_NS, "simulated"), {}), "tilth demo"),
    "candump": (candump_with_truth, "tilth simulate"),
    "a tractor's": (lambda p: written(p, RunPart("r", 1, START_NS, "wet clay"), {}), ""),
    "a tractor's candump": (lambda p: write_candump(p.with_suffix(".log"), FRAMES[:50]), ""),
}


@pytest.mark.parametrize("name", MARKED)
def test_the_log_tells_it(name: str, tmp_path: Path) -> None:
    make, by = MARKED[name]
    log = make(tmp_path / "one.mcap")
    assert simulated_by([log]) == by
    (run,) = run_files([log])
    assert listing(run).simulated == bool(by)
    if log.suffix == ".mcap":
        assert glance(log).simulated == bool(by)


def test_a_replay_made_before_tells_it_by_its_logs(tmp_path: Path) -> None:
    log = MARKED["demo, before"][0](tmp_path / "one.mcap")
    again = written(tmp_path / "again.mcap", RunPart("replay", 1, 0), {REPLAY: {"logs": str(log)}})
    assert simulated_by([again]) == "tilth demo"


@pytest.mark.parametrize("name", MARKED)
def test_a_replay_of_it_tells_it_when_the_log_is_gone(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, by = MARKED[name]
    log, out = make(tmp_path / "one.mcap"), tmp_path / "out.mcap"
    rig = tmp_path / "rig.toml"
    rig.write_text(MACHINE_TEXT)
    assert main(["replay", str(log), "--machine", str(rig), "--out", str(out), "--json"]) == 0
    said, err = capsys.readouterr()
    assert json.loads(said)["simulated"] == bool(by) and (SAID in err) == bool(by)
    shutil.move(log, tmp_path / "elsewhere")
    assert simulated_by([out]) == by


def test_each_part_has_it_and_recover_and_offload_keep_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Recorder(tmp_path, log="rotate_minutes = 0.02", simulated="some rig")
    for frame in run.from_now(FRAMES):
        run.take(frame)
    run.recording.close()
    assert len(run.recording.files) > 1
    assert [simulated_by([path]) for path in run.recording.files] == ["some rig"] * len(run.recording.files)
    cut = written(tmp_path / "cut.mcap", RunPart("r", 1, START_NS, simulated="some rig"), {}, finish=False)
    assert simulated_by([cut]) == "some rig" and main(["recover", str(cut)]) == 0
    assert simulated_by([cut]) == "some rig"
    stick = tmp_path / "stick"
    stick.mkdir()
    assert main(["offload", str(stick), "--log", str(tmp_path)]) == 0
    copies = sorted(stick.rglob("*.mcap"))
    assert copies and all(simulated_by([path]) == "some rig" for path in copies)
    capsys.readouterr()
    assert main(["logs", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["simulated"] is True
    assert main(["logs", str(tmp_path)]) == 0
    assert "simulated" in capsys.readouterr().out


@pytest.mark.parametrize("form", ["csv", "mat", "parquet"])
def test_every_export_tells_it(form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if form == "parquet":
        pytest.importorskip("pyarrow")
    (log,) = record(tmp_path, FRAMES, 1).parts
    log = log.rename(tmp_path / "r.mcap")
    log.with_name(log.name + TRUTH).write_text("{}")
    assert main(["export", str(log), "--to", form, "--out", str(tmp_path / "out")]) == 0
    (about,) = tmp_path.glob("out/*/export.json")
    assert json.loads(about.read_text())["simulated"] is True
    assert SAID in capsys.readouterr().err


def test_every_virtual_tractor_marks_its_log() -> None:
    """Whoever runs the daemon, but for the one command that hears real buses, says what drives."""
    calls = [
        (str(path.relative_to(ROOT)), {word.arg for word in node.keywords})
        for folder in ("simulator", "examples", "bench", "cli", "client", "analysis", "deploy")
        for path in sorted((ROOT / folder).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and re.search(r"\brun_daemon$", ast.unparse(node.func))
    ]
    unmarked = {path for path, words in calls if "simulated" not in words}
    assert unmarked == {"cli/run.py"} and len(calls) >= 5
