"""The virtual tractor: how a tractor with a towed implement moves when it is driven, and what is true of it.

The relaxation-length model (estimator/models/relaxation.py) is integrated exactly for wheel angles that are
linear between samples; positions, headings and the hitch follow with full trigonometry. Everything is a
function of the machine file, the seed and the scenario.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from tilth.estimator.models import relaxation
from tilth.schemas.flow import PARAMETERS, Mount
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

STEP_S: Final = 0.01
GRAVITY: Final = 9.81
SPEED_GRID: Final = 0.01  # m/s: the transition matrices are made for speeds this far apart
PARAMETER_LOG_SD: Final = 0.2
PARAMETER_LIMIT: Final = 0.35
DRAWN_LIMIT: Final = 1.5  # sd: a latency of 0.1 s with an sd of 0.05 s stays within a StarFire's 0.2 s
BLOCK: Final = 256
DRIVEN: Final = [i for i, name in enumerate(relaxation.STATES) if name != "y_t"]  # positions are trigonometry


@dataclass(frozen=True, slots=True)
class Fault:
    """What goes wrong with one receiver for a while; `kind` is a key of receivers.FAULTS."""

    mount: Mount
    start_s: float
    end_s: float
    kind: str


@dataclass(frozen=True, slots=True)
class Reclaim:
    """A receiver changes its source address; another one's address makes the two claim the same."""

    mount: Mount
    at_s: float
    source: int


@dataclass(frozen=True, slots=True)
class Scenario:
    """How the machine is driven, and what is out of order. The default is the demo's."""

    steering: tuple[tuple[float, float | None], ...] | None = None
    """((seconds, wheel angle in degrees or None for random steering), …), repeated; None: `demo_steering`."""
    speed: float = 4.5  # m/s
    speed_sd: float = 0.05  # m/s, wandering within some ten seconds
    steering_rate_degps: float = 25.0
    roll_deg: tuple[float, float] = (0.0, 0.0)  # of tractor and implement, right side down
    faults: tuple[Fault, ...] = ()
    reclaims: tuple[Reclaim, ...] = ()
    swapped: tuple[Mount, Mount] | None = None  # these two receivers stand in each other's place
    wheel_sensor: bool = True
    claims: bool = True  # False: everybody has claimed an address before the recording began
    latency_s: Mapping[Mount, float] | None = None  # instead of what is drawn
    noise: float = 1.0  # factor on every noise and drawn error of the sensors
    other_traffic: bool = True  # the frames that nobody wants
    utc_start_ns: int = 1_777_881_600_000_000_000  # 2026-05-04T08:00:00Z; a multiple of STEP_S
    clock_offset_s: float | None = None  # host clock minus UTC at the start; None: drawn


@dataclass(frozen=True, slots=True)
class Track:
    """One body's CG over time, arrays of shape (n,), named as in schemas.flow.BodyPose."""

    x: Array
    y: Array
    heading: Array  # not wrapped
    forward_velocity: Array
    lateral_velocity: Array
    yaw_rate: Array
    roll: Array


@dataclass(frozen=True, slots=True)
class Truth:
    """What a simulated run is made from, for comparison with what is estimated from its frames."""

    seed: int
    scenario: Scenario
    parameters: dict[str, float]  # PARAMETERS, N/rad and m
    geometry: Array  # as relaxation.GEOMETRY: what the machine file gives with an sd is drawn
    nuisances: dict[str, float]  # SI; see `_nuisances`
    time: Array  # s of UTC since scenario.utc_start_ns, shape (n,), STEP_S apart
    wheel_angle: Array  # rad, mean road-wheel angle of the front axle, shape (n,)
    tractor: Track
    implement: Track


def generator(seed: int, *stream: int) -> np.random.Generator:
    """An independent generator for each purpose, so that one option does not change another's draws."""
    return np.random.default_rng([seed, *stream])


def demo_steering(rng: np.random.Generator) -> tuple[tuple[float, float | None], ...]:
    """80 s of straight stretches and six steady turns to alternating sides, then random steering."""
    side = 1 if rng.random() < 0.5 else -1
    segments: list[tuple[float, float | None]] = [(5.0, 0.0)]
    for turn in range(6):
        angle = side * (-1) ** turn * rng.uniform(6.0, 9.0)
        segments += [(rng.uniform(10.0, 11.0), angle), (rng.uniform(2.0, 2.4), 0.0)]
    return (*segments, (12.0, None), (2.0, 0.0))


def drive(machine: Machine, seed: int, seconds: float, scenario: Scenario | None = None) -> Truth:
    """Drive the machine of a machine file for so long."""
    scenario = scenario or Scenario()
    parameters = _parameters(machine, generator(seed, 1))
    time: Array = np.arange(round(seconds / STEP_S) + 1, dtype=np.float64) * STEP_S
    delta = _wheel_angle(scenario, time, generator(seed, 2))
    speed = _speed(scenario, len(time), generator(seed, 3))
    roll: Array = np.radians(np.array(scenario.roll_deg))
    geometry = _geometry(machine, scenario.noise, generator(seed, 9))
    theta = np.array([parameters[name] for name in PARAMETERS])
    states = _integrate(geometry, theta, speed, delta, GRAVITY * np.sin(roll))
    tracks = _tracks(geometry, speed, states, roll)
    nuisances = _nuisances(machine, scenario, seed)
    return Truth(seed, scenario, parameters, geometry, nuisances, time, delta, *tracks)


def _parameters(machine: Machine, rng: np.random.Generator) -> dict[str, float]:
    tyres = (machine.tyres.front, machine.tyres.rear, machine.tyres.implement)
    priors = [t.cornering_stiffness for t in tyres] + [t.relaxation_length for t in tyres]
    factors = np.exp(rng.normal(0.0, PARAMETER_LOG_SD, len(PARAMETERS)))
    factors = np.clip(factors, 1.0 - PARAMETER_LIMIT, 1.0 + PARAMETER_LIMIT)
    return dict(zip(PARAMETERS, (float(p * f) for p, f in zip(priors, factors, strict=True)), strict=True))


def _geometry(machine: Machine, noise: float, rng: np.random.Generator) -> Array:
    tractor, implement = machine.tractor, machine.implement
    sd = [q.sd for q in (tractor.a, tractor.b, tractor.c, implement.d, implement.e, tractor.mass)]
    sd += [q.sd for q in (implement.mass, tractor.yaw_inertia, implement.yaw_inertia)]
    return relaxation.geometry_of(machine) + noise * np.array(sd) * _within(rng, len(sd))


def _within(rng: np.random.Generator, n: int) -> Array:
    """Standard normal draws, none beyond DRAWN_LIMIT, shape (n,)."""
    return np.clip(rng.standard_normal(n), -DRAWN_LIMIT, DRAWN_LIMIT)


def _nuisances(machine: Machine, scenario: Scenario, seed: int) -> dict[str, float]:
    """Errors that are constant over a run and that an estimator must live with.

    wheel_zero: the sensor's reading when straight minus what the machine file says of it, rad. pair_tractor,
    pair_implement: heading by the surveyed receiver positions minus true heading, rad. latency_<mount>: s.
    clock_offset, clock_skew: host clock minus UTC at the start, s, and its growth, s/s.
    """
    rng = generator(seed, 4)
    zero, tractor, implement, offset, skew = rng.normal(0.0, [0.3, 0.2, 0.2, 0.2, 15e-6])
    result = {
        "wheel_zero": np.radians(scenario.noise * zero),
        "pair_tractor": np.radians(scenario.noise * tractor),
        "pair_implement": np.radians(scenario.noise * implement),
        "clock_offset": offset if scenario.clock_offset_s is None else scenario.clock_offset_s,
        "clock_skew": skew if scenario.clock_offset_s is None else 0.0,
    }
    given = scenario.latency_s or {}
    for receiver, share in zip(machine.receiver, _within(rng, len(machine.receiver)), strict=True):
        drawn = max(0.02, receiver.latency.value + receiver.latency.sd * share)
        result[f"latency_{receiver.mount}"] = given.get(receiver.mount, drawn)
    return {key: float(value) for key, value in result.items()}


def _wheel_angle(scenario: Scenario, time: Array, rng: np.random.Generator) -> Array:
    """Targets of the scenario, reached at a limited rate."""
    segments = demo_steering(rng) if scenario.steering is None else scenario.steering
    knots, angles = [0.0], [0.0]
    while knots[-1] < time[-1]:
        for duration, target in segments:
            if target is not None:
                _turn_wheel(knots, angles, duration, target, scenario.steering_rate_degps)
                continue
            end = knots[-1] + duration
            while (left := end - knots[-1]) > 1e-9:
                hold = min(left, rng.uniform(0.5, 2.0))
                _turn_wheel(knots, angles, hold, rng.uniform(-8.0, 8.0), scenario.steering_rate_degps)
    return np.radians(np.interp(time, knots, angles))


def _turn_wheel(knots: list[float], angles: list[float], hold: float, target: float, rate: float) -> None:
    """Append corner points: towards the target at that rate, then hold."""
    start, before = knots[-1], angles[-1]
    needed = abs(target - before) / rate
    if needed >= hold:
        knots.append(start + hold)
        angles.append(before + np.sign(target - before) * rate * hold)
        return
    knots += [start + needed, start + hold]
    angles += [target, target]


def gauss_markov(rng: np.random.Generator, sd: float, correlation_s: float, step_s: float, n: int) -> Array:
    """A first-order Gauss-Markov series of that sd and correlation time, shape (n,)."""
    keep = float(np.exp(-step_s / correlation_s))
    series: Array = rng.normal(0.0, sd * np.sqrt(1.0 - keep**2), n)
    # x[k] = keep x[k - 1] + w[k], a block at a time: its own w, and what is left of the block before.
    ages = np.subtract.outer(np.arange(BLOCK), np.arange(BLOCK))
    response = np.where(ages >= 0, keep ** np.maximum(ages, 0), 0.0)
    left = rng.normal(0.0, sd)
    for start in range(0, n, BLOCK):
        block = series[start : start + BLOCK]
        m = len(block)
        block[:] = response[:m, :m] @ block + keep ** np.arange(1, m + 1) * left
        left = block[-1]
    return series


def _speed(scenario: Scenario, n: int, rng: np.random.Generator) -> Array:
    return scenario.speed + gauss_markov(rng, scenario.speed_sd, 10.0, STEP_S, n)


def _integrate(geometry: Array, theta: Array, speed: Array, delta: Array, gravity: Array) -> Array:
    """States DRIVEN at each sample, shape (n, 8), from straight running."""
    grid, which = np.unique(np.round(speed / SPEED_GRID), return_inverse=True)
    maps = [_transition(u, geometry, theta) for u in grid * SPEED_GRID]
    inputs = np.column_stack([delta, np.broadcast_to(gravity, (len(delta), 2))])
    before = np.array([m[1] for m in maps])[which[:-1]] @ inputs[:-1, :, None]
    after = np.array([m[2] for m in maps])[which[:-1]] @ inputs[1:, :, None]
    forced = (before + after)[:, :, 0]
    states = np.zeros((len(delta), len(DRIVEN)))
    state = states[0]
    for k, (index, force) in enumerate(zip(which[:-1].tolist(), forced, strict=True), start=1):
        state = maps[index][0] @ state + force
        states[k] = state
    return states


def _transition(u: float, geometry: Array, theta: Array) -> tuple[Array, Array, Array]:
    """(F, G0, G1) of x+ = F x + G0 input + G1 input+ for inputs that are linear between samples.

    Shapes (8, 8), (8, 3), (8, 3).
    """
    a = relaxation.system_matrix(u, geometry, theta)[np.ix_(DRIVEN, DRIVEN)]
    b = relaxation.input_matrix(u, geometry, theta)[DRIVEN]
    n, m = b.shape
    block = np.zeros((n + 2 * m, n + 2 * m))
    block[:n, :n], block[:n, n : n + m] = a * STEP_S, b * STEP_S
    block[n : n + m, n + m :] = np.eye(m)  # the input's slope, per step
    whole: Array = np.asarray(expm(block), dtype=np.float64)
    slope = whole[:n, n + m :]
    return whole[:n, :n], whole[:n, n : n + m] - slope, slope


def _tracks(geometry: Array, speed: Array, states: Array, roll: Array) -> tuple[Track, Track]:
    """Both bodies from the model's states: planar kinematics of the CG, then through the hitch."""
    v, r_t, r_i, psi_t, psi_i = states[:, [0, 1, 2, 6, 7]].T
    c, d = geometry[2:4]
    x = _integral(speed * np.cos(psi_t) - v * np.sin(psi_t))
    y = _integral(speed * np.sin(psi_t) + v * np.cos(psi_t))
    tractor = Track(x, y, psi_t, speed, v, r_t, np.full_like(v, roll[0]))
    hitch = v - c * r_t  # its lateral velocity in the tractor's frame
    articulation = psi_t - psi_i
    implement = Track(
        x - c * np.cos(psi_t) - d * np.cos(psi_i),
        y - c * np.sin(psi_t) - d * np.sin(psi_i),
        psi_i,
        speed * np.cos(articulation) - hitch * np.sin(articulation),
        speed * np.sin(articulation) + hitch * np.cos(articulation) - d * r_i,
        r_i,
        np.full_like(v, roll[1]),
    )
    return tractor, implement


def _integral(rate: Array) -> Array:
    """Trapezoidal, from zero, shape (n,): at 0.01 s its error is micrometres."""
    return np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) * (STEP_S / 2))])
