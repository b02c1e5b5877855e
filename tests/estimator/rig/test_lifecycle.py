"""What is found for long enough is isolated, and what is missing for long enough is over."""

from hypothesis import given
from hypothesis import strategies as st

from tilth.estimator.rig.lifecycle import FaultCase, Persistence
from tilth.schemas.diagnosis import Diagnosis, DiagnosisState
from tilth.schemas.reasons import Code

ONE = Diagnosis(Code.WHEEL_OPPOSITE, "wheel_angle.sign", since_ns=7)


@given(st.lists(st.booleans(), max_size=40), st.integers(1, 6), st.integers(1, 6))
def test_a_case_is_isolated_and_over_as_looks_in_a_row_say(looks: list[bool], begins: int, ends: int) -> None:
    case = FaultCase(ONE, ONE)
    isolated, lasted = False, 0
    for k, found in enumerate(looks):
        before = looks[max(0, k + 1 - begins) : k + 1]
        if found:
            begun = case.found(ONE, begins)
            assert begun == (not isolated and len(before) == begins and all(before))
            isolated |= begun
        else:
            gone = looks[max(0, k + 1 - ends) : k + 1]
            over = case.missing(ends)
            assert over == (not isolated or (len(gone) == ends and not any(gone)))
            if over:
                return
        lasted += isolated
        assert case.lasted == lasted
        state = DiagnosisState.ISOLATED if isolated else DiagnosisState.SUSPECTED
        assert (case.diagnosis.state, case.diagnosis.since_ns, case.isolated) == (state, 7, isolated)


def test_what_is_isolated_is_told_as_it_was_then() -> None:
    case = FaultCase(ONE, ONE)
    assert case.found(Diagnosis(Code.WHEEL_SCALE, ONE.key, amounts=(3.0,)), 1)
    later = Diagnosis(Code.WHEEL_SCALE, ONE.key, amounts=(4.0,))
    case.found(later, 1)
    assert case.diagnosis.amounts == (3.0,) and case.latest == later


@given(st.lists(st.booleans(), max_size=30))
def test_looks_in_a_row_are_counted(looks: list[bool]) -> None:
    counted = Persistence()
    for found in looks:
        counted.look(found)
    last = looks[-1:] == [True]
    row = len(looks) - max((k + 1 for k, found in enumerate(looks) if found != last), default=0)
    assert (counted.seen, counted.absent) == ((row, 0) if last else (0, row))
