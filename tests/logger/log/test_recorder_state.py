"""The recorder's states: which follows which, what is said of it, and that none is a dead end."""

import pytest

from tilth.logger.log.recorder_state import NEXT, Happening, RecorderState, RecorderStates
from tilth.schemas.sentences import notice_sentence

PATHS = [
    ([Happening.FILE_BEGUN, Happening.ON_DISK], RecorderState.RECORDING),
    ([Happening.DISK_SLOW, Happening.FILE_BEGUN], RecorderState.SLOW),
    ([Happening.DISK_SLOW, Happening.ON_DISK], RecorderState.RECORDING),
    ([Happening.FILE_FAILED, Happening.FILE_BEGUN], RecorderState.TRYING),
    ([Happening.FILE_FAILED, Happening.FILE_BEGUN, Happening.DISK_SLOW], RecorderState.TRYING),
    ([Happening.FILE_FAILED, Happening.IGNITION_OFF], RecorderState.STOPPED),
    ([Happening.IGNITION_OFF, Happening.FILE_BEGUN], RecorderState.RECORDING),
    ([Happening.IGNITION_OFF, Happening.EARLIER_FAILED, Happening.FILE_BEGUN], RecorderState.TRYING),
    ([Happening.END, Happening.FILE_BEGUN], RecorderState.ENDED),
]


def recorder() -> tuple[RecorderStates, list[str]]:
    events: list[str] = []
    return RecorderStates(lambda kind, told: events.append(f"{kind}: {notice_sentence(told)}")), events


@pytest.mark.parametrize(("path", "state"), PATHS)
def test_one_state_follows_another(path: list[Happening], state: RecorderState) -> None:
    states, _ = recorder()
    for happening in path:
        states.after(happening)
    assert states.state is state


def test_no_state_is_a_dead_end() -> None:
    back = {RecorderState.RECORDING}
    for _ in RecorderState:
        back |= {state for (state, _), after in NEXT.items() if after in back}
    assert back == set(RecorderState)


def test_a_failure_is_reported_once_until_it_has_ended() -> None:
    states, events = recorder()
    states.failed(Happening.FILE_FAILED, "no room")
    states.after(Happening.FILE_BEGUN)
    states.failed(Happening.FILE_FAILED, "no disk")
    assert events == ["log: not recording: no room"] and states.problem == "not recording: no disk"
    states.after(Happening.FILE_BEGUN)
    assert not states.recording
    states.after(Happening.ON_DISK)
    assert states.recording and states.problem == ""
    states.failed(Happening.FILE_FAILED, "no room")
    assert len(events) == 2


def test_a_slow_disk_does_not_hide_that_nothing_is_recorded() -> None:
    states, _ = recorder()
    states.slow("slow")
    assert states.recording and states.problem == "slow"
    states.failed(Happening.FILE_FAILED, "no room")
    states.after(Happening.FILE_BEGUN)
    states.slow("slow")
    assert states.state is RecorderState.TRYING and states.problem == "not recording: no room"


def test_at_rest_a_lost_file_is_known_and_the_next_run_says_when_it_is_over() -> None:
    states, _ = recorder()
    states.after(Happening.IGNITION_OFF)
    assert states.resting and not states.recording
    states.failed(Happening.EARLIER_FAILED, "no disk")
    assert states.resting and states.problem
    states.after(Happening.FILE_BEGUN)
    assert states.state is RecorderState.TRYING
