"""Whether soil differed along the way of one window: its fit, piece by piece.

The fit has one value of each of the six for the whole way. Where the soil was otherwise in a piece of it, the
innovations there, along the slopes by the six, ask for other values than those elsewhere (the score test for
parameters that vary: Nyblom 1989). So whether this is a field in patches is told by the first window, when
nothing can be compared with it yet. Told are the values of the pieces beside each
other: where all of them are together is told by the window as a whole.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.likelihood import Iterate, Search
from tilth.estimator.filters.soil_field import SOIL_FIELD, VARIOGRAMS, SoilMemory, SoilWindow, Told, smooth
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
    extent_m: float = tuned(60.0, "m", "between two places of a way, from which on it tells of patches")
    """Places of a headland turn are within some 30 m of each other, where soil is smoother than by any
    hypothesis: ten turns in patches of 26 % over 48 m told 0.5 nats for one soil each."""


SOIL_WITHIN: Final = SoilWithinTuning()
_SMOOTH: Final = tuple(one._replace(correlation=smooth) for one in VARIOGRAMS)


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


def for_patches(pieces: Pieces, wider: Array, prior_sd: Array) -> float:
    """Nats by which patches explain what the pieces tell beside each other better than one soil, whatever the
    noise; 0 for a short way. wider: factors on the sds of the six by noise, (6,). prior_sd: of the machine
    file, (n,)."""
    middles = pieces.ways.mean(axis=(1, 2))
    if np.linalg.norm(middles[:, None] - middles, axis=-1).max() < SOIL_WITHIN.extent_m:
        return 0.0
    by_noise = [
        SoilMemory(_windows(pieces, factor * wider), prior_sd, _SMOOTH, (0.0,)).for_patches
        for factor in SOIL_WITHIN.noise
    ]
    patches, alike = np.logaddexp.reduce(by_noise, axis=0).tolist()
    return float(patches - alike)


def _windows(pieces: Pieces, wider: Array) -> list[SoilWindow]:
    windows = list[SoilWindow]()
    for k, (gradient, information, way) in enumerate(zip(*pieces, strict=True)):
        found = np.linalg.pinv(information, hermitian=True) @ gradient
        counted = information / np.outer(wider, wider)
        windows.append(SoilWindow("", k, 0, way, Told(counted, counted @ found, np.zeros(6))))
    return windows
