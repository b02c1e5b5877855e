"""Positions on the ground: degrees, and metres on a plane."""

from functools import lru_cache

from pyproj import Transformer
from pyproj.enums import TransformDirection

from tilth.estimator.rig.geometry import Vector


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
