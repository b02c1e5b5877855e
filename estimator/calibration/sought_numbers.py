"""Priors as wide as people are wrong, over unknowns.NAMES, and the numbers that calibration gives."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.rig.numbers import NUMBER, NUMBERS
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

SOUGHT: Final = tuple(number for number in NUMBERS if number.prior_sd)
"""Numbers that a drive can tell."""
_IN_FIT: Final = {
    number.name: AT[number.unknown or number.name]
    for number in SOUGHT
    if (number.unknown or number.name) in AT and not number.name.startswith("roll_zero")
}
BY_LIKELIHOOD: Final = tuple(name for name in _IN_FIT if name in AT)
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
    sd[[AT["e"], AT["cg_t"], AT["cg_i"]]] = 0.0
    for name, k in _IN_FIT.items():
        number = NUMBER[name]
        sd[k] = number.prior_sd / (1.0 if number.value is None else number.value(machine))
    sd[AT["aside_i"]] *= math.sqrt(2.0)  # relative to the tractor's
    known = np.isfinite(roll_zero_sd) & (sd[unknowns.AT_ROLL_ZERO : unknowns.AT_ROLL_ZERO + 4] > 0.0)
    sd[unknowns.AT_ROLL_ZERO : unknowns.AT_ROLL_ZERO + 4] = np.where(known, roll_zero_sd, 0.0)
    return mean, sd


def metres(machine: Machine, point: Array) -> Array:
    """BY_LIKELIHOOD at a point [n] in SI: c and d as metres more than the file says."""
    found = point[[AT[name] for name in BY_LIKELIHOOD]].copy()
    for k, number in enumerate(NUMBER[name] for name in BY_LIKELIHOOD):
        if number.value is not None:
            found[k] = number.value(machine) * math.expm1(found[k])
    return found


def slopes(machine: Machine) -> Array:
    """Derivatives of `metres` over the point, (numbers,)."""
    rows = (NUMBER[name] for name in BY_LIKELIHOOD)
    return np.array([1.0 if row.value is None else row.value(machine) for row in rows])
