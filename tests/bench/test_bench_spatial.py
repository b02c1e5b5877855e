"""Rows on the spatial plant: logs are made once, interrupted rows go on, and what must hold is told from what
does not."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import spatial_logs
import spatial_rows
import spatial_runs
from estimation_table import Bench
from scipy.stats import binom

from tilth.estimator.filters.unknowns import AT
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.fleet import drawn

SCALE = 0.15  # of 120 s
NAME = "spatial_random"


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With one short run."""
    folder = tmp_path_factory.mktemp("logs")
    assert spatial_logs.make(folder, _short(NAME), 3)
    return folder


def _short(name: str) -> spatial_logs.LogRow:
    row = spatial_logs.ROW[name]
    return replace(row, seconds=row.seconds * SCALE)


@pytest.mark.long
def test_a_log_is_made_once(logs: Path) -> None:
    assert not spatial_logs.make(logs, _short(NAME), 3)
    folder = spatial_logs.folder_of(logs, NAME, 3)
    assert {path.name for path in folder.iterdir()} == {"run.log", "run.log.truth.json", "truth.npz"}
    assert not list(folder.parent.glob(".*"))
    assert not spatial_logs.is_there(folder, spatial_logs.source_of(replace(_short(NAME), rms=0.02), 3))


@pytest.mark.long
def test_a_row_is_made_of_runs_that_are_kept(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = next(row for row in spatial_rows.ROWS if row.name == NAME)
    bench = Bench(runs=1, scale=SCALE, logs=logs, kept=tmp_path / "kept.jsonl")
    lines = row.make(bench)
    assert any(line.reach for line in lines) and all(line.figure and line.reached for line in lines)
    assert any("not fitted" in line.figure for line in lines)
    kept = (tmp_path / "kept.jsonl").read_text()
    (tmp_path / "kept.jsonl").write_text(kept[:100] + "\n" + kept + kept[:100])  # lines that were cut short
    monkeypatch.setattr(spatial_runs, "follow", _never)
    again = row.make(bench)
    assert [line.reached for line in again] == [line.reached for line in lines]


def _never(*_: Any, **__: Any) -> None:
    raise AssertionError("it was to be kept")


def test_after_a_line_that_was_cut_short_comes_a_new_one(tmp_path: Path) -> None:
    bench = Bench(kept=tmp_path / "kept.jsonl")
    (tmp_path / "kept.jsonl").write_text('{"row": "spa')
    spatial_rows.keep(bench, {"row": NAME, "seed": 7, "scale": 1.0})
    assert set(spatial_rows.kept(bench, NAME)) == {7}


@pytest.mark.long
def test_what_is_true_of_the_nuisances_is_named_as_the_unknowns(logs: Path) -> None:
    run = spatial_logs.read_run(logs, NAME, 3)
    true = spatial_runs.true_nuisances(parse_machine(run.machine_text), run)
    assert true.keys() <= set(AT)
    assert all(math.isfinite(value) for value in true.values())
    assert abs(true["wheel_gain"]) < 0.04 and 0.0 <= true["roll_late_t"] < 0.1
    assert abs(true["roll_zero_tractor_front"]) < math.radians(1.0)


def test_every_seed_has_its_own_rig_and_every_row_the_same() -> None:
    sources = [spatial_logs.source_of(row, 1) for row in spatial_logs.ROWS if not row.fleet]
    heights = {source.machine.tractor.cg_height.value for source in sources}
    assert len(heights) == 1
    assert spatial_logs.drawn(1) != spatial_logs.drawn(2)
    heavy = spatial_logs.source_of(spatial_logs.ROW["spatial_8t"], 1)
    assert (heavy.machine.implement.mass.value, heavy.machine.implement.mass.sd) == (8000.0, 800.0)


def test_a_seed_of_a_row_on_the_fleet_is_a_rig_of_it() -> None:
    source = spatial_logs.source_of(spatial_logs.ROW["fleet_field"], 3)
    assert source.machine.machine.name == "fleet-3"
    assert source.driven is not None
    assert source.driven.tractor.mass.value == pytest.approx(drawn(3).tractor.mass, abs=0.01)
    assert source.machine.tractor.mass.value != source.driven.tractor.mass.value


def test_between_the_step_runs_nothing_is_recorded() -> None:
    row = spatial_logs.ROW["spatial_steps"]
    steering = spatial_logs.source_of(row, 1).scenario.steering
    assert isinstance(steering, tuple)
    ends = np.cumsum([seconds for seconds, _ in steering])
    turning = [(end - s, end) for end, (s, degrees) in zip(ends, steering, strict=True) if degrees]
    assert [start for start, _ in row.gaps] == [end for _, end in turning[:2]]
    assert all(start - end == pytest.approx(spatial_logs.LEAD_S) for (_, end), (start, _) in zip(
        row.gaps, turning[1:], strict=True))  # fmt: skip
    assert row.seconds >= turning[2][1]


def test_frames_of_a_gap_are_left_out(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    log.write_text("".join(f"({1000 + k}.000000) can0 18FF0B15#00\n" for k in range(10)))
    spatial_logs._cut(log, [(2.0, 5.0), (8.0, 9.0)])
    assert [int(line[1:5]) - 1000 for line in log.read_text().splitlines()] == [0, 1, 5, 6, 7, 9]


# What holds.


@pytest.mark.parametrize("n", [8, 40, 200])
def test_the_fewest_that_must_hold_are_those_of_the_binomial_test(n: int) -> None:
    least = spatial_rows.least_hits(n, 18)
    assert binom.cdf(least, n, 0.95) >= 0.01 / 18 > binom.cdf(least - 1, n, 0.95)


def _made(scale: float, bias: float = 0.0) -> list[dict[str, Any]]:
    """Forty runs of a method whose errors are so many sds wide."""
    rng = np.random.default_rng(1)
    runs = []
    for seed in range(40):
        error = 0.1 * (scale * rng.standard_normal(6) + bias)
        said = {
            "error": error.tolist(), "sd": [0.1] * 6, "reasons": [""] * 6, "per_mass": [float(error[2]), 0.1],
            "nuisances": {"wheel_zero": [0.01 * scale * rng.standard_normal(), 0.01]},
        }  # fmt: skip
        runs.append({"seed": seed, "methods": {"pem": said}, "events": [], "took_s": 1.0, "drive_s": 60.0})
    return json.loads(json.dumps(runs))  # type: ignore[no-any-return]


@pytest.mark.parametrize(("scale", "bias", "held"), [(1.0, 0.0, True), (2.0, 0.0, False), (0.3, 3.0, False)])
def test_intervals_that_are_right_hold_and_others_do_not(scale: float, bias: float, held: bool) -> None:
    lines = spatial_rows.judged(_made(scale, bias), spatial_rows.Reach())
    judged = [line.held for line in lines if line.figure.startswith("pem:") and line.held is not None]
    assert len(judged) == 3
    assert all(judged) is held
    nothing = [line for line in lines if line.figure.startswith("tracker:")]
    assert [line.held for line in nothing] == [False]


@pytest.mark.parametrize(("error", "sd", "held"), [(0.2, 0.01, False), (0.01, 0.2, True)])
def test_what_is_held_against_the_limit_is_how_far_off_the_numbers_are(
    error: float, sd: float, held: bool
) -> None:
    """Errors of either sign must not cancel, and a small sd is no merit."""
    made = _made(1.0)
    for k, run in enumerate(made):
        run["methods"]["pem"] |= {"error": [error * (-1) ** k] * 6, "sd": [sd] * 6}
        run["methods"]["pem"]["per_mass"] = [error * (-1) ** k, sd]
    lines = {line.figure: line for line in spatial_rows.judged(made, spatial_rows.Reach(0.07, 0.12))}
    off = lines["pem: |error|, median"]
    assert off.held is held and off.values == pytest.approx([error] * 6)


# Rows of their own.


def _changed(noticed_s: float, ratio: float) -> dict[str, Any]:
    """A run whose wheels turn from 97 s on; a method says how C changes at 92 s."""
    made = _made(1.0)[0]
    rows = [[t, *[0.0 if t < 92.5 else math.log(ratio)] * 6, *[0.1] * 6] for t in range(85, 120)]
    made["methods"]["pem"]["whole"] = rows
    events = [[noticed_s, "soil_change", "it holds less"]]
    return {**made, "wheel_s": [97.0 + 0.04 * k for k in range(400)], "events": events}


@pytest.mark.parametrize(("noticed_s", "ratio", "held"), [(98.5, 0.72, True), (101.0, 0.8, False)])
def test_a_change_of_soil_is_noticed_in_time_and_by_how_much(
    noticed_s: float, ratio: float, held: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(spatial_rows, "results", lambda bench, name: [_changed(noticed_s, ratio)] * 5)
    lines = {line.figure: line for line in spatial_rows.soil(Bench())}
    delay = lines["noticed after the first turn that could tell, median"]
    assert delay.held is held
    assert delay.values[0] == pytest.approx(noticed_s - 97.0)
    assert lines["pem: ratio of C_af, C_ar off after 8 s, median"].held is held
    assert lines["tracker: ratio of C_af, C_ar off after 8 s, median"].held is False


@pytest.mark.parametrize(("first_s", "held"), [(140.0, True), (170.0, False), (math.nan, False)])
def test_numbers_of_a_field_are_there_within_three_turns(
    first_s: float, held: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = {**_made(1.0)[0], "turn_ends_s": [50.0, 100.0, 150.0, 200.0]}
    made["methods"]["pem"]["first_s"] = [60.0] * 5 + [first_s]
    monkeypatch.setattr(spatial_rows, "results", lambda bench, name: [made])
    lines = {line.figure: line.held for line in spatial_rows.field("planar_field", Bench())}
    assert lines["pem: 6 numbers within 3 turns"] is held
    assert lines["steady_state: 3 numbers within 3 turns"] is False
