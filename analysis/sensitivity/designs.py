"""Points at which a rig is asked, each from its index by arithmetic: a worker needs two integers.

A seed is that of the design and of the block that the point lies in, so that a point does not depend on how
the work is shared out.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tilth.analysis.sensitivity.answers import DesignAnswer

Array = NDArray[np.float64]

BLOCK: Final = 1024  # points drawn from one seed


class ParameterBox(NamedTuple):
    """A range of each parameter, SI; all above zero."""

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


DISSERTATION: Final = ParameterBox(
    ("C_af", "C_ar", "C_ai", "sigma_f", "sigma_r", "sigma_i", "m_i", "I_i"),
    (20e3, 50e3, 10e3, 0.1, 0.15, 0.1, 1100.0, 3200.0),
    (450e3, 980e3, 340e3, 2.2, 3.0, 2.2, 7000.0, 21000.0),
)
"""Karkee (2009), table 6.2."""
LEVELS: Final = 5


def checked(box: ParameterBox) -> ParameterBox:
    """The same box. Raises ValueError, one sentence, where a range is empty or not above zero."""
    for name, low, high in zip(*box, strict=True):
        if not 0 < low < high < float("inf"):
            raise ValueError(
                f"{name}: from {low:g} to {high:g}; give a range above zero, the lower end first"
            )
    return box


def grid_size(box: ParameterBox, levels: int = LEVELS) -> int:
    """Points of the full grid."""
    return int(levels ** len(box.names))


def grid_levels(box: ParameterBox, start: int, stop: int, levels: int = LEVELS) -> NDArray[np.int64]:
    """Level of each parameter at the points start to stop - 1, (n, k); the last changes fastest."""
    shape = (levels,) * len(box.names)
    return np.stack(np.unravel_index(np.arange(start, stop), shape), axis=1).astype(np.int64)


def grid(box: ParameterBox, start: int, stop: int, levels: int = LEVELS) -> Array:
    """Points start to stop - 1 of the grid, (n, k)."""
    low, high = np.array(box.low), np.array(box.high)
    return np.asarray(low + (high - low) * grid_levels(box, start, stop, levels) / (levels - 1))


def uniform(box: ParameterBox, seed: int, start: int, stop: int) -> Array:
    """Random points of the box, (n, k)."""
    low, high = np.array(box.low), np.array(box.high)
    return np.asarray(low + (high - low) * _by_block(seed, start, stop, len(low), normal=False))


def log_normal(median: Sequence[float], log_covariance: Array, seed: int, start: int, stop: int) -> Array:
    """Correlated random points above zero, (n, k). log_covariance: (k, k), of the natural logarithms.

    Raises ValueError where that is not positive definite.
    """
    covariance = np.asarray(log_covariance, dtype=np.float64)
    try:
        if not np.allclose(covariance, covariance.T):
            raise np.linalg.LinAlgError
        root = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        raise ValueError("the covariance is not positive definite; give one that is") from None
    drawn = _by_block(seed, start, stop, len(root), normal=True)
    return np.asarray(np.array(median) * np.exp(drawn @ root.T))


class Grid(NamedTuple):
    """All points of a grid over a box."""

    box: ParameterBox
    levels: int = LEVELS

    @property
    def names(self) -> tuple[str, ...]:
        return self.box.names

    @property
    def size(self) -> int:
        """Points."""
        return grid_size(self.box, self.levels)

    def points(self, start: int, stop: int) -> Array:
        """Those from start to stop - 1, (n, k)."""
        return grid(self.box, start, stop, self.levels)

    def levels_of(self, start: int, stop: int) -> NDArray[np.int64]:
        """In which part of its range each parameter of these points lies, (n, k)."""
        return grid_levels(self.box, start, stop, self.levels)


class Uniform(NamedTuple):
    """Random points of a box, each as likely as another."""

    box: ParameterBox
    size: int
    seed: int = 1
    levels: int = LEVELS

    @property
    def names(self) -> tuple[str, ...]:
        return self.box.names

    def points(self, start: int, stop: int) -> Array:
        """Those from start to stop - 1, (n, k)."""
        return uniform(self.box, self.seed, start, stop)

    def levels_of(self, start: int, stop: int) -> NDArray[np.int64]:
        """In which part of its range each parameter of these points lies, (n, k)."""
        low, high = np.array(self.box.low), np.array(self.box.high)
        parts = (self.points(start, stop) - low) / (high - low) * self.levels
        return _whole(parts, self.levels)


class LogNormal(NamedTuple):
    """Random points as a covariance of logarithms has them; a level holds as many as another."""

    names: tuple[str, ...]
    median: tuple[float, ...]
    log_covariance: tuple[tuple[float, ...], ...]
    size: int
    seed: int = 1
    levels: int = LEVELS

    def points(self, start: int, stop: int) -> Array:
        """Those from start to stop - 1, (n, k)."""
        return log_normal(self.median, np.array(self.log_covariance), self.seed, start, stop)

    def levels_of(self, start: int, stop: int) -> NDArray[np.int64]:
        """In which part of its distribution each parameter of these points lies, (n, k)."""
        sds = np.sqrt(np.diag(np.array(self.log_covariance)))
        scores = np.log(self.points(start, stop) / np.array(self.median)) / sds
        return _whole(ndtr(scores) * self.levels, self.levels)


Design = Grid | Uniform | LogNormal


def _whole(parts: Array, levels: int) -> NDArray[np.int64]:
    return np.clip(parts.astype(np.int64), 0, levels - 1).astype(np.int64)


def _by_block(seed: int, start: int, stop: int, k: int, *, normal: bool) -> Array:
    drawn = []
    first = start // BLOCK
    for block in range(first, -(-stop // BLOCK)):
        rng = np.random.default_rng((seed, block))
        drawn.append(rng.standard_normal((BLOCK, k)) if normal else rng.random((BLOCK, k)))
    if not drawn:
        return np.zeros((0, k))
    return np.concatenate(drawn)[start - first * BLOCK : stop - first * BLOCK]


def described(design: Design) -> DesignAnswer:
    """For JSON and people: what rigs these are."""
    if isinstance(design, LogNormal):
        what = f"{design.size} random rigs, by the covariance of a log's estimates"
        return {"what": what, "names": list(design.names), "points": design.size}
    what = (
        f"a grid of {design.levels} values of each of {len(design.names)} parameters"
        if isinstance(design, Grid)
        else f"{design.size} random rigs of the box"
    )
    return {
        "what": what,
        "names": list(design.names),
        "points": design.size,
        "low": list(design.box.low),
        "high": list(design.box.high),
    }
