"""The way on from a fit: how far from the truth does the fitted model drive a window that was not fitted?"""

import math
from dataclasses import dataclass

import numpy as np
from estimation_study import Case, driven, fitted, segments, windows
from numpy.typing import NDArray

from tilth.analysis.fit.rig import fitted_rig
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.models import nonlinear
from tilth.estimator.models.parameters import Rig
from tilth.estimator.record.record import TICK_NS, Record
from tilth.estimator.record.windows import WINDOWS
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Way:
    """How a rig really went: times (m,), s, states (m, 13) there, and what it is."""

    time: Array
    states: Array
    rig: Rig


def trajectory_error(
    packaged: Machine, case: Case, seed: int, length: int = WINDOWS.longest
) -> tuple[float, float, float, float] | None:
    """Root mean square distance from the true way of both CGs over a window that was not fitted, m: (tractor,
    implement) by what was fitted, then both by what is true. The start is the true one; the wheel angle,
    speed and roll are measured, their zero and gain as fitted. None where the run has no two windows."""
    run = driven(packaged, case, seed)
    records = windows(segments(run), length)
    if len(records) < 2:
        return None
    found = fitted(run.machine, run.logs, records[:1])
    rig, truth = fitted_rig(run.machine, found.mean), run.truth
    zero, gain = found.mean[AT["wheel_zero"]], math.exp(found.mean[AT["wheel_gain"]])
    way, at_s = Way(truth.time, truth.states, truth.rig), run.seconds_of(records[1].t_ns)
    told = truth.nuisances
    return (
        *distances(way, records[1], at_s, rig, (zero, gain)),
        *distances(way, records[1], at_s, truth.rig, (told["wheel_zero"], told["wheel_gain"])),
    )


def distances(
    way: Way, record: Record, at_s: float, rig: Rig, wheel: tuple[float, float], level: bool = False
) -> tuple[float, float]:
    """(tractor's, implement's) root mean square distance from the way over a record that begins at_s, m.

    wheel: zero, rad, and gain of the wheel angle. level: the measured roll is not taken for a slope.
    """
    ticks = record.ticks
    times = at_s + np.arange(len(ticks)) * TICK_NS * 1e-9
    true = np.array([np.interp(times, way.time, column) for column in way.states.T]).T
    slopes = np.zeros((len(ticks), 2)) if level else ticks[:, 6:8]
    inputs = nonlinear.inputs_of(
        len(ticks),
        delta=(ticks[:, 0] - wheel[0]) / wheel[1],
        speed=ticks[:, 1],
        gravity_t=rig.g * np.sin(slopes[:, 0]),
        gravity_i=rig.g * np.sin(slopes[:, 1]),
    )
    made = nonlinear.simulate(rig, inputs, true[0], TICK_NS * 1e-9, linear=True)
    carts = [nonlinear.implement(r, states)[:, :2] for r, states in ((rig, made), (way.rig, true))]
    off = made[:, :2] - true[:, :2], carts[0] - carts[1]
    rms = [math.sqrt(float(np.mean(np.sum(one**2, axis=1)))) for one in off]
    return rms[0], rms[1]
