"""Identifiability of the parameters from a manoeuvre and a set of sensors: rank, condition, Cramér-Rao bound.

The information of a record is that of its innovations: sensitivities of the outputs, whitened by the Kalman
filter of the disturbances. Only the information from the *known steering* counts, not that from the spectrum
of the disturbances. Parameters are logarithms, so a bound is relative to the value.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.family import Model
from tilth.estimator.models.linear_analysis import discretise, outputs_of, simulate, system
from tilth.estimator.models.parameters import Rig
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class IdentifiabilityTuning:
    """Numerics of the Cramér-Rao bound."""

    step: float = tuned(1e-4, "1, rad, s", "of the central differences: of a logarithm, an angle or a time")
    null_share: float = tuned(1e-6, "1", "sensitivities below this share of the largest are rounding errors")


IDENTIFIABILITY: Final = IdentifiabilityTuning()

NUISANCES = ("wheel_zero", "wheel_gain", "latency", "speed")
"""Offset of the wheel angle, rad; logarithm of its scale; delay of all outputs, s; logarithm of the scale of
speed."""


class Sensor(NamedTuple):
    """One measured output, a name that linear_analysis.output_row knows, with white noise."""

    output: str
    sd: float  # SI
    every: int = 1  # it measures at each `every`-th sample


class Bound(NamedTuple):
    """Cramér-Rao bound of `names`: no unbiased estimator has a smaller covariance."""

    names: tuple[str, ...]
    sd: Array  # (q,) of logarithms (or rad, s); infinite for a parameter that the data do not determine
    information: Array  # (q, q)
    rank: int
    condition: float  # best over worst known direction; infinite below full rank


def _deg(degrees: float) -> float:
    return float(np.radians(degrees))


SENSOR_SETS: Mapping[str, tuple[Sensor, ...]] = {
    "gyros": (Sensor("r_t", _deg(0.2)), Sensor("r_i", _deg(0.2))),
    "gyros_headings": (
        Sensor("r_t", _deg(0.2)), Sensor("r_i", _deg(0.2)),
        Sensor("psi_t", _deg(0.3)), Sensor("psi_i", _deg(0.3)),
    ),
    # Two RTK receivers 2.7 m apart on each body, 2.5 cm each: their middle and their direction.
    "positions_5hz": (
        Sensor("y_t", 0.018, 10), Sensor("psi_t", 0.0131, 10),
        Sensor("y_i", 0.018, 10), Sensor("psi_i", 0.0136, 10),
    ),
}  # fmt: skip
"""At 50 samples a second."""

DISTURBANCES: Mapping[str, float] = {"v": 0.25, "r_t": 0.1, "r_i": 0.1}
"""Sd of white accelerations from uneven ground, held for one sample of 20 ms: m/s^2, rad/s^2."""


def sensitivities(
    model: Model,
    rig: Rig,
    speed: float,
    wheel_angle: Array,
    dt: float,
    outputs: Sequence[str],
    names: Sequence[str] = PARAMETERS,
) -> Array:
    """Slope of each output over each parameter, shape (n, p, q), from straight running.

    wheel_angle: (n,) rad, linear between samples. names: fields of Rig, as logarithms, or NUISANCES.
    """

    def respond(name: str, nudge: float) -> Array:
        changed, pace, angle, delay = rig, speed, wheel_angle, 0.0
        if name == "wheel_zero":
            angle = wheel_angle + nudge
        elif name == "wheel_gain":
            angle = wheel_angle * np.exp(nudge)
        elif name == "speed":
            pace = speed * float(np.exp(nudge))
        elif name == "latency":
            delay = nudge
        else:
            changed = rig._replace(**{name: getattr(rig, name) * float(np.exp(nudge))})
        return _response(model, changed, pace, angle, dt, outputs, delay)

    slopes = [
        (respond(name, IDENTIFIABILITY.step) - respond(name, -IDENTIFIABILITY.step))
        / (2 * IDENTIFIABILITY.step)
        for name in names
    ]
    return np.stack(slopes, axis=-1)


def _response(
    model: Model, rig: Rig, speed: float, wheel_angle: Array, dt: float, outputs: Sequence[str], delay: float
) -> Array:
    """Outputs, shape (n, p), reported `delay` seconds after the fact."""
    sys = system(model, rig, speed, outputs=outputs)
    inputs = np.zeros((len(wheel_angle), len(sys.inputs)))
    inputs[:, 0] = wheel_angle
    states = simulate(model, rig, speed, inputs, np.zeros(len(sys.states)), dt, linear=True)
    values = outputs_of(sys, states, inputs)
    return values - delay * np.gradient(values, dt, axis=0) if delay else values


def cramer_rao(
    model: Model,
    rig: Rig,
    speed: float,
    wheel_angle: Array,
    dt: float,
    sensors: Sequence[Sensor],
    *,
    names: Sequence[str] = PARAMETERS,
    disturbances: Mapping[str, float] | None = None,
) -> Bound:
    """The bound of a manoeuvre that starts from straight running, with known initial state.

    disturbances: state -> sd of the white disturbance of its rate, held for dt; None: only sensors are noisy.
    """
    slopes = sensitivities(model, rig, speed, wheel_angle, dt, [s.output for s in sensors], names)
    white = whitened(model, rig, speed, dt, sensors, slopes, disturbances or {})
    return bound(white, names)


def whitened(
    model: Model,
    rig: Rig,
    speed: float,
    dt: float,
    sensors: Sequence[Sensor],
    slopes: Array,
    disturbances: Mapping[str, float],
) -> Array:
    """Sensitivities of the innovations over their sd, shape (rows, q). slopes: as `sensitivities`."""
    sys = system(model, rig, speed, outputs=[s.output for s in sensors])
    f, _, _ = discretise(sys.a, sys.b, dt)
    q = np.diag([(disturbances.get(name, 0.0) * dt) ** 2 for name in sys.states])
    variance, every = np.array([s.sd**2 for s in sensors]), np.array([s.every for s in sensors])
    n = len(sys.states)
    p, x = np.zeros((n, n)), np.zeros((n, slopes.shape[2]))
    rows = []
    for k in range(len(slopes)):
        sampled = np.flatnonzero(k % every == 0)
        if len(sampled):
            c = sys.c[sampled]
            covariance = c @ p @ c.T + np.diag(variance[sampled])
            innovation = slopes[k, sampled] - c @ x
            rows.append(np.linalg.solve(np.linalg.cholesky(covariance), innovation))
            gain = np.linalg.solve(covariance, c @ p).T
            x, p = x + gain @ innovation, p - gain @ c @ p
        x, p = f @ x, f @ p @ f.T + q
    return np.concatenate(rows)


def bound(white: Array, names: Sequence[str]) -> Bound:
    """From whitened sensitivities, shape (rows, q)."""
    whole = np.vstack(
        [white, np.zeros((len(names), len(names)))]
    )  # directions that no row speaks of count too
    _, sizes, directions = np.linalg.svd(whole, full_matrices=False)
    known = sizes > IDENTIFIABILITY.null_share * sizes[0]
    open_ = np.sum(directions[~known] ** 2, axis=0) > IDENTIFIABILITY.null_share
    variance = np.sum((directions[known] / sizes[known, None]) ** 2, axis=0)
    rank = int(known.sum())
    condition = float(sizes[0] / sizes[-1]) if rank == len(names) else float("inf")
    return Bound(tuple(names), np.where(open_, np.inf, np.sqrt(variance)), white.T @ white, rank, condition)
