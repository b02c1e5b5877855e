"""What is gathered of a run: what was put into it, in SI."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_run import ANGLE, SECONDS, SHARE, SPEED, VALUES, WRITTEN, WrittenRun, write_run

from tilth.analysis.report.gather import facts_of
from tilth.analysis.runs.run import MARK, Run, open_runs
from tilth.analysis.runs.segments import between
from tilth.schemas.flow import PARAMETERS


def of(folder: Path, run: WrittenRun) -> Any:
    (found,) = open_runs(write_run(folder / "run.mcap", run))
    return facts_of(found)


def test_the_drive(facts: Any) -> None:
    driving = facts["driving"]
    assert facts["duration_s"] == SECONDS and facts["note"] == "clay <dry>"
    assert driving["distance_m"] == pytest.approx(SPEED * SECONDS)
    assert driving["median_speed_mps"] == pytest.approx(SPEED)
    assert driving["reverse_s"] == driving["still_s"] == 0.0
    assert (driving["latitude_deg"], driving["longitude_deg"]) == (52.0, 5.0)
    assert facts["start_utc_s"] == 1_700_000_000.0


def test_the_segment_and_what_it_can_tell(facts: Any) -> None:
    (segment,) = facts["segments"]
    assert segment["kind"] == "step" and segment["largest_angle_rad"] == pytest.approx(ANGLE)
    assert [text.split()[0] for text in segment["tells"]] == list(PARAMETERS[:5])


def test_given_segments_replace_those_found(run: Run) -> None:
    given = between(run.poses, 12.0, 20.0)
    (segment,) = facts_of(run, [given])["segments"]
    assert (segment["kind"], segment["start_s"], segment["end_s"]) == ("given", 12.0, 20.0)


def test_marks_and_changes_of_soil_have_their_places(facts: Any, run: Run) -> None:
    (mark,) = (event for event in facts["events"] if event["kind"] == MARK)
    at = int(np.argmin(abs(run.poses.t_s - mark["t_s"])))
    assert mark["text"] == WRITTEN
    assert (mark["x_m"], mark["y_m"]) == pytest.approx(
        (run.poses["tractor_x_m"][at], run.poses["tractor_y_m"][at])
    )
    assert [event["t_s"] for event in facts["events"] if event["kind"] == "soil_change"] == [45.0]


def test_the_last_estimate(facts: Any) -> None:
    last = facts["estimates"]["recommended"]
    assert last["t_s"] == SECONDS and set(facts["estimates"]) == {"recommended", "pem", "tracker"}
    for name, value in zip(PARAMETERS, VALUES, strict=True):
        found = last["parameters"][name]
        assert (found["value"], found["sd"]) == pytest.approx((value, value * SHARE))
        assert found["status"] == "estimated"
    assert np.array(last["log_covariance"])[0, 0] == pytest.approx(SHARE**2)


def test_nuisances_stand_beside_what_was_assumed(facts: Any) -> None:
    zero = {one["name"]: one for one in facts["nuisances"]}["wheel_zero"]
    assert zero["prior_sd"] == pytest.approx(math.radians(0.5))
    assert zero["value"] == pytest.approx(3.0 * zero["prior_sd"])


def test_a_silent_sensor_has_a_gap(tmp_path: Path) -> None:
    sensors = {one["name"]: one for one in of(tmp_path, WrittenRun(silent_s=(20.0, 26.0)))["sensors"]}
    gaps = sensors["implement_rear"]["gaps"]
    assert gaps["count"] == 1 and gaps["longest"][0]["seconds"] == pytest.approx(6.2)
    assert gaps["longest"][0]["start_s"] == pytest.approx(19.8)
    assert sensors["implement_rear"]["alive_share"] == pytest.approx(1 - 6.2 / SECONDS)
    assert sensors["tractor_front"]["gaps"]["count"] == 0 and sensors["tractor_front"]["fix"] == {
        "rtk_fixed": 1.0
    }


def test_a_contradiction_is_counted(tmp_path: Path) -> None:
    (flag,) = of(tmp_path, WrittenRun(contradicted=True))["flags"]
    assert (flag["flag"], flag["share"]) == ("contradiction:tractor.c", 1.0)


def test_a_log_that_was_cut(tmp_path: Path) -> None:
    found = of(tmp_path, WrittenRun(finish=False))
    assert not found["origin"]["whole"] and found["origin"]["cut"] == ["run.mcap"]
    assert "cut" in found["skipped"] and found["driving"]["poses"] > 100


def test_a_run_without_estimates(tmp_path: Path) -> None:
    found = of(tmp_path, WrittenRun(without_estimates=True))
    assert found["estimates"] == {} and found["nuisances"] == [] and found["curves"]["parameters"] == {}


def test_it_is_plain_data_with_sums_of_the_log(run: Run, facts: Any) -> None:
    json.dumps(facts, allow_nan=False)
    (log,) = facts["origin"]["logs"]
    assert len(log["sha256"]) == 64 and log["bytes"] == run.sources[0].stat().st_size
    assert facts["origin"]["machine_sha256"] == run.files[0].metadata["machine"]["sha256"]
    assert not facts["origin"]["simulated"]


def test_a_simulated_log_is_told_by_the_truth_beside_it(tmp_path: Path) -> None:
    path = write_run(tmp_path / "run.mcap", replace(WrittenRun(), run="x"))
    path.with_name("run.mcap.truth.json").write_text("{}")
    (found,) = open_runs(path)
    assert facts_of(found)["origin"]["simulated"]
