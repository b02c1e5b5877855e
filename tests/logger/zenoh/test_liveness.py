"""Which sensors are alive."""

import pytest
from logs import MACHINE

from tilth.estimator.pose.receiver_lost import LOST
from tilth.logger.zenoh.liveness import STARTING_NS, Sensors
from tilth.schemas.flow import Mount, Origin, Position, WheelAngle, YawRate
from tilth.schemas.states import DeviceState

FRONT = Origin("can0", 28, mount=Mount.TRACTOR_FRONT)
SECOND = 1_000_000_000


def position(t_ns: int) -> Position:
    return Position(t_ns, t_ns, FRONT, 129025, None, 43.5, -83.4, 0.01)


def test_a_receiver_is_waited_for_alive_and_lost() -> None:
    sensors = Sensors(MACHINE)
    assert {row.state for row in sensors.receivers(SECOND)} == {DeviceState.WAITING}
    for k in range(10):
        sensors.take(position(SECOND + k * SECOND // 5))
    front, *others = sensors.receivers(3 * SECOND)
    assert front.state == DeviceState.ALIVE and front.source == 28 and front.per_s == pytest.approx(5.0)
    assert front.age_s == pytest.approx(0.2) and {row.state for row in others} == {DeviceState.WAITING}
    front, *_ = sensors.receivers(3 * SECOND + LOST.lost_ns)
    assert front.state == front.fault == DeviceState.LOST and front.fault_age_s == 0.0
    sensors.take(position(6 * SECOND))
    front, *_ = sensors.receivers(6 * SECOND)
    assert front.state == DeviceState.ALIVE and front.fault == DeviceState.LOST
    assert front.fault_age_s == pytest.approx(3.0 - LOST.lost_ns * 1e-9)


def test_one_that_sends_no_position_has_no_data() -> None:
    sensors = Sensors(MACHINE)
    for t_ns in range(SECOND, 12 * SECOND, SECOND):
        sensors.take(YawRate(t_ns, t_ns, FRONT, 127251, None, 0.1, 0.01))
        row = sensors.receivers(t_ns)[0]
        starting = t_ns - SECOND < STARTING_NS
        assert row.state == (DeviceState.WAITING if starting else DeviceState.NO_DATA)
        assert row.HasField("fault_age_s") is not starting  # a start is no fault that is told of ever after


def test_others_do_not_count() -> None:
    sensors = Sensors(MACHINE)
    sensors.take(Position(SECOND, SECOND, Origin("can0", 99), 129025, None, 43.5, -83.4, 0.01))
    assert {row.state for row in sensors.receivers(SECOND)} == {DeviceState.WAITING}
    sensors.take(WheelAngle(SECOND, SECOND, Origin("can0", -1), 0, None, 0.1, 0.01))
    assert sensors.wheel_angle(SECOND).state == DeviceState.ALIVE
