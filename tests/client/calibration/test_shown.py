"""What a driver is shown of a calibration."""

from calibration_shown import STANDS, computed, fold_of, shown_of
from kinematic_drive import GUIDED, Plan

from tilth.cli.calibrate_computing import LEAST_S
from tilth.estimator.calibration.stage_words import STAGES

DRIVES: Plan = ((LEAST_S + 20, 3.0, 0),)


def test_a_driver_is_always_told_something() -> None:
    for plan in (STANDS, DRIVES, GUIDED):
        fold = fold_of(plan)
        for answer in ({}, {"refused": "RTK was never fixed"}, computed(), computed(good=True)):
            state = shown_of(fold, answer)
            assert state.text and state.computed and len(state.stages) == len(STAGES)
            assert all(stage.what and stage.why and 0.0 <= stage.share <= 1.0 for stage in state.stages)
    assert shown_of(fold_of(STANDS), {}, trouble="Nothing is heard.").happening == "Nothing is heard."
    assert "RTK" in shown_of(fold_of(STANDS), {"refused": "RTK was never fixed"}).told[0]
