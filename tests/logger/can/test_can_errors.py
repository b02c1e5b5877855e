"""What a controller says in error frames: every row of the table, its state, and what is told of it when."""

import pytest

from tilth.logger.can.can_errors import (
    AGAIN_NS,
    BACK_NS,
    ERRORS,
    HEALTHY_NS,
    STATES,
    UNKNOWN,
    ControllerState,
    Error,
    Health,
    errors_of,
)

S = 1_000_000_000
PASSIVE = (0x04, b"\0\x10" + bytes(6))
BUS_OFF = (0x40, bytes(8))


def frame_of(row: Error) -> tuple[int, bytes]:
    data = bytearray(8)
    if row.byte >= 0:
        data[row.byte] = row.mask
    return row.bits, bytes(data)


@pytest.mark.parametrize("row", ERRORS, ids=lambda row: row.name)
def test_each_row_is_told_by_its_frame(row: Error) -> None:
    health = Health()
    health.hear(S, *frame_of(row))
    assert row.name in [found.name for found in errors_of(*frame_of(row))]
    assert health.counts[row.name] == 1 and health.state == (row.state or ControllerState.ACTIVE)
    assert any(text.startswith(row.words) and "(1 times, 1 in all)" in text for text in health.news(S, False))
    assert (health.problem != "") == (row.state not in (None, ControllerState.ACTIVE))


def test_a_frame_may_tell_several_things_or_none_that_is_known() -> None:
    assert {row.name for row in errors_of(0x8C, b"\0\x31\0\0\0\0\0\0")} == {
        "overrun", "passive", "protocol", "bus_error"
    }  # fmt: skip
    assert errors_of(0x200, bytes(8)) == errors_of(0x04, b"") == [UNKNOWN]


def test_a_flood_of_errors_is_told_once_in_ten_seconds_with_its_count() -> None:
    health = Health()
    messages = []
    for tick in range(4 * 25):  # four looks a second, ten errors between two
        for _ in range(10):
            health.hear(tick * S // 4, 0x80, bytes(8))
        messages += health.news(tick * S // 4, traffic=True)
    assert [text.rpartition("(")[2] for text in messages] == [
        "10 times, 10 in all)", "400 times, 410 in all)", "400 times, 810 in all)"
    ]  # fmt: skip
    assert AGAIN_NS == 10 * S


@pytest.mark.parametrize(("frame", "until_ns"), [(PASSIVE, HEALTHY_NS), (BUS_OFF, BACK_NS)])
def test_a_controller_nobody_can_ask_has_recovered_when_frames_come_without_errors(
    frame: tuple[int, bytes], until_ns: int
) -> None:
    health = Health()
    health.hear(S, *frame)
    state = health.state
    health.news(S, traffic=True)
    health.news(S + until_ns + 1, traffic=False)  # silence proves nothing
    health.news(S + until_ns, traffic=True)
    assert health.state == state != "active"
    assert "error-active again" in health.news(S + until_ns + 1, traffic=True)[0]
    assert health.state == "active" and health.problem == ""


def test_who_knows_is_believed() -> None:
    health = Health()
    for number, state in enumerate(STATES[:4]):
        health.set_state(number * S, state)
        assert health.state == state
    health.set_state(5 * S, ControllerState.STOPPED)  # the interface is down: that is told otherwise
    assert health.state is ControllerState.BUS_OFF
    health.set_state(6 * S, ControllerState.ACTIVE)
    health.set_state(7 * S, ControllerState.ACTIVE)
    assert health.counts == {"warning": 1, "passive": 1, "bus_off": 1, "recovered": 1}
