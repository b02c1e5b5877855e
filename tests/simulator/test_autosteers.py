"""Autosteers of different make: they keep to the row, each with wheel angles of its own."""

from dataclasses import replace
from functools import cache
from typing import Any, Final

import numpy as np
import pytest
from circle import demo_machine
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from sampled import sampled

from studies.rows.own_share import own_of, quiet
from tilth.simulator.autosteers import VALVE_SLACK, Valve
from tilth.simulator.drive import drive, drive_in, driver_in
from tilth.simulator.receivers import wheel_readings
from tilth.simulator.scenario import STEP_S, Autosteer, Fieldwork, Ground, RowSteering, Scenario, Wheel
from tilth.simulator.tractor import Truth, setting_of

Array = NDArray[np.float64]

MACHINE: Final = demo_machine()
MAKES: Final = ("pid", "valve", "pursuit")
BEGIN_S, END_S = 20.0, 100.0  # of a row: where the start is forgotten
UNEVEN: Final = {"planar": Ground(force_sd=0.005, rut=True), "spatial": Ground(rms=0.01)}


def scenario(make: str, plant: str = "planar", own: float = 1.0, **keys: Any) -> Scenario:
    steer = Autosteer(make, own=own)  # type: ignore[arg-type]
    row = RowSteering(position_sd=0.008, autosteer=steer)
    return replace(Scenario(plant=plant, speed=3.5, steering=row, ground=UNEVEN[plant]), **keys)  # type: ignore[arg-type]


@cache
def driven(make: str, plant: str = "planar", seed: int = 3) -> Truth:
    return drive(MACHINE, seed, END_S, scenario(make, plant))


def _in_row(values: Array) -> Array:
    return values[round(BEGIN_S / STEP_S) :]


@pytest.mark.parametrize("make", MAKES)
@pytest.mark.parametrize("plant", sampled(["planar", "spatial"], ["planar"]))
def test_rows_are_kept_to_by_wheel_angles_that_are_its_own_for_the_greater_part(
    make: str, plant: str
) -> None:
    truth = driven(make, plant)
    offset = _in_row(truth.states[:, 1])
    assert np.sqrt(np.mean(offset**2)) < 0.05 and np.abs(offset).max() < 0.12
    own = own_of(MACHINE, truth, (BEGIN_S, END_S))
    assert 0.3 < own.driven_deg < 0.9
    assert own.own_deg > 0.25 and own.share > 0.5


@pytest.mark.parametrize("make", [*MAKES, "manual"])
def test_without_anything_of_its_own_it_only_answers_the_ground(make: str) -> None:
    setting = quiet(setting_of(MACHINE, 3, 30.0, scenario(make, own=0.0, speed_sd=0.0)))
    truth = drive_in(setting, driver_in(MACHINE, setting))
    assert np.degrees(np.abs(truth.wheel_angle)).max() < 0.01


def test_the_valves_limit_cycle_has_one_frequency_and_the_amplitude_of_its_slack_and_delay() -> None:
    setting = quiet(setting_of(MACHINE, 3, END_S, scenario("valve")))
    degrees = np.degrees(_in_row(drive_in(setting, driver_in(MACHINE, setting)).wheel_angle))
    fast = degrees - np.convolve(degrees, np.ones(100) / 100, "same")
    power = np.abs(np.fft.rfft(fast[100:-100])) ** 2
    frequency = np.fft.rfftfreq(len(fast) - 200, STEP_S)
    peak = frequency[np.argmax(power)]
    assert 0.8 < peak < 3.0
    assert power[np.abs(frequency - peak) < 0.25 * peak].sum() > 0.6 * power.sum()
    assert 0.3 < np.std(fast[100:-100]) * np.sqrt(2) < 0.8


def test_a_valve_turns_over_beyond_its_slack_only() -> None:
    valve = Valve(VALVE_SLACK)
    missing = [0.9, -0.9, -1.1, 0.5, 0.9, 1.1, *[0.0] * 6]
    ways = np.sign([valve.command(each * VALVE_SLACK) for each in missing])
    assert ways.tolist() == [1, 1, 1, 1, 1, 1, 1, -1, -1, -1, 1, 1]  # five looks late


def test_a_person_moves_the_wheels_in_steps_and_strays_further() -> None:
    truth = driven("manual")
    offset = _in_row(truth.states[:, 1])
    assert 0.02 < np.sqrt(np.mean(offset**2)) < 0.15
    assert own_of(MACHINE, truth, (BEGIN_S, END_S)).share > 0.5


@pytest.mark.parametrize("make", MAKES)
def test_rows_are_met_again_after_headlands(make: str) -> None:
    work = Fieldwork(length=100.0, position_sd=0.0, autosteer=Autosteer(make))  # type: ignore[arg-type]
    truth = drive(MACHINE, 3, 120.0, replace(scenario(make), steering=work))
    north, east = truth.states[:, 0], truth.states[:, 1]
    for row, ahead in enumerate((1, -1)):
        right = east - row * work.spacing
        there = (ahead * truth.states[:, 4] * np.cos(truth.tractor.heading) > 1.0) & (np.abs(right) < 1.0)
        late = there & ((north > 70.0) if ahead > 0 else (north < 30.0)) & (north > 0.0) & (north < 100.0)
        assert late.sum() > 300
        assert np.abs(right[late]).max() < 0.15


@pytest.mark.parametrize("make", [*MAKES, "manual"])
def test_a_side_slope_makes_no_lasting_offset(make: str) -> None:
    slope = Ground(slope_deg=3.0, downhill_deg=90.0)
    truth = drive(MACHINE, 3, 90.0, scenario(make, ground=slope, noise=0.0))
    assert abs(np.mean(truth.states[round(50.0 / STEP_S) :, 1])) < (0.08 if make == "manual" else 0.04)


@given(st.sampled_from([*MAKES, "manual"]), st.integers(0, 1000))
@settings(max_examples=4, deadline=None)
def test_all_is_drawn_from_the_seed(make: str, seed: int) -> None:
    one, same, other = (
        drive(MACHINE, each, 20.0, scenario(make)).wheel_angle for each in (seed, seed, seed + 1)
    )
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


def test_the_sensors_zero_drifts() -> None:
    drift = 0.3 / 600.0
    plain, drifting = (
        drive(MACHINE, 3, 30.0, scenario("pid", wheel=Wheel(zero_drift_degps=rate))) for rate in (0.0, drift)
    )
    off = np.degrees(wheel_readings(drifting) - wheel_readings(plain))
    np.testing.assert_allclose(off, drift * plain.time, atol=1e-9)
