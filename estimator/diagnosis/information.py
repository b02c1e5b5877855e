"""What samples tell of a handful of constants of the rig, by linear regression.

The constants say by how much the machine file is off, and what cannot be told apart from that: the length of
each pair, where each body has the hitch, latencies, the yaw of each pair, the wheels' zero. What soil and
slope do to the slip of an axle is beside them. Absolute values hardly matter: the watch compares what was
with what is.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.diagnosis.sample import BodySample, Sample
from tilth.estimator.driving import DRIVING
from tilth.estimator.once import once_for_a_machine
from tilth.estimator.pose.aligner import MOUNTS
from tilth.estimator.rig.numbers import NUMBERS
from tilth.estimator.rig.residuals import (
    LATENCIES,
    PairGeometry,
    PairSlopes,
    gap_by_place,
    gap_slopes,
    hitch_shares,
    pair_geometry,
    pair_slopes,
    path_angle,
    sideways,
    wheel_off,
    wheel_slopes,
)
from tilth.estimator.tuning import tuned
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class InformationTuning:
    """Which samples tell where things are."""

    correlated: float = tuned(25.0, "poses", "5 s whose position errors count as one, as in pose/latency.py")
    crab_sd: float = tuned(0.012, "rad", "of one pose on even ground")
    crab_correlated: float = tuned(6.0, "poses", "that count as one")
    wheel_sd: float = tuned(0.006, "rad", "of the wheel angle of one pose")
    wheel_correlated: float = tuned(10.0, "poses", "that count as one")
    straight: float = tuned(0.1, "rad/s", "turn rates of straight driving")
    gentle: float = tuned(1.0, "m/s^2", "lateral, up to which slip is proportional to it")
    small_angle: float = tuned(math.radians(9.0), "rad", "of the wheels")
    soil: Mapping[str, tuple[float, float]] = tuned({
        "crab_per_turn_t": (0.03, 0.01), "crab_per_turn_i": (0.03, 0.01),  # rad per m/s^2, lateral
        "crab_per_roll_t": (0.3, 0.1), "crab_per_roll_i": (0.3, 0.1),  # rad per rad of roll
        "wheel_per_turn": (0.03, 0.005), "wheel_per_roll": (0.2, 0.05),
    }, "by unknown", "prior sd of each effect of soil and slope; sd by which it may drift")  # fmt: skip


INFORMATION: Final = InformationTuning()

CONSTANTS: Final = {row.name: (row.watch_sd, row.drift_sd) for row in NUMBERS if row.watch_sd} | dict(
    INFORMATION.soil
)
"""The same of the numbers of the rig that samples tell of: by how much each is more than the file says.
c, d and aside are where the antennas of a body have the hitch."""
NAMES: Final = tuple(CONSTANTS)
AT: Final = {name: k for k, name in enumerate(NAMES)}
N: Final = len(NAMES)


def _at(*names: str) -> list[int]:
    return [AT[name] for name in names]


LONGER: Final = _at("longer_t", "longer_i")
HITCH: Final = _at("c", "aside_t", "d", "aside_i")
FORWARD: Final = np.array([1.0, 1.0, -1.0, 1.0])
"""Of HITCH, by which the hitch goes forward and right where that number is larger: the implement's d pulls it
back."""
DELAY: Final = _at(*(f"latency_{mount.value}" for mount in MOUNTS))
PAIR, TURN, ROLL = (_at(f"{name}_t", f"{name}_i") for name in ("pair", "crab_per_turn", "crab_per_roll"))
WHEEL_ROW: Final = _at("wheel_zero", "wheel_gain", "wheel_per_turn", "wheel_per_roll")

CRAB: Final = (4, 5)
"""The rows of crab angles of tractor and implement."""
KINDS: Final = 7  # rows of a sample: two lengths, gap forward and right, two crab angles, wheels


@dataclass(frozen=True, slots=True)
class Lengths:
    """What rows need of a machine file, m. Bodies tractor first, receivers front first."""

    levers: Array  # (2, 2, 2): of each body and receiver, forward and right
    pairs: PairGeometry  # of each body
    axles: tuple[float, float]  # forward of the CG
    wheelbase: float
    sds: Array  # (KINDS,): of one pose
    correlated: Array  # (KINDS,): poses that count as one


@once_for_a_machine
def lengths(machine: Machine) -> Lengths:
    """Of a machine file with four receivers."""
    by_mount = {receiver.mount: receiver for receiver in machine.receiver}
    levers = np.array([by_mount[mount].position[:2] for mount in MOUNTS]).reshape(2, 2, 2)
    places = np.array([-machine.tractor.c.value, machine.implement.d.value])
    front, rear = levers.transpose(1, 2, 0)
    shares = hitch_shares((front[0], front[1]), (rear[0], rear[1]), places)
    sd = max(receiver.position_sd for receiver in machine.receiver)
    right_sd = sd * float(np.linalg.norm(shares))
    of = INFORMATION
    return Lengths(
        levers, pair_geometry(levers, places),
        (-machine.tractor.b.value, -machine.implement.e.value), machine.tractor.wheelbase,
        np.array([sd * math.sqrt(2)] * 2 + [sd, right_sd] + [of.crab_sd] * 2 + [of.wheel_sd]),
        np.array([of.correlated] * 4 + [of.crab_correlated] * 2 + [of.wheel_correlated]),
    )  # fmt: skip


def rows(rig: Lengths, now: Sample) -> tuple[NDArray[np.int64], Array, Array]:
    """(kinds, design (n, N), measured (n,)) of a sample: which rows of KINDS it gives, n of them."""
    design, measured, there = np.zeros((KINDS, N)), np.zeros(KINDS), np.zeros(KINDS, bool)
    bodies = (now.tractor, now.implement)
    _lengths_and_gap(rig, now, design)
    measured[:4] = now.tractor.excess, now.implement.excess, *now.gap
    there[:4] = True
    for k, body in enumerate(bodies):
        if _is_gentle(body):
            u, r = body.forward_velocity, body.yaw_rate
            row = design[CRAB[k]]
            row[[PAIR[k], TURN[k], ROLL[k]]] = -1.0, u * r, body.roll
            measured[CRAB[k]] = sideways(body.lateral_velocity, r, rig.axles[k]) / u
            there[CRAB[k]] = True
    wheel = now.wheel_angle
    if there[CRAB[0]] and wheel is not None and abs(wheel) < INFORMATION.small_angle:
        u, r = now.tractor.forward_velocity, now.tractor.yaw_rate
        path = path_angle(rig.wheelbase, u, r)
        design[6, WHEEL_ROW] = *wheel_slopes(np.array(path), np.array(u * r)), now.tractor.roll
        measured[6] = wheel_off(wheel, path, u * r, 0.0, 1.0, 0.0)
        there[6] = True
    kinds = np.flatnonzero(there).astype(np.int64)
    return kinds, design[kinds], measured[kinds]


def _is_gentle(body: BodySample) -> bool:
    u, r = body.forward_velocity, body.yaw_rate
    return u > DRIVING.cruise and abs(r) < INFORMATION.straight and abs(u * r) < INFORMATION.gentle


def _lengths_and_gap(rig: Lengths, now: Sample, design: Array) -> None:
    """The first four rows: constants are places of antennas and hitch, and how late receivers are."""
    bodies = (now.tractor, now.implement)
    motion = [(body.forward_velocity, body.lateral_velocity, body.yaw_rate) for body in bodies]
    slopes = slopes_of(rig, np.array(motion), np.array([body.excess for body in bodies]))
    by_place = gap_by_place(np.array(now.articulation), np.array(0.0))
    tractor, implement = (PairSlopes(*(slope[body] for slope in slopes)) for body in (0, 1))
    of_gap = gap_slopes(tractor, implement, by_place, np.array(now.gap)).reshape(2, 2, -1)
    design[2:4, HITCH] = by_place * FORWARD
    for body in (0, 1):
        late = DELAY[2 * body : 2 * body + 2]
        design[body, LONGER[body]] = 1.0
        design[body, late] = -slopes.excess[body, LATENCIES]
        design[2:4, late] = -of_gap[:, body, LATENCIES]


def slopes_of(rig: Lengths, motion: Array, excess: Array) -> PairSlopes:
    """Of both bodies: (2, …). motion: (2, 3), forward and lateral velocity, m/s, and yaw rate of their CGs.
    excess: (2,), m."""
    u, v, r = motion.T[:, :, None]
    velocity = np.stack([u - r * rig.levers[:, :, 1], v + r * rig.levers[:, :, 0]], axis=-1)
    return pair_slopes(rig.pairs, velocity, excess)


@dataclass(slots=True)
class InformationForm:
    """Normal equations of the constants."""

    information: Array = field(default_factory=lambda: np.zeros((N, N)))  # in their units^-2
    vector: Array = field(default_factory=lambda: np.zeros(N))
    since_ns: int = 0  # of its first sample


def prior_information() -> Array:
    """(N, N), before any sample; the means are zero."""
    return np.diag([sd**-2 for sd, _ in CONSTANTS.values()])


def drift() -> Array:
    """(N, N), covariance of what may change while nothing has been moved."""
    return np.diag([sd**2 for _, sd in CONSTANTS.values()])
