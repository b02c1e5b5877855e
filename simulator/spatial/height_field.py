"""The ground as a height field: a plane, random roughness, and bumps. Heights in m, positive upwards.

Roughness is filtered noise on a square that is repeated for ever, with cubic B-splines between its points
(Unser, Splines, IEEE Signal Processing Magazine 16(6), 1999): its spectrum is continuous from the shortest
to the longest wave, where a filter could predict a sum of some pure waves. It depends on the place only, so
each wheel meets its own ground, with its cross slope, and the implement meets what the tractor has met.
Power along a line falls with the square of the wavenumber: a waviness of 2, as ISO 8608 has it.
World frame: x north, y east.
"""

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.simulator.scenario import Ground

Array = NDArray[np.float64]

POINTS: Final = 1024  # along a side of a square, a power of two
FINENESS: Final = 5.0  # of them within the shortest wave: splines are right to 0.5 % of it
WIDEST: Final = 25.0  # longest over shortest wave of a square, 8 of which fit along its side; else one more
GOLDEN: Final = (math.sqrt(5.0) - 1.0) / 2.0
TURNED: Final = (math.cos(math.atan(GOLDEN)), math.sin(math.atan(GOLDEN)))
"""Cosine and sine of the angle by which the square is turned from north: rows to north or east cross it
side by side and so do not meet the same ground again."""
SHARP: Final = 0.2  # 1/m, rms of the curvature: a fifth of a wheel's


class HeightField(NamedTuple):
    """Plain data for the kernels."""

    plane: Array  # (2,), slope to north and to east
    rough: Array  # (squares, POINTS, POINTS): weights of the splines, m; no square on even ground
    spacing: Array  # (squares,), m, between the points
    bump: Array  # (any, 6): north, east, height, half length, half width, ramp, m
    sharp: bool  # whether the ground bends so much within a wheel that no plane stands for it


@kernel
def _step(inside: float, ramp: float) -> tuple[float, float]:
    """0 to 1, smooth, and its derivative. inside: m beyond the foot of the ramp."""
    s = min(max(inside / ramp, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s), 6.0 * s * (1.0 - s) / ramp


@kernel
def height(field: HeightField, x: float, y: float) -> tuple[float, float, float]:
    """(height, m; slope to north; slope to east) at a place."""
    up, north, east = without_bumps(field, x, y)
    return with_bumps(field, x, y, up, north, east)


@kernel
def _spline(t: float) -> tuple[float, float, float, float]:
    """Weights of the four points round a place, which lies t of 0 to 1 from the second to the third."""
    s = 1.0 - t
    return (
        s * s * s / 6.0,
        2.0 / 3.0 - t * t * (1.0 - 0.5 * t),
        2.0 / 3.0 - s * s * (1.0 - 0.5 * s),
        t * t * t / 6.0,
    )


@kernel
def _spline_slope(t: float) -> tuple[float, float, float, float]:
    """Derivatives of `_spline`."""
    s = 1.0 - t
    return -0.5 * s * s, t * (1.5 * t - 2.0), s * (2.0 - 1.5 * s), 0.5 * t * t


@kernel
def without_bumps(field: HeightField, x: float, y: float) -> tuple[float, float, float]:
    """As height, of plane and roughness only."""
    north, east = field.plane[0], field.plane[1]
    up = north * x + east * y
    for k in range(field.rough.shape[0]):
        spacing = field.spacing[k]
        one = (x * TURNED[0] + y * TURNED[1]) / spacing
        two = (y * TURNED[0] - x * TURNED[1]) / spacing
        row, column = math.floor(one), math.floor(two)
        along, along_slope = _spline(one - row), _spline_slope(one - row)
        across, across_slope = _spline(two - column), _spline_slope(two - column)
        d_one = d_two = 0.0
        for i in range(4):
            line = field.rough[k, (row - 1 + i) % POINTS]
            value = slope = 0.0
            for j in range(4):
                weight = line[(column - 1 + j) % POINTS]
                value += across[j] * weight
                slope += across_slope[j] * weight
            up += along[i] * value
            d_one += along_slope[i] * value
            d_two += along[i] * slope
        north += (d_one * TURNED[0] - d_two * TURNED[1]) / spacing
        east += (d_one * TURNED[1] + d_two * TURNED[0]) / spacing
    return up, north, east


@kernel
def with_bumps(
    field: HeightField, x: float, y: float, up: float, north: float, east: float
) -> tuple[float, float, float]:
    """Height and slopes at a place, where up, north and east are those without bumps."""
    bump = field.bump
    for k in range(bump.shape[0]):
        along, across = x - bump[k, 0], y - bump[k, 1]
        one, d_one = _step(bump[k, 3] - abs(along), bump[k, 5])
        two, d_two = _step(bump[k, 4] - abs(across), bump[k, 5])
        up += bump[k, 2] * one * two
        north -= bump[k, 2] * math.copysign(d_one * two, along)
        east -= bump[k, 2] * math.copysign(one * d_two, across)
    return up, north, east


@kernel
def bump_within(field: HeightField, x: float, y: float, reach: float) -> bool:
    """Whether the foot of a bump's ramp is so near to a place, m."""
    bump = field.bump
    for k in range(bump.shape[0]):
        if abs(x - bump[k, 0]) < bump[k, 3] + reach and abs(y - bump[k, 1]) < bump[k, 4] + reach:
            return True
    return False


def height_field(ground: Ground, rms: float, rng: np.random.Generator) -> HeightField:
    """The ground of a scenario; rms: m, of the roughness."""
    fall, towards = math.tan(math.radians(ground.slope_deg)), math.radians(ground.downhill_deg)
    plane = -fall * np.array([math.cos(towards), math.sin(towards)])
    bumps = [
        (b.north, b.east, b.height, b.length / 2, b.width / 2, min(b.ramp, b.length / 2, b.width / 2))
        for b in ground.bumps
    ]
    bands = _bands(ground.waves) if rms > 0.0 else []
    rough = np.zeros((len(bands), POINTS, POINTS))
    for k, band in enumerate(bands):
        share = math.sqrt(_power(band, -2) / _power(ground.waves, -2))
        rough[k] = _roughness(rng, rms * share, band)
    spacing = np.array([band[0] / FINENESS for band in bands])
    curvature = rms * math.sqrt(_power(ground.waves, 2) / _power(ground.waves, -2))
    return HeightField(plane, rough, spacing, np.array(bumps).reshape(-1, 6), curvature > SHARP)


def _bands(band: tuple[float, float]) -> list[tuple[float, float]]:
    """A band of lengths, m, in parts none of which is wider than WIDEST."""
    parts = math.ceil(math.log(band[1] / band[0]) / math.log(WIDEST))
    ends = np.geomspace(*band, parts + 1).tolist()
    return list(pairwise(ends))


def _power(band: tuple[float, float], exponent: int) -> float:
    """Integral of a power of the wavenumber, rad/m, over a band of lengths, m."""
    low, high = 2 * math.pi / band[1], 2 * math.pi / band[0]
    return (high ** (exponent + 1) - low ** (exponent + 1)) / (exponent + 1)


def _roughness(rng: np.random.Generator, rms: float, band: tuple[float, float]) -> Array:
    """Weights of the splines of a square, shape (POINTS, POINTS), with waves of those lengths, m, in all
    directions. Over the plane of wavenumbers power falls with the cube of theirs, so along a line with the
    square."""
    one = 2 * np.pi * np.fft.fftfreq(POINTS)[:, None]
    two = 2 * np.pi * np.fft.rfftfreq(POINTS)
    number = np.hypot(one, two) * FINENESS / band[0]  # rad/m
    inside = (number >= 2 * np.pi / band[1]) & (number <= 2 * np.pi / band[0])
    amplitude = np.where(inside, np.maximum(number, 1e-9) ** -1.5, 0.0)
    heights = np.fft.rfft2(rng.standard_normal((POINTS, POINTS))) * amplitude
    size = rms / np.std(np.fft.irfft2(heights, (POINTS, POINTS)))
    through = (2 / 3 + np.cos(one) / 3) * (2 / 3 + np.cos(two) / 3)  # heights over weights
    return np.asarray(size * np.fft.irfft2(heights / through, (POINTS, POINTS)))
