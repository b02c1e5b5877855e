"""Positions on the ground: degrees, and metres on a plane."""

import math
from functools import lru_cache
from typing import Final

from pyproj import Geod, Transformer
from pyproj.enums import TransformDirection

from tilth.estimator.rig.geometry import Vector

_WGS_84: Final = Geod(ellps="WGS84")
_EQUATOR, _SQUARED = float(_WGS_84.a), float(_WGS_84.es)  # radius, m; eccentricity squared


@lru_cache(maxsize=8)
def _transformer(latitude_deg: float, longitude_deg: float) -> Transformer:
    plane = f"+proj=tmerc +lat_0={latitude_deg:.12f} +lon_0={longitude_deg:.12f} +k=1 +ellps=WGS84 +units=m"
    return Transformer.from_crs("EPSG:4326", plane, always_xy=True)


def to_plane(origin_deg: Vector, latitude_deg: float, longitude_deg: float) -> Vector:
    """(x north, y east) in m on the plane tangent at origin_deg = (latitude, longitude), WGS 84.

    A transverse Mercator plane, to 10 um within 5 km of the origin, where its scale and direction are right
    to 1e-6 and 1 mrad. Redfearn's series (1948) in differences of degrees: PROJ subtracts two distances from
    the equator, which are rounded at 1e-9 m, and not alike on all processors.
    """
    north = math.radians(latitude_deg - origin_deg[0])
    east = math.radians(math.remainder(longitude_deg - origin_deg[1], 360.0))
    latitude = math.radians(latitude_deg)
    sine, cosine = math.sin(latitude), math.cos(latitude)
    normal = _EQUATOR / math.sqrt(1.0 - _SQUARED * sine * sine)
    curved = 1.0 - _SQUARED * math.sin(latitude - north / 2.0) ** 2
    meridian = _EQUATOR * (1.0 - _SQUARED) / (curved * math.sqrt(curved))
    third = (cosine * cosine - sine * sine + _SQUARED / (1.0 - _SQUARED) * cosine**4) / 6.0
    return (
        meridian * north + normal * sine * cosine * east * east / 2.0,
        normal * cosine * east * (1.0 + third * east * east),
    )


def to_degrees(origin_deg: Vector, x: float, y: float) -> Vector:
    """(latitude, longitude), deg, of a point (x north, y east), m: the inverse of `to_plane`, by PROJ."""
    place = _transformer(*origin_deg).transform(y, x, direction=TransformDirection.INVERSE)
    return float(place[1]), float(place[0])
