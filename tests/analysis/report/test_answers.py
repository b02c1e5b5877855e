"""Which segments a report fits, and how it counts its tests."""

from typing import Any

import numpy as np
import pytest
from recorded import recorded

from tilth.analysis.fit.fitting import Wanted
from tilth.analysis.report.answers import fewer, judged
from tilth.analysis.runs.run import open_runs
from tilth.analysis.runs.segments import MARKED, STEP, DrivenSegment


@pytest.mark.parametrize(
    ("kind", "name", "most", "kept"),
    [
        (STEP, "", None, [3, 4, 5, 6]),
        (STEP, "", 2, [5, 6]),
        (MARKED, "west step", None, [3, 4, 5, 6]),
        (MARKED, "experiment plan run 1 step replicate 1 of 1 try 1 seed 1", None, [1, 2, 3, 4, 5, 6]),
        (MARKED, "experiment plan run 1 step replicate 1 of 1 try 1 seed 1", 1, [6]),
    ],
)
def test_all_runs_of_a_plan_are_fitted_and_of_other_driving_what_steers_most(
    kind: str, name: str, most: int | None, kept: list[int]
) -> None:
    (run,) = open_runs(recorded().parts[0])
    wanted = [
        Wanted(run, 1, k, DrivenSegment(kind, 10.0 * k, 10.0 * k + 8.0, 4.0, -0.01 * k, name))
        for k in range(1, 7)
    ]
    chosen, notes = fewer(wanted, most)
    assert [one.number for one in chosen] == kept
    assert bool(notes) == (len(kept) < 6)


def rows_of(p_values: list[float | None]) -> Any:
    return [
        {"output": f"o{k}", "test": "InputTest", "outcome": "failed", "p_value": p, "sentence": "It follows."}
        for k, p in enumerate(p_values)
    ]


def test_72_tests_of_right_models_fail_one_report_in_twenty_and_a_wrong_one_fails_among_them() -> None:
    rng = np.random.default_rng(3)
    alarms = 0
    for _ in range(400):
        *failed, counted = judged(rows_of(rng.uniform(size=72).tolist()))
        alarms += bool(failed)
        assert counted["sentence"].startswith(
            f"{72 - len(failed)} of 72 outputs of segments passed, at 5 % for"
        )
    assert 0.02 < alarms / 400 < 0.085
    *failed, _ = judged(rows_of([1e-6, *rng.uniform(size=71).tolist()]))
    assert failed[0]["output"] == "o0" and failed[0]["p_value"] == pytest.approx(72e-6)


def test_an_undecided_test_counts_for_none() -> None:
    failed, counted = judged(rows_of([0.04, None]))
    assert failed["output"] == "o0" and counted["outcome"] == "not all"
    (counted,) = judged(rows_of([0.9, None]))
    assert counted["outcome"] == "undecided"
