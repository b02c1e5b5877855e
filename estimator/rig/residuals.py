"""What data leave over of a rig's numbers, each once: value and slopes (Jacobian), of one instant or of many.

A residual is what was measured less what the numbers say, so it is zero where they are right. Values take
floats or arrays of any shape. Slopes are arrays, with the same leading axes as what they are taken at; where
a number is too small by δ, −slope · δ is left over.

| residual | of | numbers |
|---|---|---|
| `pair_of(…).excess` | a pair's length, m | both levers, both latencies |
| `hitch_gap` | the hitch as seen from either body, m | four levers, four latencies, c, d |
| `sideways` | an axle's direction of travel, m/s | yaw of the pair, b or e, lever |
| `wheel_off` | wheel angle against the path, rad | zero, gain, understeer |
| `roll_slopes` | a measured roll, rad | zero, lean of the body |
| `speed_off` | wheel-based against true speed, logarithm | the factor of both |

A latency that is too small by τ leaves a point τ times its velocity behind.
"""

import math
from typing import Final, Generic, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.rig.geometry import (
    X,
    arctangent,
    between,
    direction,
    length,
    middle,
    rotate,
    rotation,
    turned,
)

Array = NDArray[np.float64]


PAIR_NUMBERS: Final = (
    "front_forward", "front_right", "rear_forward", "rear_right", "front_latency", "rear_latency", "hitch",
)  # fmt: skip
"""Columns of the slopes of a pair: levers and the place of the hitch from the body's CG, m forward and right;
latencies, s. The hitch is at −c of the tractor and at d of the implement."""
LEVERS: Final = slice(0, 4)
LATENCIES: Final = slice(4, 6)
HITCH: Final = 6


class SeenPair(NamedTuple, Generic[X]):
    """A body by its two antennas."""

    bearing: X  # rad, from the rear to the front antenna
    heading: X  # rad, of the body; not wrapped
    excess: X  # m, measured minus surveyed distance


def pair_of(
    front: tuple[X, X], rear: tuple[X, X], front_lever: tuple[X, X], rear_lever: tuple[X, X]
) -> SeenPair[X]:
    """front, rear: reported points, north, east, m. Levers: of these from the CG, forward, right, m."""
    apart, arm = between(front, rear), between(front_lever, rear_lever)
    bearing = direction(apart)
    return SeenPair(bearing, bearing - direction(arm), length(apart) - length(arm))


def seen_hitch(
    front: tuple[X, X],
    rear: tuple[X, X],
    front_lever: tuple[X, X],
    rear_lever: tuple[X, X],
    heading: X,
    place: X,
) -> tuple[X, X]:
    """Where a pair has the hitch: north, east, m. place: of the hitch, forward of the body's CG, m."""
    at, (forward, right) = middle(front, rear), middle(front_lever, rear_lever)
    north, east = rotate((place - forward, -right), heading)
    return at[0] + north, at[1] + east


def hitch_gap(tractor: tuple[X, X], implement: tuple[X, X], heading: X) -> tuple[X, X]:
    """The tractor's hitch minus the implement's, ahead and to the right, m, in the axes of the implement.

    tractor, implement: of `seen_hitch`. heading: the implement's, rad.
    """
    return rotate(between(tractor, implement), -heading)


def hitch_shares(front_lever: tuple[X, X], rear_lever: tuple[X, X], place: X) -> tuple[X, X]:
    """How far the hitch moves across the baseline where the front, and where the rear antenna does by 1."""
    arm, (forward, right) = between(front_lever, rear_lever), rear_lever
    share = ((place - forward) * arm[0] - right * arm[1]) / (arm[0] ** 2 + arm[1] ** 2)
    return share, 1 - share


class PairSlopes(NamedTuple):
    """Over PAIR_NUMBERS, as the last axis."""

    excess: Array  # (..., 7)
    heading: Array  # (..., 7)
    hitch: Array  # (..., 2, 7): forward and right in the axes of the body


class PairGeometry(NamedTuple):
    """What the slopes of a pair take from where its antennas are."""

    span: Array  # (..., 1): distance of the antennas, m
    by_points: Array  # (..., 4): slopes of the excess, over both points
    turn: Array  # (..., 4): slopes of the heading, times that distance
    out: Array  # (..., 2): from the middle of the pair to the hitch, turned by a quarter


def pair_geometry(levers: Array, place: Array) -> PairGeometry:
    """levers: (..., 2, 2), front and rear, forward and right, m. place: (...), as for `seen_hitch`."""
    arm = levers[..., 0, :] - levers[..., 1, :]
    square = (arm * arm).sum(axis=-1, keepdims=True)
    span = np.sqrt(square)
    along, across = arm / span, turned(arm) / span  # unit vectors of the baseline
    by_points = np.concatenate([along, -along], axis=-1)
    turn = np.concatenate([across, -across], axis=-1)
    out = -(levers[..., 0, :] + levers[..., 1, :]) / 2
    out[..., 0] += place
    return PairGeometry(span, by_points, turn, turned(out))


def pair_slopes(pair: PairGeometry, velocity: Array, excess: Array) -> PairSlopes:
    """Of `pair_of` and `seen_hitch`.

    velocity: (..., 2, 2), of front and rear antenna, forward and right in the axes of the body, m/s. excess:
    (...), m.
    """
    span, by_points, turn, out = pair
    moved = velocity.reshape(*velocity.shape[:-2], 4)
    shape = (*np.broadcast(span[..., 0], moved[..., 0], excess).shape, 7)
    of_excess, of_heading, of_hitch = np.zeros(shape), np.zeros(shape), np.zeros((*shape[:-1], 2, 7))
    of_excess[..., LEVERS] = -by_points
    of_heading[..., LEVERS] = -turn / span
    products = by_points * moved, turn * moved / (span + excess[..., None])
    for k in (0, 1):
        of_excess[..., 4 + k] = products[0][..., 2 * k] + products[0][..., 2 * k + 1]
        of_heading[..., 4 + k] = products[1][..., 2 * k] + products[1][..., 2 * k + 1]
        of_hitch[..., 4 + k] = velocity[..., k, :] / 2
        of_hitch[..., 0, 2 * k] = of_hitch[..., 1, 2 * k + 1] = -0.5
    of_hitch[..., 0, HITCH] = 1.0
    of_hitch += out[..., None] * of_heading[..., None, :]
    return PairSlopes(of_excess, of_heading, of_hitch)


def pair_turn(levers: Array) -> Array:
    """(..., 4): change of both levers, as LEVERS, where the pair is turned about its middle by 1 rad.

    levers: as for `pair_slopes`.
    """
    half = turned(levers[..., 0, :] - levers[..., 1, :]) / 2
    return np.concatenate([half, -half], axis=-1)


def gap_by_place(tractor: Array, implement: Array) -> Array:
    """(..., 2, 4): slopes of the gap, north and east, over where the tractor's pair has the hitch, forward
    and right in the axes of the tractor, and where the implement's has it in those of the implement.

    tractor, implement: headings, rad, (...). With the headings from the implement's the rows are ahead and to
    the right, as of `hitch_gap`.
    """
    return np.concatenate([rotation(tractor), -rotation(implement)], axis=-1)


def gap_slopes(tractor: PairSlopes, implement: PairSlopes, by_place: Array, gap: Array) -> Array:
    """(..., 2, 14): of `hitch_gap`, over PAIR_NUMBERS of the tractor and then of the implement.

    by_place: of `gap_by_place`, in the axes of the implement. gap: (..., 2), m.
    """
    of_tractor = by_place[..., 0:2] @ tractor.hitch
    of_implement = by_place[..., 2:4] @ implement.hitch
    of_implement -= turned(gap)[..., None] * implement.heading[..., None, :]  # the axes turn
    return np.concatenate([of_tractor, of_implement], axis=-1)


def sideways(lateral_velocity: X, yaw_rate: X, ahead: float | X) -> X:
    """Velocity to the right of an axle, m/s: zero where a pair points where its body goes, and no tyre slips.

    Over the forward velocity it is the angle from where the pair points to where the axle goes. ahead: of the
    axle from the CG, m.
    """
    return lateral_velocity + yaw_rate * ahead


def sideways_slopes(forward_velocity: Array, yaw_rate: Array) -> Array:
    """(..., 2): of `sideways` over the yaw of the pair in its body, rad, clockwise, and over `ahead`, m."""
    return np.stack([forward_velocity, yaw_rate], axis=-1)


def path_angle(wheelbase: float | X, forward_velocity: X, yaw_rate: X) -> X:
    """The wheel angle, rad, with which a tractor whose tyres do not slip turns so."""
    return arctangent(wheelbase * yaw_rate / forward_velocity)


def wheel_off(reading: X, path: X, lateral: X, zero: float | X, gain: float | X, understeer: float | X) -> X:
    """A reading of the wheels' angle less what the path asks for, rad.

    path: of `path_angle`. lateral: acceleration, speed times yaw rate, m/s^2. zero: reading when straight,
    rad. gain: reading over true angle. understeer: rad per m/s^2, of the reading.
    """
    return reading - (zero + gain * path + understeer * lateral)


def wheel_slopes(path: Array, lateral: Array) -> Array:
    """(..., 3): of what `wheel_off` takes away, over zero, gain and understeer."""
    return np.stack([np.ones_like(path), path, lateral], axis=-1)


def roll_slopes(lateral: Array) -> Array:
    """(..., 2): of a measured roll, rad, over the zero of its sensor, rad, and over the lean of its body on
    its tyres, rad per m/s^2. The slope of the ground comes on top. lateral: as for `wheel_off`."""
    return np.stack([np.ones_like(lateral), lateral], axis=-1)


def speed_off(wheels: float, ground: float, factor: float = 1.0) -> float:
    """Logarithm of the wheel-based over the true speed and their known factor; its slope is −1 / factor."""
    return math.log(wheels / ground) - math.log(factor)
