"""What the open tracker finds of the numbers that it leaves open, against what a machine file says of them.

The tracker itself is a method (methods/open_tracker.py); the fold hands its evidence in.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.once import once_for_a_machine
from tilth.estimator.rig.numbers import NUMBER, NUMBERS, names
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

OPEN: Final = sorted((row for row in NUMBERS if row.open_sd), key=lambda row: AT[row.name])
"""Numbers of the rig that are left open."""
NAMES: Final = names(OPEN)
OF_PAIRS: Final = names(row for row in OPEN if row.in_rows and row.place)

HYPOTHESES: Final = (*OPEN, NUMBER["I_t"])
"""What may be wrong in a file, each alone. The last is the tractor's mass, with the row of its inertia: it
cannot be left open, since motion shows forces over it, and is seen as other inertias."""
_INERTIAL: Final = ("m_i", "I_t", "I_i")
_FOUND_OFF: Final = np.column_stack([np.eye(len(NAMES)), [-1.0 * (name in _INERTIAL) for name in NAMES]])
"""[n, n + 1]: how far off the open tracker finds the numbers, by an error of each of HYPOTHESES. Where a
tractor is heavier than its file says, its inertia and what is behind it look smaller, ..."""
_STIFFNESSES: Final = np.array([1.0 * (name in ("C_af", "C_ar", "C_ai")) for name in PARAMETERS])
"""... and all tyres are stiffer than they are learned: by the same logarithm."""


_ALLOWED, _FIT_SD = (np.array([getattr(row, of) for row in OPEN]) for of in ("allowed_sd", "fit_sd"))
BY_FIT: Final = np.array([row.fit_sd > 0.0 for row in HYPOTHESES])
"""[n + 1]: of HYPOTHESES, of which a fit is believed."""


@dataclass(frozen=True, slots=True)
class Misfit:
    """Difference between what the open tracker finds and the file. Arrays by OPEN or HYPOTHESES."""

    total: float  # chi-square of all open numbers, len(NAMES) degrees of freedom
    off: Array  # [n]; result minus the file's value, in the unit of each
    sd: Array  # [n]; of the result
    found: Array  # [n + 1]; error of each of HYPOTHESES if it alone is wrong
    alone: Array  # [n + 1]; sd of that, with the error that is allowed
    moves: Array  # [6, n + 1]; true less learned logarithms, by such an error of the file that is believed

    @property
    def by_name(self) -> Array:
        """[n]; decrease of `total` if this number alone is freed."""
        return (self.found / self.alone)[: len(NAMES)] ** 2


@dataclass(frozen=True, slots=True)
class OpenEvidence:
    """Of the open tracker at one pose."""

    misfit: Misfit
    at_first: Misfit  # before it has learned
    learned: int  # segments from which it has learned
    rejected: float  # share of outliers among the rows of its last segments; 0 before there are enough
    rough: bool  # the ground is so uneven that what it finds may be a divergence
    uneven: float = 0.0  # how far it is from even (0) to that (1)

    def restarted(self) -> "OpenEvidence":
        """As if it had begun anew."""
        return replace(self, misfit=self.at_first, learned=0, rejected=0.0)


def misfit_of(
    off: Array, covariance: Array, believing: Array, machine: Machine, of_fit: bool = False
) -> Misfit:
    """off: [n], what is found minus what the file says. covariance: [6 + n, 6 + n], of the six logarithms and
    of what is found; believing: the same where the file's numbers are believed as far as it says. of_fit: it
    is found by a fit of whole windows."""
    own, apart = covariance[6:, 6:], allowed(machine)
    if of_fit:
        apart = np.sqrt(apart**2 + np.where(BY_FIT[:-1], _FIT_SD**2 - _ALLOWED**2, 0.0))
    inverse = np.linalg.inv(own + np.diag(apart**2))
    solved = inverse @ off
    precision = np.einsum("ik,ij,jk->k", _FOUND_OFF, inverse, _FOUND_OFF)
    moves = _slopes(covariance, believing, _stated(machine)) @ _FOUND_OFF
    moves[:, -1] += _STIFFNESSES
    return Misfit(
        float(off @ solved), off, np.sqrt(np.diag(own)), solved @ _FOUND_OFF / precision,
        1.0 / np.sqrt(precision), moves,
    )  # fmt: skip


def _slopes(covariance: Array, believing: Array, stated: Array) -> Array:
    """[6, n]: what errors of the file make of the six where it is believed.

    A posterior's mean moves by covariance over prior variance with its prior's mean. Slopes of the open
    tracker itself are too small where a length is wrong (C_ai by implement.d to an eighth, by e to a third):
    it forgets what it has learned, and in its free state a wrong length looks like motion. They stand for
    what a method does not have as an unknown, masses above all.
    """
    slopes = covariance[:6, 6:] @ np.linalg.inv(covariance[6:, 6:] + np.diag(stated**2))
    unknown = np.diag(believing)[6:] > 0.0
    slopes[:, unknown] = believing[:6, 6:][:, unknown] / stated[unknown] ** 2
    return np.asarray(slopes, np.float64)


@once_for_a_machine
def _stated(machine: Machine) -> Array:
    """Sds that the file gives, [n] in the order of OPEN: the methods have these."""
    return unknowns.prior(machine)[1][[AT[name] for name in NAMES]]


@once_for_a_machine
def allowed(machine: Machine) -> Array:
    """Sd by which a right file may differ from the result, [n] in the order of OPEN."""
    out: Array = np.hypot(_stated(machine), _ALLOWED)
    for k, row in enumerate(OPEN):
        if row.cg_of:
            length = 1.0 if row.value is None else row.value(machine)
            out[k] = math.hypot(out[k], getattr(machine, row.cg_of).cg_sd / length)
    return out
