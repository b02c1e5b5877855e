"""A driver through a plan in real time: real bus, real daemon, `tilth experiment` as a person starts it."""

import logging
from importlib import resources
from pathlib import Path

import pytest
from prompted_live import drive_plan

from tilth.analysis.runs.run import open_runs
from tilth.analysis.runs.segments import MARKED, marked
from tilth.simulator.prompted_driver import Person
from tilth.simulator.scenario import Ground, Scenario, Soil

PLAN = """
name = "short"
machine = "jd7930-parker500"
countdown_s = 2
[field]
length = 400
width = 100
[[run]]
kind = "chirp"
speed = 4.5
amplitude_deg = 8
seconds = 10
replicates = 1
[[run]]
kind = "steps"
speed = 4.5
amplitude_deg = 8
seconds = 10
replicates = 1
"""
ROUGH = Ground(roll_sd_deg=0.7, force_sd=0.015)


@pytest.mark.prompted
def test_two_runs_get_done_are_marked_and_fitted(tmp_path: Path) -> None:
    logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)  # it warns at each half-read frame
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN)
    text = resources.files("tilth.deploy").joinpath("machines/jd7930-parker500.toml").read_text("utf-8")
    scenario = Scenario(speed=4.5, other_traffic=False, soil=Soil(grip=0.7, rolling=0.06), ground=ROUGH)
    lane = (20.0, 0.0, 0.0, 360.0)
    live = drive_plan(text, plan, scenario, Person(looks_away=0.01), 1, 400.0, lane, tmp_path / "logs")
    assert live.status == 0, live.said
    last = live.states[-1]
    assert last.phase == "finished"
    assert sorted(one.outcome for one in last.attempts if one.outcome == "done") == ["done"] * 2
    assert all(one.reason for one in last.attempts if one.outcome != "done")
    assert "agree" in live.said and "tilth report" in live.said
    (run,) = open_runs(list(live.summary.log_files))
    segments = marked(run.poses, run.marks)
    assert [segment.kind for segment in segments] == [MARKED] * 2
    done = {one.name for one in last.attempts if one.outcome == "done"}
    assert {segment.name for segment in segments} == done
    assert all(segment.seconds == pytest.approx(12.0, abs=0.5) for segment in segments)
