"""Forces of ground and drive on the six tyres, computed at each step and applied to the engine's bodies.

A tyre is a thin disc (simulator/spatial/contact.py). Its radial spring and damper push along the ground's
normal and never pull. Side force, drive and rolling resistance lie in the ground's plane at the contact.
World: x north, y east, z down; a height is positive upwards.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.simulator.spatial.contact import contact_of, cross, dot, rotated
from tilth.simulator.spatial.height_field import HeightField
from tilth.simulator.spatial.tyre import (
    CURVES,
    RELAXATIONS,
    carcass_damping,
    lag_length,
    lagged,
    side_force,
    side_share,
    stiffness_at,
)
from tilth.simulator.spatial.vehicle import WHEELS, Vehicle, static_loads, wheel_places

Array = NDArray[np.float64]

TYRE_COLUMNS: Final = ("load", "along", "across", "slip", "deflection", "elevation", "camber", "power")
"""Of each tyre: N; N; N; rad; m; m; rad, leaning right of the ground's normal; W, done on the bodies."""
GOVERNED_KG: Final = 9391.0  # kg
GOVERNOR: Final = (60e3, 60e3)  # N s/m and N/m: proportional, integral; assumed: a transmission's
DRIVE_LIMIT: Final = 40e3  # N, assumed: four tenths of a tractor's weight
"""Of a tractor of GOVERNED_KG, and of others as their masses are: one for 9 t lifts the front of 3 t."""
ROLLING_SPEED: Final = 0.1  # m/s: rolling resistance changes its sign over this range of speed


class TyreSet(NamedTuple):
    """Constants of the six tyres for the kernel; arrays of shape (6,) unless said."""

    body: NDArray[np.int64]  # the engine's
    place: Array  # (6, 3), of the wheel's centre from that body's origin, m
    radius: Array  # without load, m
    stiffness: Array
    damping: Array
    static: Array  # load at rest on level ground, N
    driven: Array  # share of the drive force
    curve: int
    string: bool
    exponent: float
    camber: float
    grip: float
    rolling: float
    combined: bool
    ackermann: float  # half the front track over the wheelbase, times its share
    governor: float  # times GOVERNOR and DRIVE_LIMIT


def tyres_of(vehicle: Vehicle) -> TyreSet:
    """TyreSet whose springs, at rest on level ground, hold both CGs at their heights."""
    m = vehicle.masses
    place = wheel_places(vehicle)
    place[:2] -= [m.a, 0.0, m.h_t - vehicle.pin_height]  # the front ones turn with the beam
    static = np.repeat(static_loads(vehicle), 2) / 2
    stiffness = np.repeat(vehicle.stiffness, 2)
    front = vehicle.front_drive / 2
    return TyreSet(
        np.array([2, 2, 1, 1, 3, 3]),
        place,
        np.repeat(vehicle.radius, 2) + static / stiffness,
        stiffness,
        np.repeat(vehicle.damping, 2),
        static,
        np.array([front, front, 0.5 - front, 0.5 - front, 0.0, 0.0]),
        CURVES.index(vehicle.tyre),
        vehicle.relaxation == RELAXATIONS[1],
        vehicle.load_exponent,
        vehicle.camber_thrust,
        vehicle.grip,
        vehicle.rolling,
        vehicle.combined,
        vehicle.ackermann * vehicle.track[0] / 2 / (m.a + m.b),
        m.m_t / GOVERNED_KG,
    )


@kernel
def tyre_on_ground(
    k: int, tyres: TyreSet, soil: Array, drive: float, slip: float, along: float, across: float, load: float,
    camber: float, step: float,
) -> tuple[float, float, float]:  # fmt: skip
    """(force along the wheel, force across it to the right, N; tan of the lagged slip after the step).

    along, across: m/s of the contact. soil: shape (6,), as PARAMETERS, of the axles.
    """
    length, cornering = soil[3 + k // 2], 0.5 * soil[k // 2]
    limit = tyres.grip * load
    driven = tyres.driven[k] * drive
    traction = driven - tyres.rolling * load * math.tanh(along / ROLLING_SPEED)
    stiffness = stiffness_at(cornering, load, tyres.static[k], tyres.exponent)
    lag = lag_length(tyres.string, length, tyres.curve, math.atan(slip), stiffness, limit)
    after = lagged(slip, along, across, lag, step)
    alpha = math.atan(0.5 * (slip + after))  # amid the step: the force is not late by half of it
    side = side_force(tyres.curve, alpha, stiffness, limit) + tyres.camber * load * math.sin(camber)
    if tyres.combined:
        side *= side_share(driven, limit)
    if load > 0.0:
        side -= carcass_damping(cornering, length, along) * across
    return traction, side, after


@kernel
def forward_speed(place: Array, turn: Array, twist: Array, root: Array) -> float:
    """Of a body along its own x axis, m/s. arguments as those of plant.body_motion."""
    arm = (place[0] - root[0], place[1] - root[1], place[2] - root[2])
    spin = cross((twist[0], twist[1], twist[2]), arm)
    velocity = (twist[3] + spin[0], twist[4] + spin[1], twist[5] + spin[2])
    return dot(velocity, (turn[0], turn[3], turn[6]))


@kernel
def govern(target_speed: float, forward: float, governor: float, drive: Array, step: float) -> None:
    """Drive force towards a speed, m/s. drive: N, and the integral of the speed error, m."""
    error = target_speed - forward
    integral = drive[1] + error * step
    requested = governor * (GOVERNOR[0] * error + GOVERNOR[1] * integral)
    limit = governor * DRIVE_LIMIT
    drive[0] = min(max(requested, -limit), limit)
    if requested == drive[0]:
        drive[1] = integral


@kernel
def steering_angles(tyres: TyreSet, mean: float) -> tuple[float, float]:
    """Angles of the left and right front wheel, rad, whose cotangents' mean is that of `mean`."""
    tangent = math.tan(mean)
    skew = tyres.ackermann * tangent
    return math.atan(tangent / (1.0 + skew)), math.atan(tangent / (1.0 - skew))


@kernel
def apply_forces(
    field: HeightField, tyres: TyreSet, soil: Array, delta: float, target_speed: float, step: float,
    xpos: Array, xmat: Array, xipos: Array, cvel: Array, com: Array,
    slip: Array, drive: Array, xfrc: Array, tyre_rows: Array,
) -> None:  # fmt: skip
    """Fill xfrc, shape (4, 6), N and N m about each xipos, and tyre_rows, shape (6, len(TYRE_COLUMNS)).

    slip, shape (6,), and drive, shape (2,), go on by a step. xpos, xmat, xipos, cvel, com: MuJoCo's places,
    axes, CGs and velocities of its bodies, and the points that the velocities are of. delta: mean angle of
    the front wheels, rad. target_speed: m/s.
    """
    xfrc[:, :] = 0.0
    angles = steering_angles(tyres, delta)
    root = com[1]
    govern(target_speed, forward_speed(xpos[1], xmat[1], cvel[1], root), tyres.governor, drive, step)
    for k in range(6):
        b = tyres.body[k]
        turn = xmat[b]
        place = rotated(turn, (tyres.place[k, 0], tyres.place[k, 1], tyres.place[k, 2]))
        hub = (xpos[b, 0] + place[0], xpos[b, 1] + place[1], xpos[b, 2] + place[2])
        steered = angles[k] if k < 2 else 0.0
        contact, ahead, right, down, far, up, camber = contact_of(field, turn, hub, steered, tyres.radius[k])
        arm = (contact[0] - root[0], contact[1] - root[1], contact[2] - root[2])
        spun = cross((cvel[b, 0], cvel[b, 1], cvel[b, 2]), arm)
        moving = (cvel[b, 3] + spun[0], cvel[b, 4] + spun[1], cvel[b, 5] + spun[2])
        deflection = tyres.radius[k] - far
        load = 0.0
        if deflection > 0.0:
            load = max(tyres.stiffness[k] * deflection + tyres.damping[k] * dot(moving, down), 0.0)
        traction, side, slip[k] = tyre_on_ground(
            k, tyres, soil, drive[0], slip[k], dot(moving, ahead), dot(moving, right), load, camber, step
        )
        if load <= 0.0:
            traction = 0.0
        force = (
            traction * ahead[0] + side * right[0] - load * down[0],
            traction * ahead[1] + side * right[1] - load * down[1],
            traction * ahead[2] + side * right[2] - load * down[2],
        )
        lever = (contact[0] - xipos[b, 0], contact[1] - xipos[b, 1], contact[2] - xipos[b, 2])
        moment = cross(lever, force)
        for i in range(3):
            xfrc[b, i] += force[i]
            xfrc[b, 3 + i] += moment[i]
        tyre_rows[k, 0], tyre_rows[k, 1], tyre_rows[k, 2], tyre_rows[k, 3] = (
            load,
            traction,
            side,
            math.atan(slip[k]),
        )
        tyre_rows[k, 4], tyre_rows[k, 5], tyre_rows[k, 6], tyre_rows[k, 7] = (
            deflection,
            up,
            camber,
            dot(force, moving),
        )


assert len(WHEELS) == 6
