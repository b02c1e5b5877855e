"""Predicted measurements against the motion: velocities are rates of positions, and those of the wheels."""

import math

import numpy as np
import pytest
import sympy
from logs import MACHINE
from numpy.typing import NDArray

from tilth.deploy import motion_equations
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.measurement_model import predict_measurement
from tilth.estimator.filters.propagation import set_parameters
from tilth.estimator.filters.rig_setup import RigSetup, rig_setup
from tilth.estimator.filters.sensors.observation import Observation
from tilth.estimator.filters.states import (
    N_STATES,
    X_BANK,
    X_LATERAL_OFFSET,
    X_PAIR,
    X_POSITION,
    X_PSI,
    X_R,
    X_ROLL,
    X_V,
)
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.models.rolling_terms import CONSTANTS, INPUTS, PARAMETERS, STATES
from tilth.estimator.record.record import EAST, NORTH, ROLL_ANGLE, VELOCITY
from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]

SETUP = rig_setup(MACHINE)._replace(heights=np.array([2.8, 0.0, 3.1, 2.0]))
SPEED = 3.0
predict = predict_measurement.interpreted()


def somewhere(seed: int) -> tuple[Array, Array]:
    """(x, point): folded, turning and swaying on level ground."""
    rng, (mean, sd) = np.random.default_rng(seed), unknowns.prior(MACHINE)
    values = mean + 0.5 * sd * rng.normal(size=len(mean))
    values[AT["aside_i"]] = 0.0
    x = np.zeros(N_STATES)
    x[X_V], x[X_R], x[X_R + 1] = rng.uniform(-0.3, 0.3, 3)
    x[X_ROLL : X_ROLL + 4] = rng.uniform(-1.0, 1.0, 4) * [0.01, 0.01, 0.1, 0.1]
    x[X_PSI], x[X_PSI + 1] = 0.7, 0.7 - math.radians(50.0)
    return x, values


def value(x: Array, kind: int, place: int, point: Array, setup: RigSetup = SETUP) -> float:
    psi_ref = x[X_PSI + place // 2]
    obs = Observation(kind, place, 0.0, SPEED, psi_ref, 0.0)
    return float(predict(x, obs, point, setup, np.zeros(N_STATES + len(point))))


def rate(x: Array) -> Array:
    """Of what places the rig: position, headings and leans."""
    out, (psi, v) = np.zeros(N_STATES), (x[X_PSI], x[X_V])
    out[X_POSITION] = SPEED * math.cos(psi) - v * math.sin(psi)
    out[X_POSITION + 1] = SPEED * math.sin(psi) + v * math.cos(psi)
    out[X_PSI : X_PSI + 2], out[X_ROLL : X_ROLL + 2] = x[X_R : X_R + 2], x[X_ROLL + 2 : X_ROLL + 4]
    return out


@pytest.mark.parametrize("roll_compensation", [0.0, 1.0], ids=["as its position", "of the antenna"])
@pytest.mark.parametrize("place", range(4))
@pytest.mark.parametrize("seed", range(3))
def test_a_velocity_is_the_rate_of_the_position(place: int, seed: int, roll_compensation: float) -> None:
    """Of a receiver that corrects its position for roll it may be that of the antenna all the same."""
    x, point = somewhere(seed)
    point[AT["sway"]] = roll_compensation
    antennas = SETUP._replace(heights=SETUP.heights + roll_compensation * SETUP.corrected)
    step = 1e-5 * rate(x)
    north, east = (
        (value(x + step, kind, place, point, antennas) - value(x - step, kind, place, point, antennas)) / 2e-5
        for kind in (NORTH, EAST)
    )
    psi = x[X_PSI + place // 2]
    across = east * math.cos(psi) - north * math.sin(psi)
    # A lean of the tractor turns with it: a hundredth of a radian on a drawbar of half a metre.
    assert value(x, VELOCITY, place, point) == pytest.approx(across, abs=3e-3)


@pytest.mark.parametrize("heading", [0.0, 1.0, 3.0])
def test_slow_errors_of_receivers_stand_still_while_a_body_turns(heading: float) -> None:
    """They come from what is around an antenna: those of a pair are apart, those of the implement aside."""
    x, point = somewhere(1)
    x[X_PSI : X_PSI + 2] += heading
    off = x.copy()
    off[X_PAIR:] = [0.001, -0.002, 0.003, 0.004, 0.01, -0.02]
    for kind, east in ((NORTH, 0), (EAST, 1)):
        moved = np.array([value(off, kind, k, point) - value(x, kind, k, point) for k in range(4)])
        arms = SETUP.levers[:, 0] - np.repeat(SETUP.middles[:, 0], 2)
        pair = off[[X_PAIR + east, X_PAIR + east, X_PAIR + 2 + east, X_PAIR + 2 + east]]
        lateral_offset = off[X_LATERAL_OFFSET + east] * np.array([0.0, 0.0, 1.0, 1.0])
        np.testing.assert_allclose(moved, arms * pair + lateral_offset, atol=1e-12)
        assert arms[0] == -arms[1] > 0.5 and arms[2] == -arms[3] > 0.5


@pytest.mark.parametrize("seed", range(3))
def test_a_receiver_on_the_axle_of_the_implement_moves_as_its_wheels_do(seed: int) -> None:
    """On the ground, and wherever the drawbar is."""
    x, point = somewhere(seed)
    point[AT["roll_hitch"]], point[AT["sway"]] = 0.2, 0.0
    p = np.zeros(len(PARAMETERS) + len(CONSTANTS))
    set_parameters.interpreted()(point, SETUP, p, np.zeros(len(unknowns.ACTIONS)))
    named = dict(zip((*PARAMETERS, *CONSTANTS), p, strict=True)) | dict.fromkeys(INPUTS, 0.0) | {"u": SPEED}
    named |= dict(zip(STATES, x[: len(STATES)], strict=True))
    levers = SETUP.levers.copy()
    levers[2, 0] = -named["e"] - point[AT["lever_i"]] + point[AT["cg_i"]]
    on_axle = SETUP._replace(levers=levers, heights=np.zeros(4))
    symbols = {sympy.Symbol(name, real=True): value for name, value in named.items()}
    across = float(motion_equations.velocities()["i"][1].subs(symbols))
    assert value(x, VELOCITY, 2, point, on_axle) == pytest.approx(across, abs=1e-9)


@pytest.mark.parametrize("place", range(4))
def test_a_roll_is_lean_and_slope_a_little_ago_with_its_zero(place: int) -> None:
    x, point = somewhere(1)
    body = place // 2
    x[X_BANK + body] = 0.3
    late = point[AT["roll_late_t"] + body]
    zero = point[AT["roll_zero_tractor_front"] + place]
    lean = x[X_ROLL + body] - late * x[X_ROLL + 2 + body]
    assert value(x, ROLL_ANGLE, place, point) == pytest.approx(lean + 0.3 / GRAVITY + zero, abs=1e-12)
