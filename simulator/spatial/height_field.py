"""The ground as a height field: a plane, waves in all directions, and bumps. Heights in m, positive upwards.

The waves depend on the place only, so that each wheel meets its own ground and the implement meets what the
tractor has met. Their amplitudes grow with the root of their length: a power spectrum of waviness 2, as ISO
8608 has it for roads and fields. World frame: x north, y east.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.simulator.scenario import Ground

Array = NDArray[np.float64]

WAVES: Final = 96
WAVINESS: Final = 0.5  # amplitude grows with the length to this power, per equal step of its logarithm
SHARP: Final = 0.2  # 1/m, rms of the curvature: a fifth of a wheel's


class HeightField(NamedTuple):
    """Plain data for the kernels."""

    plane: Array  # (2,), slope to north and to east
    wave: Array  # (WAVES or 0, 4): amplitude (m), wavenumber north and east (rad/m), phase
    bump: Array  # (any, 6): north, east, height, half length, half width, ramp, m
    sharp: bool  # whether the waves bend so much within a wheel that no plane stands for them


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
def without_bumps(field: HeightField, x: float, y: float) -> tuple[float, float, float]:
    """As height, of plane and waves only."""
    north, east = field.plane[0], field.plane[1]
    up = north * x + east * y
    wave = field.wave
    for k in range(wave.shape[0]):
        angle = wave[k, 1] * x + wave[k, 2] * y + wave[k, 3]
        up += wave[k, 0] * math.cos(angle)
        steep = -wave[k, 0] * math.sin(angle)
        north += steep * wave[k, 1]
        east += steep * wave[k, 2]
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
    """The ground of a scenario; rms: m, of the waves."""
    fall, towards = math.tan(math.radians(ground.slope_deg)), math.radians(ground.downhill_deg)
    plane = -fall * np.array([math.cos(towards), math.sin(towards)])
    bumps = [
        (b.north, b.east, b.height, b.length / 2, b.width / 2, min(b.ramp, b.length / 2, b.width / 2))
        for b in ground.bumps
    ]
    wave = _waves(rng, rms, ground.waves)
    curvature = wave[:, 0] * (wave[:, 1] ** 2 + wave[:, 2] ** 2)
    sharp = bool(0.5 * curvature @ curvature > SHARP**2)
    return HeightField(plane, wave, np.array(bumps).reshape(-1, 6), sharp)


def _waves(rng: np.random.Generator, rms: float, band: tuple[float, float]) -> Array:
    """Rows of HeightField.wave; lengths (m) spread over the band by logarithm, directions all round."""
    shares = (np.arange(WAVES) + rng.random(WAVES)) / WAVES
    lengths = band[0] * (band[1] / band[0]) ** shares
    direction, phase = rng.uniform(0.0, 2 * np.pi, (2, WAVES))
    if rms == 0.0:
        return np.zeros((0, 4))
    amplitude = lengths**WAVINESS
    amplitude *= rms / math.sqrt(0.5 * float(amplitude @ amplitude))
    number = 2 * np.pi / lengths
    return np.column_stack([amplitude, number * np.cos(direction), number * np.sin(direction), phase])
