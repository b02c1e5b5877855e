"""What an estimate leaves over of each kind of measurement, against the noise that the file states."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.unknowns import AT
from tilth.estimator.record.record import EAST, HEADING, NORTH, ROLL_ANGLE, VELOCITY, YAW_RATE
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ResidualTuning:
    """When what is left over is told."""

    more: float = tuned(1.5, "1", "times the stated noise, from which on it is said")
    fewest: int = tuned(50, "measurements", "or nothing is said")


RESIDUALS: Final = ResidualTuning()


@dataclass(frozen=True, slots=True)
class MeasuredKind:
    """A row of what is left."""

    name: str
    words: str
    kinds: tuple[int, ...]  # of rows of a record
    level: str  # the unknown that is the logarithm of their noise over the file's
    why: str  # where more is left than expected, what to look at


KINDS: Final = (
    MeasuredKind("position", "positions", (NORTH, EAST), "s_position",
                 "RTK comes and goes, or an antenna or its bracket moves"),
    MeasuredKind("heading", "headings", (HEADING,), "s_position",
                 "an antenna or its bracket moves, or a receiver smooths its positions"),
    MeasuredKind("velocity", "speeds sideways", (VELOCITY,), "s_velocity",
                 "a receiver smooths its speed, or its velocity_sd in the file is too small"),
    MeasuredKind("yaw_rate", "turn rates", (YAW_RATE,), "s_yaw_rate",
                 "a receiver is shaken or smooths, or its yaw_rate_sd in the file is too small"),
    MeasuredKind("roll", "rolls", (ROLL_ANGLE,), "s_roll",
                 "a receiver is shaken, or its roll_sd in the file is too small"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class KindResiduals:
    """Of one kind. ratio: what is left over the noise that the file states; 1 is what is expected."""

    kind: MeasuredKind
    ratio: float
    count: int

    @property
    def more(self) -> bool:
        return self.ratio > RESIDUALS.more

    @property
    def words(self) -> str:
        """For a mechanic."""
        if not self.more:
            return "as expected"
        return f"more than expected, {self.ratio:.1f} times: {self.kind.why}"


def residuals(squares: Mapping[int, tuple[float, int]], point: Array) -> tuple[KindResiduals, ...]:
    """squares: kind of a row -> sum and number of its squared innovations over their variances.

    point: [n], where they were taken. A fit finds the noise itself, and innovations over it are about 1
    whatever it is; so what it has found counts along.
    """
    found = list[KindResiduals]()
    for kind in KINDS:
        have = [squares[one] for one in kind.kinds if one in squares]
        count = sum(n for _, n in have)
        if count >= RESIDUALS.fewest:
            rms = math.sqrt(sum(size for size, _ in have) / count)
            found.append(KindResiduals(kind, math.exp(float(point[AT[kind.level]])) * rms, count))
    return tuple(found)


def sentences(left: Sequence[KindResiduals]) -> list[str]:
    """For people: in one what is as expected, and one for each of which there is more."""
    fine = ", ".join(one.kind.words for one in left if not one.more)
    said = [f"What is left of {fine}: as expected by the noise that the file states."] if fine else []
    return said + [f"What is left of {one.kind.words}: {one.words}." for one in left if one.more]


def squares_of(kinds: Array, z: Array) -> dict[int, tuple[float, int]]:
    """As `residuals` takes them. kinds: (n,), of rows. z: (n,), innovations over their sds."""
    rows: Sequence[int] = [int(kind) for kind in np.unique(kinds)]
    return {one: (float(np.sum(z[kinds == one] ** 2)), int(np.sum(kinds == one))) for one in rows}
