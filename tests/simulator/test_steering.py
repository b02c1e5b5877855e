"""The virtual tractor's steering by commands from CAN: whom it obeys, what it refuses, how it follows."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilth.schemas.decode import Decoder, encode, frames_of
from tilth.schemas.flow import Frame, Measurement, Position, Velocity, WheelAngle, Word, YawRate
from tilth.schemas.machine import Machine
from tilth.simulator.drive import drive
from tilth.simulator.scenario import STEP_S, Scenario
from tilth.simulator.steered_rig import LiveDriver
from tilth.simulator.steering import ADDRESS, COMMAND, REFUSALS, TIMEOUT_S, Steering
from tilth.simulator.tractor import Setting, Truth
from tilth.simulator.traffic import traffic

WHEELBASE = 2.9
ONE, OTHER = 0x1C, 0x2A  # source addresses of controllers

Sent = tuple[int, bytes]


def command(angle: float | None, source: int = ONE, status: str = "intended") -> Sent:
    words: dict[str, Word] = {"command_status": status}
    if angle is not None:
        words["commanded_curvature_per_m"] = math.tan(angle) / WHEELBASE
    ((can_id, data),) = frames_of(COMMAND, encode(COMMAND, words), source, ADDRESS)
    return can_id, data


def steering() -> Steering:
    return Steering(WHEELBASE, math.radians(35.0), math.radians(25.0))


def obeying(angle: float = 0.0) -> Steering:
    ecu = steering()
    ecu.hear(*command(angle), 1.0, angle)
    return ecu


@pytest.mark.parametrize(
    ("ecu", "sent", "reason"),
    [
        (obeying, command(0.01, OTHER), "another_controller"),
        (steering, command(None), "not_available"),
        (obeying, command(None), "not_available"),
        (steering, (command(0.0)[0], b""), "short_frame"),
        (steering, (command(0.0)[0], b"\x80"), "short_frame"),
        (steering, command(math.radians(40.0)), "beyond_limit"),
        (obeying, command(math.radians(-40.0)), "beyond_limit"),
        (obeying, command(math.radians(8.0)), "too_fast"),
        (steering, command(math.radians(14.0)), "too_far"),
    ],
)
def test_a_command_that_is_not_obeyed_is_counted_by_its_reason(
    ecu: Callable[[], Steering], sent: Sent, reason: str
) -> None:
    subject = ecu()
    before = subject.obeyed, subject.taken
    subject.hear(*sent, 1.1, 0.0)
    assert dict(subject.refused) == {reason: 1}
    assert (subject.obeyed, subject.taken) == before
    assert reason in REFUSALS


@pytest.mark.parametrize(
    "sent",
    [
        frames_of(COMMAND, encode(COMMAND, {"commanded_curvature_per_m": 0.01}), ONE, 0x21)[0],  # another's
        frames_of(65097, encode(65097, {"speed_mps": 3.0}), ONE)[0],
        command(0.1, status="not_intended"),
    ],
)
def test_what_is_no_command_to_it_changes_nothing(sent: Sent) -> None:
    subject = steering()
    subject.hear(*sent, 1.0, 0.0)
    assert (subject.obeyed, subject.taken, dict(subject.refused)) == (None, 0, {})
    assert subject.valve(1.0, 0.1) == 0.0


def test_the_valve_brings_the_wheels_to_what_is_commanded_within_rate_and_stop() -> None:
    subject = obeying()
    assert subject.valve(1.0, 0.0) == pytest.approx(0.0, abs=1e-3)
    subject.hear(*command(math.radians(3.0)), 1.1, 0.0)
    assert 0.0 < subject.valve(1.1, math.radians(2.0)) < subject.rate
    assert subject.valve(1.1, math.radians(-30.0)) == subject.rate
    assert subject.valve(1.1, math.radians(36.0)) < 0.0
    at_stop = obeying(math.radians(34.9))
    assert at_stop.valve(1.0, math.radians(35.1)) <= 0.0


def test_a_controller_that_lets_go_or_falls_silent_is_obeyed_no_more_and_another_may_begin() -> None:
    gone, silent = obeying(0.1), obeying(0.1)
    gone.hear(*command(0.1, status="not_intended"), 1.1, 0.1)
    silent.hear(*command(0.1, OTHER, "not_intended"), 1.1, 0.1)  # not the other's to say
    assert (gone.obeyed, silent.obeyed) == (None, ONE)
    later = 1.0 + TIMEOUT_S + 0.01
    assert silent.valve(later, 0.0) == 0.0  # the wheels stay where they are
    assert (gone.let_go, silent.let_go) == (0, 1)
    silent.hear(*command(0.1, OTHER), later, 0.1)
    assert silent.obeyed == OTHER


@given(st.binary(max_size=64), st.integers(0, 255), st.floats(0.0, 10.0), st.floats(-1.0, 1.0))
def test_any_bytes_leave_the_wheels_within_their_stop(
    data: bytes, source: int, now: float, reading: float
) -> None:
    subject = obeying()
    subject.hear(command(0.0, source)[0], data, 1.0 + now, reading)
    assert abs(subject.valve(1.0 + now, reading)) <= subject.rate
    assert set(subject.refused) <= set(REFUSALS)


# The tractor that hears them.


SECONDS = 16.0
QUIET = Scenario(speed=3.0, other_traffic=False, clock_offset_s=0.0)


def driven(
    machine: Machine, scenario: Scenario, commands: Callable[[float], list[Sent]]
) -> tuple[Truth, list[Frame], LiveDriver]:
    frames: list[Frame] = []
    drivers: list[LiveDriver] = []

    def exchange(now: float, sent: list[Frame]) -> list[Sent]:
        frames.extend(sent)
        return commands(now)

    def driver(setting: Setting) -> LiveDriver:
        drivers.append(LiveDriver(machine, setting, exchange))
        return drivers[0]

    truth = drive(machine, 3, SECONDS, scenario, driven_by=driver)
    return truth, frames, drivers[0]


def weaving(now: float) -> list[Sent]:
    """A command each 0.1 s, from 1 s to 10 s."""
    if not 0.999 < now < 10.0 or round(now / STEP_S) % 10:
        return []
    return [command(math.radians(6.0) * math.sin(0.8 * (now - 1.0)))]


@pytest.fixture(scope="module")
def weaved(machine: Machine) -> tuple[Truth, list[Frame], LiveDriver]:
    return driven(machine, QUIET, weaving)


def test_the_wheels_follow_and_stay_and_the_driver_brakes_when_commands_cease(
    weaved: tuple[Truth, list[Frame], LiveDriver],
) -> None:
    truth, _, driver = weaved
    assert dict(driver.steering.refused) == {}
    assert (driver.steering.taken, driver.steering.let_go) == (90, 1)
    steered = (truth.time > 2.0) & (truth.time < 10.0)
    wanted = math.radians(6.0) * np.sin(0.8 * (truth.time - 1.0 - 0.45))  # a servo lags by its time constant
    off = truth.wheel_angle - wanted + truth.nuisances["wheel_zero"]  # by its own sensor it is right
    assert np.degrees(np.std(off[steered])) < 0.5
    after = truth.time > 10.0 + TIMEOUT_S + 0.5
    assert np.ptp(truth.wheel_angle[after]) < 1e-3
    assert truth.tractor.forward_velocity[-1] < 0.5


@pytest.mark.parametrize(
    ("kind", "value", "within"),
    [
        (Position, lambda m: m.latitude_deg * 111_000, 0.02),  # m
        (Position, lambda m: m.longitude_deg * 82_000, 0.02),
        (YawRate, lambda m: m.yaw_rate, 0.003),
        (Velocity, lambda m: m.speed, 0.02),
        (WheelAngle, lambda m: m.angle, 0.0002),
    ],
)
def test_it_sends_what_a_recorder_of_its_whole_motion_would_have_heard(
    machine: Machine,
    weaved: tuple[Truth, list[Frame], LiveDriver],
    kind: type[Measurement],
    value: Callable[[Any], float],
    within: float,
) -> None:
    truth, live, _ = weaved
    result = by_sender(machine, live, kind)
    made = by_sender(machine, list(traffic(machine, truth)), kind)
    assert result.keys() == made.keys()
    for sender, late in made.items():
        now = result[sender]
        assert len(late) - 4 <= len(now) <= len(late)
        assert max(abs(a.t_ns - b.t_ns) for a, b in zip(now, late, strict=False)) < 25_000_000
        assert max(abs(value(a) - value(b)) for a, b in zip(now, late, strict=False)) < within


def by_sender(machine: Machine, frames: list[Frame], kind: type[Measurement]) -> dict[int, list[Measurement]]:
    decoder = Decoder(machine)
    received: dict[int, list[Measurement]] = {}
    for frame in frames:
        for found in decoder.measurements(frame):
            if isinstance(found, kind):
                received.setdefault(found.origin.source, []).append(found)
    return received
