"""Local sensitivities: how much each output changes with each parameter, at one point.

Source: Karkee (2009), section 6.2.2.1, eqs. 6.10 to 6.17. Each parameter in turn is raised by 1 % (6.16); the
change of each output is measured as a share (outputs.measured) and divided by the 1 %. `derivative` is the
same measure of the derivative of the response, without a step: the limit of the first for ever smaller steps.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.sensitivity.outputs import (
    BESIDE_M,
    NAMES,
    SERIES,
    SIX,
    STEP,
    STEP_S,
    WHEEL_ANGLE,
    Case,
    Response,
    case_of,
    deviations,
    measured,
    respond,
    run_linear,
    steady_values,
)
from tilth.analysis.sensitivity.slopes import MACHINE_PARAMETERS, by_logarithm, known, scaled, system_slope
from tilth.estimator.models.actuator import BOSSERD
from tilth.estimator.models.family import Model
from tilth.estimator.models.linear_analysis import system
from tilth.estimator.models.parameters import Rig

Array = NDArray[np.float64]

SHARE: Final = 0.01  # of a parameter's value (6.16)


class LocalSensitivities(NamedTuple):
    """At one speed; arrays are (parameters, outputs.NAMES), per cent of output per per cent of parameter.

    signed: with the sign of the change, see outputs.deviations, over the same denominators as `derivative`.
    """

    case: Case
    reference: Response
    parameters: tuple[str, ...]
    step: Array
    derivative: Array
    signed: Array


def local_sensitivities(
    model: Model,
    rig: Rig,
    speed: float,
    *,
    seconds: float | None = None,
    steering: str = STEP,
    parameters: Sequence[str] = MACHINE_PARAMETERS,
) -> LocalSensitivities:
    """seconds, steering: as of `case_of`. Raises Unstable, ValueError."""
    names = known(parameters)
    case = case_of(model, rig, speed, seconds, WHEEL_ANGLE, steering)
    reference = respond(case, rig)
    step, derivative, signed = [], [], []
    for name in names:
        changed = respond(case, scaled(rig, {name: 1 + SHARE}))
        step.append(measured(case, reference, changed.minus(reference)) / SHARE)
        slope = response_slope(case, rig, name)
        derivative.append(measured(case, reference, slope))
        signed.append(np.copysign(derivative[-1], deviations(case, reference, slope)))
    return LocalSensitivities(case, reference, names, np.array(step), np.array(derivative), np.array(signed))


def overall(values: Array) -> Array:
    """Mean over the dissertation's six outputs (6.17), (parameters,). values: (parameters, outputs.NAMES)."""
    return np.asarray(values[:, [NAMES.index(name) for name in SIX]].mean(axis=1))


def response_slope(case: Case, rig: Rig, name: str) -> Response:
    """Derivative of the response by the logarithm of a parameter.

    State and derivative are simulated together: s' = A s + (dA/dln p) x + (dB/dln p) w.
    """
    sys = system(case.model, rig, case.speed, outputs=SERIES)
    by = system_slope(case.model, rig, case.speed, SERIES, name)
    input_gain = np.append(sys.b[:, 0], by.b[:, 0])
    x, s = _both(sys.a, by.a, input_gain, np.zeros(len(input_gain)), case.wheel)
    series = x @ sys.c.T + np.outer(case.wheel, sys.d[:, 0])
    slope = s @ sys.c.T + x @ by.c.T + np.outer(case.wheel, by.d[:, 0])
    return Response(
        slope[:, :4],
        slope[:, 4:],
        *_place_slopes(case, rig, name, series, slope),
        by_logarithm(lambda at: steady_values(case, at), rig, name),
        _track_slope(case, rig, name),
    )


def _both(a: Array, slope: Array, input_gain: Array, start: Array, wheel: Array) -> tuple[Array, Array]:
    """(x, dx/dln p), each (samples, n), of x' = A x + b w. input_gain: b and its derivative."""
    n = len(a)
    whole = np.block([[a, np.zeros((n, n))], [slope, a]])
    states = run_linear(whole, input_gain, start, wheel)
    return states[:, :n], states[:, n:]


def _place_slopes(case: Case, rig: Rig, name: str, series: Array, slope: Array) -> tuple[Array, Array]:
    """Derivatives of outputs.places."""
    u, v, psi = case.speed, series[:, 0], series[:, 4]
    dv, dpsi = slope[:, 0], slope[:, 4]
    north = -(u * np.sin(psi) + v * np.cos(psi)) * dpsi - dv * np.sin(psi)
    east = (u * np.cos(psi) - v * np.sin(psi)) * dpsi + dv * np.cos(psi)
    place = np.array([north.sum(), east.sum()]) * STEP_S
    hitch, towed = rig.c, rig.towed_length
    longer = {"c": (rig.c, 0.0), "d": (0.0, rig.d), "e": (0.0, rig.e)}.get(name, (0.0, 0.0))
    implement = place
    for length, more, at, turned in zip((hitch, towed), longer, series[-1, 4:], slope[-1, 4:], strict=True):
        along = np.array([math.cos(at), math.sin(at)])
        across = np.array([-math.sin(at), math.cos(at)])
        implement = implement - more * along - length * across * turned
    return place, implement


def _track_slope(case: Case, rig: Rig, name: str) -> Array:
    """Derivative of outputs.track_error; the gain stays."""
    row = ("y_axle",)
    sys = system(case.model, rig, case.speed, outputs=row, actuator=BOSSERD)
    by = system_slope(case.model, rig, case.speed, row, name, BOSSERD)
    closed = sys.a - np.outer(sys.b[:, 0], case.gain)
    slope = by.a - np.outer(by.b[:, 0], case.gain)
    n = len(closed)
    start = np.concatenate([BESIDE_M * (np.array(sys.states) == "y_t"), np.zeros(n)])
    x, s = _both(closed, slope, np.zeros(2 * n), start, np.zeros(case.samples))
    return np.asarray(s @ sys.c[0] + x @ by.c[0], dtype=np.float64)
