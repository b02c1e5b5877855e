"""Positions on the ground and lever arms on a tilted body."""

import math
from functools import lru_cache

from pyproj import Transformer
from pyproj.enums import TransformDirection

Vector = tuple[float, float]


@lru_cache(maxsize=8)
def _transformer(latitude_deg: float, longitude_deg: float) -> Transformer:
    plane = f"+proj=tmerc +lat_0={latitude_deg:.12f} +lon_0={longitude_deg:.12f} +k=1 +ellps=WGS84 +units=m"
    return Transformer.from_crs("EPSG:4326", plane, always_xy=True)


def to_plane(origin_deg: Vector, latitude_deg: float, longitude_deg: float) -> Vector:
    """(x north, y east) in m on the plane tangent at origin_deg = (latitude, longitude), WGS 84.

    A transverse Mercator plane: scale and direction are right to 1e-6 and 1 mrad within 5 km of the origin.
    """
    east, north = _transformer(*origin_deg).transform(longitude_deg, latitude_deg)
    return north, east


def to_degrees(origin_deg: Vector, x: float, y: float) -> Vector:
    """(latitude, longitude), deg, of a point (x north, y east), m: the inverse of `to_plane`."""
    place = _transformer(*origin_deg).transform(y, x, direction=TransformDirection.INVERSE)
    return float(place[1]), float(place[0])


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


def rotate(vector: Vector, heading: float) -> Vector:
    """A vector (forward, right) of a body at `heading`, rad, as (north, east)."""
    cosine, sine = math.cos(heading), math.sin(heading)
    return vector[0] * cosine - vector[1] * sine, vector[0] * sine + vector[1] * cosine


def wrap(angle: float) -> float:
    """The angle, rad, in [−π, π)."""
    return (angle + math.pi) % math.tau - math.pi
