"""Decisions within rounding of their threshold are logged, and a replay elsewhere goes on from the log."""

import contextvars
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from logs import MACHINE, MACHINE_TEXT, record
from sampled import sampled

from tilth.estimator import ties
from tilth.estimator.record import record_builder
from tilth.estimator.results.reporting import is_supported
from tilth.logger import fitting
from tilth.logger.guarded_fold import GuardedFold
from tilth.replay import compare
from tilth.replay.compare import Comparison
from tilth.replay.offline import ReplayOutputs, replay
from tilth.schemas.channels import TIE_TOPIC
from tilth.schemas.flow import Pose, Tie
from tilth.schemas.machine_toml import MachineFile
from tilth.simulator.traffic import simulate

LIMIT = 0.3
NEAR = LIMIT * (1.0 + 1e-13)


@pytest.mark.parametrize(
    ("statistic", "above", "is_tie"),
    [
        (NEAR, True, True),
        (LIMIT, False, True),
        (LIMIT * (1.0 - 1e-13), False, True),
        (LIMIT * (1.0 + 1e-8), True, False),
        (-LIMIT, False, False),
        (math.inf, True, False),
        (math.nan, False, False),
    ],
)
def test_a_decision_near_its_threshold_is_a_tie(statistic: float, above: bool, is_tie: bool) -> None:
    ties.use()
    ties.begin(7)
    assert ties.exceeds(statistic, LIMIT, 1e-9) is above
    assert ties.found() == ([Tie(7, statistic, LIMIT, above)] if is_tie else [])
    assert ties.found() == []


@pytest.mark.parametrize(
    ("logged", "above", "turned"),
    [
        (Tie(7, NEAR, LIMIT, True), True, 1),
        (Tie(7, LIMIT, LIMIT, False), False, 0),
        (Tie(8, NEAR, LIMIT, True), False, 0),  # of another instant
        (Tie(7, NEAR, 2.0 * LIMIT, True), False, 0),  # of another decision
        (Tie(7, 2.0 * LIMIT, LIMIT, True), False, 0),
    ],
)
def test_of_a_tie_the_log_decides(logged: Tie, above: bool, turned: int) -> None:
    found = ties.use([logged])
    ties.begin(7)
    assert ties.exceeds(LIMIT * (1.0 - 1e-13), LIMIT, 1e-9) is above
    assert found.turned == turned
    assert ties.exceeds(2.0, 1.0) and not ties.exceeds(1.0, 2.0)


@pytest.mark.parametrize("kept", sampled([True, False], [True]), ids=["ties logged", "ties lost"])
def test_a_replay_elsewhere_goes_on_from_the_logged_decision(
    kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drive with a pose at the limit of the articulation, on either side of it by the last digits."""
    frames = list(simulate(MACHINE, 3, 20.0))
    fold = GuardedFold(MACHINE, encoded=False)
    poses = [p.value for p, _ in fold.take_all(frames) if isinstance(p.value, Pose)]
    limit = max(abs(pose.articulation) for pose in poses if pose.articulation is not None)

    def round_the_limit(share: float) -> None:
        at = replace(record_builder.RECORD, largest_articulation=limit * (1.0 + share))
        monkeypatch.setattr(record_builder, "RECORD", at)

    round_the_limit(-1e-13)
    if not kept:
        monkeypatch.setattr(ties, "found", list)
    (path,) = record(tmp_path, frames, 1).parts
    round_the_limit(1e-13)
    for module in (compare, fitting):
        monkeypatch.setattr(module, "computed_elsewhere", lambda software: "another kind of processor")
    comparison = Comparison()
    replay([path], MachineFile(MACHINE, MACHINE_TEXT), outputs=ReplayOutputs(comparison=comparison))
    assert (comparison.turned, bool(comparison.difference)) == ((1, False) if kept else (0, True))
    assert TIE_TOPIC not in comparison.difference


@pytest.mark.parametrize("statistic", [0.0, LIMIT, math.inf, math.nan])
@pytest.mark.parametrize("threshold", [0.0, LIMIT, math.inf, math.nan])
@pytest.mark.parametrize("begin", [lambda: None, ties.use], ids=["no fold", "a fold"])
def test_they_are_comparisons_and_what_is_no_number_is_within_nothing(
    statistic: float, threshold: float, begin: Callable[[], object]
) -> None:
    def both() -> tuple[bool, bool]:
        begin()
        return ties.exceeds(statistic, threshold), ties.within(statistic, threshold)

    assert contextvars.Context().run(both) == (statistic > threshold, statistic <= threshold)


def test_an_sd_that_is_no_number_supports_none() -> None:
    assert is_supported(True, 0.1, 1.0) and not is_supported(True, math.nan, 1.0)
