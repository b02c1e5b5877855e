"""Whether soil differed along the way of one window: its fit, piece by piece.

The fit has one value of each of the six for the whole way. Where the soil was otherwise in a piece of it, the
innovations there, along the slopes by the six, ask for other values than those elsewhere (the score test for
parameters that vary: Nyblom 1989). How likely that is by each hypothesis of how soil differs is known after
the first window, when nothing can be compared with it yet. Told are the values of the pieces beside each
other: where all of them are together is told by the window as a whole.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from tilth.estimator.filters.likelihood import Iterate, Search
from tilth.estimator.filters.soil_field import SOIL_FIELD, VARIOGRAMS, SoilMemory, SoilWindow, Told
from tilth.estimator.filters.states import DT
from tilth.estimator.record.record import PSI, TICK, Record, U
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SoilWithinTuning:
    """What else may make pieces of a way differ."""

    noise: tuple[float, ...] = tuned(
        (1.0, 1.4, 2.0, 2.8), "1", "factors on the sds of pieces by noise, each as likely as the others"
    )
    """What the ground does over seconds is more, or less, than its model has: of a chirp over 2 cm the pieces
    scattered three times as far, which is not as soil differs."""
    zones: float = tuned(
        0.1, "1", "probability that one window lies in one zone of a field that differs from zone to zone"
    )
    """Patches go on everywhere; a wet end does not. So one window alone never makes one soil ten times as
    likely beside them."""


SOIL_WITHIN: Final = SoilWithinTuning()
_ALIKE: Final = np.array([one.sd == min(SOIL_FIELD.sds) for one in VARIOGRAMS])


class Pieces(NamedTuple):
    """What p pieces of a window's way tell at the end of its fit, all but the six as it has found them."""

    gradient: Array  # (p, 6), of the log-likelihood
    information: Array  # (p, 6, 6)
    ways: Array  # (p, SOIL_FIELD.points, 3, 2), of the axles, m, from where the window began


def pieces_of(search: Search, left: Iterate) -> Pieces:
    """Pieces of the shortest length over which soil may be alike. left: as `likelihood.apart_from_ground`."""
    record, six = search.record, search.active < 6
    metres = np.cumsum(np.abs(record.ticks[:, U])) * DT
    count = max(int(metres[-1] / min(SOIL_FIELD.lengths_m)), 1)
    of_tick = np.minimum((metres / max(metres[-1], DT) * count).astype(np.int64), count - 1)
    of_row = of_tick[record.rows[:, TICK].astype(np.int64)]
    slopes = left.de[six] * (search.scored / np.sqrt(left.S))
    told, at = slopes * (left.e / np.sqrt(left.S)), search.active[six]
    gradient, information = np.zeros((count, 6)), np.zeros((count, 6, 6))
    for k in range(count):
        inside = of_row == k
        gradient[k, at] = -told[:, inside].sum(axis=1)
        information[k][np.ix_(at, at)] = slopes[:, inside] @ slopes[:, inside].T
    way = _way(record, search.setup.geometry)
    ticks = [np.flatnonzero(of_tick == k) for k in range(count)]
    shown = [t[np.linspace(0, len(t) - 1, SOIL_FIELD.points).round().astype(np.int64)] for t in ticks]
    return Pieces(gradient, information, way[np.array(shown)])


def _way(record: Record, geometry: Array) -> Array:
    """Of the axles at each tick, (n, 3, 2), m. geometry: as of RigSetup."""
    a, b, c, d, e = geometry[:5]
    ahead, behind = (np.column_stack([np.cos(psi), np.sin(psi)]) for psi in record.ticks[:, PSI : PSI + 2].T)
    cg = np.cumsum(record.ticks[:, U, None] * ahead * DT, axis=0)
    return np.stack([cg + a * ahead, cg - b * ahead, cg - c * ahead - (d + e) * behind], axis=1)


def likelihoods(pieces: Pieces, wider: Array, prior_sd: Array) -> Array:
    """Logarithm of the likelihood of what the pieces tell beside each other by each of VARIOGRAMS, the
    largest 0, (v,), whatever the noise, and though all may lie in one zone. wider: factors on the sds of the
    six by noise, (6,). prior_sd: of the machine file, (n,)."""
    by_noise = [
        SoilMemory(_windows(pieces, factor * wider), prior_sd).log_likelihoods for factor in SOIL_WITHIN.noise
    ]
    found = np.asarray(logsumexp(by_noise, axis=0), np.float64)
    in_one_zone = logsumexp(found[_ALIKE]) - math.log(np.sum(_ALIKE))
    found = np.logaddexp(found + math.log1p(-SOIL_WITHIN.zones), in_one_zone + math.log(SOIL_WITHIN.zones))
    return np.asarray(found - found.max(), np.float64)


def _windows(pieces: Pieces, wider: Array) -> list[SoilWindow]:
    windows = list[SoilWindow]()
    for k, (gradient, information, way) in enumerate(zip(*pieces, strict=True)):
        found = np.linalg.pinv(information, hermitian=True) @ gradient
        counted = information / np.outer(wider, wider)
        windows.append(SoilWindow("", k, 0, way, Told(counted, counted @ found, np.zeros(6))))
    return windows
