"""What the linear model with relaxation lengths gives for the wheel angles of a drive, and its residuals."""

from typing import Final

import numpy as np

from tilth.analysis.response.segments import Array, Complex, Flags, stretches
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import (
    System,
    discretise,
    eigenvalues,
    outputs_of,
    settling_time,
    simulate,
    system,
)
from tilth.estimator.models.parameters import Rig

MODEL: Final = model_named("relaxation")
MEMORY: Final = 2.0  # settling times of 2 %: a rig half as quick as its model has settled too


def model_of(rig: Rig, speed: float, outputs: tuple[str, ...]) -> System:
    """Small motions about straight driving at that speed, m/s, from the wheel angle to outputs."""
    return system(MODEL, rig, speed, outputs=outputs, position=False)


def settling(model: System) -> float | None:
    """Seconds until the model has forgotten how it began; None if it is unstable and never does."""
    poles = eigenvalues(model.a)
    return MEMORY * settling_time(poles) if float(poles.real.max()) <= 0.0 else None


def sampled_response(model: System, omega: Array, dt: float) -> Complex:
    """Response of `residuals`' simulation from samples to samples, shape (f, p), at omega in rad/s.

    The wheel angle is linear between samples, dt seconds apart.
    """
    f, g0, g1 = discretise(model.a, model.b[:, :1], dt)
    z = np.exp(1j * omega * dt)[:, None, None]
    states = np.linalg.solve(z * np.eye(len(f)) - f, g0 + z * g1)
    return np.asarray((model.c @ states + model.d[:, :1])[:, :, 0], dtype=np.complex128)


def residuals(rig: Rig, model: System, u: Array, y: Array, present: Flags, usable: Flags, dt: float) -> Array:
    """Measured less simulated outputs, (n, p); NaN where not usable.

    u: wheel angle, (n,), rad; y: (n, p), outputs of the model. Each stretch of present samples, (n,), is
    simulated from straight driving, which usable samples, (n,), have forgotten. Only the mean wheel angle of
    a stretch is left out.
    """
    found = np.full(y.shape, np.nan)
    whole = system(MODEL, rig, model.speed, outputs=model.outputs)
    for begin, end in stretches(present):
        if not usable[begin:end].any():
            continue
        inputs = np.zeros((end - begin, len(whole.inputs)))
        inputs[:, 0] = u[begin:end] - u[begin:end].mean()
        states = simulate(MODEL, rig, model.speed, inputs, np.zeros(len(whole.states)), dt, linear=True)
        found[begin:end] = y[begin:end] - outputs_of(whole, states, inputs)
    found[~usable] = np.nan
    return found
