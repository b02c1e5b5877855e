"""Random numbers of a simulated run: independent streams for each purpose, and coloured noise."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DRAWN_LIMIT: Final = 1.5  # sd: a latency of 0.1 s with an sd of 0.05 s stays within a StarFire's 0.2 s
BLOCK: Final = 256

# Streams: what a generator is for. `receivers` and `common` take one number more.
(PARAMETERS, STEERING, SPEED, NUISANCES, RECEIVERS, WHEEL, COMMON, OTHERS, GEOMETRY, GROUND, SOIL, BELIEF,
 DROP_OUT, SPATIAL, ROLL, WHEEL_SPEED, FLEET, FLEET_FILE, AUTOSTEER, BASE) = range(1, 21)  # fmt: skip


def generator(seed: int, *stream: int) -> np.random.Generator:
    """An independent generator for each purpose, so that one option does not change another's draws."""
    return np.random.default_rng([seed, *stream])


def within(rng: np.random.Generator, n: int) -> Array:
    """Standard normal draws, none beyond DRAWN_LIMIT, shape (n,)."""
    return np.clip(rng.standard_normal(n), -DRAWN_LIMIT, DRAWN_LIMIT)


def gauss_markov(rng: np.random.Generator, sd: float, correlation_s: float, step_s: float, n: int) -> Array:
    """A first-order Gauss-Markov series of that sd and correlation time, shape (n,)."""
    keep = float(np.exp(-step_s / correlation_s))
    series: Array = rng.normal(0.0, sd * np.sqrt(1.0 - keep**2), n)
    # x[k] = keep x[k - 1] + w[k], a block at a time: its own w, and what is left of the block before.
    ages = np.subtract.outer(np.arange(BLOCK), np.arange(BLOCK))
    response = np.where(ages >= 0, keep ** np.maximum(ages, 0), 0.0)
    carried_over = rng.normal(0.0, sd)
    for start in range(0, n, BLOCK):
        block = series[start : start + BLOCK]
        m = len(block)
        block[:] = response[:m, :m] @ block + keep ** np.arange(1, m + 1) * carried_over
        carried_over = block[-1]
    return series
