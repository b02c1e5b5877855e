"""Both bodies for viewers of 3D scenes: the transforms of their frames, and the solids to draw.

In this project the world W has x north, y east, and bodies have x forward, y right, z down. Viewers use x
east, y north, z up, and x forward, y left, z up, so a heading counts anticlockwise from the east:

    world ─► tractor ─► tractor_front_left, tractor_front_right (rotated by the wheel angle)
          └► implement

The frame of a body is at its CG. The ground is the plane z = 0 of the world; a body rolls about the point of
the ground below its CG.
"""

import math
from typing import Final

from tilth.estimator.models.parameters import TABLE_5_1
from tilth.schemas.flow import BodyFrames, BodyPose, Drawing, Mount, Pose, Solid, Transform
from tilth.schemas.machine import Machine, Tyre

WORLD: Final = "world"
_BODY: Final = {mount: mount.value.partition("_")[0] for mount in Mount}  # the body that a receiver is on
# Diameter and width of wheels, m. The machine file has none; these are usual ones, as are the sizes below.
_FRONT: Final = (1.4, 0.45)
_REAR: Final = (1.9, 0.6)
_CART: Final = (1.7, 0.6)
_GREEN: Final = (0.17, 0.42, 0.15)
_YELLOW: Final = (0.9, 0.75, 0.1)
_VIOLET: Final = (0.42, 0.25, 0.6)
_BLACK: Final = (0.12, 0.12, 0.12)
_WHITE: Final = (0.95, 0.95, 0.95)

_Vector = tuple[float, float, float]


def body_frames(machine: Machine, pose: Pose) -> BodyFrames | None:
    """The transforms of a pose's bodies; None if no body has a position and a heading."""
    tractor, implement = machine.tractor, machine.implement
    transforms = [
        *_body("tractor", pose.tractor, tractor.cg_height.value),
        *_body("implement", pose.implement, implement.cg_height.value),
    ]
    if not transforms:
        return None
    if pose.wheel_angle is not None and transforms[0].child == "tractor":
        rotation = _yaw_quaternion(-pose.wheel_angle)
        transforms += [
            Transform("tractor", f"tractor_front_{side}", (tractor.a.value, y, up), rotation)
            for side, y in _sides(machine.tyres.front, TABLE_5_1.w_f)
            for up in (_FRONT[0] / 2 - tractor.cg_height.value,)
        ]
    return BodyFrames(pose.t_ns, tuple(transforms))


def _body(name: str, body: BodyPose, cg_height: float) -> list[Transform]:
    if body.x is None or body.y is None or body.heading is None:
        return []
    roll = body.roll or 0.0
    at = body.y, body.x, cg_height * math.cos(roll)
    return [Transform(WORLD, name, at, body_quaternion(body.heading, roll))]


def body_quaternion(heading: float, roll: float) -> tuple[float, float, float, float]:
    """(x, y, z, w) of a body in the world of viewers. Angles in rad, of this project."""
    _, _, sin_yaw, cos_yaw = _yaw_quaternion(math.pi / 2 - heading)
    sin_roll, cos_roll = math.sin(roll / 2), math.cos(roll / 2)
    # Rotation about z, then about the new x. Roll, right side down, has the same sign in both systems.
    return cos_yaw * sin_roll, sin_yaw * sin_roll, sin_yaw * cos_roll, cos_yaw * cos_roll


def _yaw_quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w) of a rotation about z, anticlockwise seen from above."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def _sides(tyres: Tyre, usual: float) -> tuple[tuple[str, float], tuple[str, float]]:
    width = usual if tyres.track is None else tyres.track.value
    return ("left", width / 2), ("right", -width / 2)


def drawing(machine: Machine, t_ns: int) -> Drawing:
    """The solids of both bodies. Their lengths, axle to axle and to the hitch, are those of the machine
    file."""
    return Drawing(t_ns, (*_tractor(machine), *_implement(machine), *_antennas(machine)))


def _tractor(machine: Machine) -> list[Solid]:
    a, b, c = (getattr(machine.tractor, name).value for name in "abc")
    ground = -machine.tractor.cg_height.value

    def box(name: str, rear: float, front: float, low: float, high: float, width: float) -> Solid:
        return _box("tractor", name, (rear, front), (ground + low, ground + high), width, _GREEN)

    return [
        box("frame", -b, a, 0.6, 1.0, 0.5),
        box("bonnet", 0.3, a + 0.7, 1.0, 1.8, 0.8),
        box("cab", -b - 0.3, 0.3, 1.0, 2.7, 1.5),
        box("drawbar", -c, -b, 0.4, 0.5, 0.1),
        *(
            _wheel("tractor", f"rear_{side}", (-b, y, ground + _REAR[0] / 2), _REAR, _YELLOW)
            for side, y in _sides(machine.tyres.rear, TABLE_5_1.w_r)
        ),
        *(
            _wheel(f"tractor_front_{side}", "wheel", (0.0, 0.0, 0.0), _FRONT, _YELLOW)
            for side, _ in _sides(machine.tyres.front, TABLE_5_1.w_f)
        ),
    ]


def _implement(machine: Machine) -> list[Solid]:
    d, e = machine.implement.d.value, machine.implement.e.value
    ground, front = -machine.implement.cg_height.value, 0.55 * d
    return [
        _box("implement", "tongue", (min(-e, front), d), (ground + 0.4, ground + 0.5), 0.15, _VIOLET),
        _box("implement", "box", (-e - front, front), (ground + 0.9, ground + 2.7), 2.4, _VIOLET),
        *(
            _wheel("implement", side, (-e, y, ground + _CART[0] / 2), _CART, _BLACK)
            for side, y in _sides(machine.tyres.implement, TABLE_5_1.w_i)
        ),
    ]


def _antennas(machine: Machine) -> list[Solid]:
    solids = []
    for receiver in machine.receiver:
        forward, right, height = receiver.position
        body = _BODY[receiver.mount]
        up = height - getattr(machine, body).cg_height.value
        solids.append(Solid(receiver.mount.value, body, (forward, -right, up), (0.2, 0.2, 0.1), _WHITE))
    return solids


def _box(
    frame: str, name: str, along: tuple[float, float], up: tuple[float, float], width: float, colour: _Vector
) -> Solid:
    (rear, front), (low, high) = along, up
    size = (front - rear, width, high - low)
    return Solid(f"{frame}_{name}", frame, ((rear + front) / 2, 0.0, (low + high) / 2), size, colour)


def _wheel(frame: str, name: str, centre: _Vector, size: tuple[float, float], colour: _Vector) -> Solid:
    diameter, width = size
    return Solid(f"{frame}_{name}", frame, centre, (diameter, width, diameter), colour, wheel=True)
