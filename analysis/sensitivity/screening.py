"""Which inputs matter at all, for fewer points than Sobol' indices take: Morris's elementary effects, and the
bound by derivatives (DGSM).

Sources: Morris (1991), Technometrics 33, 161, with Campolongo's mean of sizes; Sobol' and Kucherenko (2009),
Mathematics and Computers in Simulation 79, 3009.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.sensitivity.inputs import Inputs, Outputs
from tilth.analysis.sensitivity.sobol import sobol_points

Array = NDArray[np.float64]

MORRIS_LEVELS: Final = 4


class Screening(NamedTuple):
    """Of Morris, each (k, m), by the unit of the output over the whole range of an input."""

    size: Array  # mean of the elementary effects' sizes
    spread: Array  # their standard deviation: large where an input acts otherwise at other points


def morris(outputs: Outputs, inputs: Inputs, *, paths: int = 32, seed: int = 1) -> Screening:
    """For inputs of a box. paths: each changes every input once, in random order. Paths with a point that has
    no answer are left out."""
    k = len(inputs.names)
    low, high = np.array(inputs.low), np.array(inputs.high)
    jump = MORRIS_LEVELS / (2 * (MORRIS_LEVELS - 1))
    rng = np.random.default_rng(seed)
    walked, orders = [], []
    for _ in range(paths):
        at = rng.integers(0, MORRIS_LEVELS // 2, k) / (MORRIS_LEVELS - 1)
        up = rng.random(k) < 0.5
        at = np.where(up, at, at + jump)
        order = rng.permutation(k)
        rows = [at.copy()]
        for j in order:
            at[j] += jump if up[j] else -jump
            rows.append(at.copy())
        walked.append(np.array(rows))
        orders.append((order, up))
    cube = np.concatenate(walked)
    answers = np.array(np.split(outputs(low + (high - low) * cube), paths))
    effects = np.full((paths, k, answers.shape[2]), np.nan)
    for path, (order, up) in enumerate(orders):
        if np.isfinite(answers[path]).all():
            steps = np.diff(answers[path], axis=0) / jump
            effects[path, order] = np.where(up[order], 1.0, -1.0)[:, None] * steps
    effects = effects[np.isfinite(effects).all(axis=(1, 2))]
    return Screening(np.abs(effects).mean(axis=0), effects.std(axis=0, ddof=1))


def dgsm(
    outputs: Outputs, inputs: Inputs, *, points: int = 256, step: float = 1e-4, seed: int = 1
) -> tuple[Array, Array]:
    """(upper bound of the total index, mean square of the derivative by the share of the range), each (k, m).

    For inputs of a box: T <= nu / (pi^2 V). Points near the upper end are stepped down from.
    """
    k = len(inputs.names)
    low, high = np.array(inputs.low), np.array(inputs.high)
    cube = sobol_points(k, points, np.random.default_rng(seed))
    groups = [cube]
    for j in range(k):
        moved = cube.copy()
        moved[:, j] += np.where(cube[:, j] < 0.5, step, -step)
        groups.append(moved)
    parts = np.array(np.split(outputs(low + (high - low) * np.concatenate(groups)), k + 1))
    parts = parts[:, np.isfinite(parts).all(axis=(0, 2))]
    squares = (((parts[1:] - parts[0]) / step) ** 2).mean(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return squares / (np.pi**2 * parts[0].var(axis=0)), squares
