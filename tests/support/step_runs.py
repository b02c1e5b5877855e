"""A step of the wheels on the linear model, as the two-step form sees it."""

import math

import numpy as np
from circle import START_NS, demo_machine
from numpy.typing import NDArray

from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import simulate
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.record.record import HEADING, YAW_RATE, Record

Array = NDArray[np.float64]
MACHINE = demo_machine()
RIG = rig_of(MACHINE)
TRUTH = np.asarray(RIG.theta)
SPEED = 4.5
TICKS = 1500
STEP_AT = 400


def record_of(wheel: Array, noise: float = 0.0, zero: float = 0.0, seed: int = 1) -> Record:
    """What the relaxation model does at that wheel angle, with yaw rates and headings at 5 Hz."""
    rng = np.random.default_rng(seed)
    n = len(wheel)
    x = simulate(
        model_named("relaxation"), RIG, SPEED, np.column_stack([wheel, np.zeros((n, 2))]), np.zeros(9), 0.02,
        linear=True,
    )  # fmt: skip
    ticks = np.zeros((n, 8))
    ticks[:, 0], ticks[:, 1] = wheel + zero + noise * rng.normal(0, 0.001, n), SPEED
    ticks[:, 2:4], ticks[:, 4:6] = x[:n, 7:9], x[:n, 1:3]
    rows = []
    for k in range(0, n, 10):
        for body in (0, 1):
            rate, heading = x[k, 1 + body], x[k, 7 + body]
            rows.append((k, 0.0, YAW_RATE, body, rate + noise * rng.normal(0, 0.004), 0.004))
            rows.append((k, 0.0, HEADING, body, heading + noise * rng.normal(0, 0.005), 0.005))
    return Record(START_NS, ticks, np.array(rows, dtype=np.float64))


def step_run(degrees: float = 8.0) -> Array:
    wheel = np.zeros(TICKS)
    wheel[STEP_AT:] = math.radians(degrees) * np.minimum(np.arange(TICKS - STEP_AT) / 16, 1.0)
    return wheel
