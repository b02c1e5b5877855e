"""A sensor that goes on sending its last reading is named, and nothing else is blamed for it."""

import json
import math
from collections.abc import Callable
from functools import cache

import pytest
from circle import demo_machine
from paths import shared
from sampled import sampled

from tilth.estimator.driving import DRIVING
from tilth.estimator.fold import State, initial, step
from tilth.estimator.pose import aligner, standing
from tilth.estimator.pose.aligner import Aligner
from tilth.estimator.pose.standing import StandingCheck
from tilth.replay.readers.any_log import open_log
from tilth.schemas.flow import BodyPose, Estimate, Event, Flag, Frame, Pose, Status
from tilth.schemas.notices import Notice
from tilth.schemas.reasons import Code, Reason
from tilth.schemas.sentences import event_sentence
from tilth.simulator.scenario import DrivenManoeuvre, Scenario
from tilth.simulator.traffic import simulate

MACHINE = demo_machine()
WHEEL_ID = 0x18FF0B15
SECONDS = 40.0
FAILS_S = 30.0
Edit = Callable[[float, int, Frame], Frame]  # seconds, number among the wheel's frames, frame


@cache
def drive() -> tuple[Frame, ...]:
    scenario = Scenario(steering=DrivenManoeuvre("random"), other_traffic=False)
    return tuple(simulate(MACHINE, 3, SECONDS, scenario))


def with_data(frame: Frame, data: bytes) -> Frame:
    return Frame(frame.t_ns, frame.rx_ns, frame.bus, frame.can_id, frame.extended, frame.error, data)


def run(edit: Edit) -> tuple[State, list[Event], list[Pose], list[Estimate]]:
    state, values, number = initial(MACHINE), list[object](), 0
    first_ns = drive()[0].t_ns
    for frame in drive():
        if frame.can_id == WHEEL_ID:
            frame, number = edit((frame.t_ns - first_ns) * 1e-9, number, frame), number + 1
        values += [publication.value for publication in step(state, frame)]
    return (
        state,
        [value for value in values if isinstance(value, Event)],
        [value for value in values if isinstance(value, Pose)],
        [value for value in values if isinstance(value, Estimate) and value.method == "tracker"],
    )


def spike(frame: Frame) -> Frame:
    raw = int.from_bytes(frame.data[:2], "big", signed=True) + 4000  # 40 degrees
    return with_data(frame, raw.to_bytes(2, "big", signed=True) + frame.data[2:])


@cache
def clean() -> Estimate:
    state, events, _, estimates = run(lambda s, number, frame: frame)
    assert not events and state.rejected.keys() == {"address_conflict"}
    return estimates[-1]


@pytest.mark.parametrize(("every", "burst", "told"), [(97, 1, True), (1000, 1, False), (200, 3, True)])
def test_spikes_of_the_wheel_angle_change_no_number(every: int, burst: int, told: bool) -> None:
    state, events, _, estimates = run(
        lambda s, number, frame: spike(frame) if number % every >= every - burst else frame
    )
    assert state.rejected["spike"] >= SECONDS * 100 / every * burst - burst
    assert [event.kind for event in events] == ["spikes"] * told
    for one, true in zip(estimates[-1].parameters, clean().parameters, strict=True):
        assert one.value is not None and true.value is not None and true.sd is not None
        assert abs(one.value - true.value) < 0.3 * true.sd


def test_a_wheel_angle_that_stands_still_is_named_and_no_number_is_given() -> None:
    held: list[bytes] = []

    def freeze(seconds: float, number: int, frame: Frame) -> Frame:
        if seconds < FAILS_S:
            held[:] = [frame.data]
        return with_data(frame, held[0])

    state, events, poses, estimates = run(freeze)
    assert [event.kind for event in events] == ["stands_still"]
    assert "wheel-angle sensor" in event_sentence(events[0]) and "cable" in event_sentence(events[0])
    assert (events[0].t_ns - drive()[0].t_ns) * 1e-9 < FAILS_S + 5.0
    assert Flag.parse("stands_still:wheel_angle") in poses[-1].flags and poses[-1].wheel_angle is None
    assert {p.status for p in estimates[-1].parameters} == {Status.INVALID}
    assert estimates[-1].parameters[0].reason == Reason(Code.WHEEL_ANGLE_STANDS)
    assert state.rejected["stands_still"] > 0


TOLD: dict[str, list[str]] = {
    "00-base": [], "27-wheel-spikes": ["spikes"], "28-wheel-frozen-at-30s": ["stands_still"],
}  # fmt: skip


@pytest.mark.parametrize("name", sampled(TOLD, ["27-wheel-spikes"]))
def test_logs_of_strangers(name: str) -> None:
    strangers = shared("data/strangers/second")
    true = json.loads((strangers / "00-base.truth.json").read_text())["parameters"]
    log = open_log(strangers / f"{name}.log.gz")
    state, events, last = initial(MACHINE), list[str](), None
    for record in log.records:
        if not isinstance(record, Frame):
            continue
        for value in (publication.value for publication in step(state, record)):
            if isinstance(value, Event):
                events.append(value.kind)
            elif isinstance(value, Estimate) and value.method == "tracker":
                last = value
    log.file.close()
    assert events == TOLD[name] and last is not None
    given = last.parameters[0]
    if "stands_still" in events:
        assert given.status is Status.INVALID
    else:
        assert given.value is not None and given.sd is not None
        assert abs(given.value - true["C_af"]) < 2.0 * given.sd


# What a run of equal readings is compared with, by itself.


def body(yaw_rate: float, heading: float, u: float) -> BodyPose:
    return BodyPose(0.0, 0.0, 0.02, heading, 0.01, u, 0.0, 0.05, 0.05, yaw_rate, 0.005, 0.0, 0.01)


def feed(
    quantity: str, who: str, value: Callable[[float], float], rate: Callable[[float], float], u: float = 4.0,
    seconds: float = 30.0,
) -> tuple[Aligner, list[tuple[str, Notice]]]:  # fmt: skip
    """A rig that turns at rate(t), with readings value(t) of one quantity at 50 Hz."""
    rig, state, heading, events = aligner.initial(MACHINE), StandingCheck(), 0.0, list[tuple[str, Notice]]()
    rig.moving = u >= DRIVING.under_way
    for k in range(round(seconds * 5)):
        t = k / 5
        for j in range(10):
            at = t + j / 50
            rig.screens.near(who, quantity, (round(at * 1e9) + 10**18, value(at), 0.0, 0.01), rig.moving)
        heading += rate(t) / 5
        t_ns = round((t + 0.2) * 1e9) + 10**18
        bodies = body(rate(t), heading, u), body(rate(t), heading, u)
        pose = Pose(t_ns, 0.0, 0.0, *bodies, 0.0, 0.01, 0.0, 0.01, 1, None, 0.0, 4, ())
        events += standing.observe(state, rig, pose)
    return rig, events


def wander(t: float) -> float:
    return 0.2 * math.sin(0.7 * t)


@pytest.mark.parametrize("quantity", ["velocity", "yaw_rate", "heading", "roll", "wheel_angle"])
def test_each_reading_that_stands_still_while_the_rig_turns_is_named(quantity: str) -> None:
    who = "wheel_angle" if quantity == "wheel_angle" else "tractor_rear"
    rig, events = feed(
        quantity, who, lambda t: 0.2 * wander(min(t, 15.0)) + (t % 0.13 if t < 15 else 0.0) / 50, wander
    )
    assert [kind for kind, _ in events] == ["stands_still"]
    assert rig.screens.by[f"{who} {quantity}"].failed


@pytest.mark.parametrize("quantity", ["velocity", "yaw_rate", "heading", "roll", "wheel_angle", "pitch"])
@pytest.mark.parametrize("u", [0.0, 4.0])
def test_a_rig_that_stands_or_drives_straight_is_not_accused(quantity: str, u: float) -> None:
    who = "wheel_angle" if quantity == "wheel_angle" else "tractor_rear"
    assert feed(quantity, who, lambda t: 0.01, lambda t: 0.004 * math.sin(3.0 * t), u)[1] == []


@pytest.mark.parametrize("quantum", [0.1, 0.5])
@pytest.mark.parametrize("turn", [0.0, 0.05, 0.3])
def test_a_coarse_wheel_angle_that_is_held_is_not_accused(quantum: float, turn: float) -> None:
    """Wheels that are turned and then held for long: the path follows by and by."""
    wheelbase = MACHINE.tractor.wheelbase

    def angle(t: float) -> float:
        return turn * min(1.0, (t % 20.0) / 0.7)

    def reading(t: float) -> float:
        return math.radians(round(math.degrees(angle(t)) / quantum) * quantum)

    def rate(t: float) -> float:
        since = max(0.0, t % 20.0 - 0.7)
        return 4.0 * math.tan(0.8 * angle(t)) / wheelbase * (1.0 - math.exp(-since / 0.5))

    assert feed("wheel_angle", "wheel_angle", reading, rate, seconds=19.0)[1] == []
