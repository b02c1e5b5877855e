"""The runs of chapter 7: each is what its name says, made once, and the same wherever it is made."""

from pathlib import Path

import pytest

from studies.dissertation import experiments
from studies.dissertation.experiments import Experiment, all_of, made, truth
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.scenario import DrivenManoeuvre
from tilth.simulator.tractor import setting_of

RUN = Experiment("planar", "first", "steps", 1)


def test_there_are_36_runs_each_with_its_own_noise() -> None:
    runs = all_of()
    assert len(runs) == len({run.name for run in runs}) == 36
    assert len({run.seed for run in runs}) == 18  # the plants have the same ones


@pytest.mark.parametrize("run", [run for run in all_of() if run.replicate == 1], ids=lambda run: run.name)
def test_a_run_is_what_its_name_says(run: Experiment) -> None:
    scenario = run.scenario
    assert scenario.plant == run.plant and scenario.speed == 4.5 and scenario.rig_seed is not None
    if run.manoeuvre == "steps":
        assert isinstance(scenario.steering, tuple)
        assert max(abs(angle or 0.0) for _, angle in scenario.steering) < 10.0
        assert sum(seconds for seconds, angle in scenario.steering if angle) == 30.0
    else:
        assert scenario.steering == DrivenManoeuvre(run.manoeuvre, 8.0)  # type: ignore[arg-type]
    assert scenario.seconds > experiments.FITTED_S[1] + 0.5


def test_the_fields_are_those_in_print() -> None:
    assert list(truth("first").values()) == [90e3, 580e3, 62e3, 1.5, 1.9, 1.1]  # table 7.5, all runs
    assert list(truth("second").values()) == [120e3, 650e3, 90e3, 0.7, 0.9, 0.5]
    assert tuple(truth("first")) == PARAMETERS


def test_replicates_are_of_one_rig_and_fields_of_two() -> None:
    machine = parse_machine(experiments.machine_text())
    runs = [RUN, RUN._replace(replicate=2), RUN._replace(manoeuvre="chirp"), RUN._replace(field="second")]
    one, two, chirp, other = (setting_of(machine, run.seed, 1.0, run.scenario).rig for run in runs)
    assert one == two == chirp and one.m_i != other.m_i


def test_a_log_is_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    short = RUN.text.replace("seconds = 38.0", "seconds = 2.0")
    monkeypatch.setattr(Experiment, "text", property(lambda run: short))
    log = made(RUN, tmp_path)
    before = log.stat().st_mtime_ns
    assert made(RUN, tmp_path) == log and log.stat().st_mtime_ns == before
    assert {path.name for path in tmp_path.iterdir()} == {
        log.name, f"{log.name}.truth.json", f"{log.name}.truth.csv",
    }  # fmt: skip
    assert made(RUN._replace(replicate=2), tmp_path) != log
