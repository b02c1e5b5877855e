"""A rig that moves exactly as the estimators' own model says, as a record, and the least left unknown by it.

Relaxation model at one speed, a ground that pushes with a memory, white noise of yaw rates and headings at
each tick: the likelihood is then the true one, so that a fit can be held against its
Cramér-Rao bound. `bound` is made without the estimators' filter: a Kalman filter of its own, on arrays.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.rig_setup import RigSetup, rig_setup
from tilth.estimator.filters.states import DT
from tilth.estimator.filters.unknowns import AT, NAMES, NOISES, SIX
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import discretise, system
from tilth.estimator.models.manoeuvres import manoeuvre_named
from tilth.estimator.models.parameters import Rig
from tilth.estimator.record.record import HEADING, INPUTS, YAW_RATE, Record
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine import Machine
from tilth.simulator.noise import generator

Array = NDArray[np.float64]

SPEED: Final = 4.5  # m/s
DISTURBANCES: Final = (0.3, 0.15, 0.05)  # m/s^2, m/s^2, rad/s^2: sds of the ground's, as unknowns.NOISES
MEMORY_S: Final = 0.1
SDS: Final = (math.radians(0.2), math.radians(0.3))  # of a yaw rate, rad/s, and of a heading, rad
ZERO_SD: Final = math.radians(0.3)  # of the wheel angle's zero, drawn
HALF: Final = 0.5  # truths lie within this share of the prior's median
LATERAL_STATES: Final = (0, 1, 2, 3, 4, 5, 7, 8)  # of relaxation.STATES: all but the lateral position
STATES: Final = 11  # these and three pushes
OUTPUT_STATES: Final = (1, 2, 6, 7)  # of these: both yaw rates and both headings
UNSEEN: Final = ("s_velocity", "uneven", "s_roll")  # noise levels of what the record does not have
UNKNOWN: Final = tuple(n for n in (*PARAMETERS, "wheel_zero", *NOISES) if n not in UNSEEN)
NUDGE: Final = 1e-4  # of the central differences
NO_SCATTER: Final = 1e-10  # variance of the first state
SETTLED: Final = 400  # ticks after which the filter's gain stands
REPEATS: Final = 4  # records over which the information is averaged


class Plant(NamedTuple):
    """What is true of one run. The ground pushes as DISTURBANCES and MEMORY_S say, the noises are SDS."""

    rig: Rig
    zero: float  # rad, that the wheel angle reads when straight
    wheel: Array  # rad, (n,), true
    seed: int


def plant(rig: Rig, seed: int, kind: str, seconds: float = 30.0, degrees: float = 8.0) -> Plant:
    """A run of a manoeuvre of estimator.manoeuvres with six parameters drawn about those of `rig`."""
    rng = generator(seed, 1)
    factors = rng.uniform(1.0 - HALF, 1.0 + HALF, len(PARAMETERS))
    theta = dict(zip(PARAMETERS, (rig.theta * factors).tolist(), strict=True))
    time: Array = np.arange(round(seconds / DT), dtype=np.float64) * DT
    wheel = manoeuvre_named(kind).wheel_angle(time, math.radians(degrees), rng)
    return Plant(rig._replace(**theta), float(rng.normal(0.0, ZERO_SD)), wheel, seed)


def record_of(run: Plant) -> Record:
    """What is measured of it. The same run gives the same record."""
    states, y = _driven(run.rig, run.wheel, 1, generator(run.seed, 2))
    n = len(run.wheel)
    ticks = np.zeros((n, len(INPUTS)))
    ticks[:, 0], ticks[:, 1] = run.wheel + run.zero, SPEED
    ticks[:, 2:4], ticks[:, 4:6] = states[:, 0, 6:8], states[:, 0, 1:3]
    rows = np.zeros((n, 4, 6))
    rows[:, :, 0] = np.arange(n)[:, None]
    rows[:, :, 2] = YAW_RATE, YAW_RATE, HEADING, HEADING
    rows[:, :, 3] = 0, 1, 0, 1
    rows[:, :, 4] = y[:, 0]
    rows[:, :, 5] = SDS[0], SDS[0], SDS[1], SDS[1]
    return Record(0, ticks, rows.reshape(-1, 6))


def prior(machine: Machine) -> tuple[Array, Array]:
    """(mean [n], covariance [n, n]) of unknowns.NAMES where only UNKNOWN is not known."""
    mean, sd = unknowns.prior(machine)
    sd = np.where([name in UNKNOWN for name in NAMES], sd, 0.0)
    # What is usual on a tractor, such as late turn rates, is not in this plant.
    mean = np.where([name in (*UNKNOWN, *UNSEEN) for name in NAMES], mean, 0.0)
    return mean, np.diag(sd**2)


def setup(machine: Machine) -> RigSetup:
    """The relaxation model alone, and no error but those of the plant."""
    return rig_setup(machine, linear=True)._replace(sds=np.zeros(4))


def bound(run: Plant, covariance: Array) -> Array:
    """Smallest covariance of the six logarithms, (6, 6): of the prior (over NAMES) and the expected Fisher
    information of the full likelihood at the truth, everything else in UNKNOWN unknown too."""
    chosen = [AT[name] for name in UNKNOWN]
    before = np.linalg.inv(covariance[np.ix_(chosen, chosen)])
    whole: Array = np.asarray(np.linalg.inv(information(run) + before), np.float64)
    return np.asarray(whole[SIX, SIX])


def information(run: Plant, repeats: int = REPEATS) -> Array:
    """Fisher information over UNKNOWN at the truth, mean over `repeats` fresh records, (q, q)."""
    truth = np.zeros(len(UNKNOWN))
    truth[6:] = [run.zero, *np.log([*DISTURBANCES, MEMORY_S]), 0.0, 0.0]
    nudges = np.vstack([np.eye(len(UNKNOWN)), -np.eye(len(UNKNOWN))]) * NUDGE
    _, y = _driven(run.rig, run.wheel, repeats, generator(run.seed, 3))
    points = truth + np.vstack([np.zeros(len(UNKNOWN)), nudges])
    e, innovation_covariances = _innovations(run, points, y)
    q = len(UNKNOWN)
    de = (e[:, 1 : q + 1] - e[:, q + 1 :]) / (2 * NUDGE)  # (n, q, repeats, 4)
    ds = (innovation_covariances[:, 1 : q + 1] - innovation_covariances[:, q + 1 :]) / (
        2 * NUDGE
    )  # (settled, q, 4, 4)
    inverse = np.linalg.inv(innovation_covariances[:, 0])
    weight = np.concatenate([inverse, np.tile(inverse[-1:], (len(e) - len(inverse), 1, 1))])
    found = np.einsum("kimo,kop,kjmp->ij", de, weight, de, optimize=True) / repeats
    wide = np.einsum("kop,kipr->kior", inverse, ds)
    times = np.ones(len(wide))
    times[-1] += len(e) - len(wide)
    found += 0.5 * np.einsum("k,kior,kjro->ij", times, wide, wide, optimize=True)
    return np.asarray(found, np.float64)


def white(rig: Rig) -> Array:
    """Sds of white v', r_t', r_i' (m/s^2, rad/s^2), held for a tick, that push as much as the ground does
    over times longer than its memory, (3,): for who models no memory."""
    b = system(model_named("relaxation"), rig, SPEED).b[:3, 1:]
    of_yaw = np.array([0.0, DISTURBANCES[2], 0.0])
    size = np.sqrt(np.sum(np.square(b * DISTURBANCES[:2]), axis=1) + np.square(of_yaw))
    lasts = math.exp(-DT / MEMORY_S)
    return np.asarray(size * math.sqrt((1.0 + lasts) / (1.0 - lasts)), np.float64)


def _matrices(rig: Rig, memory_s: float) -> tuple[Array, Array]:
    """(F (11, 11), G (11,)) of one tick: the wheel angle held at its mean, pushes as at the first end."""
    whole = system(model_named("relaxation"), rig, SPEED)
    turning = np.zeros((len(whole.a), 1))
    turning[1] = 1.0
    f, before, after = discretise(whole.a, np.hstack([whole.b, turning]), DT)
    held, states = before + after, list(LATERAL_STATES)
    made = np.zeros((STATES, STATES))
    made[:8, :8], made[:8, 8:] = f[np.ix_(states, states)], held[states, 1:]
    made[8:, 8:] = math.exp(-DT / memory_s) * np.eye(3)
    return made, np.append(held[states, 0], np.zeros(3))


def _driven(rig: Rig, wheel: Array, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """(states (n, count, 11), outputs SEEN (n, count, 4)) from straight running."""
    f, g = _matrices(rig, MEMORY_S)
    n, fresh = len(wheel), math.sqrt(1.0 - math.exp(-2.0 * DT / MEMORY_S))
    shocks = rng.standard_normal((n, count, 3)) * DISTURBANCES
    states = np.zeros((n, count, STATES))
    states[0, :, 8:] = shocks[0]
    for k in range(n - 1):
        states[k + 1] = states[k] @ f.T + g * (wheel[k] + wheel[k + 1]) / 2
        states[k + 1, :, 8:] += fresh * shocks[k + 1]
    noise = rng.standard_normal((n, count, 4)) * (SDS[0], SDS[0], SDS[1], SDS[1])
    return states, states[:, :, list(OUTPUT_STATES)] + noise


def _innovations(run: Plant, points: Array, y: Array) -> tuple[Array, Array]:
    """(e (n, p, count, 4), their covariance (at most SETTLED, p, 4, 4)) at points (p, q) of UNKNOWN, whose
    first six count from the truth."""
    n, p = len(run.wheel), len(points)
    rigs = [
        run.rig._replace(**dict(zip(PARAMETERS, (run.rig.theta * np.exp(at[:6])).tolist(), strict=True)))
        for at in points
    ]
    memories = np.exp(points[:, 10])
    made = [_matrices(rig, memory) for rig, memory in zip(rigs, memories.tolist(), strict=True)]
    f, g = np.array([m[0] for m in made]), np.array([m[1] for m in made])
    q, r = np.zeros((p, STATES)), np.zeros((p, 4))
    disturbances = np.exp(2.0 * points[:, 7:10])
    q[:, 8:] = (1.0 - np.exp(-2.0 * DT / memories))[:, None] * disturbances
    r[:, :2], r[:, 2:] = (np.exp(2 * points[:, 11:13]) * np.square(SDS)).T[:, :, None]
    reading = run.wheel + run.zero
    delta = ((reading[:-1] + reading[1:]) / 2)[:, None] - points[:, 6]
    outputs = list(OUTPUT_STATES)
    # Runs begin straight. If the first state had a variance, its absence would count as information.
    first = np.hstack([np.full((p, STATES - 3), NO_SCATTER), disturbances])
    P = first[:, :, None] * np.eye(STATES)
    x, e, innovation_covariances, gain = (
        np.zeros((p, y.shape[1], STATES)), np.zeros((n, p, y.shape[1], 4)), [], np.zeros(0),
    )  # fmt: skip
    for k in range(n):
        if k < SETTLED:
            cross = P[:, :, outputs]
            S = cross[:, outputs] + r[:, :, None] * np.eye(4)
            gain = cross @ np.linalg.inv(S)
            P = P - gain @ cross.transpose(0, 2, 1)
            P = f @ P @ f.transpose(0, 2, 1) + q[:, :, None] * np.eye(STATES)
            P = (P + P.transpose(0, 2, 1)) / 2  # keeps it symmetric
            innovation_covariances.append(S)
        e[k] = y[k] - x[:, :, outputs]
        x = x + e[k] @ gain.transpose(0, 2, 1)
        if k < n - 1:
            x = x @ f.transpose(0, 2, 1) + (g * delta[k][:, None])[:, None]
    return e, np.array(innovation_covariances)
