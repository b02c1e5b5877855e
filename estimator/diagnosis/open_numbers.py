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
from tilth.estimator.tuning import tuned
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

OPEN: Final = sorted((row for row in NUMBERS if row.open_sd), key=lambda row: AT[row.name])
"""Numbers of the rig that are left open."""
NAMES: Final = names(OPEN)
OF_PAIRS: Final = names(row for row in OPEN if row.in_rows and row.place)


@dataclass(frozen=True, slots=True)
class OpenNumberTuning:
    """When a gross error is ruled out."""

    certain: float = tuned(2.33, "sd", "by which data must be off each gross error: one in a hundred passes")


OPEN_NUMBERS: Final = OpenNumberTuning()


class Misfit(NamedTuple):
    """Difference between what the open tracker finds and the file. Arrays in the order of OPEN."""

    total: float  # chi-square of all open numbers, len(NAMES) degrees of freedom
    by_name: Array  # [n]; decrease of `total` if this number alone is freed
    off: Array  # [n]; result minus the file's value, in the unit of each
    sd: Array  # [n]; of the result
    alone: Array  # [n]; sd of the difference if all other numbers are right, with the error that is allowed


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
    """off: [n], what is found minus what the file says. covariance: [n, n], of that."""
    inverse = np.linalg.inv(covariance + np.diag(allowed(machine) ** 2))
    solved = inverse @ off
    precision = np.diag(inverse)
    return Misfit(
        float(off @ solved),
        solved**2 / precision,
        off,
        np.sqrt(np.diag(covariance)),
        1.0 / np.sqrt(precision),
    )


@once_for_a_machine
def allowed(machine: Machine) -> Array:
    """Sd by which a right file may differ from the result, [n] in the order of OPEN."""
    _, stated = unknowns.prior(machine)
    out = np.array([math.hypot(stated[AT[row.name]], row.allowed_sd) for row in OPEN])
    for k, row in enumerate(OPEN):
        if row.cg_of:
            length = 1.0 if row.value is None else row.value(machine)
            out[k] = math.hypot(out[k], getattr(machine, row.cg_of).cg_sd / length)
    return out


def unconfirmed(now: Misfit, machine: Machine) -> list[str]:
    """The names of which a gross error would not show yet, the largest sd relative to its limit first."""
    ratio: dict[str, float] = {}
    for k, row in enumerate(OPEN):
        if not row.confirming_sd:
            continue
        ratio[row.name] = float(now.sd[k]) / row.confirming_sd
        if row.gross:
            size = math.log1p(row.gross / (1.0 if row.value is None else row.value(machine)))
            off = size / float(now.alone[k]) - math.sqrt(float(now.by_name[k]))
            ratio[row.name] = max(ratio[row.name], OPEN_NUMBERS.certain / max(off, 1e-3))
    return sorted((name for name, excess in ratio.items() if excess > 1.0), key=lambda name: -ratio[name])
