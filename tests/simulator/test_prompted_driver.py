"""The driver who is prompted: late by his lag, off by his error, and sometimes elsewhere."""

import math

import numpy as np
import pytest

from tilth.estimator.models import nonlinear
from tilth.simulator.prompted_driver import ARM, AT, STOP, Bar, Person, PromptedDriver

LANE = (20.0, 0.0, 0.0, 300.0)
EXACT = Person(lag_s=0.5, error=0.0)


def at(north: float, east: float = 0.0, heading: float = 0.0) -> np.ndarray:
    x = nonlinear.running(4.5)
    x[AT["x_t"]], x[AT["y_t"]], x[AT["psi_t"]] = north, east, heading
    return np.asarray(x)


def followed(person: Person, seconds: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """(what was wanted, where his hands were), every 0.1 s."""
    driver, wanted, hands = PromptedDriver(person, LANE, seed), [], []
    for k in range(round(seconds / 0.1)):
        now = 0.1 * k
        bar = Bar("running", 0.14 * math.sin(now), 4.5, True)
        driver.look(now, bar, at(100.0))
        wanted.append(bar.wanted)
        hands.append(driver.hands(now, bar, at(100.0)))
    return np.array(wanted), np.array(hands)


@pytest.mark.parametrize("phase", ["", "idle", "finished"])
@pytest.mark.parametrize("room", [True, False])
def test_past_the_lane_he_turns_round_whether_or_not_somebody_knows_of_room(phase: str, room: bool) -> None:
    driver = PromptedDriver(EXACT, LANE, 1)
    driver.hands(0.0, Bar(phase, 0.0, 4.5, room), at(310.0))
    # In the far half there is room back: he turns where he is.
    assert driver.outward == room and not driver.turning
    driver = PromptedDriver(EXACT, LANE, 1)
    driver.hands(0.0, Bar(phase, 0.0, 4.5, room), at(LANE[0] + LANE[3] + 1.0))
    assert driver.turning
    driver.hands(1.0, Bar(phase, 0.0, 4.5, room), at(LANE[0] + LANE[3] + 60.0))
    assert not driver.outward and not driver.turning


def test_he_is_late_by_his_lag() -> None:
    wanted, hands = followed(EXACT, 20.0)
    assert hands[10:] == pytest.approx(wanted[5:-5], abs=0.02)


def test_he_is_off_by_his_error() -> None:
    _, exact = followed(EXACT, 200.0)
    _, off = followed(Person(lag_s=0.5), 200.0)
    assert np.std(off - exact) == pytest.approx(math.radians(1.0), rel=0.2)


def test_he_looks_away_as_often_as_was_said() -> None:
    driver = PromptedDriver(Person(looks_away=0.05), LANE, 3)
    for k in range(20_000):
        driver.look(0.1 * k, Bar("running", 0.1, 4.5, True), at(100.0))
    assert driver.looked_away == pytest.approx(2000 / (20.0 + 3.25), rel=0.3)


def test_he_arms_on_the_lane_only_and_gives_up_without_room() -> None:
    driver = PromptedDriver(EXACT, LANE, 1)
    assert driver.look(0.0, Bar("idle", 0.0, 4.5, True), at(100.0, 20.0)) == ""
    assert driver.look(0.2, Bar("idle", 0.0, 4.5, True), at(100.0, 0.0, 0.4)) == ""
    assert driver.look(0.4, Bar("idle", 0.0, 4.5, False), at(100.0)) == ""
    assert driver.look(0.6, Bar("idle", 0.0, 4.5, True), at(100.0)) == ARM
    pressed = [driver.look(1.0 + 0.2 * k, Bar("lining_up", 0.0, 4.5, False), at(100.0)) for k in range(40)]
    assert pressed.count(STOP) == 1


@pytest.mark.parametrize(("east", "heading"), [(0.0, 0.0), (25.0, 0.5), (-30.0, math.pi)])
def test_he_finds_back_to_the_lane(east: float, heading: float) -> None:
    driver, x = PromptedDriver(EXACT, LANE, 1), at(50.0, east, heading)
    for k in range(1500):
        angle = driver.hands(0.05 * k, Bar("idle", 0.0, 4.5, True), x)
        x[AT["psi_t"]] += 4.5 * math.tan(angle) / 2.9 * 0.05
        x[AT["x_t"]] += 4.5 * math.cos(x[AT["psi_t"]]) * 0.05
        x[AT["y_t"]] += 4.5 * math.sin(x[AT["psi_t"]]) * 0.05
        if k > 300 and abs(x[AT["y_t"]]) < 0.5:
            break
    assert abs(x[AT["y_t"]]) < 0.5
