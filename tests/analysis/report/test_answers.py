"""Which segments a report fits."""

import pytest
from recorded import recorded

from tilth.analysis.fit.fitting import Wanted
from tilth.analysis.report.answers import fewer
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
