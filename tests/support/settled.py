"""The rolling model driven until it has settled, and what the steady filter sees of it."""

import math

import numpy as np
from circle import demo_machine
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.propagation import empty_plant, set_plant
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.steady_outputs import (
    CONSTANTS,
)
from tilth.estimator.models import nonlinear, rolling, rolling_terms
from tilth.estimator.models.parameters import Rig
from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]
MACHINE = demo_machine()
NOTHING = np.zeros(0, dtype=np.int64)
ROLLING = {"roll_f": 0.06, "roll_r": 0.06, "roll_i": 0.06}


def settled(rig: Rig, degrees: float, speed: float) -> dict[str, float]:
    """States of the nonlinear model after 30 s at a constant wheel angle."""
    driven = nonlinear.inputs_of(3000, delta=math.radians(degrees), speed=speed)
    states = nonlinear.simulate(rig, driven, nonlinear.running(speed), 0.01)[-1]
    return dict(zip(nonlinear.STATES, states.tolist(), strict=True))


def point_of(**known: float) -> Array:
    """CONSTANTS at the machine file's, but for those that are known, (n,)."""
    mean, _ = unknowns.prior(MACHINE)
    return np.array([known.get(name, float(mean[unknowns.AT[name]])) for name in CONSTANTS])


def driven_on(
    point: Array, x: Array, speed: float, delta: float, slope: float | Array, seconds: float
) -> dict[str, float]:
    """States of the rolling model so many seconds after x, (12,), at a constant wheel angle, rad. slope: of
    the ground across, rad, or of that under either body, (2,)."""
    setup, at = rig_setup(MACHINE), unknowns.prior(MACHINE)[0]
    at[[unknowns.AT[name] for name in CONSTANTS]] = point
    plant, step = empty_plant(setup, 0), 0.005
    set_plant(plant, at, setup, NOTHING)
    x, w, rate = x.copy(), np.zeros(rolling.N_INPUTS), np.zeros(len(rolling_terms.STATES))
    for name, value in (("delta", delta), ("u", speed)):
        w[rolling_terms.INPUTS.index(name)] = value
    w[rolling_terms.INPUTS.index("gravity_t") :][:2] = GRAVITY * np.sin(slope)
    for _ in range(round(seconds / step)):
        rolling.rates(x, w, plant.p, plant.motion, rate)
        x += step * rate
    return dict(zip(rolling_terms.STATES, x.tolist(), strict=True))


def settled_rolling(point: Array, speed: float, delta: float, slope: float) -> dict[str, float]:
    """States of the rolling model a minute after it began to turn."""
    return driven_on(point, np.zeros(len(rolling_terms.STATES)), speed, delta, slope, 60.0)


def seen(at: dict[str, float]) -> Array:
    """steady_outputs.OUTPUTS of states, (3,)."""
    return np.array([at["r_t"], at["psi_t"] - at["psi_i"], at["v"]])
