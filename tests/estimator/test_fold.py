"""The fold: a function of machine file and frames, whole or stored and restored, on good input and bad."""

from collections.abc import Iterable
from dataclasses import replace
from functools import cache, lru_cache

import pytest
from circle import demo_machine

from tilth.estimator import fold
from tilth.estimator.fold import FOLD, State, accept, initial, step
from tilth.estimator.methods import estimators
from tilth.estimator.methods.estimators import ESTIMATORS
from tilth.estimator.rig.geometry import wrap
from tilth.estimator.snapshot import restore, snapshot
from tilth.estimator.state import WaitingPose
from tilth.estimator.state_json import to_json_data
from tilth.schemas.channels import CHANNEL, payload
from tilth.schemas.flow import (
    Accepted,
    Estimate,
    Event,
    Flag,
    Frame,
    Mount,
    Pose,
    Position,
    Publication,
    Status,
)
from tilth.schemas.machine import Machine
from tilth.schemas.sentences import event_sentence
from tilth.simulator.drive import drive
from tilth.simulator.scenario import Fault, Reclaim, Scenario
from tilth.simulator.traffic import simulate

MACHINE = demo_machine()
QUIET = Scenario(other_traffic=False)


@lru_cache(maxsize=4)
def frames(seconds: float = 30.0, scenario: Scenario = QUIET) -> tuple[Frame, ...]:
    return tuple(simulate(MACHINE, 3, seconds, scenario))


def run(given: Iterable[Frame], machine: Machine = MACHINE) -> tuple[State, list[Publication]]:
    state = initial(machine)
    return state, [publication for frame in given for publication in step(state, frame)]


@cache
def whole() -> tuple[State, list[Publication]]:
    """What comes of all frames; not to be changed."""
    return run(frames())


def as_bytes(publications: list[Publication]) -> list[tuple[int, str, bytes]]:
    return [(p.t_ns, p.topic, payload(p)) for p in publications]


def poses(publications: list[Publication]) -> list[Pose]:
    return [p.value for p in publications if isinstance(p.value, Pose)]


def events(publications: list[Publication]) -> list[Event]:
    return [p.value for p in publications if isinstance(p.value, Event)]


def test_the_same_frames_give_the_same_bytes_through_stored_states() -> None:
    given, waiting = frames(), [0.05, 0.7, 5.0, 20.01]
    state, uncut = whole()
    again, out = initial(MACHINE), list[Publication]()
    for frame in given:
        if waiting and frame.t_ns - given[0].t_ns >= waiting[0] * 1e9:
            waiting.pop(0)
            text = snapshot(again)
            again = restore(MACHINE, text)
            assert snapshot(again) == text
        out += step(again, frame)
    assert waiting == [] and as_bytes(out) == as_bytes(uncut)
    assert again.rejected == state.rejected
    assert (again.frames, again.poses) == (state.frames, state.poses)


def test_every_publication_has_a_channel_and_a_payload_that_parses() -> None:
    _, out = whole()
    topics = set()
    for publication in out:
        message = CHANNEL[publication.topic].message
        parsed = message.FromString(payload(publication))
        assert parsed.ByteSize() > 0
        topics.add(publication.topic)
    assert {
        "/pose",
        "/soil_tire",
        "/soil_tire/steady_state",
        "/measurement/position",
        "/gnss/tractor_front",
        "/drawing/frames",
        "/drawing/bodies",
    } <= topics


def test_poses_follow_the_simulated_rig() -> None:
    truth = drive(MACHINE, 3, 30.0, QUIET)
    _, out = whole()
    clean = [p for p in poses(out) if not p.flags]
    assert len(clean) > 130
    within = [
        abs(p.articulation or 9.0) < 0.5 and (p.tractor.sd_heading or 9.0) < 0.05 and p.direction == 1
        for p in clean
    ]
    assert sum(within) > 0.95 * len(within)
    assert truth.parameters["C_af"] > 0


def test_the_clock_of_a_log_stepping_back_is_counted_and_survived() -> None:
    given = list(frames())
    half = len(given) // 2
    hour = 3_600_000_000_000
    stepped = given[:half] + [replace(f, t_ns=f.t_ns - hour, rx_ns=f.rx_ns - hour) for f in given[half:]]
    state, out = run(stepped)
    assert state.rejected["clock_step"] == 1
    (event,) = [e for e in events(out) if e.kind == "clock_step"]
    assert "3600.0 s" in event_sentence(event)
    assert not poses(out)[-1].flags  # aligned anew
    assert state.poses > 130


def test_all_receivers_not_available_gives_reasons_and_no_pose() -> None:
    scenario = replace(QUIET, faults=tuple(Fault(mount, 0.0, 99.0, "not_available") for mount in Mount))
    state, out = run(frames(6.0, scenario))
    assert state.poses == 0
    assert state.rejected["not_available"] > 100
    assert not [p for p in out if p.topic == "/measurement/position"]


def test_one_receiver_silent_is_flagged_at_the_sample_and_back() -> None:
    scenario = replace(QUIET, faults=(Fault(Mount.IMPLEMENT_REAR, 8.0, 12.0, "silent"),))
    _, out = run(frames(16.0, scenario))
    flagged = [p.t_ns for p in poses(out) if Flag.parse("lost:implement_rear") in p.flags]
    start = frames(16.0, scenario)[0].t_ns
    assert 8.2e9 < flagged[-1] - start < 12.6e9
    assert (flagged[-1] - flagged[0]) * 1e-9 == pytest.approx(3.2, abs=0.4)
    texts = [text for e in events(out) if "implement_rear" in (text := event_sentence(e))]
    assert "implement_rear gives no usable position" in texts and "implement_rear: over" in texts


def test_frames_that_waited_for_a_busy_loop_give_the_poses_they_would_have_given() -> None:
    """Judged is when they came, not when they were taken."""
    given = frames()
    from_ns, until_ns = given[0].t_ns + 8_000_000_000, given[0].t_ns + 20_000_000_000
    late = [replace(f, t_ns=max(f.t_ns, until_ns)) if f.t_ns > from_ns else f for f in given]
    state, out = run(late)
    other, in_time = whole()
    assert poses(out) == poses(in_time) and events(out) == events(in_time)
    assert state.rejected == other.rejected and state.poses > 130


def test_silence_of_everything_makes_no_poses_of_what_nobody_saw() -> None:
    given = list(frames())
    half = len(given) // 2
    gap = 3_600_000_000_000
    later = given[:half] + [replace(f, t_ns=f.t_ns + gap, rx_ns=f.rx_ns + gap) for f in given[half:]]
    state, out = run(later)
    assert state.poses < 200
    assert not poses(out)[-1].flags


def test_garbage_between_good_frames_changes_no_pose() -> None:
    given = list(frames(10.0))
    bus = given[0].bus
    mixed: list[Frame] = []
    for k, frame in enumerate(given):
        mixed.append(frame)
        mixed.append(
            Frame(
                frame.t_ns,
                frame.rx_ns,
                bus,
                (k * 7919) & 0x1FFFFFFF,
                True,
                k % 3 == 0,
                bytes([k % 251] * (k % 9)),
            )
        )
    clean, dirty = poses(run(given)[1]), poses(run(mixed)[1])
    assert [p.tractor for p in clean][:30] == [p.tractor for p in dirty][:30]


def test_statuses_before_there_is_anything_to_say() -> None:
    _, out = run(frames(5.0))
    (*_, last) = [p.value for p in out if p.topic == "/soil_tire"]
    assert isinstance(last, Estimate)
    assert last.method == "recommended"
    assert {p.status for p in last.parameters} == {Status.UNESTIMATED}
    assert all(p.reason and p.value is None for p in last.parameters)


def test_a_receiver_that_claims_another_address_is_followed_by_its_name() -> None:
    scenario = replace(QUIET, reclaims=(Reclaim(Mount.TRACTOR_REAR, 6.0, 200),))
    _, out = run(frames(12.0, scenario))
    assert not [p.flags for p in poses(out)[10:] if p.flags]
    sources = {
        p.value.origin.source
        for p in out
        if isinstance(p.value, Position) and p.value.origin.mount is Mount.TRACTOR_REAR
    }
    assert 200 in sources and len(sources) == 2


def test_two_receivers_that_send_from_one_address_are_not_taken_for_one() -> None:
    """The lower NAME keeps the address. What a loser goes on sending from it jumps to and fro, and is left
    out."""
    held = next(
        p.value.origin.source
        for p in whole()[1]
        if isinstance(p.value, Position) and p.value.origin.mount is Mount.TRACTOR_FRONT
    )
    scenario = replace(QUIET, reclaims=(Reclaim(Mount.TRACTOR_REAR, 6.0, held),))
    state, out = run(frames(12.0, scenario))
    assert state.rejected["address_conflict"] > 0
    late = [p for p in poses(out) if p.t_ns > frames(12.0, scenario)[0].t_ns + 8_000_000_000]
    assert all(Flag.parse("lost:tractor_rear") in p.flags for p in late)
    assert state.rejected["spike"] > 10
    alone = {p.t_ns: p.tractor.heading for p in poses(run(frames(12.0))[1])}
    for p in late:
        right = alone[p.t_ns]
        assert p.tractor.heading is None or (right and abs(wrap(p.tractor.heading - right)) < 0.03)


def test_another_estimator_is_one_row(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (first, *_) = ESTIMATORS
    monkeypatch.setattr(estimators, "ESTIMATORS", (*ESTIMATORS, replace(first, method="other")))
    state, out = run(frames(5.0))
    assert set(state.estimates) == {*(row.method for row in estimators.rows_for(MACHINE)), fold.RECOMMENDED}
    assert "other" in state.estimates
    recommended = [p.value for p in out if p.topic == "/soil_tire"]
    firsts = [p.value for p in out if p.topic == f"/soil_tire/{first.method}"]  # of both rows
    assert len(firsts) >= len(recommended) > 0
    assert snapshot(restore(MACHINE, snapshot(state))) == snapshot(state)


def test_estimators_that_are_ready_late_take_what_was_driven_before() -> None:
    """Within three seconds they have learned the same as if they had been ready from the first frame."""
    begin_ns = frames()[0].t_ns + 24_000_000_000
    before = [frame for frame in frames() if frame.t_ns < begin_ns]
    state = initial(MACHINE)
    state.ready = False
    published = [publication for frame in before for publication in step(state, frame)]
    assert not any(isinstance(one.value, Estimate) for one in published)
    state = restore(MACHINE, snapshot(state))  # as at the beginning of a file
    assert len(state.waiting) > 100
    state.ready = True
    published = [publication for frame in frames()[len(before) :] for publication in step(state, frame)]
    assert not state.waiting
    told = [one for one in published if one.topic == "/soil_tire"]
    assert told[0].t_ns - begin_ns < 3_000_000_000
    for method, learned in whole()[0].estimators.items():
        assert to_json_data(state.estimators[method]) == to_json_data(learned), method
    assert payload(told[-1]) == payload([one for one in whole()[1] if one.topic == "/soil_tire"][-1])


def test_of_what_is_driven_before_they_are_ready_the_end_is_kept() -> None:
    state = initial(MACHINE)
    state.ready = False
    first = poses(whole()[1])[0]
    state.waiting = [WaitingPose(first, None, judged=True)] * FOLD.poses_waiting
    for frame in frames(3.0):
        step(state, frame)
    assert state.poses > 5 and state.waiting[-1].pose != first
    assert len(state.waiting) == FOLD.poses_waiting
    accept(state, Accepted(state.latest_ns, "wheel_angle", (0.01,), (0.001,)))  # another rig from here on
    assert not state.waiting
