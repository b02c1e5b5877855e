"""What is wrong with receivers from the start: found in simulated runs, named, and nothing else is."""

import json
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from circle import demo_machine
from logs import MACHINE_TEXT, record

from tilth.estimator import fold
from tilth.estimator.methods import pem
from tilth.estimator.pose import aligner, receiver_checks
from tilth.estimator.pose.pose import poses
from tilth.estimator.pose.receiver_checks import ReceiverChecks
from tilth.estimator.pose.turn_rate_lag import Lag, regress, time_constant
from tilth.estimator.record.record import YAW_RATE, concatenate
from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.estimator.warm_start import SavedPosterior
from tilth.replay.compare import Comparison
from tilth.replay.offline import ReplayOutputs, replay
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Attitude, Event, Flag, FlagKind, Frame, Measurement, Mount, Pose, YawRate
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.sentences import event_sentence, sentence
from tilth.simulator.scenario import Ground, Scenario
from tilth.simulator.traffic import simulate

MACHINE = demo_machine()
TRACTOR = (Mount.TRACTOR_FRONT, Mount.TRACTOR_REAR)
IMPLEMENT = (Mount.IMPLEMENT_FRONT, Mount.IMPLEMENT_REAR)
FLAT = Scenario(other_traffic=False)
ROUGH = replace(FLAT, ground=Ground(roll_sd_deg=1.0))
HILL = replace(FLAT, ground=Ground(slope_deg=4.0))

SECOND = 1_000_000_000
YAW_RATE_BIT = 3.125e-8  # rad/s

Edit = Callable[[Measurement], Measurement]


def as_received(measurement: Measurement) -> Measurement:
    return measurement


def reversed_front_and_rear(mounts: Collection[Mount]) -> Machine:
    """The rig as it really is where the machine file has roll_corrected the wrong way for these."""
    receivers = [
        r.model_copy(update={"roll_corrected": r.roll_corrected != (r.mount in mounts)})
        for r in MACHINE.receiver
    ]
    return MACHINE.model_copy(update={"receiver": receivers})


class Smoothed:
    """Turn rates of some receivers as a mean over the last so many seconds, or through a first-order lag."""

    def __init__(self, seconds: Mapping[Mount, float], mean: bool = False) -> None:
        self.seconds, self.mean = seconds, mean
        self.samples: dict[Mount, list[tuple[float, float]]] = {}
        self.held: dict[Mount, float] = {}

    def __call__(self, measurement: Measurement) -> Measurement:
        mount = measurement.origin.mount
        if not isinstance(measurement, YawRate) or mount is None or mount not in self.seconds:
            return measurement
        tau, at, rate = self.seconds[mount], measurement.rx_ns * 1e-9, measurement.yaw_rate
        samples = self.samples.setdefault(mount, [])
        samples.append((at, rate))
        if self.mean:
            return replace(measurement, yaw_rate=float(np.mean([r for t, r in samples if t > at - tau])))
        before, last = self.held.get(mount, rate), samples[-2:][0]
        save_learned = math.exp(-(at - last[0]) / tau)
        self.held[mount] = save_learned * before + (1.0 - save_learned) * (last[1] + rate) / 2
        return replace(measurement, yaw_rate=self.held[mount])


def drive(
    scenario: Scenario,
    seconds: float,
    edit: Edit = as_received,
    really: Machine = MACHINE,
    stored_at: int = -1,
    believed: Machine = MACHINE,
) -> tuple[ReceiverChecks, list[tuple[float, str, str]]]:
    """(state, (s since the first pose, kind, text) of events), seed 1. stored_at: pose at which
    it is stored and restored. believed: the machine file that the checks use."""
    decoder, tracks, state = Decoder(believed), aligner.initial(believed), ReceiverChecks()
    found: list[tuple[float, str, str]] = []
    first_ns = count = 0
    for frame in simulate(really, 1, seconds, scenario):
        for measurement in decoder.measurements(frame):
            aligner.take(tracks, edit(measurement))
        for pose in poses(tracks, frame.rx_ns):
            first_ns = first_ns or pose.t_ns
            receiver_checks.observe(state, tracks, pose)
            count += 1
            if count == stored_at:
                state = from_json_data(ReceiverChecks, json.loads(json.dumps(to_json_data(state))))
            for flag, told in receiver_checks.begun(state):
                found.append(((pose.t_ns - first_ns) * 1e-9, flag.kind, sentence(told.reason)))
    return state, found


def who(text: str) -> str:
    return text.partition(":")[0]


# Turn rates.


@pytest.mark.parametrize(("tau", "mean"), [(0.8, False), (2.0, False), (2.0, True)])
def test_a_lag_is_the_slope_of_what_is_missing(tau: float, mean: bool) -> None:
    """Against a weaving rig in closed form; of a mean over T half of T, a little less for its bends."""
    lag, dt = Lag(), 0.01
    t = np.arange(0.0, 80.0, dt)
    heading = np.sin(0.5 * t)
    rate = np.empty_like(t)
    if mean:
        rate = (heading - np.sin(0.5 * (t - tau))) / tau
    else:
        real = 0.5 * np.cos(0.5 * t)
        rate[0] = real[0]
        for k in range(1, len(t)):
            rate[k] = rate[k - 1] + dt / tau * (real[k] - rate[k - 1])
    for start in range(1000, len(t) - 200, 200):
        end = start + 200
        lag.integral = float(np.sum((rate[start:end] + rate[start + 1 : end + 1]) / 2) * dt)
        lag.first_rate, lag.rate = float(rate[start]), float(rate[end])
        regress(lag, float(heading[end] - heading[start]), 2.0, 0.005)
    found, sd = time_constant(lag)
    assert found == pytest.approx(tau / 2 if mean else tau, rel=0.15 if mean else 0.02)
    assert 0.0 < sd < 0.1


def test_a_smoothed_turn_rate_is_found_in_the_first_turn_and_not_used() -> None:
    state, found = drive(FLAT, 30.0, Smoothed(dict.fromkeys(TRACTOR, 1.0)))
    assert {(kind, who(text)) for _, kind, text in found} == {
        (receiver_checks.SMOOTHED, m.value) for m in TRACTOR
    }
    assert all("turn its smoothing off" in text for _, _, text in found)
    assert len(found) == 2 and max(at for at, _, _ in found) < 20.0
    assert receiver_checks.lagging(state) == {m.value for m in TRACTOR}
    for lag in state.lags[:2]:
        tau, sd = time_constant(lag)
        assert abs(tau - 1.0) < 0.15 and sd < 0.1
    assert receiver_checks.flags(state) == [Flag(receiver_checks.SMOOTHED, m.value) for m in TRACTOR]


def test_one_smoothed_turn_rate_of_four_is_found() -> None:
    state, found = drive(FLAT, 30.0, Smoothed({Mount.IMPLEMENT_REAR: 2.0}, mean=True))
    assert [who(text) for _, _, text in found] == ["implement_rear"]
    assert receiver_checks.lagging(state) == {"implement_rear"}


ALONE = MACHINE.model_copy(
    update={"receiver": [r for r in MACHINE.receiver if r.mount is not Mount.IMPLEMENT_REAR]}
)
"""The implement has one receiver, which reports its heading."""


@pytest.mark.parametrize("tau", [1.0, 2.6, 10.0])
def test_behind_the_heading_of_one_receiver_alone_it_is_found_as_well(tau: float) -> None:
    state, found = drive(FLAT, 40.0, Smoothed({Mount.IMPLEMENT_FRONT: tau}), ALONE, believed=ALONE)
    ((at, kind, text),) = found
    assert (kind, who(text)) == (receiver_checks.SMOOTHED, "implement_front") and at < 35.0
    assert receiver_checks.lagging(state) == {"implement_front"}
    assert receiver_checks.flags(state) == [Flag.parse("smoothed_yaw_rate:implement_front")]
    lag, sd = time_constant(state.lags[2])
    assert abs(lag - tau) < max(0.25 * tau, 4 * sd)


def test_the_heading_of_one_receiver_alone_accuses_nobody() -> None:
    for scenario in (FLAT, ROUGH):
        state, found = drive(scenario, 40.0, really=ALONE, believed=ALONE)
        assert not found and not receiver_checks.flags(state) and state.lags[2].intervals > 12


def test_one_not_a_number_poisons_nothing() -> None:
    count = 0

    def spoil(measurement: Measurement) -> Measurement:
        nonlocal count
        if isinstance(measurement, YawRate) and measurement.origin.mount is Mount.TRACTOR_FRONT:
            count += 1
            return replace(measurement, yaw_rate=math.nan) if count == 40 else measurement
        return measurement

    state, found = drive(FLAT, 30.0, spoil)
    assert not found
    assert all(abs(time_constant(lag)[0]) < 0.1 for lag in state.lags)
    assert np.all(np.isfinite(state.information))


# Roll.


@pytest.mark.parametrize(
    ("mounts", "kind"),
    [
        pytest.param(TRACTOR, "not_roll_corrected", marks=pytest.mark.long),
        pytest.param(IMPLEMENT, "roll_corrected_twice", marks=pytest.mark.long),
        pytest.param((Mount.IMPLEMENT_REAR,), "roll_corrected_twice", marks=pytest.mark.long),
    ],
    ids=["tractor", "implement", "one"],
)
def test_roll_that_is_corrected_the_wrong_way_is_found_on_uneven_ground(
    mounts: tuple[Mount, ...], kind: str
) -> None:
    # waves of roll are 15 to 150 m long: about three minutes until tractor and implement can be told apart
    state, found = drive(ROUGH, 240.0, really=reversed_front_and_rear(mounts))
    setting = "true" if kind == "roll_corrected_twice" else "false"
    reported = {who(text): (k, text) for _, k, text in found if k != receiver_checks.UNCLEAR}
    assert reported.keys() == {m.value for m in mounts}
    for k, text in reported.values():
        assert k == kind and text.endswith(f"set roll_corrected = {setting} in the machine file")
    assert set(receiver_checks.flags(state)) == {Flag(FlagKind(kind), m.value) for m in mounts}


@pytest.mark.parametrize(
    ("front", "rear", "accused"),
    [
        (0.05, 1.05, ["implement_front"]),  # as if front corrected for roll
        (0.3, 1.75, []),  # no setting makes a receiver move by 1.75 of its height: something else moves it
        (1.1, 0.9, []),
    ],
)
def test_what_no_setting_explains_accuses_nobody(front: float, rear: float, accused: list[str]) -> None:
    """Responses of the implement's receivers, each ± 0.1; neither corrects for roll, by the machine file."""
    state = ReceiverChecks()
    response = np.array([*[float(not r.roll_corrected) for r in MACHINE.receiver[:2]], front, rear])
    state.information[:4, :4] = 100.0 * np.eye(4)
    state.vector[:4] = 100.0 * response
    state.rolls[:] = (100.0, 0.1, 0.0)
    receiver_checks._judge_rolls(state, MACHINE)
    assert [flag.of for flag in receiver_checks.flags(state)] == accused


def test_on_a_hillside_it_says_that_something_is_wrong_and_not_more_than_it_knows() -> None:
    """Both bodies lean alike: either of the two explains where they see the hitch."""
    state, found = drive(HILL, 40.0, really=reversed_front_and_rear(IMPLEMENT))
    assert [kind for _, kind, _ in found] == [receiver_checks.UNCLEAR]
    assert receiver_checks.flags(state) == [Flag.parse("roll_correction:rig")]


@pytest.mark.parametrize("seed", range(20))
def test_directions_of_which_only_noise_is_known_accuse_nobody(seed: int) -> None:
    """What noise adds to the squares of rolls is taken off, and may be more than there was."""
    rng, machine, state = np.random.default_rng(seed), demo_machine(), ReceiverChecks()
    state.rolls[:] = 1.0, 0.1, 0.0  # said to be large
    declared = np.array([*(0.0 if r.roll_corrected else 1.0 for r in machine.receiver), 0.0])
    axes = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    known = np.array([0.0, 0.0, 2.0, 30.0, 100.0])
    state.information = (axes * (known - [200.0, 5.0, 0.0, 0.0, 0.0])) @ axes.T
    noise = axes @ (np.sqrt(np.add(known, [400.0, 20.0, 0.0, 0.0, 0.0])) * rng.normal(size=5))
    state.vector = (axes * known) @ axes.T @ declared + noise
    receiver_checks._judge_rolls(state, machine)
    assert state.wrong == [None] * 4 and not state.unclear


def test_receivers_whose_zeros_of_roll_differ_are_not_noisy_for_that() -> None:
    """1° of difference counted as noise: what it adds to the squares was taken off, three quarters of them,
    and a right file was accused of roll correction in a slalom."""

    def crooked(one: Measurement) -> Measurement:
        if not isinstance(one, Attitude) or one.roll is None:
            return one
        return replace(
            one, roll=one.roll + math.radians(1.0) * (one.origin.mount in (TRACTOR[0], IMPLEMENT[0]))
        )

    (plain, _), (state, _) = (drive(ROUGH, 18.0, edit) for edit in (as_received, crooked))
    assert state.hitch_samples == plain.hitch_samples > 10
    assert state.rolls[:, 1] == pytest.approx(plain.rolls[:, 1], rel=0.05)
    assert state.rolls[:, 2] - plain.rolls[:, 2] == pytest.approx(math.radians(0.5), rel=1e-3)


def test_on_even_ground_roll_correction_stays_unknown() -> None:
    state, found = drive(FLAT, 40.0, really=reversed_front_and_rear(IMPLEMENT))
    assert not found and not receiver_checks.flags(state)
    assert np.all(np.isinf(receiver_checks.responses(state)[1]))


@pytest.mark.parametrize("scenario", [FLAT, ROUGH, HILL], ids=["flat", "rough", "hill"])
def test_where_nothing_is_wrong_nothing_is_found(scenario: Scenario) -> None:
    state, found = drive(scenario, 60.0)
    assert not found and not receiver_checks.flags(state)
    assert not receiver_checks.lagging(state)
    assert all(abs(time_constant(lag)[0]) < 0.05 for lag in state.lags)


def test_a_stored_state_continues_exactly() -> None:
    edit = Smoothed(dict.fromkeys(TRACTOR, 1.0))
    state, found = drive(ROUGH, 20.0, edit, reversed_front_and_rear(IMPLEMENT))
    again = Smoothed(dict.fromkeys(TRACTOR, 1.0))
    stored, found_again = drive(ROUGH, 20.0, again, reversed_front_and_rear(IMPLEMENT), stored_at=37)
    assert to_json_data(stored) == to_json_data(state) and found_again == found


def test_after_a_step_of_the_clock_intervals_begin_anew_and_findings_stay() -> None:
    state, _ = drive(FLAT, 30.0, Smoothed(dict.fromkeys(TRACTOR, 1.0)))
    before = receiver_checks.flags(state)
    receiver_checks.clock_stepped(state)
    assert receiver_checks.flags(state) == before and state.last_pose_ns == 0


# In the fold.


def smoothed_frames(seconds: float) -> list[Frame]:
    """A drive whose implement's receivers, which speak NMEA 2000, send turn rates that lag by a second."""
    decoder, smooth = Decoder(MACHINE), Smoothed(dict.fromkeys(IMPLEMENT, 1.0))
    out = []
    for frame in simulate(MACHINE, 1, seconds, FLAT):
        for samples in decoder.measurements(frame):
            if isinstance(samples, YawRate) and samples.origin.mount in IMPLEMENT:
                rate = smooth(samples)
                assert isinstance(rate, YawRate)
                raw = round(rate.yaw_rate / YAW_RATE_BIT)
                data = frame.data[:1] + raw.to_bytes(4, "little", signed=True) + frame.data[5:]
                frame = replace(frame, data=data)
        out.append(frame)
    return out


@pytest.fixture(scope="module")
def rows() -> list[Frame]:
    return smoothed_frames(36.0)


def learned_before() -> dict[str, SavedPosterior]:
    state = fold.initial(MACHINE)
    method_state = state.estimators[pem.METHOD]
    method_state.mean[:6] += 0.2
    method_state.covariance[:6, :6] *= 0.25
    method_state.informed_ns = 1
    state.diagnosis.consistency.confirmed = True
    return fold.save_learned(state, 1)


def test_what_was_learned_with_a_smoothed_turn_rate_is_forgotten_and_it_is_not_used(
    rows: list[Frame],
) -> None:
    state = fold.initial(MACHINE)
    fold.resume(state, learned_before(), 0.0, rows[0].t_ns)
    out = [p.value for row in rows for p in fold.step(state, row)]
    # Until it is found, one method or another may well disagree.
    events = [value for value in out if isinstance(value, Event) and value.kind != "disagreement"]
    assert [(e.kind, who(event_sentence(e))) for e in events] == [
        (receiver_checks.SMOOTHED, m.value) for m in IMPLEMENT
    ]
    assert all(e.latitude_deg is not None and "turn its smoothing off" in event_sentence(e) for e in events)
    found = out.index(events[0])
    before = [value for value in out[:found] if isinstance(value, Pose)]
    after = [value for value in out[found:] if isinstance(value, Pose)]
    reported = {Flag(receiver_checks.SMOOTHED, m.value) for m in IMPLEMENT}
    assert all(reported <= set(pose.flags) for pose in after) and len(after) > 20
    assert not any(reported & set(pose.flags) for pose in before[:-1])
    assert any(Flag.parse("yaw_rate_of_heading:implement") in pose.flags for pose in after)
    method_state = state.estimators[pem.METHOD]
    assert method_state.mean[:6] == pytest.approx(learned_before()[pem.METHOD].mean[:6], abs=1e-3)
    kinds = concatenate(method_state.window).rows[:, 2:4]
    assert {body for kind, body in kinds.tolist() if kind == YAW_RATE} == {0.0}  # the tractor's
    assert method_state.window[0].record.t_ns > events[0].t_ns - SECOND


@pytest.mark.long
def test_live_and_replay_find_it_alike(rows: list[Frame], tmp_path: Path) -> None:
    live = record(tmp_path, rows, 3)
    for parts in (live.parts, live.parts[2:]):
        comparison, lines = Comparison(), list[str]()
        replay(
            parts,
            MachineFile(MACHINE, MACHINE_TEXT),
            outputs=ReplayOutputs(comparison=comparison),
            say=lines.append,
        )
        assert comparison.compared > 0 and comparison.difference == ""
        assert sum("turn its smoothing off" in text for text in lines) == (2 if parts == live.parts else 0)
