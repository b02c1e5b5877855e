"""Directions, lever arms and rotations in the plane: of one instant as floats, of many as arrays.

Headings clockwise from north, bodies with forward and right. Floats go to the functions of `math` and arrays
to those of numpy: the two agree but for the last digit.
"""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
X = TypeVar("X", float, Array)  # one instant, or many
Vector = tuple[float, float]


def cosine(angle: X) -> X:
    if isinstance(angle, float):
        return math.cos(angle)
    return np.cos(angle)


def sine(angle: X) -> X:
    if isinstance(angle, float):
        return math.sin(angle)
    return np.sin(angle)


def arctangent(ratio: X) -> X:
    if isinstance(ratio, float):
        return math.atan(ratio)
    return np.arctan(ratio)


def direction(vector: tuple[X, X]) -> X:
    """Of a vector (north, east), or (forward, right): rad, clockwise from its first axis."""
    ahead, right = vector
    if isinstance(ahead, float):
        return math.atan2(right, ahead)
    return np.arctan2(right, ahead)


def length(vector: tuple[X, X]) -> X:
    ahead, right = vector
    if isinstance(ahead, float):
        return math.hypot(ahead, right)
    return np.hypot(ahead, right)


def between(one: tuple[X, X], other: tuple[X, X]) -> tuple[X, X]:
    """The vector from the other to the one."""
    return one[0] - other[0], one[1] - other[1]


def middle(one: tuple[X, X], other: tuple[X, X]) -> tuple[X, X]:
    """Of two points."""
    return (one[0] + other[0]) / 2, (one[1] + other[1]) / 2


def rotate(vector: tuple[X, X], heading: X) -> tuple[X, X]:
    """A vector (forward, right) of a body at `heading`, rad, as (north, east)."""
    c, s = cosine(heading), sine(heading)
    return vector[0] * c - vector[1] * s, vector[0] * s + vector[1] * c


def rotation(heading: Array) -> Array:
    """`rotate` as a matrix, (..., 2, 2), of headings (...)."""
    out = np.empty((*heading.shape, 2, 2))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(heading)
    out[..., 1, 0] = np.sin(heading)
    out[..., 0, 1] = -out[..., 1, 0]
    return out


def turned(vector: Array) -> Array:
    """By a quarter to the right, (..., 2): (forward, right) -> (−right, forward)."""
    out = np.empty_like(vector)
    out[..., 0], out[..., 1] = -vector[..., 1], vector[..., 0]
    return out


def wrap(angle: X) -> X:
    """The angle, rad, in [−π, π)."""
    return (angle + math.pi) % math.tau - math.pi


def lever(
    position: tuple[float, float, float], cg_height: float, roll_corrected: bool, roll: float, pitch: float
) -> Vector:
    """Horizontal offset (forward, right), m, from the body's CG to the point that a receiver reports.

    position: of the antenna: forward and right of the CG, and above the ground, m, in the body's axes. A
    roll-corrected receiver reports the point on the ground below the antenna instead. Both kinds count their
    height from the ground, so they can be mixed on a slope. roll: positive right side down; pitch: positive
    nose up, rad.
    """
    forward, right, height = position
    below_cg = cg_height - (0.0 if roll_corrected else height)  # body z is down
    down = right * math.sin(roll) + below_cg * math.cos(roll)
    return (
        forward * math.cos(pitch) + down * math.sin(pitch),
        right * math.cos(roll) - below_cg * math.sin(roll),
    )
