"""`tilth experiment --propose --from LOG`: what a log has told counts, and what none tells is said."""

import gzip
import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from logs import MACHINE, MACHINE_FILE, MACHINE_TEXT, OTHER_TEXT, write_candump
from numpy.typing import NDArray
from recorded_run import START_NS, write_run

from tilth.analysis.experiment.predict import from_machine, sds
from tilth.cli import main
from tilth.schemas.experiment import parse_plan
from tilth.schemas.flow import PARAMETERS
from tilth.simulator.scenario import Scenario
from tilth.simulator.traffic import simulate

STEP = Scenario(other_traffic=False, speed=4.5, steering=((4.0, 0.0), (9.0, 7.0), (8.0, 0.0)))
SECONDS = 18.0


@pytest.fixture(autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))


@pytest.fixture(scope="module")
def step(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One step, as another program logs it."""
    return write_candump(tmp_path_factory.mktemp("step") / "step.log", simulate(MACHINE, 3, SECONDS, STEP))


def proposed(out: Path, logs: Sequence[Path] = (), machine: Path = MACHINE_FILE) -> int:
    """Exit status. One headland turn: of that kind nothing is to be searched."""
    words = ["--kind", "turn", "--runs", "1", "--replicates", "1", "--seconds", "10"]
    given = ["--from", *map(str, logs)] if logs else []
    return main(["experiment", "--propose", "--machine", str(machine), "--out", str(out), *words, *given])


def sds_of(predicted: Mapping[str, float]) -> NDArray[np.float64]:
    return np.array([predicted[name] for name in PARAMETERS])


@pytest.mark.long
def test_what_a_log_told_counts_and_is_not_asked_for_again(
    step: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert proposed(tmp_path / "new.toml") == proposed(tmp_path / "from.toml", [step]) == 0
    said = capsys.readouterr()
    assert "fitting 1 stretch of driving in the log" in said.err
    texts = [(tmp_path / name).read_text(encoding="utf-8") for name in ("new.toml", "from.toml")]
    assert "--propose`. Edit" in texts[0] and "--propose` from step.log. Edit" in texts[1]
    plans = [parse_plan(text) for text in texts]
    new, known = sds_of(plans[0].predicted), sds_of(plans[1].predicted_with_log)
    assert not plans[0].predicted_with_log
    prior = sds(from_machine(MACHINE), ())
    assert np.all(new < prior) and np.all(known < 0.7 * new)
    # A slow turn tells next to nothing of sigma_i: that it is known is by the log, and nothing asks for it.
    assert new[-1] > 0.9 * prior[-1] and known[-1] < 0.3 * prior[-1]


def foreign(folder: Path, step: Path) -> list[Path]:
    log = folder / "foreign.log"
    log.write_text("(1700000000.000000) can0 18FEF300#0102030405060708\n")
    return [log]


def text(folder: Path, step: Path) -> list[Path]:
    log = folder / "text.mcap"
    log.write_text("not a log\n")
    return [log]


def empty(folder: Path, step: Path) -> list[Path]:
    log = folder / "empty.mcap"
    log.touch()
    return [log]


def cut_gzip(folder: Path, step: Path) -> list[Path]:
    log = folder / "cut.log.gz"
    log.write_bytes(gzip.compress(step.read_bytes())[:200])
    return [log]


REFUSED: dict[str, tuple[Callable[[Path, Path], list[Path]], int, str]] = {
    "of another rig": (lambda at, step: write_run(at, 5.0, name="fendt"), 2, "is of fendt, "),
    "one of two of another rig": (
        lambda at, step: [*write_run(at, 5.0), *write_run(at, 6.0, name="fendt")], 2, "is of fendt, ",
    ),
    "no steering": (lambda at, step: write_run(at, 30.0), 1, "no driving with steering was found"),
    "no poses": (lambda at, step: write_run(at, 5.0, results=False), 1, "there are no poses in these logs"),
    "of other devices": (foreign, 1, "there are no poses in these logs"),
    "no log": (text, 2, "text.mcap: not a log of CAN frames"),
    "empty": (empty, 1, "empty.mcap: an empty file"),
    "a folder": (lambda at, step: [at], 2, "a folder; give the log files in it"),
    "cut": (cut_gzip, 1, ""),
    "not there": (lambda at, step: [step, at / "none.mcap"], 2, "none.mcap: there is no such log"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_of_a_log_that_tells_nothing_it_is_said_why_and_nothing_is_written(
    case: str, step: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, status, words = REFUSED[case]
    logs, out = tmp_path / "logs", tmp_path / "plan.toml"
    logs.mkdir()
    assert proposed(out, make(logs, step)) == status
    said = capsys.readouterr()
    last = said.err.splitlines()[-1]
    assert last.startswith("tilth experiment: ") and words in last and "--segment" not in last
    assert said.out == "" and not out.exists()


@pytest.mark.long
def test_a_log_without_steering_is_named_beside_one_that_tells(
    step: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    straight = Scenario(other_traffic=False, speed=4.5, steering=((60.0, 0.0),))
    log = write_candump(tmp_path / "straight.log", simulate(MACHINE, 4, SECONDS, straight))
    assert proposed(tmp_path / "plan.toml", [step, log]) == 0
    said = capsys.readouterr().err
    assert "straight.log: no driving with steering is in it" in said
    assert "fitting 1 stretch of driving in the log" in said


NAMES = itertools.count(60)
BY_SOURCE = re.sub(r'name = "[0-9A-F]{16}"', lambda found: f"source = {next(NAMES)}", MACHINE_TEXT)


def test_of_several_logs_it_is_said_which_told_nothing_and_why(
    step: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of receivers that are found by NAME in the log, and by their source in the machine file of today."""
    today = tmp_path / "today.toml"
    today.write_text(BY_SOURCE, encoding="utf-8")
    logs = tmp_path / "logs"
    logs.mkdir()
    (log,) = write_run(logs, 60.0)
    assert proposed(tmp_path / "plan.toml", [log], today) == 1
    *_, said, last = capsys.readouterr().err.splitlines()
    assert said.startswith(f"tilth experiment: {log}: no pose comes out of it with {today}")
    assert "the machine file in it differs in receiver[1].name, receiver[1].source" in said
    assert "there are no poses in these logs" in last


def test_logs_that_were_recorded_over_two_ways_to_the_buses_count_together(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """To which port a bus was opened is of no interest to a fit."""
    moved = MACHINE_TEXT.replace("bitrate = 250000", "bitrate = 500000", 1)
    assert moved != MACHINE_TEXT
    logs = tmp_path / "logs"
    logs.mkdir()
    found = [*write_run(logs, 60.0), *write_run(logs, 60.0, start_ns=START_NS + 10**12, text=moved)]
    assert proposed(tmp_path / "plan.toml", found) == 1  # there is nothing in their frames
    said = capsys.readouterr().err
    assert "fitting 2 stretches of driving" in said and "different machine files" not in said


def test_a_log_of_another_rig_by_its_devices_alone(
    step: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A log of another program names no rig; none of the machine file's receivers is in it."""
    other = tmp_path / "other.toml"
    other.write_text(OTHER_TEXT, encoding="utf-8")
    assert proposed(tmp_path / "plan.toml", [step], other) == 1
    assert "there are no poses in these logs" in capsys.readouterr().err
    assert not (tmp_path / "plan.toml").exists()
