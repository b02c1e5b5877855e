"""Windowed segments of a record with gaps: where they lie, their spectra, how many are independent.

Source: Welch's method (1967), with Hann's window and half overlap. Segments lie where there is no gap.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]

LENGTHS_S: Final = (20.0, 16.0, 12.0, 10.0, 8.0, 6.0)
"""Of a segment; the first that gives WANTED segments is taken. 6 s resolve 1 rad/s, the width of what a rig
does at 4.5 m/s; segments longer than 20 s show nothing more."""
WANTED: Final = 15
FEWEST: Final = 6  # with fewer, a 95 % band is wider than most responses are large


@dataclass(frozen=True, slots=True)
class SegmentPlan:
    """Segments of one length on one clock, each with Hann's window."""

    starts: NDArray[np.int64]  # (k,), index of each segment's first sample, increasing
    length: int  # samples
    dt: float  # s

    @property
    def hz(self) -> Array:
        """Frequencies of the spectra, shape (f,). Without zero: segments lose their mean."""
        return np.asarray(np.fft.rfftfreq(self.length, self.dt)[1:], dtype=np.float64)

    @property
    def independent(self) -> float:
        """L: so many segments without overlap give spectra as exact as these (Welch 1967)."""
        k = len(self.starts)
        return k / (1.0 + 2.0 * float(np.sum(overlap_correlation(self) ** 2)) / k)


def stretches(usable: Flags) -> list[tuple[int, int]]:
    """(begin, end) of each run of True, end excluded. usable: (n,)."""
    steps = np.diff(np.concatenate([[0], usable.astype(np.int8), [0]]))
    return list(zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True))


def plan_segments(usable: Flags, dt: float) -> SegmentPlan | None:
    """The longest segments of LENGTHS_S of which there are WANTED, else the shortest if there are FEWEST.

    usable: (n,), samples that a segment may hold, dt seconds apart. None where even the shortest are too few.
    """
    plan = None
    for seconds in LENGTHS_S:
        length = 2 * round(seconds / dt / 2)
        if length < 4:
            break
        starts = [
            start
            for begin, end in stretches(usable)
            for start in range(begin, end - length + 1, length // 2)
        ]  # fmt: skip
        plan = SegmentPlan(np.array(starts, dtype=np.int64), length, dt)
        if len(starts) >= WANTED:
            return plan
    return plan if plan is not None and len(plan.starts) >= FEWEST else None


def hann(length: int) -> Array:
    """Hann's window whose period is its length, shape (length,)."""
    return np.asarray(np.sin(np.pi * np.arange(length) / length) ** 2)


def overlap_correlation(plan: SegmentPlan) -> Array:
    """Correlation of white noise's spectra in segments k and k + 1, shape (k-1,); zero without an overlap."""
    window = hann(plan.length)
    shifts = np.minimum(np.diff(plan.starts), plan.length)
    of_shift = {
        shift: float(window[shift:] @ window[: plan.length - shift]) for shift in set(shifts.tolist())
    }
    return np.array([of_shift[shift] for shift in shifts.tolist()]) / float(window @ window)


def segment_spectra(values: Array, plan: SegmentPlan) -> Complex:
    """Spectra of each segment less its mean, shape (k, f, c): |.|² is a density, unit²/Hz, one-sided.

    values: (n, c). Phases count from the record's first sample, so that segments can be compared.
    """
    window = hann(plan.length)[:, None]
    scale = np.sqrt(2.0 * plan.dt / float(np.sum(window**2)))
    found = np.zeros((len(plan.starts), len(plan.hz), values.shape[1]), np.complex128)
    for k, start in enumerate(plan.starts.tolist()):
        part = values[start : start + plan.length]
        turned = np.exp(-2j * np.pi * plan.hz * plan.dt * start)
        found[k] = scale * turned[:, None] * np.fft.rfft((part - part.mean(axis=0)) * window, axis=0)[1:]
    return found
