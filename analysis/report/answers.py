"""What is computed for a report from its runs: fits, predictions, tests of residuals, frequency responses.

Plain and SI. What cannot be computed is absent, and notes say why.
"""

import math
from collections.abc import Callable, Sequence

from tilth.analysis.fit.fitting import CannotFit, Fitted, Wanted, choose, fit_all, in_order
from tilth.analysis.fit.result import as_json as fit_json
from tilth.analysis.report.data import Answers, ResponseFacts, TestFacts
from tilth.analysis.report.document import plain
from tilth.analysis.report.given import MOST_FITTED, of_a_plan
from tilth.analysis.runs.run import Run
from tilth.analysis.runs.segments import DrivenSegment
from tilth.analysis.validation.residuals import LEVEL, together
from tilth.analysis.validation.validate import hold_out, residual_tests, responses

Progress = Callable[[str, int, int], None]  # what, done, of all


def answers_of(
    runs: Sequence[Run],
    given: Sequence[Sequence[DrivenSegment]],
    progress: Progress,
    most: int | None = None,
    marks: Sequence[str] = (),
) -> Answers:
    """given: of each run the segments that the user
    named, which are all fitted. most: segments that are fitted of each other run; None: the runs of a plan of
    experiments, and MOST_FITTED of what else there is. marks: only those between marks of such
    names. Raises LogError, OSError.
    """
    try:
        wanted = _wanted(runs, given, marks)
        chosen, notes = (wanted, []) if any(given) else fewer(wanted, most)
        fitted = fit_all(chosen, progress=lambda done, of: progress("fitting", done, of))
    except CannotFit as error:
        return {"notes": [f"Nothing was fitted: {error}."]}
    found: Answers = {"fit": plain(fit_json(fitted)) | {"notes": notes}, "notes": notes}
    if fitted.joint is None:
        return found
    found["held_out"] = {"subsets": plain(hold_out(fitted))}
    found["residuals"] = _residuals(fitted)
    found["response"] = _response(fitted)
    return found


def _wanted(
    runs: Sequence[Run], given: Sequence[Sequence[DrivenSegment]], marks: Sequence[str]
) -> tuple[Wanted, ...]:
    if any(given):
        return in_order(
            [
                Wanted(run, log, number, segment)
                for log, (run, rows) in enumerate(zip(runs, given, strict=True), 1)
                for number, segment in enumerate(rows, 1)
            ]
        )
    return choose(runs, marks=marks)


def fewer(wanted: Sequence[Wanted], most: int | None) -> tuple[tuple[Wanted, ...], list[str]]:
    """At most so many of each log, and what is left out, in a sentence. most: as of `answers_of`."""
    kept: set[int] = set()
    for log in {one.log for one in wanted}:
        of_log = [one for one in wanted if one.log == log]
        of_log.sort(key=lambda one: -abs(one.segment.largest_angle))
        if most is None:
            kept |= {id(one) for one in of_log if of_a_plan(one.segment)}
            of_log = [one for one in of_log if not of_a_plan(one.segment)]
        kept |= {id(one) for one in of_log[: MOST_FITTED if most is None else most]}
    chosen = tuple(one for one in wanted if id(one) in kept)
    if len(chosen) == len(wanted):
        return chosen, []
    return chosen, [
        f"{len(chosen)} of {len(wanted)} segments were fitted, those with the largest wheel angles; "
        "--fit N or --fit all fits more, which takes some seconds for each."
    ]


def _residuals(fitted: Fitted) -> list[TestFacts]:
    """Those that fail among all tests, and per test one row that says how many passed."""
    rows: list[TestFacts] = []
    for found in residual_tests(fitted):
        for test in (found.white, found.by_wheel, found.size):
            row: TestFacts = plain(test) | {"test": type(test).__name__}
            rows.append(row)
    return judged(rows)


def judged(rows: Sequence[TestFacts]) -> list[TestFacts]:
    """Tests of single outputs, decided together: among 72 right ones nearly four fail at 5 % each."""
    given = [math.nan if row["p_value"] is None else row["p_value"] for row in rows]
    failed: list[TestFacts] = []
    kept: dict[str, list[str]] = {}  # test -> outcomes
    for row, p in zip(rows, together(given).tolist(), strict=True):
        outcome = "undecided" if math.isnan(p) else "failed" if p < LEVEL else "passed"
        kept.setdefault(row["test"], []).append(outcome)
        if outcome == "failed":
            now: TestFacts = {**row, "outcome": outcome, "p_value": p}
            failed.append(now)
    return failed + [_counted(test, outcomes, len(rows)) for test, outcomes in kept.items()]


def _counted(test: str, outcomes: Sequence[str], tests: int) -> TestFacts:
    """The row that says how many passed."""
    passed = outcomes.count("passed")
    sentence = (
        f"{passed} of {len(outcomes)} outputs of segments passed, at {LEVEL:.0%} for all {tests} tests "
        "together "
        "(Holm)."
    ).replace("%", " %")
    outcome = "passed" if passed == len(outcomes) else "not all" if "failed" in outcomes else "undecided"
    return {"output": "all", "test": test, "outcome": outcome, "p_value": None, "sentence": sentence}


def _response(fitted: Fitted) -> ResponseFacts | None:
    """Of the first run that gives one, else why the first gives none."""
    every: list[ResponseFacts] = [plain(one) for one in responses(fitted).values()]
    good = [one for one in every if not one.get("reason")]
    return next(iter(good or every), None)
