"""One rigid body from the receivers on it: heading, CG position, CG velocity, yaw rate.

World: x north, y east; headings clockwise from north. Each result carries a standard deviation in which the
receivers' timing errors (sd_time, s) act along their velocity.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tilth.estimator.pose.geometry import Vector, rotate, wrap


@dataclass(frozen=True, slots=True)
class ReportedPoint:
    """What one receiver contributes at one instant."""

    at: Vector  # reported point, m
    sd: float  # per axis, m
    lever: Vector  # of that point from the CG: forward, right, m
    velocity: Vector | None  # north, east, m/s
    sd_velocity: float  # per axis, m/s
    sd_time: float  # s


@dataclass(frozen=True, slots=True)
class Baseline:
    """The pair of antennas of one body."""

    heading: float
    sd_heading: float
    excess: float  # measured less surveyed length, m
    speed_along: float  # speed of the pair along the baseline, m/s


def baseline(front: ReportedPoint, rear: ReportedPoint, sd_tilt: float) -> Baseline:
    """Heading from two positions of one body.

    sd_tilt: how far roll and pitch, as uncertain as they are, may shift the two points against each other, m.
    """
    north, east = front.at[0] - rear.at[0], front.at[1] - rear.at[1]
    forward, right = front.lever[0] - rear.lever[0], front.lever[1] - rear.lever[1]
    length = math.hypot(forward, right)
    bearing = math.atan2(east, north)
    across, speed_along = 0.0, 0.0
    for antenna in (front, rear):
        velocity = antenna.velocity or (0.0, 0.0)
        speed = math.hypot(*velocity)
        angle = math.atan2(velocity[1], velocity[0]) - bearing
        smear = speed * antenna.sd_time
        across += antenna.sd**2 + (smear * math.sin(angle)) ** 2
        speed_along += speed * math.cos(angle) / 2
    return Baseline(
        heading=wrap(bearing - math.atan2(right, forward)),
        sd_heading=math.sqrt(across + sd_tilt**2) / length,
        excess=math.hypot(north, east) - length,
        speed_along=speed_along,
    )


def centre(antennas: Sequence[ReportedPoint], heading: float, sd_heading: float) -> tuple[Vector, float]:
    """((north, east) of the CG, sd per axis), m: the antennas less their levers, weighted by variance."""
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
        # The heading comes from the same two points, so their errors enter once more through the arm that is
        # left between their mean and the CG: along the baseline with signs, across it as it is.
        ahead = antennas[0].lever[0] - antennas[1].lever[0], antennas[0].lever[1] - antennas[1].lever[1]
        square = ahead[0] ** 2 + ahead[1] ** 2
        turn = (forward * ahead[0] + right * ahead[1]) / square
        slide = (forward * ahead[1] - right * ahead[0]) / square
        variance = (shares[0] - turn) ** 2 * variances[0] + (shares[1] + turn) ** 2 * variances[1]
        variance = max(variance, 1 / total) + slide**2 * sum(variances)
    else:
        variance = variances[0] + (math.hypot(*antennas[0].lever) * sd_heading) ** 2
    # Noise common to all receivers of a site does not average out: no better than the best one.
    return (north, east), math.sqrt(max(variance, min(antenna.sd**2 for antenna in antennas)))


def _variance(antenna: ReportedPoint) -> float:
    speed = math.hypot(*antenna.velocity) if antenna.velocity else 0.0
    return antenna.sd**2 + (speed * antenna.sd_time) ** 2


def centre_velocity(
    antennas: Sequence[ReportedPoint], heading: float, yaw_rate: float, sd_yaw_rate: float
) -> tuple[float, float, float] | None:
    """(forward u, lateral v, sd per axis) of the CG, m/s, in the body's axes; None without velocities.

    The sd holds the receivers' noise and the lever arm's share of the yaw rate's error, not the heading's.
    """
    total, forward, right, reach = 0.0, 0.0, 0.0, 0.0
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
        reach += weight * antenna.lever[0]
    if total == 0.0:
        return None
    return forward / total, right / total, math.sqrt(1 / total + (sd_yaw_rate * reach / total) ** 2)
