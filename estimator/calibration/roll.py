"""Zeros and signs of the receivers' rolls: the same ground, driven over in other directions.

roll = zero + slope of the ground across + lean times lateral acceleration. The slope is that of a cell of the
ground, which does not care who drives over it and where to: driving there and back, or round in circles,
tells it from a zero. Both sides of turning tell the lean.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration.changes import BODY
from tilth.estimator.calibration.drive import DriveGrid
from tilth.estimator.calibration.initial_guess import Pairs
from tilth.estimator.calibration.least_squares import solve
from tilth.estimator.rig.residuals import roll_slopes
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GroundTuning:
    """The ground of a field and the lean of bodies, from rolls."""

    cell_m: float = tuned(40.0, "m", "of ground with one slope")
    every: int = tuned(5, "instants", "one row a second")
    zero_sd: float = tuned(np.radians(6.0), "rad", "prior of the zero of a roll")
    plane_sd: float = tuned(np.radians(6.0), "rad", "prior of the field's slope")
    cell_sd: float = tuned(np.radians(0.7), "rad", "by which a cell's slope differs from the plane")
    lean_sd: float = tuned(np.radians(1.5), "rad s^2/m", "of lean over lateral acceleration")
    floor: float = tuned(np.radians(0.1), "rad", "of what is left out")
    reversed: float = tuned(0.75, "1", "a fit with one sign turned that leaves less than this share is taken")


GROUND: Final = GroundTuning()


class Rolls(NamedTuple):
    """Receivers in the order of flow.Mount."""

    zero: Array  # rad, after the signs, (4,)
    sd: Array  # rad, (4,)
    sign: tuple[int, ...]
    lean: Array  # rad for each m/s^2 to the right, of both bodies, (2,)
    heard: tuple[bool, ...]
    signs_told: bool  # whether ground or turns were enough to tell a sign


def rolls(drive: DriveGrid, view: Pairs) -> Rolls:
    """Of a drive."""
    heard = tuple(bool(np.isfinite(drive.roll[:, k]).any()) for k in range(4))
    cells, rows = _cells(view)
    plain = _fit(drive, view, cells, rows, (1, 1, 1, 1))
    signs: tuple[int, ...] = (1, 1, 1, 1)
    best = plain
    for turned in range(4):
        trial = tuple(-1 if k == turned else 1 for k in range(4))
        found = _fit(drive, view, cells, rows, trial) if heard[turned] else plain
        if found[3] < GROUND.reversed * plain[3] and found[3] < best[3]:
            best, signs = found, trial
    told = plain[4] > 4.0 * GROUND.floor**2
    return Rolls(best[0], best[1], signs, best[2], heard, told)


def _cells(view: Pairs) -> tuple[Array, NDArray[np.bool_]]:
    """(number of the cell under each body, (n, 2); rows that are used, (n,))."""
    rows = view.known & (np.abs(view.along[:, 0]) > 0.5) & np.isfinite(view.middle).all((1, 2))
    rows &= np.arange(len(rows)) % GROUND.every == 0
    numbers = np.zeros((len(rows), 2))
    if np.any(rows):
        keys = np.floor(view.middle[rows] / GROUND.cell_m).astype(np.int64).reshape(-1, 2)
        _, found = np.unique(keys, axis=0, return_inverse=True)
        numbers[rows] = found.reshape(-1, 2)
    return numbers, rows


def _fit(
    drive: DriveGrid, view: Pairs, cells: Array, rows: NDArray[np.bool_], signs: tuple[int, ...]
) -> tuple[Array, Array, Array, float, float]:
    """(zeros (4,), sds (4,), leans (2,), mean square of what is left, mean square of rolls)."""
    count = int(cells.max()) + 1 if len(cells) else 1
    prior = np.concatenate(
        [np.full(4, GROUND.zero_sd), np.full(2, GROUND.lean_sd), np.full(2, GROUND.plane_sd)]
    )
    prior = np.concatenate([prior, np.full(2 * count, GROUND.cell_sd)])
    designs, observed, order = [], [], []
    for k in range(4):
        body = BODY[k]
        here = np.flatnonzero(rows & np.isfinite(drive.roll[:, k]) & np.isfinite(view.rate[:, body]))
        psi, cell = view.heading[here, body], cells[here, body].astype(np.int64)
        design = np.zeros((len(here), len(prior)))
        right = -np.sin(psi), np.cos(psi)
        design[:, [k, 4 + body]] = roll_slopes(view.along[here, body] * view.rate[here, body])
        for axis in range(2):
            design[:, 6 + axis] = right[axis]
            design[np.arange(len(here)), 8 + 2 * cell + axis] = right[axis]
        designs.append(design)
        observed.append(signs[k] * drive.roll[here, k])
        order.append(here)
    times = np.argsort(np.concatenate(order), kind="stable")
    values = np.concatenate(observed)[times]
    found = solve(np.concatenate(designs)[times], values, prior, GROUND.floor)
    left = values - np.concatenate(designs)[times] @ found.value
    swing = float(np.mean((values - values.mean()) ** 2)) if len(values) else 0.0
    return (
        found.value[:4],
        found.sds[:4],
        found.value[4:6],
        float(np.mean(left**2)) if len(left) else 0.0,
        swing,
    )
