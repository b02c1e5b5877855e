"""The bound of a row: its response is the plant's, its sds are those of steps from the truth, and they follow
what a row can tell."""

from functools import cache
from typing import Final

import numpy as np
import pytest
from circle import demo_machine
from numpy.typing import NDArray

from studies.rows.bound import RowBound, bound_of, likeliest_spread, measured, response, true_point
from studies.rows.own_share import own_of, quiet
from tilth.simulator.drive import drive, drive_in, driver_in
from tilth.simulator.scenario import Autosteer, Ground, RowSteering, Scenario
from tilth.simulator.tractor import setting_of

Array = NDArray[np.float64]

MACHINE: Final = demo_machine()
PID: Final = Autosteer("pid")
UNEVEN: Final = {"planar": Ground(force_sd=0.005, rut=True), "spatial": Ground(rms=0.01)}


def scenario(plant: str = "planar", steer: Autosteer = PID, ground: Ground | None = None) -> Scenario:
    row = RowSteering(position_sd=0.008, autosteer=steer)
    return Scenario(plant=plant, speed=3.5, steering=row, ground=ground or UNEVEN[plant])  # type: ignore[arg-type]


@cache
def bound(seed: int = 3, seconds: float = 70.0, steer: Autosteer = PID, rough: float = 1.0) -> RowBound:
    ground = Ground(force_sd=0.005 * rough, rut=True)
    truth = drive(MACHINE, seed, seconds, scenario(steer=steer, ground=ground))
    return bound_of(MACHINE, truth, (5.0, seconds))


@pytest.mark.parametrize(("plant", "within"), [("planar", 0.03), ("spatial", 0.03)])
def test_the_response_is_that_of_the_plant(plant: str, within: float) -> None:
    """Yaw rates without ground and noise; the spatial plant shares no equation with the model."""
    setting = quiet(setting_of(MACHINE, 1, 40.0, scenario(plant)))
    truth = drive_in(setting, driver_in(MACHINE, setting))
    y, samples = measured(MACHINE, truth, (5.0, 40.0))
    first = int(samples[0]) % 2
    wheel_angle = truth.wheel_angle[first : samples[-1] + 1 : 2]
    u = float(np.mean(truth.tractor.forward_velocity))
    made = response([true_point(MACHINE, truth)], u, wheel_angle, (samples - first) // 2)[:, :, 0]
    assert np.all(np.std((y - made)[:, 6:], axis=0) < within * np.std(y[:, 6:], axis=0))


def test_steps_from_the_truth_are_as_large_as_the_bound_says() -> None:
    z = np.array([made.step / made.sd for made in (bound(seed) for seed in range(3, 9))])
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.5
    assert np.abs(z).max() < 3.5


def test_more_steering_of_its_own_and_more_time_tell_more_and_rough_ground_less() -> None:
    usual = bound().sd
    assert np.all(usual < 0.6 * MACHINE.tyres.front.log_sd)
    assert np.all(bound(seconds=130.0).sd < 0.9 * usual)
    assert np.all(bound(steer=Autosteer("pid", dither_deg=0.6)).sd < 0.95 * usual)
    assert np.all(bound(rough=3.0).sd > 1.1 * usual)
    assert np.all(bound(steer=Autosteer("pid", own=0.0)).sd[[0, 3]] > 1.5 * usual[[0, 3]])


def test_what_past_innovations_do_not_explain_is_the_steerings_own() -> None:
    for own in (0.0, 1.0):
        truth = drive(MACHINE, 3, 70.0, scenario(steer=Autosteer("pid", own=own)))
        share = own_of(MACHINE, truth, (20.0, 70.0)).share
        assert share == pytest.approx(own, abs=0.2)
    assert bound(steer=Autosteer("pid", own=0.0)).unexplained < bound().unexplained - 0.1


def test_what_is_missing_is_said() -> None:
    truth = drive(MACHINE, 3, 20.0, scenario())
    three = MACHINE.model_copy(update={"receiver": MACHINE.receiver[:3]})
    with pytest.raises(ValueError, match="all four receivers; there is none at implement_rear"):
        bound_of(three, truth, (5.0, 20.0))


@pytest.mark.parametrize(("width", "least", "most"), [(1, 0.0, 0.2), (25, 0.5, 10.0)])
def test_smooth_ground_needs_large_coefficients(width: int, least: float, most: float) -> None:
    """Of white noise they are small; waves that last are predicted by differences of what was before."""
    rng = np.random.default_rng(3)
    smooth = np.convolve(rng.standard_normal(1200), np.hanning(width + 2), "valid")[:600, None]
    e = np.concatenate([smooth, smooth], axis=1) + 0.01 * rng.standard_normal((600, 2))
    e[:, 1] = rng.standard_normal(600)
    spreads = (0.03, 0.1, 0.2, 0.3, 0.5, 1.0, 3.0, 10.0)
    assert least < likeliest_spread([e], 6, spreads) <= most
