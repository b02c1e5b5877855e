"""How much of an output's variance each input makes: Sobol' indices with intervals.

Sources: Saltelli et al. (2010), Computer Physics Communications 181, 259, for the first-order index; Jansen
(1999), ibid. 117, 35, for the total one; Kucherenko, Tarantola and Annoni (2012), ibid. 183, 937, for inputs
that are correlated.

Points are scrambled Sobol' sequences. Intervals are of Student's t over independent scrambles.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from tilth.analysis.sensitivity.inputs import Inputs, Outputs

Array = NDArray[np.float64]

SCRAMBLES: Final = 16
POINTS: Final = 64  # of each scramble, a power of two
_INSIDE: Final = 1e-9  # of the unit interval: a normal score is finite


def sobol_points(k: int, points: int, rng: np.random.Generator) -> Array:
    """Points of the unit cube of k dimensions, (points, k), scrambled."""
    from scipy.stats import qmc  # importing it takes half a second, so only where it is needed

    return np.asarray(qmc.Sobol(k, rng=rng).random(points))


class SobolIndices(NamedTuple):
    """Each (k, m): of inputs and outputs. For inputs that are correlated the first-order index holds what an
    input shares with others, the total one only what it has alone; it may then be the smaller."""

    first: Array
    first_half: Array  # half of the 95 % interval
    total: Array
    total_half: Array
    lost: float  # share of points whose row, or one that it is compared with, has no answer
    each: Array  # (scrambles, 2, k, m): first order and total of each scramble

    def of_mean(self, columns: Sequence[int]) -> "SobolIndices":
        """Each (k, 1): of some outputs together, the mean of their indices. Those that do not vary are left
        out."""
        chosen = self.each[..., list(columns)]
        chosen = chosen[..., np.isfinite(chosen).all(axis=(0, 1, 2))]
        together = (
            chosen.mean(axis=-1, keepdims=True)
            if chosen.shape[-1]
            else np.full_like(self.each[..., :1], np.nan)
        )
        return _with_intervals(together, self.lost)


def sobol(
    outputs: Outputs, inputs: Inputs, *, points: int = POINTS, scrambles: int = SCRAMBLES, seed: int = 1
) -> SobolIndices:
    """points: of each scramble, a power of two."""
    found, lost = [], 0.0
    k = len(inputs.names)
    for scramble in range(scrambles):
        cube = sobol_points(2 * k, points, np.random.default_rng((seed, scramble)))
        scores = ndtri(np.clip(cube, _INSIDE, 1.0 - _INSIDE))
        groups = _groups(scores[:, :k], scores[:, k:], inputs)
        answers = outputs(inputs.of_scores(np.concatenate(groups)))
        parts = np.array(np.split(answers, len(groups)))  # (groups, points, m)
        good = np.isfinite(parts).all(axis=(0, 2))
        lost += float(1.0 - good.mean()) / scrambles
        found.append(_indices(parts[:, good], k, correlated=inputs.correlation is not None))
    return _with_intervals(np.array(found), lost)


def _with_intervals(every: Array, lost: float) -> SobolIndices:
    count = len(every)
    value = np.mean(every, axis=0)
    half = float(stdtrit(count - 1, 0.975)) * np.std(every, axis=0, ddof=1) / np.sqrt(count)
    return SobolIndices(value[0], half[0], value[1], half[1], lost, every)


def _groups(a: Array, b: Array, inputs: Inputs) -> list[Array]:
    """Scores: A, B, then of each input A with that one new; of correlated ones also those with only that one
    kept."""
    if inputs.correlation is None:
        mixed = []
        for k in range(a.shape[1]):
            one = a.copy()
            one[:, k] = b[:, k]
            mixed.append(one)
        return [a, b, *mixed]
    correlation = np.array(inputs.correlation)
    root = np.linalg.cholesky(correlation)
    base, other = a @ root.T, b @ root.T
    changed, kept = [], []
    for k in range(a.shape[1]):
        rest = [j for j in range(a.shape[1]) if j != k]
        # z_k given the others, and the others given z_k: of a joint normal distribution.
        weights = np.linalg.solve(correlation[np.ix_(rest, rest)], correlation[rest, k])
        sd = np.sqrt(1.0 - correlation[k, rest] @ weights)
        one = base.copy()
        one[:, k] = base[:, rest] @ weights + sd * b[:, k]
        changed.append(one)
        spread = correlation[np.ix_(rest, rest)] - np.outer(correlation[rest, k], correlation[rest, k])
        two = base.copy()
        two[:, rest] = np.outer(base[:, k], correlation[rest, k]) + b[:, rest] @ np.linalg.cholesky(spread).T
        kept.append(two)
    return [base, other, *changed, *kept]


def _indices(parts: Array, k: int, *, correlated: bool) -> Array:
    """(2, k, m): first order and total."""
    a, b, changed = parts[0], parts[1], parts[2 : 2 + k]
    middle = (a.mean(axis=0) + b.mean(axis=0)) / 2  # centred, so that products do not cancel
    a, b, changed = a - middle, b - middle, changed - middle
    variance = (a**2 + b**2).mean(axis=0) / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        total = ((a - changed) ** 2).mean(axis=1) / (2 * variance)
        if correlated:
            kept = parts[2 + k :] - middle
            first = (a * (kept - b)).mean(axis=1) / variance
        else:
            first = (b * (changed - a)).mean(axis=1) / variance
    return np.stack([first, total])
