"""Rows on the virtual fleet: the design, the table, a drive of it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rows
from circle import demo_machine
from estimation_table import Bench

from tilth.estimator.methods import rows as methods_rows
from tilth.simulator.scenario import RowSteering


def test_eighteen_drives_are_all_cells_once() -> None:
    assert len({rows.cell_of(5 + k) for k in range(18)}) == 18
    for of in range(3):
        values = [rows.cell_of(k)[of] for k in range(12)]
        counts = [values.count(value) for value in set(values)]
        assert max(counts) - min(counts) <= 2


@pytest.mark.parametrize("row", rows.ROWS)
def test_a_row_differs_from_the_usual_one_in_what_it_is_about(row: str) -> None:
    rig, usual = rows.scenario_for("usual", 4, 2.0)
    same, other = rows.scenario_for(row, 4, 2.0)
    assert same == rig and (other == usual) is (row in ("usual", "short", "held_out", "hours", "ten_hours"))
    assert isinstance(other.steering, RowSteering) and isinstance(usual.steering, RowSteering)
    given = replace(other, steering=usual.steering, ground=usual.ground, wheel=usual.wheel)  # nothing else
    assert given == usual


def _made(z: float, over: float, count: int = 200) -> list[dict[str, Any]]:
    """Drives whose numbers are off by z sds, times a normal number, with sds `over` times the bound."""
    rng, made = np.random.default_rng(1), []
    for k in range(count):
        cell, sd = rows.cell_of(k), 0.1 * over
        made.append({
            "row": "rows usual", "seed": k, "first": 0, "scale": 2.0, "rig": k, "speed": 4.0,
            **cell._asdict(),
            "error": (z * sd * rng.standard_normal(6)).tolist(), "sd": [sd] * 6, "bound": [0.1] * 6,
            "step": (0.1 * rng.standard_normal(6)).tolist(), "said_share": 0.9, "refused": None,
            "unexplained": 0.9, "wheel_deg": 0.5, "own_deg": 0.45, "share": 0.81,
        })  # fmt: skip
    return json.loads(json.dumps(made))  # type: ignore[no-any-return]


@pytest.mark.parametrize(
    ("z", "over", "held"), [(1.0, 1.2, True), (1.8, 1.2, False), (1.0, 1.7, False), (1.0, 0.8, False)]
)
def test_the_table_tells_right_numbers_from_wrong_ones(z: float, over: float, held: bool) -> None:
    """Too far off for their sds; sds wider than need be; sds below what any drive can tell."""
    lines = {line.figure: line for line in rows.lines_of(_made(z, over))}
    assert lines["C_ar"].held is held
    assert lines["all: 95 % intervals that hold"].held is (z == 1.0)
    assert "0.45°" in lines["1 pid, spatial, 0.5 cm, 4.0 m/s"].reached


@pytest.mark.parametrize(("found", "held"), [(0.11, True), (0.13, False)])
def test_the_way_with_what_was_found_is_judged_by_that_with_what_is_true(found: float, held: bool) -> None:
    made = [one | {"ways": {"row": [found, 0.1, 0.2], "turn": [0.5, 0.5, 0.6]}} for one in _made(1.0, 1.2, 8)]
    lines = {line.figure: line for line in rows.lines_of(made)}
    assert lines["implement's way, 30 s of a row"].held is held
    assert lines["implement's way, 30 s of a turn"].held is True


@pytest.mark.parametrize(("over", "held"), [(1.4, True), (1.6, False)])
def test_sds_are_compared_with_those_of_the_same_usual_rows(over: float, held: bool) -> None:
    usual = {one["seed"]: one for one in _made(1.0, 1.2, 4)}
    lines = {line.figure: line for line in rows.lines_of(_made(1.0, 1.2 * over, 8), usual)}
    assert lines["sds over those of the same usual rows"].held is held


@pytest.mark.parametrize(
    ("z", "sd", "changed", "held"),
    [(0.5, 0.12, False, [True, True]), (0.5, 0.15, False, [False, True]), (3.0, 0.12, False, [False, True]),
     (0.5, 0.12, True, [True, False])],
)  # fmt: skip
def test_hours_are_judged_at_their_end_and_by_changes_of_soil_that_were_none(
    z: float, sd: float, changed: bool, held: list[bool]
) -> None:
    block = {"error": [z * sd] * 6, "sd": [sd] * 6, "bound": [0.02] * 6, "refused": None, "changed": changed}
    made = [{"rig": k, "blocks": [block] * 4} for k in range(6)]
    lines = {line.figure: line for line in rows.hours_lines(made)}
    assert [lines["end"].held, lines["false changes of soil"].held] == held
    assert lines["withheld"].reached == "0 of 6"


def test_hours_of_what_one_row_told_hold_and_change_nothing() -> None:
    machine = demo_machine()
    state = methods_rows.initial(machine)
    row = state.covariance.copy()
    row[:6, :6] *= 0.2**2
    made: list[dict[str, Any]] = [
        {"rig": k, "blocks": rows.in_pieces(machine, row, 5.0, 2400.0, 20, k)} for k in range(20)
    ]
    z = np.array([np.divide(one["blocks"][-1]["error"], one["blocks"][-1]["sd"]) for one in made])
    assert np.mean(np.abs(z) < 1.96) > 0.88 and 0.7 < np.std(z) < 1.3
    assert not any(block["changed"] for one in made for block in one["blocks"])
    first, last = (np.array(made[0]["blocks"][at]["sd"]) for at in (0, -1))
    assert np.all(last < first) and np.all(last > made[0]["blocks"][-1]["bound"])


def test_a_drive_that_could_not_be_driven_is_named() -> None:
    made = [{"rig": 3, "undriven": "it turns over"}]
    line, withheld = rows.lines_of(made)
    assert line.reached == "rigs [3]" and withheld.reached == "rigs []"


def test_a_drive_is_followed_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(runs=1, scale=0.3, kept=tmp_path / "kept.jsonl")
    said = rows.Fit(np.zeros(6), np.eye(6), np.ones(6), 0.5, None)
    monkeypatch.setattr(rows, "fit", lambda machine, record: said)  # a fit is minutes of this test's time
    lines = rows.row("usual", 0, bench)
    made = json.loads((tmp_path / "kept.jsonl").read_text())
    assert min(made["bound"]) > 0.0 and max(made["bound"]) < 0.75
    assert 0.2 < made["own_deg"] < 1.2 and made["seconds"] == pytest.approx(18.0, abs=1.0)
    monkeypatch.setattr(rows, "drive", None)  # not driven again
    assert [line.reached for line in rows.row("usual", 0, bench)] == [line.reached for line in lines]
