"""Where a tyre, as a thin disc, meets the ground.

Smooth ground is taken as the plane that touches it straight below the hub. Near a bump, and on short waves,
that plane would stand far above the ground: a steep ramp, carried on over a tyre's radius, is as high as the
tractor. There the disc meets the point of the ground that is nearest to its hub, in its own plane. Then no
tyre is pressed in by more than the ground rises, and what a bump takes of the rig's energy it gives back.
World: x north, y east, z down; a height is positive upwards.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.simulator.spatial.height_field import HeightField, bump_within, height, with_bumps, without_bumps

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
Plane = tuple[float, float, float, float, float]
"""North and east of a place, m; height there, m; slopes to north and to east."""

LOOKS: Final = 32  # along the disc: 6 cm apart, less than the shortest bump
NARROWINGS: Final = 16  # of 0.62 each: to less than 0.1 mm
GOLDEN: Final = (math.sqrt(5.0) - 1.0) / 2.0


@kernel
def unit(x: float, y: float, z: float) -> Vector:
    long = math.sqrt(x * x + y * y + z * z)
    return x / long, y / long, z / long


@kernel
def cross(one: Vector, two: Vector) -> Vector:
    return (
        one[1] * two[2] - one[2] * two[1],
        one[2] * two[0] - one[0] * two[2],
        one[0] * two[1] - one[1] * two[0],
    )


@kernel
def dot(one: Vector, two: Vector) -> float:
    return one[0] * two[0] + one[1] * two[1] + one[2] * two[2]


@kernel
def rotated(turn: Array, v: Vector) -> Vector:
    """turn: a body's axes as columns, shape (9,), row by row."""
    return (
        turn[0] * v[0] + turn[1] * v[1] + turn[2] * v[2],
        turn[3] * v[0] + turn[4] * v[1] + turn[5] * v[2],
        turn[6] * v[0] + turn[7] * v[1] + turn[8] * v[2],
    )


@kernel
def contact_of(
    field: HeightField, turn: Array, hub: Vector, delta: float, radius: float
) -> tuple[Vector, Vector, Vector, Vector, float, float, float]:
    """(point of contact, m; its unit vectors ahead, to the right and down along the ground's normal; distance
    of the hub, m; height of the ground below it, m; camber, rad) of a disc.

    turn: the axes of its body as columns, shape (9,). hub: place of its centre, m. delta: rad.
    """
    axis = rotated(turn, (-math.sin(delta), math.cos(delta), 0.0))
    reach = (turn[2] * radius, turn[5] * radius, turn[8] * radius)  # below, along the body's z
    foot = hub[0] + reach[0], hub[1] + reach[1]
    up, north, east = height(field, foot[0], foot[1])
    if field.sharp or bump_within(field, foot[0], foot[1], radius):
        below, down, far = _nearest(field, axis, hub, foot, radius)
        ahead = cross(axis, below)
    else:
        down = unit(north, east, 1.0)  # the ground's normal
        ahead = cross(axis, down)
        ahead = unit(ahead[0], ahead[1], ahead[2])
        below = cross(ahead, axis)
        # The ground near by is a plane: where the disc's plane meets it, along `below`.
        short = north * reach[0] + east * reach[1] + reach[2] - (hub[2] + reach[2] + up)
        far = short / (north * below[0] + east * below[1] + below[2])
    right = cross(down, ahead)
    contact = (hub[0] + far * below[0], hub[1] + far * below[1], hub[2] + far * below[2])
    return contact, ahead, right, down, far, up, math.asin(dot(axis, down))


@kernel
def _nearest(
    field: HeightField, axis: Vector, hub: Vector, foot: tuple[float, float], radius: float
) -> tuple[Vector, Vector, float]:
    """(unit vector to the nearest ground in the disc's plane; the ground's normal there, down; distance, m).

    The normal leans across the disc as the ground does there; along it, the distance being the shortest, the
    normal points away from the hub.
    """
    plane = (foot[0], foot[1], *without_bumps(field, foot[0], foot[1]))
    level = cross(axis, (0.0, 0.0, 1.0))
    level = unit(level[0], level[1], level[2])
    deep = cross(level, axis)
    between = 2.0 * radius / LOOKS
    place, least = -radius, math.inf
    for k in range(LOOKS + 1):
        ahead = k * between - radius
        far = _distance(field, plane, hub, level, deep, radius, ahead)
        if far < least:
            place, least = ahead, far
    back, fore = place - between, place + between
    for _ in range(NARROWINGS):
        one, two = fore - GOLDEN * (fore - back), back + GOLDEN * (fore - back)
        if _distance(field, plane, hub, level, deep, radius, one) < _distance(
            field, plane, hub, level, deep, radius, two
        ):
            fore = two
        else:
            back = one
    place = 0.5 * (back + fore)
    depth, north, east = _depth(field, plane, hub, level, deep, radius, place)
    far = math.sqrt(place * place + depth * depth)
    one, two = place / far, depth / far
    below = (
        one * level[0] + two * deep[0],
        one * level[1] + two * deep[1],
        one * level[2] + two * deep[2],
    )
    leaning = dot(axis, unit(north, east, 1.0))
    upright = math.sqrt(1.0 - leaning * leaning)
    down = (
        upright * below[0] + leaning * axis[0],
        upright * below[1] + leaning * axis[1],
        upright * below[2] + leaning * axis[2],
    )
    return below, down, far


@kernel
def _distance(
    field: HeightField, plane: Plane, hub: Vector, level: Vector, deep: Vector, radius: float, ahead: float
) -> float:
    """From the hub to the ground so far ahead in the disc's plane, m."""
    return math.hypot(ahead, _depth(field, plane, hub, level, deep, radius, ahead)[0])


@kernel
def _depth(
    field: HeightField, plane: Plane, hub: Vector, level: Vector, deep: Vector, radius: float, ahead: float
) -> Vector:
    """(how deep the ground lies in the disc's plane so far ahead of the hub, m; its slopes there).

    plane: the ground without bumps. level, deep: unit vectors of the disc's plane.
    """
    x = hub[0] + ahead * level[0] + radius * deep[0]
    y = hub[1] + ahead * level[1] + radius * deep[1]
    z = hub[2] + ahead * level[2] + radius * deep[2]
    if field.sharp:
        up, north, east = height(field, x, y)
    else:
        even = plane[2] + plane[3] * (x - plane[0]) + plane[4] * (y - plane[1])
        up, north, east = with_bumps(field, x, y, even, plane[3], plane[4])
    return radius - (z + up) / (deep[2] + plane[3] * deep[0] + plane[4] * deep[1]), north, east
