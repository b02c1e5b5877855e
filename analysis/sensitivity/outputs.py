"""What a rig answers to its wheels, and how a change of the answer is measured.

Source: Karkee (2009), section 6.2.2.1: the six outputs that its overall sensitivity is the mean of (6.17),
and how each change is made a share. The others are what else people ask: the articulation, the implement's
own path, steady turning, and how far the implement strays from a line under a regulator. The wheels are
turned at once, as there, or in any manoeuvre of estimator/models/manoeuvres.py.

Equations 6.10 and 6.11 are summed over the samples, which are STEP_S apart.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.rig_report import steady_turn
from tilth.estimator.models.actuator import BOSSERD
from tilth.estimator.models.family import Model
from tilth.estimator.models.linear_analysis import discretise, eigenvalues, scan, settling_time, system
from tilth.estimator.models.manoeuvres import MANOEUVRE, manoeuvre_named
from tilth.estimator.models.parameters import Rig
from tilth.estimator.models.regulator import regulator

Array = NDArray[np.float64]

STEP_S: Final = 0.01
WHEEL_ANGLE: Final = math.radians(10.0)
STEP: Final = "step"  # the dissertation's manoeuvre
SEED: Final = 1  # of a manoeuvre that is drawn
SHORTEST_S: Final = 20.0  # of another manoeuvre than the step, if nothing is said
SPEEDS: Final = (1.0, 4.5, 7.5)  # m/s
BESIDE_M: Final = 1.0  # from the line, where the regulator begins
SERIES: Final = ("v", "r_t", "r_i", "articulation", "psi_t", "psi_i")  # rows of the simulated system
LONGEST: Final = 200_000  # samples of a simulation
STILL: Final = 1e-9  # 1/s: a pole with a larger real part grows


class Output(NamedTuple):
    """One output. unit: of its deviation; "" where that is a share of the reference."""

    name: str
    meaning: str
    unit: str


OUTPUTS: Final = (
    Output("v", "lateral velocity of the tractor's CG", ""),
    Output("r_t", "yaw rate of the tractor", ""),
    Output("r_i", "yaw rate of the implement", ""),
    Output("position", "end of the path of the tractor's CG", "m"),
    Output("psi_t", "heading of the tractor, after a step at the end", ""),
    Output("psi_i", "heading of the implement, after a step at the end", ""),
    Output("articulation", "articulation", ""),
    Output("implement_position", "end of the path of the implement's axle", "m"),
    Output("steady_v", "lateral velocity of the tractor's CG in the steady turn", ""),
    Output("steady_r", "yaw rate in the steady turn", ""),
    Output("steady_articulation", "articulation in the steady turn", ""),
    Output(
        "off_tracking", "how far the implement's axle runs inside the tractor's path, in the steady turn", "m"
    ),
    Output("cross_track", "cross-track error of the implement's axle on its way back to the line", "m"),
)
SIX: Final = tuple(output.name for output in OUTPUTS[:6])
"""Those of the dissertation, whose mean is the overall sensitivity (6.17)."""
NAMES: Final = tuple(output.name for output in OUTPUTS)
_VELOCITIES: Final = ("v", "r_t", "r_i", "articulation")
_HEADINGS: Final = ("psi_t", "psi_i")
_STEADY: Final = ("steady_v", "steady_r", "steady_articulation", "off_tracking")


class Response(NamedTuple):
    """The answer to the wheels; or, in the same places, the difference of two or the derivative of one."""

    velocities: Array  # (n, 4): v (m/s), r_t, r_i (rad/s), articulation (rad) at each sample
    headings: Array  # (n, 2): psi_t, psi_i, rad
    place: Array  # (2,): north, east of the tractor's CG at the end, m
    implement_place: Array  # (2,): of the implement's axle, m
    steady: Array  # (4,): v (m/s), r (rad/s), articulation (rad), off-tracking (m)
    track: Array  # (n,): cross-track error of the implement's axle under the regulator, m

    def minus(self, other: "Response") -> "Response":
        """The difference."""
        return Response(*(a - b for a, b in zip(self, other, strict=True)))


class Case(NamedTuple):
    """What is simulated: a model at a speed (m/s), the wheels' angle (rad) at each sample, linear between
    them, and its largest; and the regulator's gain, which stays what the nominal rig asked for."""

    model: Model
    speed: float
    wheel: Array  # (samples,)
    angle: float
    gain: Array  # (states of the model with its actuator,)
    steering: str = STEP  # of MANOEUVRES, by name

    @property
    def samples(self) -> int:
        """Of the simulation."""
        return len(self.wheel)

    @property
    def seconds(self) -> float:
        """Simulated time."""
        return self.samples * STEP_S


class Unstable(ValueError):
    """The rig cannot be asked: its answer grows without end."""


def case_of(
    model: Model,
    rig: Rig,
    speed: float,
    seconds: float | None = None,
    angle: float = WHEEL_ANGLE,
    steering: str = STEP,
) -> Case:
    """seconds: twice the settling time if None, as in 6.2.2.1, and SHORTEST_S at least for another manoeuvre
    than the step. Raises Unstable; ValueError where the simulation would be too long."""
    poles = eigenvalues(system(model, rig, speed).a)
    if float(poles.real.max()) > STILL:
        raise Unstable(
            f"at {speed:g} m/s this rig is unstable by the {model.name} model (an eigenvalue of "
            f"{poles.real.max():+.3g} 1/s): its answer has no end; give a lower speed, or other "
            "values in the machine file"
        )
    length = 2 * settling_time(poles) if seconds is None else seconds
    if seconds is None and steering != STEP:
        length = max(length, SHORTEST_S)
    samples = round(length / STEP_S)
    if not 2 <= samples <= LONGEST:
        raise ValueError(
            f"{length:g} s of simulation at {speed:g} m/s: give --seconds from {2 * STEP_S:g} to "
            f"{LONGEST * STEP_S:g}"
        )
    gain = regulator(system(model, rig, speed, actuator=BOSSERD)).gain
    return Case(model, speed, wheel_angles(steering, samples, angle), angle, gain, steering)


def wheel_angles(steering: str, samples: int, angle: float) -> Array:
    """Of a manoeuvre from its beginning, rad, at each sample."""
    time: Array = MANOEUVRE.start_s + STEP_S * np.arange(samples, dtype=np.float64)
    return manoeuvre_named(steering).wheel_angle(time, angle, np.random.default_rng(SEED))


def respond(case: Case, rig: Rig) -> Response:
    """Of a rig, not necessarily the nominal one."""
    sys = system(case.model, rig, case.speed, outputs=SERIES)
    states = run_linear(sys.a, sys.b[:, 0], np.zeros(len(sys.a)), case.wheel)
    series = states @ sys.c.T + np.outer(case.wheel, sys.d[:, 0])
    return Response(
        series[:, :4],
        series[:, 4:],
        *places(case, rig, series),
        steady_values(case, rig),
        track_error(case, rig),
    )


def run_linear(a: Array, b: Array, x0: Array, wheel: Array) -> Array:
    """States of x' = A x + b w from x0, shape (samples, n), exact at samples STEP_S apart."""
    f, g0, g1 = discretise(a, b[:, None], STEP_S)
    states = np.zeros((len(wheel), len(a)))
    states[0] = x0
    steps = len(wheel) - 1
    g = np.hstack([g0, g1])
    scan(
        np.ascontiguousarray([f, f]),
        np.ascontiguousarray([g, g]),
        np.zeros(steps, np.int64),
        np.zeros(steps),
        np.column_stack([wheel[:-1], wheel[1:]]),
        states,
    )
    return states


def places(case: Case, rig: Rig, series: Array) -> tuple[Array, Array]:
    """(of the tractor's CG, of the implement's axle) at the end, each (2,), m. series: (n, 6), as SERIES."""
    v, psi = series[:, 0], series[:, 4]
    north = case.speed * np.cos(psi) - v * np.sin(psi)  # 6.10
    east = case.speed * np.sin(psi) + v * np.cos(psi)  # 6.11
    place = np.array([north.sum(), east.sum()]) * STEP_S
    psi_t, psi_i = series[-1, 4:]
    return place, place - rig.c * _along(psi_t) - rig.towed_length * _along(psi_i)


def _along(psi: float) -> Array:
    return np.array([math.cos(psi), math.sin(psi)])


def steady_values(case: Case, rig: Rig) -> Array:
    """Response.steady; NaN where the rig does not settle, or has no steady turn."""
    sys = system(case.model, rig, case.speed)
    turn = None if float(eigenvalues(sys.a).real.max()) > STILL else steady_turn(case.model, rig, case.speed)
    if turn is None:
        return np.full(4, np.nan)
    v, r, bent = (
        case.angle * turn[name] for name in ("lateral_velocity", "yaw_rate", "articulation")
    )  # fmt: skip
    return np.array([v, r, bent, off_tracking(rig, case.speed, v, r, bent)])


def off_tracking(rig: Rig, speed: float, v: float, r: float, articulation: float) -> float:
    """Radius of the circle of the tractor's CG less that of the implement's axle, m.

    From lateral velocity (m/s), yaw rate (rad/s) and articulation (rad) of a steady turn, without small
    angles. The centre lies at (-v/r, u/r) in the tractor's body frame.
    """
    behind = -rig.c - rig.towed_length * math.cos(articulation)
    lateral_offset = rig.towed_length * math.sin(articulation)
    return (math.hypot(speed, v) - math.hypot(behind * r + v, lateral_offset * r - speed)) / abs(r)


def track_error(case: Case, rig: Rig) -> Array:
    """Response.track: both bodies begin parallel to the line, BESIDE_M to its right.

    The regulator is the dissertation's (5.3.2) with the steering actuator. Its gain is the nominal rig's,
    since it does not know better.
    """
    sys = system(case.model, rig, case.speed, outputs=("y_axle",), actuator=BOSSERD)
    closed = sys.a - np.outer(sys.b[:, 0], case.gain)
    x0 = BESIDE_M * (np.array(sys.states) == "y_t")
    return np.asarray(
        run_linear(closed, np.zeros(len(closed)), x0, np.zeros(case.samples)) @ sys.c[0], dtype=np.float64
    )


def measured(case: Case, reference: Response, change: Response) -> Array:
    """Size of a change as a share of the reference, (len(OUTPUTS),): numerators and denominators of 6.16.

    Velocities, articulation and cross-track error: root mean square over root mean square. Places: distance
    of the end points over the radius of the turn. Headings, steady values: change over value. Of another
    manoeuvre than the step headings are measured as velocities are, and the radius is that of the root mean
    square of the yaw rate: its end is like any other moment.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.abs(deviations(case, reference, change))
        return np.asarray(size / sizes(case, reference), dtype=np.float64)


def sizes(case: Case, reference: Response) -> Array:
    """What changes are shares of: the denominators of 6.16, SI, (len(OUTPUTS),)."""
    velocities = root_mean_square(reference.velocities)
    held = case.steering == STEP
    radius = case.speed / (abs(reference.velocities[-1, 1]) if held else velocities[1])
    headings = np.abs(reference.headings[-1]) if held else root_mean_square(reference.headings)
    whole = {
        **dict(zip(_VELOCITIES, velocities, strict=True)),
        **dict(zip(_HEADINGS, headings, strict=True)),
        "position": radius,
        "implement_position": radius,
        **dict(zip(_STEADY, np.abs(reference.steady), strict=True)),
        "cross_track": root_mean_square(reference.track),
    }
    return np.array([whole[name] for name in NAMES])


def products(case: Case, changes: Sequence[Response]) -> Array:
    """Products of small changes by output, (len(OUTPUTS), k, k): what covariances of parameters are weighted
    with. Of curves the mean over the samples, of places the inner product."""
    curves = np.stack(
        [np.column_stack([change.velocities, change.track, change.headings]) for change in changes]
    )
    ends = np.stack([np.concatenate([change.headings[-1], change.steady]) for change in changes])
    place, implement = (
        np.stack([getattr(change, name) for change in changes]) for name in ("place", "implement_place")
    )
    of_curves = np.einsum("jno,kno->ojk", curves, curves) / curves.shape[1]
    of_ends = np.einsum("jo,ko->ojk", ends, ends)
    swung = () if case.steering == STEP else _HEADINGS  # these are curves then
    found = {
        **dict(zip((*_HEADINGS, *_STEADY), of_ends, strict=True)),
        **dict(zip((*_VELOCITIES, "cross_track", *swung), of_curves, strict=False)),
        "position": place @ place.T,
        "implement_position": implement @ implement.T,
    }
    return np.stack([found[name] for name in NAMES])


def deviations(case: Case, reference: Response, change: Response) -> Array:
    """Change of each output with its sign, SI, (len(OUTPUTS),).

    Of what is a curve the root mean square of the change, positive where it adds to the reference; of places
    the distance of the end points, positive where the heading changes in the direction of the turn.
    """
    turned = _sign(change.headings[-1] * reference.headings[-1])
    held = case.steering == STEP
    headings = change.headings[-1] if held else _signed(reference.headings, change.headings)
    found = {
        **dict(zip(_VELOCITIES, _signed(reference.velocities, change.velocities), strict=True)),
        **dict(zip(_HEADINGS, headings, strict=True)),
        "position": turned[0] * math.hypot(*change.place),
        "implement_position": turned[1] * math.hypot(*change.implement_place),
        **dict(zip(_STEADY, change.steady, strict=True)),
        "cross_track": _signed(reference.track, change.track),
    }
    return np.array([found[name] for name in NAMES], dtype=np.float64)


def _signed(reference: Array, change: Array) -> Array:
    return np.asarray(_sign(np.sum(reference * change, axis=0)) * root_mean_square(change))


def _sign(value: Array) -> Array:
    return np.where(value < 0, -1.0, 1.0)


def root_mean_square(series: Array) -> Array:
    """Over the first axis."""
    return np.asarray(np.sqrt(np.mean(series**2, axis=0)))
