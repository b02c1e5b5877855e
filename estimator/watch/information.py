"""What samples tell of a handful of constants of the rig, by linear regression.

The constants say by how much the machine file is off, and what cannot be told apart from that: the length of
each pair, where each body has the hitch, latencies, the yaw of each pair, the wheels' zero. What soil and
slope do to the slip of an axle is beside them. Absolute values hardly matter: the watch compares what was
with what is.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.once import once_for_a_machine
from tilth.estimator.pose.aligner import MOUNTS
from tilth.estimator.watch.sample import BodySample, Sample
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

CONSTANTS: Final[dict[str, tuple[float, float]]] = {
    "length_t": (0.3, 0.01), "length_i": (0.3, 0.01),  # m: excess of a pair's length
    "hitch_t_forward": (0.3, 0.01), "hitch_t_right": (0.3, 0.01),  # m: where the tractor's antennas have it
    "hitch_i_forward": (0.3, 0.01), "hitch_i_right": (0.3, 0.01),  # m: and the implement's
    "late_tractor_front": (0.06, 0.003), "late_tractor_rear": (0.06, 0.003),  # s
    "late_implement_front": (0.06, 0.003), "late_implement_rear": (0.06, 0.003),  # s
    "crab_t": (0.05, 0.002), "crab_i": (0.05, 0.002),  # rad: way of the axle minus heading of the pair
    "crab_per_turn_t": (0.03, 0.01), "crab_per_turn_i": (0.03, 0.01),  # rad per m/s^2 of lateral acceleration
    "crab_per_roll_t": (0.3, 0.1), "crab_per_roll_i": (0.3, 0.1),  # rad per rad of roll
    "zero": (0.1, 0.002),  # rad: wheels' reading when straight
    "gain": (0.3, 0.03), "wheel_per_turn": (0.03, 0.005), "wheel_per_roll": (0.2, 0.05),
}  # fmt: skip
"""Prior sd of each constant; sd by which it may drift while nothing is moved: other soil, other slope."""
NAMES: Final = tuple(CONSTANTS)
AT: Final = {name: k for k, name in enumerate(NAMES)}
N: Final = len(NAMES)
LENGTH, HITCH, DELAY = AT["length_t"], AT["hitch_t_forward"], AT["late_tractor_front"]
CRAB, TURN, ROLL, ZERO = AT["crab_t"], AT["crab_per_turn_t"], AT["crab_per_roll_t"], AT["zero"]

KINDS: Final = 7  # rows of a sample: two lengths, gap forward and right, two crab angles, wheels
CORRELATED: Final = 25.0  # poses (5 s) whose position errors count as one, as in pose/latency.py
CRAB_SD, CRAB_CORRELATED = 0.012, 6.0  # rad of one pose on even ground; poses that count as one
WHEEL_SD, WHEEL_CORRELATED = 0.006, 10.0
SLOWEST: Final = 1.5  # m/s, for directions of travel
STRAIGHT: Final = 0.1  # rad/s
GENTLE: Final = 1.0  # m/s^2 of lateral acceleration, up to which slip is proportional to it
SMALL_ANGLE: Final = math.radians(9.0)  # of the wheels


@dataclass(frozen=True, slots=True)
class Lengths:
    """What rows need of a machine file. Arrays in the order of flow.Mount, m."""

    forward: Array  # (4,), of the receivers
    right: Array  # (4,)
    shares: Array  # (4,): how far the hitch goes right where that antenna does
    spans: tuple[float, float]  # between the antennas of a body
    axles: tuple[float, float]  # forward of the CG
    wheelbase: float
    sds: Array  # (KINDS,): of one pose
    correlated: Array  # (KINDS,): poses that count as one


@once_for_a_machine
def lengths(machine: Machine) -> Lengths:
    """Of a machine file with four receivers."""
    by_mount = {receiver.mount: receiver for receiver in machine.receiver}
    places = np.array([by_mount[mount].position[:2] for mount in MOUNTS])
    hitches = (-machine.tractor.c.value, machine.implement.d.value)
    shares = np.zeros(4)
    for body, hitch in enumerate(hitches):
        front, rear = places[2 * body, 0], places[2 * body + 1, 0]
        beyond = (hitch - (front + rear) / 2) / (front - rear)
        shares[2 * body : 2 * body + 2] = 0.5 + beyond, 0.5 - beyond
    sd = max(receiver.position_sd for receiver in machine.receiver)
    right_sd = sd * math.sqrt(float(shares @ shares))
    return Lengths(
        places[:, 0], places[:, 1], shares,
        (places[0, 0] - places[1, 0], places[2, 0] - places[3, 0]),
        (-machine.tractor.b.value, -machine.implement.e.value),
        machine.tractor.a.value + machine.tractor.b.value,
        np.array([sd * math.sqrt(2)] * 2 + [sd, right_sd, CRAB_SD, CRAB_SD, WHEEL_SD]),
        np.array([CORRELATED] * 4 + [CRAB_CORRELATED] * 2 + [WHEEL_CORRELATED]),
    )  # fmt: skip


def rows(rig: Lengths, now: Sample) -> tuple[NDArray[np.int64], Array, Array]:
    """(kinds, design (n, N), measured (n,)) of a sample: which rows of KINDS it gives, n of them."""
    design, measured, there = np.zeros((KINDS, N)), np.zeros(KINDS), np.zeros(KINDS, bool)
    bodies = (now.tractor, now.implement)
    along, across = _velocities(rig, bodies)
    _lengths_and_gap(rig, now, along, across, design)
    measured[:4] = now.tractor.excess, now.implement.excess, *now.gap
    there[:4] = True
    for k, body in enumerate(bodies):
        if _is_gentle(body):
            u, r = body.forward_velocity, body.yaw_rate
            row = design[4 + k]
            row[CRAB + k], row[TURN + k], row[ROLL + k] = 1.0, u * r, body.roll
            measured[4 + k] = (body.lateral_velocity + r * rig.axles[k]) / u
            there[4 + k] = True
    wheel = now.wheel_angle
    if there[4] and wheel is not None and abs(wheel) < SMALL_ANGLE:
        u, r = now.tractor.forward_velocity, now.tractor.yaw_rate
        path = math.atan(rig.wheelbase * r / u)
        design[6, ZERO : ZERO + 4] = 1.0, path, u * r, now.tractor.roll
        measured[6] = wheel - path
        there[6] = True
    kinds = np.flatnonzero(there).astype(np.int64)
    return kinds, design[kinds], measured[kinds]


def _is_gentle(body: BodySample) -> bool:
    u, r = body.forward_velocity, body.yaw_rate
    return u > SLOWEST and abs(r) < STRAIGHT and abs(u * r) < GENTLE


def _velocities(rig: Lengths, bodies: tuple[BodySample, BodySample]) -> tuple[Array, Array]:
    """Of the four antennas in the axes of their body, forward and right, m/s."""
    u, v, r = (
        np.repeat([getattr(body, name) for body in bodies], 2)
        for name in ("forward_velocity", "lateral_velocity", "yaw_rate")
    )
    return u - r * rig.right, v + r * rig.forward


def _lengths_and_gap(rig: Lengths, now: Sample, along: Array, across: Array, design: Array) -> None:
    """The first four rows. A receiver that is s seconds late reports a point s times its velocity behind."""
    for body in (0, 1):
        design[body, LENGTH + body] = 1.0
        design[body, DELAY + 2 * body : DELAY + 2 * body + 2] = -along[2 * body], along[2 * body + 1]
    cosine, sine = math.cos(now.articulation), math.sin(now.articulation)
    turned = np.array([[cosine, -sine], [sine, cosine]])  # from the tractor's axes to the implement's
    behind = np.array([-0.5 * along, -rig.shares * across])
    design[2:4, HITCH : HITCH + 2] = turned
    design[2:4, HITCH + 2 : HITCH + 4] = -np.eye(2)
    design[2:4, DELAY : DELAY + 2] = turned @ behind[:, :2]
    design[2:4, DELAY + 2 : DELAY + 4] = -behind[:, 2:]


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
