"""What a prompter sees of the driving: one pose, judged, and what it may not go on with."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.planned_run import room
from tilth.estimator.pose.geometry import rotate, to_degrees, to_plane
from tilth.schemas.experiment import DrivingLimits, Rectangle
from tilth.schemas.flow import MISPLACED, WITHOUT_RTK, FlagKind, Pose

Array = NDArray[np.float64]

LOST_FLAGS: Final = WITHOUT_RTK | MISPLACED | {FlagKind.LOST, FlagKind.MISSING}
BEYOND_ANGLE: Final = math.radians(3.0)  # of the wheels over the plan's limit: a driver is not exact
BACKWARDS: Final = -0.2  # m/s
OVER_S: Final = 0.6  # over which braking is measured
LEAST_S: Final = 0.35  # at least


class Seen(NamedTuple):
    """One pose. Angles rad; the tractor's CG in the plane of the poses, m. NaN where it is not known."""

    t_s: float
    north: float
    east: float
    heading: float
    yaw_rate: float
    speed: float  # m/s, forward
    wheel_angle: float
    direction: int  # as of a pose
    trouble: str = ""  # why nothing can be learned from this driving, in words; ""
    origin_deg: tuple[float, float] = (0.0, 0.0)  # of the plane


class FieldPlace(NamedTuple):
    """Where a field's rectangle lies in the plane of the poses: its corner, m, and its length's heading."""

    north: float
    east: float
    heading: float
    origin_deg: tuple[float, float] = (0.0, 0.0)  # of the plane


class FieldCorner(NamedTuple):
    """The same for a plan, whatever the plane is. Degrees; heading_deg clockwise from north."""

    latitude: float
    longitude: float
    heading_deg: float

    @property
    def text(self) -> str:
        """As `tilth experiment --corner` takes it: within 2 cm, and on a field's length within 10 cm."""
        return f"{self.latitude:.7f},{self.longitude:.7f},{self.heading_deg:.3f}"


def seen_of(pose: Pose) -> Seen:
    """What a pose shows."""
    body = pose.tractor
    numbers = (body.x, body.y, body.heading, body.yaw_rate, body.forward_velocity, pose.wheel_angle)
    x, y, heading, yaw_rate, speed, wheel = (math.nan if one is None else one for one in numbers)
    return Seen(
        pose.t_ns * 1e-9, x, y, heading, yaw_rate, speed, wheel, pose.direction,
        _trouble(pose), (pose.origin_latitude_deg, pose.origin_longitude_deg),
    )  # fmt: skip


def _trouble(pose: Pose) -> str:
    without = sorted({flag.of for flag in pose.flags if flag.kind in WITHOUT_RTK})
    if without:
        return f"RTK is lost at {', '.join(without).replace('_', ' ')}"
    lost = sorted({flag.of for flag in pose.flags if flag.kind in LOST_FLAGS})
    if lost:
        return f"receivers are lost or do not fit: {', '.join(lost).replace('_', ' ')}"
    if pose.wheel_angle is None:
        return "the wheel angle is not heard"
    body = pose.tractor
    if None in (body.x, body.y, body.heading, body.yaw_rate, body.forward_velocity):
        return "the tractor's pose is not known"
    return ""


def place_of(field: Rectangle, seen: Seen) -> FieldPlace:
    """Where the rectangle lies: by its corner, or else with the tractor in the middle of the line where its
    near headland ends."""
    if field.corner is not None and field.heading_deg is not None:
        corner = to_plane(seen.origin_deg, *field.corner)
        return FieldPlace(*corner, math.radians(field.heading_deg), seen.origin_deg)
    north, east = rotate((-field.headland, -field.width / 2), seen.heading)
    return FieldPlace(seen.north + north, seen.east + east, seen.heading, seen.origin_deg)


def corner_of(place: FieldPlace) -> FieldCorner:
    """Where the field begins, for who goes on with the plan."""
    latitude, longitude = to_degrees(place.origin_deg, place.north, place.east)
    return FieldCorner(latitude, longitude, math.degrees(place.heading) % 360.0)


def in_plane(place: FieldPlace, origin_deg: tuple[float, float]) -> FieldPlace:
    """The same place in another plane: a daemon chooses one when it begins, and anew far away."""
    if place.origin_deg == origin_deg:
        return place
    corner = to_degrees(place.origin_deg, place.north, place.east)
    return FieldPlace(*to_plane(origin_deg, *corner), place.heading, origin_deg)


def in_field(place: FieldPlace, seen: Seen, ahead: Array, lateral_offset: Array) -> tuple[Array, Array]:
    """(along, across), m from the corner, (n,), of points ahead of the tractor and aside, to the right."""
    turned = seen.heading - place.heading
    along, across = rotate((seen.north - place.north, seen.east - place.east), -place.heading)
    cosine, sine = math.cos(turned), math.sin(turned)
    return along + ahead * cosine - lateral_offset * sine, across + ahead * sine + lateral_offset * cosine


def room_left(
    field: Rectangle, place: FieldPlace, seen: Seen, ahead: Array, lateral_offset: Array, turning: bool
) -> float:
    """m that the way keeps from the edges, negative where it leaves the field."""
    return room(field, *in_field(place, seen, ahead, lateral_offset), turning)


def abort_reason(
    limits: DrivingLimits, field: Rectangle, place: FieldPlace | None, track: tuple[Seen, ...]
) -> str:
    """Why a run must be broken off now, "" where it need not. track: of the run so far, at least one."""
    now = track[-1]
    if now.trouble:
        return now.trouble
    if now.direction < 0 or now.speed < BACKWARDS:
        return "the tractor goes backwards"
    slowed = _braking(track)
    if slowed > limits.braking:
        return f"braked with {slowed:.1f} m/s²"
    sideways = abs(now.speed * now.yaw_rate)
    if sideways > limits.lateral_acceleration:
        return f"{sideways:.1f} m/s² to the side; the plan allows {limits.lateral_acceleration:g}"
    if abs(now.wheel_angle) > math.radians(limits.wheel_angle_deg) + BEYOND_ANGLE:
        angle = math.degrees(now.wheel_angle)
        return f"the wheels are at {angle:.0f}°; the plan allows {limits.wheel_angle_deg:g}°"
    if place is not None:
        second = np.array([0.0, max(now.speed, 0.0)])
        if room_left(field, place, now, second, np.zeros(2), True) < 0.0:
            return "the field ends here"
    return ""


def _braking(track: tuple[Seen, ...]) -> float:
    """Mean deceleration over the last OVER_S, m/s^2."""
    now = track[-1]
    before = next((one for one in track if now.t_s - one.t_s <= OVER_S), now)
    elapsed = now.t_s - before.t_s
    return (before.speed - now.speed) / elapsed if elapsed >= LEAST_S else 0.0
