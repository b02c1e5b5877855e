"""Priors as wide as people are wrong, over unknowns.NAMES, and the numbers that calibration gives."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration import linkage
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import AT
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

LEVER_SD: Final = 0.20  # m
PAIR_SD: Final = math.radians(3.0)
ZERO_SD: Final = math.radians(5.0)
GAIN_SD: Final = 0.15
LATENCY_SD: Final = 0.10  # s: 0 to 200 ms
ACKERMANN_SD: Final = 0.3
HITCH_SD: Final = 0.20  # m, of hitch and drawbar
IDENTIFIABLE: Final = 0.5  # of the prior sd: a larger sd says that the drive tells nothing of a number

DEG: Final = math.degrees(1.0)
CURVED: Final = DEG * math.radians(30.0) ** 2  # ° at 30° per 1/rad
ROW, CIRCLE, FOLD, WEAVE = (
    "drive straight there and back on one line, 150 m each way",
    "drive slow circles to both sides, at three angles of the wheels",
    "drive turns in which the implement folds by 20° and more, to both sides",
    "weave with the wheels, slowly and quickly, for a minute each",
)


@dataclass(frozen=True, slots=True)
class Sought:
    """One that a drive can tell."""

    name: str
    words: str  # for people
    unit: str  # for people
    per_unit: float  # SI per unit
    wanted_sd: float  # SI
    prior_sd: float  # SI
    drive: str  # the manoeuvre that tells it
    tape: str  # what tells it without driving


_LEVER: Final = "a tape, from rear axle to antenna along the body"
_PIN: Final = "a tape, from rear axle to hitch pin"
_AXLE: Final = "a tape, from hitch pin to the axle"
_SIDE: Final = "a tape, from the middle of the body to the antenna"
NUMBERS: Final = (
    Sought("pair_t", "yaw of the tractor's pair", "°", 1 / DEG, math.radians(0.1), PAIR_SD, ROW, _SIDE),
    Sought("pair_i", "yaw of the implement's pair", "°", 1 / DEG, math.radians(0.1), PAIR_SD, ROW, _SIDE),
    Sought("aside_t", "tractor's receivers to the right", "m", 1.0, 0.01, LEVER_SD, FOLD, _SIDE),
    Sought("aside_i", "implement's receivers to the right", "m", 1.0, 0.01, LEVER_SD, ROW, _SIDE),
    Sought("lever_t", "tractor's receivers forward", "m", 1.0, 0.03, LEVER_SD, CIRCLE, _LEVER),
    Sought("lever_i", "implement's receivers forward", "m", 1.0, 0.03, LEVER_SD, CIRCLE, _LEVER),
    Sought("c", "tractor.c, CG to hitch", "m", 1.0, 0.03, HITCH_SD, FOLD, _PIN),
    Sought("d", "implement.d, hitch to CG", "m", 1.0, 0.02, HITCH_SD, FOLD, _AXLE),
    Sought("wheel_zero", "wheel angle when straight", "°", 1 / DEG, math.radians(0.05), ZERO_SD, ROW, "none"),
    Sought("wheel_gain", "scale of the wheel angle", "%", 0.01, 0.01, GAIN_SD, CIRCLE, "none"),
    Sought(
        "wheel_curve", "curvature of the wheel's linkage, at 30°", "°", 1 / CURVED, 0.2 / CURVED,
        linkage.CURVE_SD, CIRCLE, "none",
    ),
    Sought(
        "ackermann", "front wheels, share of Ackermann's angles", "%", 0.01, 0.15, ACKERMANN_SD, CIRCLE,
        "none",
    ),
    Sought("latency", "latency of the receivers", "ms", 1e-3, 0.010, LATENCY_SD, WEAVE, "none"),
    *(
        Sought(
            f"roll_zero_{place}", f"roll zero, {place.replace('_', ' ')} receiver", "°", 1 / DEG,
            math.radians(0.1), math.radians(3.0), ROW, "a level floor, each side once",
        )
        for place in ("tractor_front", "tractor_rear", "implement_front", "implement_rear")
    ),
)  # fmt: skip
NUMBER: Final = {number.name: number for number in NUMBERS}
BY_LIKELIHOOD: Final = tuple(
    number.name for number in NUMBERS if number.name in AT and not number.name.startswith("roll_zero")
)
NOT_BY_DRIVING: Final = (
    ("masses and yaw inertias", "a scale; driving shows stiffnesses over masses"),
    ("heights of the CGs and the hitch", "a tape, the data sheet of the tractor"),
    ("tractor.a, tractor.b, implement.e", "a tape and a scale; only wheelbase over wheel scale is driven"),
    ("heights of the antennas", "a tape, from the ground"),
)


def wide(machine: Machine, roll_zero_sd: Array) -> tuple[Array, Array]:
    """(mean, sd), each [n], about the machine file as it stands. roll_zero_sd: (4,), rad, of what roll.py has
    found.

    The places of the CGs are held: they move levers, a, b, c, d and e alike, and only forces tell of them. So
    is e: driving tells how far it is from the hitch to the axle, and d takes what e has wrong.
    """
    mean, sd = unknowns.prior(machine)
    sd = sd.copy()
    for name, value in (
        ("wheel_zero", ZERO_SD), ("wheel_gain", GAIN_SD), ("latency", LATENCY_SD), ("pair_t", PAIR_SD),
        ("pair_i", PAIR_SD), ("lever_t", LEVER_SD), ("lever_i", LEVER_SD),
        ("aside_i", LEVER_SD * math.sqrt(2.0)), ("c", HITCH_SD / machine.tractor.c.value),
        ("d", HITCH_SD / machine.implement.d.value), ("e", 0.0), ("cg_t", 0.0), ("cg_i", 0.0),
        ("parallel", ACKERMANN_SD),
    ):  # fmt: skip
        sd[AT[name]] = value
    known = np.isfinite(roll_zero_sd) & (sd[unknowns.AT_ROLL_ZERO : unknowns.AT_ROLL_ZERO + 4] > 0.0)
    sd[unknowns.AT_ROLL_ZERO : unknowns.AT_ROLL_ZERO + 4] = np.where(known, roll_zero_sd, 0.0)
    return mean, sd


def metres(machine: Machine, point: Array) -> Array:
    """BY_LIKELIHOOD at a point [n] in SI: c and d as metres more than the file says."""
    found = point[[AT[name] for name in BY_LIKELIHOOD]].copy()
    for name, length in (("c", machine.tractor.c.value), ("d", machine.implement.d.value)):
        k = BY_LIKELIHOOD.index(name)
        found[k] = length * math.expm1(found[k])
    return found


def slopes(machine: Machine) -> Array:
    """Derivatives of `metres` over the point, (numbers,)."""
    by = {"c": machine.tractor.c.value, "d": machine.implement.d.value}
    return np.array([by.get(name, 1.0) for name in BY_LIKELIHOOD])
