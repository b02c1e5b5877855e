"""A driver through a plan in real time: real bus, real daemon, `tilth experiment` as a person starts it."""

import logging
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from paths import ROOT
from prompted_live import Live, drive_plan
from virtual_cab import plan_of

from tilth.analysis.runs.run import open_runs
from tilth.analysis.runs.segments import MARKED, marked
from tilth.cli import WrongUse
from tilth.client.experiment.prompter import RUNNING
from tilth.client.experiment.runner import RESTARTED
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.simulator.packaged import packaged_file
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


def _live(folder: Path, **options: Any) -> Live:
    logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)  # it warns at each half-read frame
    plan = folder / "plan.toml"
    plan.write_text(PLAN)
    text = packaged_file().text
    # A NAME is said once, when a receiver is switched on: a daemon that begins later must know the addresses.
    for source, name in enumerate(re.findall(r'name = "[0-9A-F]{16}"', text), 60):
        text = text.replace(name, f"source = {source}")
    scenario = Scenario(speed=4.5, other_traffic=False, soil=Soil(grip=0.7, rolling=0.06), ground=ROUGH)
    lane = (20.0, 0.0, 0.0, 360.0)
    person = Person(looks_away=0.01)
    live = drive_plan(text, plan, scenario, person, 1, 400.0, lane, folder / "logs", **options)
    assert live.status == 0, live.said
    return live


@pytest.mark.prompted
def test_two_runs_get_done_are_marked_and_fitted(tmp_path: Path) -> None:
    live = _live(tmp_path)
    last = live.states[-1]
    assert last.phase == "finished"
    assert sorted(one.outcome for one in last.attempts if one.outcome == "done") == ["done"] * 2
    assert all(one.reason for one in last.attempts if one.outcome != "done")
    assert "agree" in live.said and "tilth report" in live.said
    (run,) = open_runs(list(live.summaries[0].log_files))
    segments = marked(run.poses, run.marks)
    assert [segment.kind for segment in segments] == [MARKED] * 2
    done = {one.name for one in last.attempts if one.outcome == "done"}
    assert {segment.name for segment in segments} == done
    assert all(segment.seconds == pytest.approx(12.0, abs=0.5) for segment in segments)


@pytest.mark.prompted
def test_a_daemon_that_is_restarted_in_a_run_leaves_the_runs_of_both_logs(tmp_path: Path) -> None:
    def in_the_second_run(states: Sequence[pb.ExperimentState]) -> bool:
        return bool(states) and states[-1].done == 1 and states[-1].phase == RUNNING

    live = _live(tmp_path, restart=in_the_second_run)
    last = live.states[-1]
    done = [one.name for one in last.attempts if one.outcome == "done"]
    lost = [one for one in last.attempts if one.outcome == "aborted"]
    assert (last.phase, len(done), len(live.summaries)) == ("finished", 2, 2)
    assert any(RESTARTED in one.reason or "no pose has come" in one.reason for one in lost)
    logs = [path for summary in live.summaries for path in summary.log_files]
    runs = open_runs(logs)
    names = [[segment.name for segment in marked(run.poses, run.marks)] for run in runs]
    assert names == [done[:1], done[1:]]
    assert f"experiment short seed 1 goes on: {RESTARTED}" in runs[1].marks["text"].tolist()
    assert "agree" in live.said
    assert all(str(path) in live.said for path in logs)  # in the command for the report


@pytest.mark.prompted
def test_a_plan_is_driven_without_a_tractor_by_the_commands_that_are_printed(tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN.replace("width = 100", "width = 100\nheadland = 30"), encoding="utf-8")
    with subprocess.Popen(
        [sys.executable, ROOT / "bench/virtual_cab.py", plan, "--log", tmp_path / "logs"],
        stdout=subprocess.PIPE, text=True,
    ) as cab:  # fmt: skip
        assert cab.stdout is not None
        words = next(shlex.split(line) for line in cab.stdout if "tilth experiment" in line)
        start = "import sys; from tilth.cli import main; sys.exit(main())"
        prompted = subprocess.run(
            [sys.executable, "-c", start, *words[words.index("tilth") + 1 :]],
            check=False, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=400.0,
        )  # fmt: skip
        cab.send_signal(signal.SIGINT)
        said, _ = cab.communicate(timeout=60.0)
    assert (prompted.returncode, cab.returncode) == (0, 0), prompted.stdout + prompted.stderr
    assert "All runs are driven." in prompted.stdout and "Log: " in said


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("jd7930-parker500", "fendt", 'is for machine = "fendt"; the virtual tractor is jd7930-parker500'),
        ("width = 100", "width = 100\ncorner = [42.0, -93.6]\nheading_deg = 0", "is not at field.corner"),
        ("width = 100", "", "field.width: missing"),
    ],
)
def test_a_plan_that_the_virtual_tractor_cannot_drive_is_refused(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN.replace(old, new), encoding="utf-8")
    with pytest.raises(WrongUse, match=re.escape(words)):
        plan_of(plan, "jd7930-parker500")
