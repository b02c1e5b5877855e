"""Mean and covariance of samples that count ever less."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(slots=True)
class Moments:
    """Of n quantities, with exponential forgetting."""

    mean: Array  # (n,)
    sums: Array  # (n, n), of products of deviations
    weight: float = 0.0  # number of samples in them

    @classmethod
    def of(cls, n: int) -> Self:
        """Without a sample."""
        return cls(np.zeros(n), np.zeros((n, n)))

    def add(self, sample: Array, memory: float) -> None:
        """sample: (n,). memory: samples over which older ones count less."""
        keep = 1.0 - 1.0 / memory
        self.weight = keep * self.weight + 1.0
        off = sample - self.mean
        self.mean += off / self.weight
        self.sums = keep * self.sums + off[:, None] * (sample - self.mean)

    @property
    def covariance(self) -> Array:
        """(n, n), of at least one sample."""
        return self.sums / self.weight
