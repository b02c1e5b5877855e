"""Play of the wheel sensor's linkage: which flank it is at.

A linkage that turns freely within 2 h passes on m where the wheels are at m + h s: s is the sign of m's last
motion. As it turns, m rests until the wheels have gone from one flank to the other, and s with them; so long
s has a standard deviation of up to 1/sqrt(3), which h times is noise of the wheel angle. h is an unknown of a
fit, s is known from the readings, before and behind.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.states import DT
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WheelPlayTuning:
    """How motion is told from noise."""

    averaged_s: float = tuned(0.1, "s", "of readings, as one")
    moved: float = tuned(np.radians(0.08), "rad", "back from an extreme: the sensor has turned there")
    crossed_s: float = tuned(0.3, "s", "at most, from flank to flank, before the sensor moves again")
    """Of nine rows with noise of 0.05 degrees these flanks correlate with the true ones by 0.8 to 0.98; with
    0.16 s, 0.5 s, or without a limit, by up to 0.04 less where a person steers, who rests between."""


WHEEL_PLAY: Final = WheelPlayTuning()


def flanks(readings: Array) -> Array:
    """At which flank the linkage is, -1 to 1, (n,): 1 where the reading grew last. readings: (n,), DT apart,
    rad. From flank to flank it is in proportion to the time; 0 without motion."""
    half = round((WHEEL_PLAY.averaged_s / DT - 1.0) / 2.0)
    means = np.convolve(np.pad(readings, half, "edge"), np.full(2 * half + 1, 1.0 / (2 * half + 1)), "valid")
    values, instants, at = means.tolist(), [0], [0.0]
    for turned, way in _turns(values):
        there = _leaves(values, turned, 1)
        begins = max(_leaves(values, turned, -1), there - round(WHEEL_PLAY.crossed_s / DT))
        instants += [max(begins, instants[-1]), there]
        at += [-way, way]
    return np.interp(np.arange(len(readings)), instants, at)


def _leaves(values: list[float], turned: int, step: int) -> int:
    """Where a value is no more what it is where it turned, or the end of them."""
    k = turned
    while 0 <= k + step < len(values) and abs(values[k] - values[turned]) <= WHEEL_PLAY.moved:
        k += step
    return k


def _turns(values: list[float]) -> list[tuple[int, float]]:
    """Where a value turns, by more than what noise does, and which way it goes from there."""
    found: list[tuple[int, float]] = []
    low = high = 0
    way = 0.0
    for k, value in enumerate(values):
        low = k if value < values[low] else low
        high = k if value > values[high] else high
        if way <= 0.0 and value - values[low] > WHEEL_PLAY.moved:
            found.append((low, 1.0))
            way, high = 1.0, k
        elif way >= 0.0 and values[high] - value > WHEEL_PLAY.moved:
            found.append((high, -1.0))
            way, low = -1.0, k
        if way > 0.0:
            low = high
        elif way < 0.0:
            high = low
    return found
