"""Manoeuvres that are informative about a rig: a table of wheel angles over time, rad."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ManoeuvreTuning:
    """Of every planned manoeuvre."""

    start_s: float = tuned(1.0, "s", "straight before it begins")
    fade_s: float = tuned(1.0, "s", "in which a multisine rises")


MANOEUVRE: Final = ManoeuvreTuning()


class Manoeuvre(NamedTuple):
    """`wheel_angle(time, amplitude, rng)`: rad, within ± amplitude, at each time (n,), s, from 0."""

    name: str
    meaning: str
    wheel_angle: Callable[[Array, float, Generator], Array]


def step(time: Array, amplitude: float, rng: Generator) -> Array:
    return np.where(time >= MANOEUVRE.start_s, amplitude, 0.0)


def turn(time: Array, amplitude: float, rng: Generator) -> Array:
    return amplitude * np.clip((time - MANOEUVRE.start_s) / 2.0, 0.0, 1.0)


def steps(time: Array, amplitude: float, rng: Generator, hold_s: float = 3.0) -> Array:
    side = np.where((time - MANOEUVRE.start_s) // hold_s % 2 == 0, 1.0, -1.0)
    return np.where(time >= MANOEUVRE.start_s, amplitude, 0.0) * side


def chirp(
    time: Array, amplitude: float, rng: Generator, low: float = 0.05, high: float = 1.0
) -> Array:  # fmt: skip
    """low, high: Hz, at the beginning and at the end of the time."""
    since = np.clip(time - MANOEUVRE.start_s, 0.0, None)
    rise = (high - low) / max(float(since[-1]), 1e-9)
    return amplitude * np.sin(2 * np.pi * (low + 0.5 * rise * since) * since)


def random_levels(
    time: Array, amplitude: float, rng: Generator, shortest_s: float = 0.3, longest_s: float = 2.0
) -> Array:
    count = int(time[-1] / shortest_s) + 2
    ends = MANOEUVRE.start_s + np.cumsum(rng.uniform(shortest_s, longest_s, count))
    levels = rng.uniform(-amplitude, amplitude, count + 1)
    return np.where(time >= MANOEUVRE.start_s, levels[np.searchsorted(ends, time, side="right")], 0.0)


def multisine(
    time: Array, amplitude: float, rng: Generator, low: float = 0.05, high: float = 0.5
) -> Array:  # fmt: skip
    """All whole periods of the time from low to high, Hz, alike strong, with Schroeder's phases (1970), which
    keep the peak low; risen within `fade_s` from straight."""
    since = np.clip(time - MANOEUVRE.start_s, 0.0, None)
    period = max(float(since[-1]), 1e-9)
    first = max(round(low * period), 1)
    lines = np.arange(first, max(round(high * period), first) + 1)
    k = np.arange(1, len(lines) + 1)
    phases = -np.pi * k * (k - 1) / len(lines)
    waves = np.cos(2 * np.pi * np.outer(since, lines / period) + phases).sum(axis=1)
    waves *= np.clip(since / MANOEUVRE.fade_s, 0.0, 1.0)
    return np.asarray(amplitude * waves / max(float(np.max(np.abs(waves))), 1e-9))


def rate_limited(wanted: Array, most: float) -> Array:
    """The same angles, changing by no more than `most` from sample to sample, from zero on."""
    value, values = 0.0, []
    for target in wanted.tolist():
        value += min(max(target - value, -most), most)
        values.append(value)
    return np.array(values)


def row_following(time: Array, amplitude: float, rng: Generator) -> Array:
    tones = np.linspace(0.05, 0.5, 10)  # Hz: corrections of a guidance system on a straight row
    phases = rng.uniform(0.0, 2 * np.pi, len(tones))
    waves = np.sin(2 * np.pi * np.outer(time, tones) + phases).sum(axis=1)
    return np.where(time >= MANOEUVRE.start_s, amplitude * waves / len(tones), 0.0)


MANOEUVRES = (
    Manoeuvre("step", "the wheels turned at once and held", step),
    Manoeuvre("steps", "to one side and the other, three seconds each", steps),
    Manoeuvre("chirp", "swinging from 0.05 to 1 Hz", chirp),
    Manoeuvre("turn", "the wheels turned within two seconds, as into a headland turn, and held", turn),
    Manoeuvre("random", "random levels, held for 0.3 to 2 s", random_levels),
    Manoeuvre("multisine", "many frequencies at once, with a low peak", multisine),
    Manoeuvre("row", "small corrections on a straight row", row_following),
)


def manoeuvre_named(name: str) -> Manoeuvre:
    """The row of that name. Raises ValueError that lists the names."""
    for row in MANOEUVRES:
        if row.name == name:
            return row
    raise ValueError(f'there is no manoeuvre "{name}"; there are {", ".join(m.name for m in MANOEUVRES)}')
