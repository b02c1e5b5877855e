"""`tilth simulate`: a log that a recorder could have taken, and beside it what was true."""

import csv
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import MACHINE_FILE, ROOT

from tilth.cli import main
from tilth.estimator.fold import initial, step
from tilth.estimator.pose.geometry import to_plane
from tilth.replay.readers.any_log import frames
from tilth.replay.readers.rig import machine_in
from tilth.schemas.flow import PARAMETERS, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.drive import drive
from tilth.simulator.fleet import drawn
from tilth.simulator.fleet_files import owners_text
from tilth.simulator.scenario import Scenario, parse_scenario
from tilth.simulator.simulate import SimulationInput, simulate_to
from tilth.simulator.traffic import host_clock, simulate

SCENARIOS = ROOT / "examples" / "scenarios"
SUDDEN = """
seconds = 4.0
seed = 5
steering = [[1.0, 0.0], [5.0, 6.0]]
faults = [{ mount = "tractor_rear", start_s = 1.0, end_s = 2.0, kind = "silent" }]
[[soil.changes]]
north = 9.0
east = 0.0
C_af = 0.5
C_ai = 0.5
"""


@pytest.fixture(scope="module")
def sudden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of SUDDEN."""
    folder = tmp_path_factory.mktemp("sudden")
    (folder / "sudden.toml").write_text(SUDDEN)
    assert main(["simulate", str(folder / "sudden.toml"), "--out", str(folder / "run.mcap")]) == 0
    return folder / "run.mcap"


def _truth(log: Path) -> dict[str, Any]:
    output: dict[str, Any] = json.loads(Path(f"{log}.truth.json").read_text())
    return output


def _table(log: Path) -> dict[str, np.ndarray]:
    with Path(f"{log}.truth.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


@pytest.mark.parametrize("ending", ["mcap", "log"])
def test_the_log_holds_the_frames_of_the_scenario(machine: Machine, tmp_path: Path, ending: str) -> None:
    log = tmp_path / f"run.{ending}"
    words = ["--out", str(log), "--seconds", "2", "--seed", "7"]
    assert main(["simulate", str(SCENARIOS / "demo.toml"), *words]) == 0
    wanted = list(simulate(machine, 7, 2.0, parse_scenario((SCENARIOS / "demo.toml").read_text())))
    got = list(frames(log))
    assert [(f.bus, f.can_id, f.data) for f in got] == [(f.bus, f.can_id, f.data) for f in wanted]
    step_ns = 1 if ending == "mcap" else 1000
    assert all(0 <= w.t_ns - g.t_ns < step_ns for w, g in zip(wanted, got, strict=True))


def test_an_mcap_log_carries_its_machine_and_replays(
    sudden: Path, machine: Machine, capsys: pytest.CaptureFixture[str]
) -> None:
    assert machine_in([sudden])[0] == machine
    assert main(["replay", str(sudden), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert output["poses"] > 10 and not output["truncated"]


def test_a_candump_log_replays_with_a_machine_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.log"
    assert main(["simulate", str(SCENARIOS / "demo.toml"), "--out", str(log), "--seconds", "3"]) == 0
    first = log.read_text().splitlines()[0]
    assert re.fullmatch(r"\(17778\d{5}\.\d{6}\) can0 18EEFF[0-9A-F]{2}#[0-9A-F]{16}", first)
    capsys.readouterr()
    assert main(["replay", str(log), "--machine", str(MACHINE_FILE), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["poses"] > 5


@pytest.mark.parametrize("ending", ["mcap", "log"])
def test_the_same_seed_gives_the_same_bytes(tmp_path: Path, ending: str) -> None:
    messages = []
    for name, seed in (("one", 3), ("two", 3), ("other", 4)):
        folder = tmp_path / name
        folder.mkdir()
        words = ["--out", str(folder / f"run.{ending}"), "--seconds", "1.5", "--seed", str(seed)]
        assert main(["simulate", str(SCENARIOS / "bad_day.toml"), *words]) == 0
        messages.append([path.read_bytes() for path in sorted(folder.iterdir())])
    assert len(messages[0]) == 3
    assert messages[0] == messages[1]
    assert all(one != other for one, other in zip(messages[0], messages[2], strict=True))


def test_the_truth_names_parameters_rig_events_and_source(sudden: Path, machine: Machine) -> None:
    result, truth = _truth(sudden), drive(machine, 5, 4.0, parse_scenario(SUDDEN))
    assert result["parameters"] == pytest.approx(truth.parameters)
    assert result["nuisances"] == pytest.approx(truth.nuisances)
    assert result["rig"]["m_i"] == {
        "value": pytest.approx(truth.rig.m_i),
        "unit": "kg",
        "meaning": "mass of the implement with its load",
    }
    assert result["source"]["seed"] == 5
    assert (result["source"]["scenario"], result["source"]["machine"]) == (SUDDEN, MACHINE_FILE.read_text())
    assert result["source"]["software"]["numpy"] == np.__version__
    clock = host_clock(truth)
    whats = [(e["what"], e.get("mount"), e.get("axle")) for e in result["events"]]
    assert whats == [
        ("silent", "tractor_rear", None),
        ("soil", None, "front"),
        ("soil", None, "rear"),
        ("soil", None, "implement"),
    ]
    assert (result["events"][0]["t_ns"], result["events"][0]["end_ns"]) == (clock(1.0), clock(2.0))


def test_the_table_is_the_truth_on_the_clock_of_the_log(sudden: Path, machine: Machine) -> None:
    table, result = _table(sudden), _truth(sudden)
    truth = drive(machine, 5, 4.0, parse_scenario(SUDDEN))
    assert list(table) == list(result["table"]["columns"])
    assert len(table["t_ns"]) == 201
    np.testing.assert_array_equal(table["t_ns"], [host_clock(truth)(t) for t in truth.time[::2]])
    for name, wanted in (
        ("x_t", truth.tractor.x),
        ("psi_i", truth.implement.heading),
        ("v_i", truth.implement.lateral_velocity),
        ("delta", truth.wheel_angle),
        ("alpha_i", truth.states[:, 10]),
        ("sigma_r", truth.soil[:, 4]),
    ):
        np.testing.assert_allclose(table[name], wanted[::2], rtol=1e-7, atol=1e-8, err_msg=name)
    halves = {name: table[name][-1] / table[name][0] for name in PARAMETERS}
    assert halves == pytest.approx({**dict.fromkeys(PARAMETERS, 1.0), "C_af": 0.5, "C_ai": 0.5})
    changed = result["events"][1]
    assert table["t_ns"][np.flatnonzero(table["C_af"] < 0.9 * table["C_af"][0])[0]] == pytest.approx(
        changed["t_ns"], abs=5e7
    )


def test_poses_replayed_from_the_log_are_those_of_the_truth(machine: Machine, tmp_path: Path) -> None:
    """Columns, clock, units and signs, through everything that a log goes through."""
    log = tmp_path / "run.log"
    words = ["--out", str(log), "--seconds", "20"]
    assert main(["simulate", str(SCENARIOS / "side_slope.toml"), *words]) == 0
    table, result = _table(log), _truth(log)
    state = initial(machine)
    poses = [p.value for f in frames(log) for p in step(state, f) if isinstance(p.value, Pose)]
    good = [p for p in poses[20:] if not p.flags]
    assert len(good) > 50

    def true(name: str, pose: Pose) -> float:
        return float(np.interp(pose.t_ns, table["t_ns"], table[name]))

    for pose in good:
        origin = to_plane(result["origin_deg"], pose.origin_latitude_deg, pose.origin_longitude_deg)
        for body, letter in ((pose.tractor, "t"), (pose.implement, "i")):
            assert body.x is not None and body.y is not None and body.heading is not None
            assert body.roll is not None and body.forward_velocity is not None
            assert body.x + origin[0] == pytest.approx(true(f"x_{letter}", pose), abs=0.5)
            assert body.y + origin[1] == pytest.approx(true(f"y_{letter}", pose), abs=0.3)
            off = (body.heading - true(f"psi_{letter}", pose) + np.pi) % (2 * np.pi) - np.pi
            assert abs(off) < 0.05
            assert body.roll == pytest.approx(true(f"phi_{letter}", pose), abs=0.05)
            assert body.forward_velocity == pytest.approx(true(f"u_{letter}", pose), abs=0.3)


def test_the_scenario_may_name_its_machine(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    assert main(["simulate", str(SCENARIOS / "kingpin.toml"), "--out", str(log), "--seconds", "1"]) == 0
    assert machine_in([log])[0].wheel_angle.kingpin == "left"
    other = tmp_path / "other.mcap"
    words = ["--out", str(other), "--seconds", "1", "--machine", str(MACHINE_FILE)]
    assert main(["simulate", str(SCENARIOS / "kingpin.toml"), *words]) == 0
    assert machine_in([other])[0].wheel_angle.kingpin == "mean"


def test_json_names_the_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.log"
    words = ["--out", str(log), "--seconds", "1", "--json"]
    assert main(["simulate", str(SCENARIOS / "demo.toml"), *words]) == 0
    captured = capsys.readouterr()
    output = json.loads(captured.out)
    assert captured.err == ""
    assert output["frames"] == len(log.read_text().splitlines())
    assert [Path(output[key]).exists() for key in ("log", "truth", "table")] == [True] * 3
    assert output["parameters"] == _truth(log)["parameters"]


def test_a_log_is_written_without_python_can(tmp_path: Path) -> None:
    order = ["simulate", str(SCENARIOS / "demo.toml"), "--seconds", "1", "--json", "--out", "run.mcap"]
    code = f"import sys; from tilth.cli import main; main({order})\n"
    code += "print({'can', 'asammdf', 'pandas', 'polars'} & set(sys.modules))"
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[1:] == ["set()"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["{bad}", "--out", "{new}"], ["bad.toml", "speeed", "did you mean", "speed"]),
        (["{gone}", "--out", "{new}"], ["gone.toml", "cannot be read"]),
        (["{good}", "--out", "{old}"], ["old.mcap", "never overwritten"]),
        (["{good}", "--out", "{beside}"], ["beside.log.truth.csv", "never overwritten"]),
        (["{good}", "--out", "{blf}"], ["run.blf", ".mcap or .log"]),
        (["{good}", "--out", "{nowhere}"], ["there is no folder"]),
        (["{good}", "--out", "{new}", "--seconds", "0"], ["--seconds 0", "above zero"]),
        (["{good}", "--out", "{new}", "--seconds", "nan"], ["--seconds nan"]),
        (["{good}", "--out", "{new}", "--seed", "-1"], ["--seed -1"]),
        (["{good}", "--out", "{new}", "--machine", "{bad}"], ["bad.toml", "speeed"]),
        (["{good}", "--out", "{new}", "--machine", "{odd}"], ["odd.toml", "mass = 93 kg: must be from 500"]),
        (["{good}"], ["--out"]),
    ],
)
def test_wrong_use_is_one_sentence_and_exit_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], expected: list[str]
) -> None:
    names = {name: tmp_path / f"{name}.toml" for name in ("good", "bad", "gone", "odd")}
    names |= {"new": tmp_path / "new.mcap", "old": tmp_path / "old.mcap", "blf": tmp_path / "run.blf"}
    names |= {"beside": tmp_path / "beside.log", "nowhere": tmp_path / "no" / "run.log"}
    names["good"].write_text("seconds = 1.0\n")
    names["bad"].write_text("speeed = 4.0\n")
    names["odd"].write_text(MACHINE_FILE.read_text().replace("mass = 9391.0", "mass = 93.0"))
    names["old"].write_bytes(b"precious")
    Path(f"{names['beside']}.truth.csv").write_bytes(b"precious")
    before = sorted(tmp_path.iterdir())
    try:
        status: object = main(["simulate", *(word.format(**names) for word in words)])
    except SystemExit as left:
        status = left.code
    captured = capsys.readouterr()
    assert (status, captured.out, len(captured.err.splitlines())) == (2, "", 1)
    for word in expected:
        assert word in captured.err
    assert sorted(tmp_path.iterdir()) == before
    assert names["old"].read_bytes() == b"precious"


SPACE = 'plant = "spatial"\nseconds = 10.0\n'
OVER = "steering = [[10.0, 40.0]]\nspeed = 15.0\n"


@pytest.mark.parametrize(
    ("scenario", "expected"),
    [
        (SPACE + OVER, ["the tractor turns over at", "m north", "its roll passes 45°", "a lower speed"]),
        (SPACE + "[ground]\nrms = 0.1\nwaves = [0.3, 1.0]", ["turns over at", "ground.rms"]),
        (SPACE + "[spatial]\nroll_gyration = [0.2, 0.2]", ["roll_gyration[1] = 0.2 m", "give 0.42 to 2.57"]),
        (SPACE + "[spatial]\nvertical_stiffness = [2e7, 2e7, 2e7]", ["too stiff", "vertical_stiffness[1]"]),
        (SPACE + "[spatial]\nvertical_stiffness = [20e3, 20e3, 20e3]", ["does not hold the tractor upright"]),
    ],
    ids=["over", "rough", "inertia", "stiff", "soft"],
)
def test_what_does_not_stay_on_its_wheels_is_refused_and_leaves_nothing(
    scenario: str,
    expected: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("mujoco", reason="needs the extra `spatial`")
    monkeypatch.chdir(tmp_path)
    Path("over.toml").write_text(scenario)
    assert main(["simulate", "over.toml", "--out", "run.mcap"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1) and err.startswith("tilth simulate: over.toml: ")
    for word in expected:
        assert word in err
    assert [path.name for path in tmp_path.iterdir()] == ["over.toml"]


@pytest.mark.parametrize("ending", ["mcap", "log"])
def test_a_simulation_that_is_stopped_leaves_nothing(tmp_path: Path, machine: Machine, ending: str) -> None:
    def stop(what: str, at_s: float) -> None:
        if what == "frames":
            assert len(list(tmp_path.iterdir())) == 3
            raise KeyboardInterrupt

    source = SimulationInput(machine, MACHINE_FILE.read_text(), Scenario(), "", 1, 10.0)
    with pytest.raises(KeyboardInterrupt):
        simulate_to(source, tmp_path / f"run.{ending}", stop)
    assert list(tmp_path.iterdir()) == []


def test_a_rig_of_the_fleet_has_its_owners_file_beside_its_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is true is in the truth; what the owner says of it is in the log and beside it."""
    (tmp_path / "drive.toml").write_text("seconds = 4.0\nsteering = [[1.0, 0.0], [5.0, 6.0]]\n")
    told = [str(tmp_path / "drive.toml"), "--fleet", "7", "--json"]
    assert main(["simulate", *told, "--out", str(tmp_path / "run.mcap")]) == 0
    files = json.loads(capsys.readouterr().out)
    text = Path(files["machine"]).read_text(encoding="utf-8")
    assert text == owners_text(drawn(7))
    assert machine_in([tmp_path / "run.mcap"]) == (parse_machine(text), text)
    truth = _truth(tmp_path / "run.mcap")
    assert truth["rig"]["m_i"]["value"] == pytest.approx(drawn(7).implement.mass, abs=0.01)
    assert truth["rig"]["m_i"]["value"] != parse_machine(text).implement.mass.value
    assert truth["parameters"] == pytest.approx(dict(drawn(7).parameters))
    assert main(["simulate", *told, "--out", str(tmp_path / "other.mcap"), "--seed", "2"]) == 0
    assert _truth(tmp_path / "other.mcap")["rig"] == truth["rig"]  # another drive of the same rig


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--fleet", "-1"], "--fleet -1"),
        (["--fleet", "3", "--machine", str(MACHINE_FILE)], "not allowed with"),
    ],
)
def test_no_rig_of_the_fleet(options: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = str(SCENARIOS / "random.toml")
    try:
        status = main(["simulate", scenario, "--out", "/nowhere/run.mcap", *options])
    except SystemExit as caught:
        status = int(str(caught.code))
    assert status == 2 and words in capsys.readouterr().err


def test_the_owners_file_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run.log.machine.toml").write_text("mine")
    out = ["--out", str(tmp_path / "run.log"), "--fleet", "3"]
    assert main(["simulate", str(SCENARIOS / "random.toml"), *out]) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert (tmp_path / "run.log.machine.toml").read_text() == "mine" and not (tmp_path / "run.log").exists()
