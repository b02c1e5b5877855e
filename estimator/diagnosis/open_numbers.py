"""What the open tracker finds of the numbers that it leaves open, against what a machine file says of them.

The tracker itself is a method (methods/open_tracker.py); the fold hands its evidence in.
"""

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.once import once_for_a_machine
from tilth.estimator.rig.numbers import NUMBERS, names
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

OPEN: Final = sorted((row for row in NUMBERS if row.open_sd), key=lambda row: AT[row.name])
"""Numbers of the rig that are left open."""
NAMES: Final = names(OPEN)
OF_PAIRS: Final = names(row for row in OPEN if row.in_rows and row.place)


class Misfit(NamedTuple):
    """Difference between what the open tracker finds and the file. Arrays in the order of OPEN."""

    total: float  # chi-square of all open numbers, len(NAMES) degrees of freedom
    by_name: Array  # [n]; decrease of `total` if this number alone is freed
    off: Array  # [n]; result minus the file's value, in the unit of each
    sd: Array  # [n]; of the result
    found: Array  # [n]; error of each number if it alone is wrong
    alone: Array  # [n]; sd of that, with the error that is allowed
    moves: Array  # [6, n]; of the six logarithms, learned with the file's values, by an error of each number


@dataclass(frozen=True, slots=True)
class OpenEvidence:
    """Of the open tracker at one pose."""

    misfit: Misfit
    at_first: Misfit  # before it has learned
    learned: int  # segments from which it has learned
    rejected: float  # share of outliers among the rows of its last segments; 0 before there are enough
    rough: bool  # the ground is so uneven that what it finds may be a divergence

    def restarted(self) -> "OpenEvidence":
        """As if it had begun anew."""
        return replace(self, misfit=self.at_first, learned=0, rejected=0.0)


def misfit_of(off: Array, covariance: Array, machine: Machine) -> Misfit:
    """off: [n], what is found minus what the file says. covariance: [6 + n, 6 + n], of the six logarithms and
    of what is found."""
    own = covariance[6:, 6:]
    inverse = np.linalg.inv(own + np.diag(allowed(machine) ** 2))
    solved = inverse @ off
    precision = np.diag(inverse)
    return Misfit(
        float(off @ solved),
        solved**2 / precision,
        off,
        np.sqrt(np.diag(own)),
        solved / precision,
        1.0 / np.sqrt(precision),
        covariance[:6, 6:] @ np.linalg.inv(own + np.diag(_stated(machine) ** 2)),
    )


def _stated(machine: Machine) -> Array:
    """Sds that the file gives, [n] in the order of OPEN: the methods have these."""
    return unknowns.prior(machine)[1][[AT[name] for name in NAMES]]


@once_for_a_machine
def allowed(machine: Machine) -> Array:
    """Sd by which a right file may differ from the result, [n] in the order of OPEN."""
    out = np.hypot(_stated(machine), [row.allowed_sd for row in OPEN])
    for k, row in enumerate(OPEN):
        if row.cg_of:
            length = 1.0 if row.value is None else row.value(machine)
            out[k] = math.hypot(out[k], getattr(machine, row.cg_of).cg_sd / length)
    return out
