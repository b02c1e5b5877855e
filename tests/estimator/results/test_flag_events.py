"""Events of flags: what begins and what is over; what comes all day is told now and then."""

from tilth.estimator.results.flag_events import flag_events
from tilth.schemas.flow import Flag, FlagKind
from tilth.schemas.notices import Notice
from tilth.schemas.sentences import notice_sentence

LOST, LATE = Flag(FlagKind.LOST, "tractor_rear"), Flag(FlagKind.LATE, "tractor_rear")


def told(flag: Flag, often: int) -> list[str]:
    """Texts where it comes and goes so often."""
    times: dict[str, int] = {}
    found: list[tuple[str, Notice]] = []
    for _ in range(often):
        found += flag_events((), (flag,), times)
        found += flag_events((flag,), (), times)
    assert {kind for kind, _ in found} == {flag.kind}
    return [notice_sentence(one) for _, one in found]


def test_each_loss_is_told_with_its_end() -> None:
    assert told(LOST, 12) == ["tractor_rear gives no usable position", "tractor_rear: over"] * 12


def test_what_is_late_all_day_is_told_now_and_then() -> None:
    begun = "tractor_rear is late; its position is extrapolated"
    over = "tractor_rear: over"
    tenth, hundredth = (f"{begun} (for the {count}th time)" for count in (10, 100))
    assert told(LATE, 500) == [begun, over, tenth, over, hundredth, over]


def test_what_stays_is_no_event_and_a_silent_sensor_is_named() -> None:
    wheel = Flag(FlagKind.LOST, "wheel_angle")
    assert flag_events((LOST,), (LOST,), {}) == []
    ((kind, one),) = flag_events((LOST,), (LOST, wheel), {})
    assert kind == FlagKind.LOST and notice_sentence(one) == "wheel_angle is silent"


def test_frames_that_come_late_are_told_each_time() -> None:
    flag = Flag(FlagKind.LATE_FRAMES, "rig")
    assert len([event for _ in range(7) for event in flag_events((), (flag,), {})]) == 7
