"""Drives of a linear rig with a known response, steered by plan or by guidance, with coloured noise."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tilth.analysis.response.response import OUTPUTS, DriveSamples
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import (
    discretise,
    frequency_response,
    outputs_of,
    simulate,
    system,
)
from tilth.estimator.models.parameters import TABLE_7_2

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SPEED = 4.5
TRUE = TABLE_7_2._replace(C_af=92e3, C_ar=576e3, C_ai=68e3, sigma_f=1.48, sigma_r=1.92, sigma_i=1.1)
FINER = 10  # steps of the truth between two samples: the wheel angle moves between samples, too
NOISE = (0.02, 0.03, 0.01)  # sd of what the ground does to the outputs, rad/s and rad; half of it is white
Steering = Literal["random", "steps"]


def coloured(rng: np.random.Generator, n: int, step: float, tau: float) -> Array:
    """First-order noise of sd 1, shape (n,)."""
    keep = np.exp(-step / tau)
    series = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.normal(size=n + 1000))
    return np.asarray(series[1000:], dtype=np.float64)


def planned(rng: np.random.Generator, n: int, step: float, steering: Steering) -> Array:
    """Wheel angles, rad, shape (n,): random of 4° sd, or steps of 6° through a valve."""
    if steering == "random":
        smooth = lfilter([1.0], [1.0, -np.exp(-step / 0.4)], coloured(rng, n, step, 0.4))
        return np.asarray(np.radians(4.0) * smooth / np.std(smooth), dtype=np.float64)
    angles: list[float] = []
    while len(angles) < n:
        angles += [float(rng.choice([-1.0, 0.0, 1.0]))] * int(rng.uniform(4.0, 9.0) / step)
    keep = np.exp(-step / 0.25)
    valve = ([1.0 - keep], [1.0, -keep])
    return np.asarray(np.radians(6.0) * lfilter(*valve, lfilter(*valve, angles[:n])), dtype=np.float64)


def open_loop(
    seed: int,
    *,
    seconds: float = 180.0,
    dt: float = 0.05,
    model: str = "relaxation",
    steering: Steering = "random",
    wheel_noise: float = 0.0,
) -> DriveSamples:
    """A drive of TRUE whose wheel angles are planned. wheel_noise: sd of its sensor, rad."""
    rng = np.random.default_rng(seed)
    n = int(seconds / dt)
    linear = model_named(model)
    inputs = np.zeros((n * FINER, len(linear.inputs)))
    inputs[:, 0] = planned(rng, n * FINER, dt / FINER, steering)
    states = simulate(linear, TRUE, SPEED, inputs, np.zeros(len(linear.states)), dt / FINER, linear=True)
    y = outputs_of(system(linear, TRUE, SPEED, outputs=OUTPUTS), states, inputs)[::FINER]
    for k, sd in enumerate(NOISE):
        y[:, k] += sd * (coloured(rng, n, dt, 1.0) + 0.5 * rng.normal(size=n))
    u = inputs[::FINER, 0] + wheel_noise * rng.normal(size=n)
    return DriveSamples(dt, u, dict(zip(OUTPUTS, y.T, strict=True)), SPEED)


def guided(seed: int, *, seconds: float = 120.0, dt: float = 0.05, planned_deg: float = 0.0) -> DriveSamples:
    """A drive of TRUE along a line, on uneven ground, by a steering system with 0.1 s of delay and a valve.

    planned_deg: sd of planned wheel angles that are added.
    """
    rng = np.random.default_rng(seed)
    n = int(seconds / dt)
    linear = model_named("relaxation")
    f, g0, g1 = discretise(*linear.matrices(TRUE, SPEED), dt)
    y_at, psi_at = linear.states.index("y_t"), linear.states.index("psi_t")
    added = planned(rng, n, dt, "random") / np.radians(4.0) * np.radians(planned_deg)
    ground = 9.81 * np.radians(1.0) * np.column_stack([coloured(rng, n, dt, 0.5) for _ in range(2)])
    late, keep = round(0.1 / dt), np.exp(-dt / 0.25)
    states, inputs, wanted = np.zeros((n, len(f))), np.column_stack([np.zeros(n), ground]), np.zeros(n)
    for k in range(1, n):
        wanted[k - 1] = added[k - 1] - 0.05 * states[k - 1, y_at] - 0.5 * states[k - 1, psi_at]
        inputs[k, 0] = keep * inputs[k - 1, 0] + (1.0 - keep) * wanted[max(k - 1 - late, 0)]
        states[k] = f @ states[k - 1] + g0 @ inputs[k - 1] + g1 @ inputs[k]
    y = outputs_of(system(linear, TRUE, SPEED, outputs=OUTPUTS), states, inputs)
    y += rng.normal(0.0, 0.003, y.shape)
    return DriveSamples(dt, inputs[:, 0], dict(zip(OUTPUTS, y.T, strict=True)), SPEED)


def true_response(model: str, omega: Array) -> Complex:
    """Of TRUE, (f, 3), at omega in rad/s."""
    linear = system(model_named(model), TRUE, SPEED, outputs=OUTPUTS, position=False)
    return np.asarray(frequency_response(linear, omega)[:, :, 0], dtype=np.complex128)
