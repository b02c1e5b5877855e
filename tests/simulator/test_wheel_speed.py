"""The speed by the wheels: its factor, slip that varies along the way, other tyres; a log that shows them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from circle import demo_machine
from logs import MACHINE_TEXT
from paths import ROOT

from tilth.cli import main
from tilth.replay.offline import ReplayOutputs, replay
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.simulator.drive import drive
from tilth.simulator.scenario import Fieldwork, Scenario, WheelBasedSpeed, parse_scenario
from tilth.simulator.tractor import Truth
from tilth.simulator.wheel_speed import LIFTED_M, MOST_SLIP, TURNING, slip, wheel_speeds

pytestmark = pytest.mark.long


WORK = WheelBasedSpeed(slip=0.06, slip_sd=0.03, slip_length=60.0, light_slip=0.01)
FIELD = Scenario(speed=3.0, steering=Fieldwork(length=80.0), wheel_speed=WORK)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return drive(demo_machine(), 3, 120.0, FIELD)


def again(truth: Truth, of: WheelBasedSpeed, seed: int = 3) -> Truth:
    """The same drive with other wheels."""
    return replace(truth, seed=seed, scenario=replace(truth.scenario, wheel_speed=of))


def test_it_runs_light_in_turns_and_next_to_them(truth: Truth) -> None:
    slips, rates = slip(truth), np.abs(truth.tractor.yaw_rate)
    assert np.all(slips[rates > TURNING] == WORK.light_slip)
    assert np.all((slips >= WORK.light_slip) & (slips <= MOST_SLIP))
    turning = np.flatnonzero(rates > TURNING)
    near = np.abs(np.arange(len(rates))[:, None] - turning[None, ::20]).min(axis=1) < 0.4 * LIFTED_M / 0.03
    assert np.all(slips[near] == WORK.light_slip)
    assert np.std(slips[slips > WORK.light_slip]) > 0.005


@pytest.mark.parametrize("seed", range(4))
def test_slip_has_the_mean_and_the_sd_that_are_asked_for(truth: Truth, seed: int) -> None:
    straight = replace(truth.tractor, yaw_rate=np.zeros_like(truth.time))
    slips = [slip(replace(again(truth, WORK, 10 * seed + k), tractor=straight)) for k in range(10)]
    assert np.mean(slips) == pytest.approx(0.06, abs=0.02)
    assert np.std(slips) == pytest.approx(0.03, abs=0.012)


def test_other_tyres_have_another_factor_from_then_on(truth: Truth) -> None:
    old = wheel_speeds(again(truth, WORK))
    new = wheel_speeds(again(truth, replace(WORK, new_tyres_s=60.0, new_radius=1.04)))
    before = truth.time < 60.0
    np.testing.assert_array_equal(new[before], old[before])
    np.testing.assert_allclose(new[~before], old[~before] / 1.04)


def test_without_slip_it_is_a_factor(truth: Truth) -> None:
    plain = wheel_speeds(again(truth, WheelBasedSpeed(factor=0.97)))
    np.testing.assert_allclose(plain, 0.97 * truth.tractor.forward_velocity)


def test_the_example_stands_while_it_gets_its_tyres() -> None:
    scenario = parse_scenario((ROOT / "examples" / "scenarios" / "new_tyres.toml").read_text())
    assert isinstance(scenario.speed, tuple) and scenario.wheel_speed.new_tyres_s is not None
    (first_s, _), (stand_s, speed), _ = scenario.speed
    assert speed == 0.0 and stand_s > 300.0
    assert first_s < scenario.wheel_speed.new_tyres_s < first_s + stand_s


LARGER = """
speed = 3.0

[steering]
kind = "field"
length = 60.0
spacing = 12.2

[wheel_speed]
factor = 1.02
new_tyres_s = 0.0
new_radius = 1.05
slip = 0.06
slip_sd = 0.025
light_slip = 0.008
"""


@pytest.mark.usefixtures("prepared")
def test_tyres_that_the_machine_file_does_not_have_are_named_in_a_replay(tmp_path: Path) -> None:
    """A log that `tilth simulate` wrote, through all that a replay does; the estimates are not withheld."""
    text = MACHINE_TEXT.replace("[implement]", "wheel_speed_factor = 1.02\n\n[implement]", 1)
    machine = parse_machine(text)
    assert machine.tractor.wheel_speed_factor is not None
    scenario, log = tmp_path / "larger.toml", tmp_path / "run.log"
    scenario.write_text(LARGER)
    assert main(["simulate", str(scenario), "--out", str(log), "--seconds", "240"]) == 0
    events: list[pb.Event] = []

    def publish(topic: str, data: bytes) -> None:
        if topic == "/event":
            events.append(pb.Event.FromString(data))

    replay([log], MachineFile(machine, text), outputs=ReplayOutputs(publish=publish))
    (moved,) = [event.text for event in events if event.kind == "moved"]
    assert "the tyres' radius has changed by" in moved and "accept it as it is now (wheel_speed)" in moved
    assert not [event.text for event in events if event.kind == "contradiction"]
