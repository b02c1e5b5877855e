"""What is wrong with receivers from the start: found in simulated runs, named, and nothing else is."""

import json
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

import numpy as np
import pytest
from circle import demo_machine

from tilth.estimator import aligner, startup
from tilth.estimator.plain import from_plain, to_plain
from tilth.estimator.pose import poses
from tilth.estimator.startup import StartUp
from tilth.estimator.turn_rate_lag import Lag, regress, time_constant
from tilth.replay.scenario import Ground, Scenario
from tilth.replay.traffic import simulate
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Measurement, Mount, YawRate
from tilth.schemas.machine import Machine

MACHINE = demo_machine()
TRACTOR = (Mount.TRACTOR_FRONT, Mount.TRACTOR_REAR)
IMPLEMENT = (Mount.IMPLEMENT_FRONT, Mount.IMPLEMENT_REAR)
FLAT = Scenario(other_traffic=False)
ROUGH = replace(FLAT, ground=Ground(roll_sd_deg=1.0))
HILL = replace(FLAT, ground=Ground(slope_deg=4.0))

Edit = Callable[[Measurement], Measurement]


def as_heard(measurement: Measurement) -> Measurement:
    return measurement


def turned_round(mounts: Collection[Mount]) -> Machine:
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
        self.heard: dict[Mount, list[tuple[float, float]]] = {}
        self.held: dict[Mount, float] = {}

    def __call__(self, measurement: Measurement) -> Measurement:
        mount = measurement.origin.mount
        if not isinstance(measurement, YawRate) or mount is None or mount not in self.seconds:
            return measurement
        tau, at, rate = self.seconds[mount], measurement.rx_ns * 1e-9, measurement.yaw_rate
        heard = self.heard.setdefault(mount, [])
        heard.append((at, rate))
        if self.mean:
            return replace(measurement, yaw_rate=float(np.mean([r for t, r in heard if t > at - tau])))
        before, last = self.held.get(mount, rate), heard[-2:][0]
        keep = math.exp(-(at - last[0]) / tau)
        self.held[mount] = keep * before + (1.0 - keep) * (last[1] + rate) / 2
        return replace(measurement, yaw_rate=self.held[mount])


def drive(
    scenario: Scenario, seconds: float, edit: Edit = as_heard, really: Machine = MACHINE, stored_at: int = -1
) -> tuple[StartUp, list[tuple[float, str, str]]]:
    """(state, (s since the first pose, kind, who) of events), seed 1. stored_at: pose at which it is stored
    and taken up again."""
    decoder, tracks, state = Decoder(MACHINE), aligner.initial(MACHINE), StartUp()
    found: list[tuple[float, str, str]] = []
    first_ns = count = 0
    for frame in simulate(really, 1, seconds, scenario):
        for measurement in decoder.measurements(frame):
            aligner.take(tracks, edit(measurement))
        for pose in poses(tracks, frame.rx_ns):
            first_ns = first_ns or pose.t_ns
            startup.observe(state, tracks, pose)
            count += 1
            if count == stored_at:
                state = from_plain(StartUp, json.loads(json.dumps(to_plain(state))))
            for kind, text in startup.events(state):
                found.append(((pose.t_ns - first_ns) * 1e-9, kind, text.partition(":")[0]))
    return state, found


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
    assert {(kind, who) for _, kind, who in found} == {("smoothed_yaw_rate", m.value) for m in TRACTOR}
    assert len(found) == 2 and max(at for at, _, _ in found) < 20.0
    assert startup.usable_yaw_rates(state) == {m.value for m in IMPLEMENT}
    for lag in state.lags[:2]:
        tau, sd = time_constant(lag)
        assert abs(tau - 1.0) < 0.15 and sd < 0.1
    assert [text.split()[0] for text in startup.findings(state)] == [
        f"smoothed_yaw_rate:{m.value}" for m in TRACTOR
    ]


def test_one_of_four_that_is_a_mean_over_two_seconds_is_told_from_the_others() -> None:
    state, found = drive(FLAT, 30.0, Smoothed({Mount.IMPLEMENT_REAR: 2.0}, mean=True))
    assert [who for _, _, who in found] == ["implement_rear"]
    assert startup.usable_yaw_rates(state) == {m.value for m in Mount} - {"implement_rear"}


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
        (TRACTOR, "not_roll_corrected"),
        (IMPLEMENT, "roll_corrected_twice"),
        ((Mount.IMPLEMENT_REAR,), "roll_corrected_twice"),
    ],
    ids=["tractor", "implement", "one"],
)
def test_roll_that_is_corrected_the_wrong_way_is_found_on_uneven_ground(
    mounts: tuple[Mount, ...], kind: str
) -> None:
    state, found = drive(ROUGH, 60.0, really=turned_round(mounts))
    assert {(k, who) for _, k, who in found} - {("roll_correction", "tractor or implement")} == {
        (kind, m.value) for m in mounts
    }
    assert {text.split()[0] for text in startup.findings(state)} == {f"{kind}:{m.value}" for m in mounts}
    word = "true" if kind == "roll_corrected_twice" else "false"
    assert all(f"set roll_corrected = {word}" in text for text in startup.findings(state))


def test_on_a_hillside_it_says_that_something_is_wrong_and_not_more_than_it_knows() -> None:
    """Both bodies lean alike: either of the two explains where they see the hitch."""
    state, found = drive(HILL, 40.0, really=turned_round(IMPLEMENT))
    assert found[0][1:] == ("roll_correction", "tractor or implement")
    assert state.unclear and not any(state.wrong)
    assert startup.findings(state)[0].startswith("roll_correction:")


def test_on_even_ground_nothing_can_be_said_of_roll() -> None:
    state, found = drive(FLAT, 40.0, really=turned_round(IMPLEMENT))
    assert not found and not startup.findings(state)
    assert np.all(np.isinf(startup.responses(state)[1]))


@pytest.mark.parametrize("scenario", [FLAT, ROUGH, HILL], ids=["flat", "rough", "hill"])
def test_where_nothing_is_wrong_nothing_is_found(scenario: Scenario) -> None:
    state, found = drive(scenario, 60.0)
    assert not found and not startup.findings(state)
    assert startup.usable_yaw_rates(state) == {m.value for m in Mount}
    assert all(abs(time_constant(lag)[0]) < 0.05 for lag in state.lags)


def test_its_state_is_plain_data_that_goes_on_exactly() -> None:
    edit = Smoothed(dict.fromkeys(TRACTOR, 1.0))
    state, found = drive(ROUGH, 20.0, edit, turned_round(IMPLEMENT))
    again = Smoothed(dict.fromkeys(TRACTOR, 1.0))
    stored, found_again = drive(ROUGH, 20.0, again, turned_round(IMPLEMENT), stored_at=37)
    assert to_plain(stored) == to_plain(state) and found_again == found


def test_after_a_step_of_the_clock_intervals_begin_anew_and_findings_stay() -> None:
    state, _ = drive(FLAT, 30.0, Smoothed(dict.fromkeys(TRACTOR, 1.0)))
    before = startup.findings(state)
    startup.clock_stepped(state)
    assert startup.findings(state) == before and state.seen_ns == 0
