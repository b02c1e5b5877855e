"""`fit_all`: the numbers of a replay, kept; which segments are taken; what cannot be fitted."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from logs import MACHINE_TEXT
from recorded import MARKS, marked, recorded, shared_cache
from threadpoolctl import threadpool_info, threadpool_limits

import tilth.analysis
from tilth.analysis.fit import fitting
from tilth.analysis.fit.fitting import CannotFit, choose, fit_all
from tilth.analysis.fit.result import as_json
from tilth.analysis.fit.segment_fit import fit_segment
from tilth.analysis.report.gather import facts_of
from tilth.analysis.runs import segments
from tilth.analysis.runs.driving import driving
from tilth.analysis.runs.run import Run
from tilth.analysis.runs.table import Table
from tilth.logger.machine_file import read_machine
from tilth.schemas.flow import PARAMETERS

pytestmark = pytest.mark.long


def replayed() -> Run:
    (run,) = tilth.analysis.open(marked(), cache=shared_cache())
    return run


def test_the_whole_drive_gives_what_its_replay_gives() -> None:
    run = replayed()
    fit = fit_segment(run.machine, driving(run, cache=shared_cache()), ("pem", "tracker"))
    for method in ("pem", "tracker"):
        last = run.estimates(method).where(np.array([-1]))
        for name, parameter in zip(PARAMETERS, fit.estimates[method].parameters, strict=True):
            unit = "N_per_rad" if name.startswith("C_") else "m"
            assert parameter.value == pytest.approx(last[f"{name}_{unit}"][0], rel=1e-9), (method, name)
            # A replay's is wider by what may be wrong with the machine file; a fit takes the file as it is.
            said = "the machine file" in last[f"{name}_reason"][0]
            assert 1.0 - 1e-9 < last[f"{name}_sd_{unit}"][0] / parameter.sd < (2.0 if said else 1.2), name


@pytest.fixture(scope="module")
def answer() -> dict[str, Any]:
    """Both steps, fitted side by side."""
    (run,) = tilth.analysis.open(recorded().parts)
    fitted = fit_all(choose([run]), jobs=2, cache=shared_cache())
    found: dict[str, Any] = json.loads(json.dumps(as_json(fitted)))
    return found


def test_each_step_and_all_together(answer: dict[str, Any]) -> None:
    assert [run["kind"] for run in answer["runs"]] == ["step", "step"]
    for row in (*answer["runs"], answer["joint"]):
        parameters = row["parameters"]
        assert set(parameters) == set(PARAMETERS)
        assert {p["status"] for p in parameters.values()} <= {"estimated", "unestimated"}
        assert np.array(row["log_covariance"]).shape == (6, 6)
        assert "wheel_zero" in row["nuisances"]
    sds = [[row["parameters"][name]["sd"] for name in PARAMETERS[:2]] for row in answer["runs"]]
    joint = [answer["joint"]["parameters"][name]["sd"] for name in PARAMETERS[:2]]
    assert all(sd < max(pair) for sd, pair in zip(joint, zip(*sds, strict=True), strict=True))
    assert set(answer["agreement"]) == {"chi2", "dof", "p", "sentence"} and answer["agreement"]["p"] > 0.01


def test_what_is_kept_is_not_fitted_again(answer: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    (run,) = tilth.analysis.open(recorded().parts)
    monkeypatch.setattr(fitting, "fit_segment", lambda *_: pytest.fail("fitted again"))
    monkeypatch.setattr(fitting, "linearise", lambda *_: pytest.fail("joined again"))
    done: list[tuple[int, int]] = []
    again = fit_all(choose([run]), cache=shared_cache(), progress=lambda *at: done.append(at))
    assert json.loads(json.dumps(as_json(again))) == answer and done == [(2, 2)]


def test_linear_algebra_has_one_thread_from_a_fit_on(answer: dict[str, Any]) -> None:
    (run,) = tilth.analysis.open(recorded().parts)
    with threadpool_limits(2):
        fit_all(choose([run]), cache=shared_cache())
        assert {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"} == {1}


def test_segments_have_the_numbers_of_the_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """A straight row counts, though nothing is fitted to it."""
    (run,) = tilth.analysis.open(recorded().parts)
    first, second = segments.find(run.poses)
    found = (replace(first, kind=segments.ROW), second)
    monkeypatch.setattr(segments, "find", lambda poses: found)
    (wanted,) = choose([run])
    row, shown = facts_of(run)["segments"]
    assert (row["number"], row["kind"]) == (1, "row")
    assert shown["number"] == wanted.number and shown["start_s"] == pytest.approx(wanted.segment.start_s)
    assert wanted.id == "1.2"


@pytest.mark.parametrize(("north_m", "east_m"), [(0.0, 0.0), (4000.0, 0.0), (-300.0, 1200.0)])
def test_runs_that_began_at_one_yard_are_as_far_apart_as_where_they_ended(
    north_m: float, east_m: float
) -> None:
    (one,) = choose([replayed()], [(1, 10.0, 20.0)])
    moved = {"tractor_x_m": north_m, "tractor_y_m": east_m}
    there = {
        name: values + moved.get(name, 0.0)
        for name, values in one.run.poses.columns.items()
        if name != "flags"
    }
    other = replace(one.run)
    other.__dict__["poses"] = Table(there)
    assert fitting._distance(one, replace(one, run=other)) == pytest.approx(
        math.hypot(north_m, east_m), rel=0.01, abs=0.01
    )


def test_marks_come_before_what_is_found() -> None:
    (wanted,) = choose([replayed()])
    assert wanted.segment.name == "west step" and wanted.id == "1.1"
    assert wanted.segment.start_s == pytest.approx(MARKS[0][0], abs=0.01)
    (given,) = choose([replayed()], [(1, 10.0, 20.0)])
    assert (given.segment.start_s, given.segment.end_s) == (10.0, 20.0)


@pytest.mark.parametrize(
    ("given", "kinds", "says"),
    [
        ([(1, 900.0, 960.0)], (), r"--segment 900:960: no poses between 900 and 960 s"),
        ([(3, 0.0, 9.0)], (), "--segment 3:0:9: there are 1 runs"),
        ([(1, 5.0, 25.0), (1, 12.0, 40.0)], (), r"5:25 and 12:40 overlap"),
        ((), ("chirp",), "no driving with steering of the kinds chirp"),
    ],
)
def test_what_cannot_be_fitted_is_said(
    given: list[tuple[int, float, float]], kinds: tuple[str, ...], says: str
) -> None:
    (run,) = tilth.analysis.open(recorded().parts)
    with pytest.raises(CannotFit, match=says):
        choose([run], given, kinds)


def test_only_marks_of_a_name_are_fitted_where_one_is_given() -> None:
    assert choose([replayed()], marks=["experiment *", "west*"]) == choose([replayed()])
    with pytest.raises(CannotFit, match=r"is called north \* or east; there are west step$"):
        choose([replayed()], marks=["north *", "east"])


def test_runs_of_two_rigs_are_not_joined(tmp_path: Path) -> None:
    changed = tmp_path / "changed.toml"
    changed.write_text(MACHINE_TEXT.replace("a = 1.7", "a = 1.75"))
    (one,) = tilth.analysis.open(recorded().parts)
    (other,) = tilth.analysis.open(marked(), machine=read_machine(changed), cache=shared_cache())
    with pytest.raises(CannotFit, match="different machine files; fit them one by one"):
        fit_all(choose([one, other]), cache=tmp_path)


def test_a_segment_that_tells_nothing_says_why(tmp_path: Path) -> None:
    (run,) = tilth.analysis.open(recorded().parts)
    fitted = fit_all(choose([run], [(1, 2.5, 5.0)]), cache=tmp_path)
    assert fitted.joint is None
    (only,) = as_json(fitted)["runs"]
    assert all(p["value"] is None and p["reason"] for p in only["parameters"].values())
    assert math.isfinite(only["speed"])
