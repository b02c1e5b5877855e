"""Heading, CG position and CG velocity of one rigid body from the receivers on it.

World frame: x north, y east; headings clockwise from north. Each result has a standard deviation, in which
the receivers' timing errors (sd_time, s) act along their velocity.
"""

import math
from collections.abc import Sequence

from tilth.estimator.rig.geometry import Vector, between, direction, length, rotate, wrap
from tilth.estimator.rig.residuals import pair_of, seen_hitch
from tilth.schemas.values import dataclass


@dataclass(frozen=True, slots=True)
class ReportedPoint:
    """One receiver at one instant: reported point, lever arm, velocity."""

    at: Vector  # reported point: north, east, m
    sd: float  # per axis, m
    lever: Vector  # of that point from the CG: forward, right, m
    velocity: Vector | None  # north, east, m/s
    sd_velocity: float  # per axis, m/s
    sd_time: float  # s


@dataclass(frozen=True, slots=True)
class Baseline:
    """The two antennas of one body."""

    heading: float  # of the body, rad
    sd_heading: float  # rad
    excess: float  # measured minus surveyed length, m
    speed_along: float  # speed of the pair along the baseline, m/s


def baseline(front: ReportedPoint, rear: ReportedPoint, sd_tilt: float) -> Baseline:
    """Heading from two positions of one body.

    sd_tilt: sd of the shift between the two points from the errors of roll and pitch, m.
    """
    seen = pair_of(front.at, rear.at, front.lever, rear.lever)
    variance_across, speed_along = 0.0, 0.0
    for antenna in (front, rear):
        velocity = antenna.velocity or (0.0, 0.0)
        speed = math.hypot(*velocity)
        angle = direction(velocity) - seen.bearing
        smear = speed * antenna.sd_time
        variance_across += antenna.sd**2 + (smear * math.sin(angle)) ** 2
        speed_along += speed * math.cos(angle) / 2
    return Baseline(
        heading=wrap(seen.heading),
        sd_heading=math.sqrt(variance_across + sd_tilt**2) / length(between(front.lever, rear.lever)),
        excess=seen.excess,
        speed_along=speed_along,
    )


def hitch(front: ReportedPoint, rear: ReportedPoint, heading: float, place: float) -> Vector:
    """Where a body has the hitch: north, east, m. place: of the hitch, forward of its CG, m."""
    return seen_hitch(front.at, rear.at, front.lever, rear.lever, heading, place)


def cg_position(antennas: Sequence[ReportedPoint], heading: float, sd_heading: float) -> tuple[Vector, float]:
    """((north, east) of the CG, sd per axis), m: antennas minus levers, weighted by inverse variance."""
    variances = [_variance(antenna) for antenna in antennas]
    total = sum(1 / variance for variance in variances)
    shares = [1 / variance / total for variance in variances]
    north = east = forward = right = 0.0  # of the CG; of the weighted antennas from it
    for antenna, share in zip(antennas, shares, strict=True):
        offset = rotate(antenna.lever, heading)
        north += share * (antenna.at[0] - offset[0])
        east += share * (antenna.at[1] - offset[1])
        forward += share * antenna.lever[0]
        right += share * antenna.lever[1]
    if len(antennas) == 2:
        # The heading comes from the same two points. So their errors also act through the arm from their
        # weighted mean to the CG: with opposite signs along the baseline, and as a rotation across it.
        ahead = antennas[0].lever[0] - antennas[1].lever[0], antennas[0].lever[1] - antennas[1].lever[1]
        square = ahead[0] ** 2 + ahead[1] ** 2
        turn = (forward * ahead[0] + right * ahead[1]) / square
        slide = (forward * ahead[1] - right * ahead[0]) / square
        variance = (shares[0] - turn) ** 2 * variances[0] + (shares[1] + turn) ** 2 * variances[1]
        variance = max(variance, 1 / total) + slide**2 * sum(variances)
    else:
        variance = variances[0] + (math.hypot(*antennas[0].lever) * sd_heading) ** 2
    # Errors that are common to all receivers do not average out: the sd is not below that of the best one.
    return (north, east), math.sqrt(max(variance, min(antenna.sd**2 for antenna in antennas)))


def _variance(antenna: ReportedPoint) -> float:
    speed = math.hypot(*antenna.velocity) if antenna.velocity else 0.0
    return antenna.sd**2 + (speed * antenna.sd_time) ** 2


def cg_velocity(
    antennas: Sequence[ReportedPoint], heading: float, yaw_rate: float, sd_yaw_rate: float
) -> tuple[float, float, float] | None:
    """(forward u, lateral v, sd per axis) of the CG, m/s, in the body's axes; None without velocities.

    The sd contains the receivers' noise and the error of the yaw rate through the lever arm, but not the
    error of the heading.
    """
    total, forward, right, lever_forward = 0.0, 0.0, 0.0, 0.0
    cosine, sine = math.cos(heading), math.sin(heading)
    for antenna in antennas:
        if antenna.velocity is None:
            continue
        weight = 1 / antenna.sd_velocity**2
        north, east = antenna.velocity
        total += weight
        # omega x lever in body axes is (−r · right, r · forward)
        forward += weight * (north * cosine + east * sine + yaw_rate * antenna.lever[1])
        right += weight * (east * cosine - north * sine - yaw_rate * antenna.lever[0])
        lever_forward += weight * antenna.lever[0]
    if total == 0.0:
        return None
    return forward / total, right / total, math.sqrt(1 / total + (sd_yaw_rate * lever_forward / total) ** 2)
