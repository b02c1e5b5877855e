"""Spikes of any sensor are left out, alone and in bursts; what a steering cylinder can do never is."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilth.estimator.pose.screen import LIMITS, SCREEN, Reading, Screens
from tilth.schemas.flow import Flag

SD = math.radians(0.1)
START_NS = 1_700_000_000_000_000_000


def readings(
    angles: list[float] | np.ndarray, hertz: float, sd: float = SD, gaps: tuple[int, ...] = ()
) -> list[Reading]:
    """gaps: numbers of readings that are missing."""
    step = round(1e9 / hertz)
    return [(START_NS + k * step, float(a), 0.0, sd) for k, a in enumerate(angles) if k not in gaps]


def through(
    given: list[Reading], quantity: str = "wheel_angle", moving: bool = True
) -> tuple[Screens, list[Reading]]:
    screens = Screens()
    return screens, [used for one in given for used in screens.near("who", quantity, one, moving)]


@settings(max_examples=60, deadline=None)
@given(
    hertz=st.sampled_from([10.0, 20.0, 50.0, 100.0]),
    rates=st.lists(st.floats(-60.0, 60.0), min_size=5, max_size=30),
    quantum=st.sampled_from([0.0, 0.01, 0.1, 0.5]),
    missing=st.sets(st.integers(0, 200), max_size=40),
    seed=st.integers(0, 2**32 - 1),
)
def test_no_honest_wheel_angle_is_ever_left_out(
    hertz: float, rates: list[float], quantum: float, missing: set[int], seed: int
) -> None:
    """Whatever a cylinder of 60°/s does, at any rate, with noise, steps, queueing on the bus and dropouts."""
    rng = np.random.default_rng(seed)
    degrees = np.cumsum(np.repeat(rates, 8)) / hertz
    degrees = degrees + np.clip(rng.normal(0.0, 0.1, len(degrees)), -0.3, 0.3)
    if quantum:
        degrees = np.round(degrees / quantum) * quantum
    given = readings(np.radians(degrees), hertz, gaps=tuple(missing))
    jittered = [(t + int(rng.integers(0, 5_000_000)), *rest) for t, *rest in given]
    screens, used = through(jittered)  # type: ignore[arg-type]
    assert used == jittered and not screens.rejected


@settings(max_examples=60, deadline=None)
@given(
    hertz=st.sampled_from([10.0, 50.0, 100.0]),
    at=st.lists(st.integers(2, 18), min_size=1, max_size=8, unique=True),
    burst=st.integers(1, SCREEN.lasting - 1),
    size=st.floats(35.0, 60.0),
    sign=st.sampled_from([-1.0, 1.0]),
)
def test_spikes_and_bursts_are_left_out_and_nothing_else(
    hertz: float, at: list[int], burst: int, size: float, sign: float
) -> None:
    true = 8.0 * np.sin(np.arange(200) / hertz)
    spikes = {10 * k + j for k in at for j in range(burst)}
    given = readings(np.radians([a + sign * size * (k in spikes) for k, a in enumerate(true)]), hertz)
    screens, used = through(given)
    assert used == [one for k, one in enumerate(given) if k not in spikes]
    assert screens.rejected == {"spike": len(spikes)}


@pytest.mark.parametrize(
    ("quantity", "size"),
    [("wheel_angle", 0.7), ("yaw_rate", 1.0), ("heading", 1.0), ("roll", 0.7), ("pitch", 0.7),
     ("velocity", 5.0), ("wheel_speed", 5.0)],
)  # fmt: skip
@pytest.mark.parametrize("burst", [1, 2, 3])
def test_every_sensor_is_screened(quantity: str, size: float, burst: int) -> None:
    values = [size * (50 <= k < 50 + burst) + 0.001 * (k % 7) for k in range(100)]
    screens, used = through(readings(values, 10.0, 0.01), quantity)
    assert screens.rejected == {"spike": burst} and len(used) == 100 - burst
    assert quantity in LIMITS


def test_positions_are_screened_along_the_way() -> None:
    screens, used = Screens(), []
    for k in range(60):
        at = (START_NS + k * 200_000_000, 0.9 * k + 20.0 * (k in (20, 40, 41)), 0.0, 0.025)
        used += screens.near_path("tractor_front", at, (4.5, 0.0))
    assert screens.rejected == {"spike": 3} and len(used) == 57


def test_what_lasts_is_used_all_of_it() -> None:
    """A sensor that is set anew jumps once: its readings wait until it is clear, and none is lost."""
    given = readings([0.0] * 20 + [0.5 + 0.001 * k for k in range(20)], 50.0)
    screens, used = through(given)
    assert used == given and not screens.rejected


def test_a_heading_goes_round() -> None:
    given = readings([(0.05 * k + math.pi) % math.tau - math.pi for k in range(200)], 10.0, 0.01)
    assert through(given, "heading")[1] == given


def test_a_share_of_spikes_is_a_flag_and_one_now_and_then_is_none() -> None:
    for every, disturbed in ((97, True), (1000, False)):
        given = readings([0.7 * (k % every == every - 1) + 0.0001 * (k % 5) for k in range(5000)], 100.0)
        screens, _ = through(given)
        assert (screens.flags() == [Flag.parse("spikes:who")]) is disturbed
    for one in readings([0.0001 * (k % 5) for k in range(4000)], 100.0):
        screens.near("who", "wheel_angle", (one[0] + 10**11, *one[1:]), True)
    assert screens.flags() == []


def test_spikes_of_a_busy_computer_are_not_the_sensors() -> None:
    screens = Screens(late=True)
    for one in readings([0.7 * (k % 50 == 49) for k in range(2000)], 100.0):
        screens.near("who", "wheel_angle", one, True)
    assert not screens.rejected and not screens.flags()


@pytest.mark.parametrize(("habit", "length", "stands"), [(1, 20, True), (30, 20, False), (30, 80, True)])
def test_a_run_is_unusual_by_what_the_sensor_did_before(habit: int, length: int, stands: bool) -> None:
    angles = [0.001 * (k // habit) for k in range(habit * (SCREEN.known_runs + 2))]
    screens, _ = through(readings([*angles, *[1.0e-4] * length], 100.0))
    assert screens.by["who wheel_angle"].stands is stands


def test_while_the_rig_stands_readings_may_repeat() -> None:
    given = readings([0.001 * k for k in range(200)], 100.0) + [
        (START_NS + 3 * 10**9 + k * 10**7, 0.199, 0.0, SD) for k in range(500)
    ]
    screens, _ = through(given, moving=False)
    assert not screens.by["who wheel_angle"].stands
