"""`tilth experiment` as a person starts it: wrong use in a sentence, a plan proposed, a plan prompted."""

import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from client_daemon import until
from logs import MACHINE_FILE
from loopback import PATIENCE_S
from paths import ROOT
from stage import Stage

from tilth.cli import main
from tilth.cli.experiment_learned import FitOfRuns, lines_of, with_all_parts
from tilth.cli.experiment_screen import bar, panel, title
from tilth.client.link import open_session
from tilth.logger.log.runs import file_name
from tilth.schemas.experiment import parse_plan, steered
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.proto import tilth_pb2 as pb

pytestmark = pytest.mark.long


EXAMPLE = ROOT / "examples/experiments.toml"
PLAN = parse_plan(EXAMPLE.read_text(encoding="utf-8"))
NAMES = [
    f"experiment {PLAN.name} run {number} {run.kind} replicate {k} of {run.replicates} try 1 seed {PLAN.seed}"
    for number, run in enumerate(PLAN.run, 1)
    for k in range(1, run.replicates + 1)
]
NOWHERE = "tcp/127.0.0.1:1"
BASE = "tilth/jd7930-parker500/replay"

PROPOSE = ["--propose", "--machine", "MACHINE", "--out", "new.toml"]
ROWS: list[tuple[list[str], str]] = [
    ([], "give the plan to drive, or --propose"),
    (["none.toml"], "none.toml: the plan cannot be read (no such file or directory)"),
    (["FOREIGN"], "FOREIGN: not a TOML file"),
    (["WRONG"], 'run[1].spede: no such key; did you mean "speed"?'),
    (["EXAMPLE", "--connect", NOWHERE], f"no daemon can be reached at {NOWHERE}; is `"),
    (["EXAMPLE", "--connect", "tractor"], "An endpoint looks like tcp/127.0.0.1:7447"),
    (["EXAMPLE", "--config", "none.json"], "none.json: no such file or directory"),
    (["EXAMPLE", "--out", "x.toml"], "--from and --out are for --propose"),
    (["EXAMPLE", "--machine", "MACHINE"], "--machine is for --propose and --check; to drive, the"),
    (["EXAMPLE", "--speed", "3", "--kind", "turn"], "--speed, --kind: for --propose; what is"),
    (["EXAMPLE", "--start-at", "10"], "has runs 1 to 9"),
    (["EXAMPLE", "--start-at", "0"], "has runs 1 to 9"),
    ([*PROPOSE, "--start-at", "2"], "--start-at, --try and --corner go with a plan to drive"),
    ([*PROPOSE, "--try", "2"], "--start-at, --try and --corner go with a plan to drive"),
    (["EXAMPLE", "--check"], "--check needs --machine M.toml"),
    (["EXAMPLE", "--check", "--machine", "none.toml"], "none.toml: the machine file cannot be read"),
    (["HARD", "--check", "--machine", "MACHINE"], "to the side, limits.lateral_acceleration allows 2.5"),
    (["NARROW", "--check", "--machine", "MACHINE"], "m of width, the field has 12 m"),
    (["OTHER", "--check", "--machine", "MACHINE"], 'OTHER is for machine = "fendt"; '),
    (["EXAMPLE", "--check", "--machine", "MACHINE", "--try", "2"], "plan to drive, not with --check"),
    (["--check", "--machine", "MACHINE"], "--check needs the plan to look at"),
    ([*PROPOSE, "--check"], "--check goes with a plan that is there, not with --propose"),
    (["EXAMPLE", "--try", "0"], "--try 0: give a whole number from 1 to 999"),
    (["EXAMPLE", "--corner", "43.5,-83.4"], "43.5,-83.4: write LATITUDE,LONGITUDE,HEADING in degrees"),
    (["EXAMPLE", "--corner=98,-83.4,0"], "98,-83.4,0: write LATITUDE,LONGITUDE,HEADING in degrees"),
    (["EXAMPLE", "--corner=nan,0,0"], "nan,0,0: write LATITUDE,LONGITUDE,HEADING in degrees"),
    (["--propose"], "--propose needs --machine M.toml and --out PLAN.toml"),
    (["EXAMPLE", *PROPOSE], "leave out the one to drive"),
    ([*PROPOSE, "--speed", "0.5"], "--speed 0.5: give 1.5 to 12 m/s"),
    ([*PROPOSE, "--seconds", "600"], "--seconds 600: give 8 to 60 s"),
    ([*PROPOSE, "--seconds", "7"], "--seconds 7: give 8 to 60 s for a run; less tells too little"),
    ([*PROPOSE, "--replicates", "0"], "--replicates 0: give a whole number from 1 to 20"),
    ([*PROPOSE, "--headland", "500"], "two of them must leave some of the field, which is 400 m long"),
    ([*PROPOSE, "--field", "40x20"], "two of them must leave some of the field, which is 40 m long"),
    ([*PROPOSE, "--field", "40x20", "--headland", "5", "--kind", "step"], "the field is too small for step"),
    ([*PROPOSE, "--field", "20x20"], "20x20: a field is 30 to 5000 m long, 10 to 5000 m wide"),
    ([*PROPOSE, "--angle", "90"], "--angle 90: give at most 37 degrees"),
    (["--propose", "--machine", "MACHINE", "--out", "none/p.toml"], "none: there is no such folder; make it"),
    ([*PROPOSE, "--field", "wide"], "wide: write LENGTHxWIDTH in m, such as 400x80"),
    ([*PROPOSE, "--field", "60x60", "--kind", "step"], "the field is too small for step runs at 4.5 m/s"),
    ([*PROPOSE, "--from", "none.mcap"], "none.mcap: there is no such log"),
    (["--propose", "--machine", "none.toml", "--out", "n"], "none.toml: the machine file cannot be read"),
    (["--propose", "--machine", "MACHINE", "--out", "EXAMPLE"], "exists and is not overwritten"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("words", "expected"), ROWS, ids=lambda v: " ".join(v) if isinstance(v, list) else ""
)
def test_one_line_says_what_to_do(
    words: list[str], expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "FOREIGN").write_text("not a plan\n")
    (tmp_path / "WRONG").write_text(EXAMPLE.read_text(encoding="utf-8").replace("speed =", "spede =", 1))
    for name, old, new in (
        ("HARD", "speed = 4.5", "speed = 9"),
        ("NARROW", "width = 80", "width = 12"),
        ("OTHER", "jd7930-parker500", "fendt"),
    ):
        (tmp_path / name).write_text(EXAMPLE.read_text(encoding="utf-8").replace(old, new))
    places = {"MACHINE": str(MACHINE_FILE), "EXAMPLE": str(EXAMPLE)}
    try:
        status: object = main(["experiment", *(places.get(word, word) for word in words)])
    except SystemExit as end:  # argparse
        status = end.code
    said = capsys.readouterr().err.splitlines()
    assert status == 2
    assert expected in said[-1]
    assert not (tmp_path / "new.toml").exists()


def test_a_plan_is_checked_without_a_daemon(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--check", "--machine", str(MACHINE_FILE)]
    assert main(["experiment", str(EXAMPLE), *words]) == 0
    said = capsys.readouterr()
    assert "9 runs, 153 s between their marks, fit the rig and the field" in said.out and said.err == ""
    fast = tmp_path / "fast.toml"
    fast.write_text(
        EXAMPLE.read_text(encoding="utf-8").replace("wheel_rate_degps = 15", "wheel_rate_degps = 8")
    )
    assert main(["experiment", str(fast), *words]) == 0
    told = capsys.readouterr().out
    assert "run[1], steps: limits.wheel_rate_degps = 8 leaves " in told and told.count("run[1]") == 1
    edited = tmp_path / "edited.toml"
    edited.write_text('predicted_for = "00000000"\n' + EXAMPLE.read_text(encoding="utf-8"))
    assert main(["experiment", str(edited), *words]) == 0
    assert "was edited after its numbers were predicted" in capsys.readouterr().out


@pytest.fixture(scope="module")
def stage() -> Iterator[Stage]:
    with Stage() as one:
        yield one


def test_a_plan_of_another_rig_is_not_begun(
    stage: Stage, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.toml"
    other.write_text(EXAMPLE.read_text(encoding="utf-8").replace("jd7930-parker500", "fendt-of-somebody"))
    assert main(["experiment", str(other), "--connect", stage.endpoint]) == 2
    assert "the daemon here is of jd7930-parker500" in capsys.readouterr().err


def test_another_prefix_is_told_as_that(stage: Stage, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["experiment", str(EXAMPLE), "--connect", stage.endpoint, "--prefix", "other"]) == 2
    said = capsys.readouterr().err
    assert "no daemon is heard on other/jd7930-parker500" in said and "--prefix is that of [zenoh]" in said


def test_a_plan_that_is_too_hard_for_the_rig_is_not_begun(
    stage: Stage, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hard = tmp_path / "hard.toml"
    hard.write_text(EXAMPLE.read_text(encoding="utf-8").replace("speed = 4.5", "speed = 9.0"))
    assert main(["experiment", str(hard), "--connect", stage.endpoint]) == 2
    assert "m/s^2 to the side" in capsys.readouterr().err


def test_who_may_not_mark_does_not_begin(stage: Stage, capsys: pytest.CaptureFixture[str]) -> None:
    stage.order(refusal="this key may not mark")
    with open_session(stage.endpoint) as session:
        until(lambda: any(r.err for r in session.get(f"{BASE}/mark", payload=b"x", timeout=PATIENCE_S)))
    assert main(["experiment", str(EXAMPLE), "--connect", stage.endpoint]) == 2
    assert "no mark can be put into the log: this key may not mark" in capsys.readouterr().err
    stage.order(refusal="")


def _prompter(stage: Stage, *words: str) -> "subprocess.Popen[str]":
    start = "import sys; from tilth.cli import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", start, "experiment", str(EXAMPLE), "--connect", stage.endpoint, *words],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def _states(page: zenoh.Session) -> list[pb.ExperimentState]:
    states: list[pb.ExperimentState] = []
    page.declare_subscriber(
        f"{BASE}/experiment", lambda s: states.append(pb.ExperimentState.FromString(s.payload.to_bytes()))
    )
    return states


def _skip(page: zenoh.Session, states: list[pb.ExperimentState], runs: int) -> None:
    for _ in range(runs):
        done = states[-1].done
        order = pb.ExperimentOrder(kind="skip").SerializeToString()
        list(page.get(f"{BASE}/experiment/order", payload=order, timeout=PATIENCE_S))
        until(lambda done=done: states[-1].done > done)  # type: ignore[misc]


def test_without_a_terminal_it_prints_lines_hears_the_page_and_tells_when_runs_are_left(
    stage: Stage, capsys: pytest.CaptureFixture[str]
) -> None:
    with _prompter(stage) as process, open_session(stage.endpoint) as page:
        states = _states(page)
        until(lambda: bool(states))
        assert main(["experiment", str(EXAMPLE), "--connect", stage.endpoint]) == 2, "two at once"
        assert "prompted through three-kinds already" in capsys.readouterr().err
        _skip(page, states, 9)
        said, complained = process.communicate(timeout=PATIENCE_S)
        until(lambda: any("No log was heard of" in line for line in states[-1].learned))  # and stays there
    assert process.returncode == 1  # nothing was driven
    assert "Arm the first run" in said and "Skipped." in said
    assert "The plan is at its end: 9 of 9 runs were skipped." in said and "All runs" not in said
    assert "No log was heard of" in said
    assert complained == "tilth experiment: 9 of 9 runs were skipped\n"


def test_a_prompter_that_was_ended_says_how_to_go_on_and_goes_on_there(stage: Stage) -> None:
    with open_session(stage.endpoint) as page:
        states = _states(page)
        with _prompter(stage) as process:
            until(lambda: bool(states))
            _skip(page, states, 7)
            process.terminate()
            _, complained = process.communicate(timeout=PATIENCE_S)
        assert "2 of 9 runs were not driven" in complained
        words = shlex.split(complained.splitlines()[-1].partition("to go on: ")[2])
        assert words[-2:] == ["--start-at", "8"] and words[-4:-2] == ["--connect", stage.endpoint]
        states.clear()
        with _prompter(stage, *words[-2:]) as process:
            until(lambda: bool(states))
            assert (states[0].done, states[0].of) == (7, 9)
            assert states[0].text.startswith("The plan goes on with run 8 of 9")
            assert "drive to where it begins" in states[0].text  # none was armed: nobody knows it
            _skip(page, states, 2)
            process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1


def test_what_was_learned_is_told_beside_what_was_expected() -> None:
    rows = {name: {"value": 2e3, "sd": 1e2, "status": "estimated", "reason": ""} for name in PARAMETERS}
    rows["sigma_i"] = {
        "value": None,
        "sd": None,
        "status": "unestimated",
        "reason": "more steering is needed",
    }
    covariance = [[0.0025 if i == j else 0.0 for i in range(6)] for j in range(6)]
    answer = {
        "runs": [{"name": name} for name in NAMES],
        "joint": {"parameters": rows, "log_covariance": covariance},
        "agreement": {"sentence": "The 2 segments agree."},
    }  # fmt: skip
    plan = PLAN.model_copy(update={"predicted": {"C_af": 0.06}, "predicted_for": steered(PLAN)})
    lines = lines_of(answer, plan)
    assert lines[0] == "C_af: 2.00 ± 0.20 kN/rad (95 %), ±10 %; expected ±12 % (95 %)"
    assert lines[5] == "sigma_i: more steering is needed"
    assert lines[-1] == "The 2 segments agree."
    other = lines_of(answer, plan.model_copy(update={"run": plan.run[:2]}))
    assert not any("expected ±" in one for one in other) and "was edited" in other[-1]
    assert "tell nothing" in lines_of({"joint": None}, PLAN)[0]
    for names in (NAMES[:-1], [*NAMES, NAMES[0].replace("try 1", "try 2")]):
        fewer = lines_of({**answer, "runs": [{"name": name} for name in names]}, plan)
        count = len({name.split(" try ")[0] for name in names})
        assert not any("expected ±" in one for one in fewer)
        assert f"{count} of the {len(NAMES)} runs are in this fit, in {len(names)} tries" in fewer[-1]


def test_all_parts_of_a_run_are_fitted(tmp_path: Path) -> None:
    parts = [tmp_path / file_name("rig_20261124T080000Z", k) for k in (1, 2, 3)]
    other = tmp_path / file_name("rig_20261124T090000Z", 1)
    for path in (*parts, other):
        path.touch()
    assert with_all_parts([str(parts[1])]) == [str(path) for path in parts]
    assert with_all_parts([str(parts[2]), str(other)]) == [str(path) for path in (*parts, other)]
    assert with_all_parts(["/nowhere/a.mcap"]) == ["/nowhere/a.mcap"]


def test_a_log_on_another_computer_is_told_of() -> None:
    fit = FitOfRuns(PLAN, ["/nowhere/run_001.mcap"])
    lines, commands = fit.told()
    fit.close()
    assert fit.over and "on the daemon's computer" in lines[0]
    assert "report /nowhere/run_001.mcap --out three-kinds.html --fit all" in commands[0]
    assert "--mark 'experiment three-kinds run * seed 1'" in commands[0]


@pytest.mark.parametrize("wanted", [-0.2, -0.05, 0.0, 0.1, 0.3])
def test_the_bar_shows_left_and_right_and_stays_in_its_frame(wanted: float) -> None:
    state = pb.ExperimentState(
        phase="running", wanted=wanted, measured=0.0, largest=0.15, ahead=[wanted] * 41
    )
    first, _, wheels = (row.plain for row in bar(state))
    middle = wheels.index("▲")
    assert len(first.split(" ")[-2]) == 61 or "▼" in first
    assert (first.index("▼") > middle) == (wanted > 0) and (first.index("▼") < middle) == (wanted < 0)
    assert panel(state).renderable is not None


def test_the_title_tells_what_was_skipped() -> None:
    state = pb.ExperimentState(plan="p", done=6, of=6)
    assert title(state) == "p: 6 of 6 runs"
    state.skipped = 5
    assert title(state) == "p: 6 of 6 runs, 5 of them skipped"
