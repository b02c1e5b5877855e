"""The virtual tractor in space, driven: the engine's steps between the samples of a run.

Steering is kinematic: the wheel angle is the commanded one, or what a hydraulic valve makes of a command.
A proportional and integral governor holds the speed, so that a rig with a target speed of zero stands on any
slope. The rig stands and settles before the run begins.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.simulator.scenario import STEP_S, CannotBeDriven
from tilth.simulator.spatial.engine import IMPLEMENT, TRACTOR, engine, mujoco
from tilth.simulator.spatial.forces import TYRE_COLUMNS, TyreSet, apply_forces, tyres_of
from tilth.simulator.spatial.height_field import HeightField, height
from tilth.simulator.spatial.vehicle import SETTLING_DAMPING, Vehicle

Array = NDArray[np.float64]

MOST_TILT_DEG: Final = 45.0  # of either body: a rig that leans so far has turned over, or soon will
SETTLING_S: Final = 2.0
BODIES: Final = (TRACTOR, IMPLEMENT)
BODY_COLUMNS: Final = (
    "north", "east", "down", "roll", "pitch", "heading", "forward", "right", "roll_rate", "pitch_rate",
    "yaw_rate", "gyro_x", "gyro_y", "gyro_z",
)  # fmt: skip
"""Of each body: place of its CG in the world, m; Euler angles (heading, pitch, roll), rad, the heading not
wrapped; horizontal velocity of the CG along and across the heading, m/s; rates of those angles, rad/s; turn
rates about its own axes, rad/s."""
AT: Final = {name: k for k, name in enumerate(BODY_COLUMNS)}

_OF_THE_TRACTOR: Final = [AT[name] for name in ("north", "east", "heading", "forward", "right", "yaw_rate")]
_OF_THE_IMPLEMENT: Final = [AT["heading"], AT["yaw_rate"]]
_SLIP: Final = TYRE_COLUMNS.index("slip")


class SteeringSource(Protocol):
    """Who steers: the part of simulator/pilots.py's Driver that the plant needs."""

    def steer(self, k: int, end: int, x: Array) -> tuple[Array | float, Array | float]: ...


@dataclass(frozen=True, slots=True)
class Motion:
    """What the plant did, at samples STEP_S apart."""

    states: (
        Array  # (n, 13), as the planar plant's: CGs, headings, velocities, mean slip, wheel angle and rate
    )
    bodies: Array  # (n, 2, len(BODY_COLUMNS)), tractor and implement
    tyres: Array  # (n, 6, len(TYRE_COLUMNS))
    beam: Array  # (n,), rad, of the front axle about its pin, right side down of the tractor
    drive: Array  # (n,), N
    soil: Array  # (n, 6), PARAMETERS under each axle


@dataclass(frozen=True, slots=True)
class Space:
    """The truth of a spatial run: what the rig is made of, and what it did."""

    vehicle: Vehicle
    motion: Motion


@dataclass(slots=True)
class SpatialPlant:
    """The engine with its tyres and its governor, at one instant."""

    vehicle: Vehicle
    ground: HeightField
    step: float  # s
    tyres: TyreSet = field(init=False)
    model: Any = field(init=False)
    data: Any = field(init=False)
    slip: Array = field(init=False)  # (6,), tangents
    tyre_rows: Array = field(init=False)  # (6, len(TYRE_COLUMNS)), of the last step
    drive: Array = field(default_factory=lambda: np.zeros(2))  # N; m, what the governor has added up
    soil: Array = field(default_factory=lambda: np.zeros(6))
    turns: list[float] = field(default_factory=lambda: [0.0, 0.0])  # headings of the last look, not wrapped
    _carried: float = 1.0
    _engine: tuple[Array, ...] = field(init=False)  # views of the engine's places and velocities
    _forces: Array = field(init=False)

    def __post_init__(self) -> None:
        """Raises NotInstalled."""
        self.tyres = tyres_of(self.vehicle)
        self.model, self.data = engine(self.vehicle, self.step)
        self.slip, self.tyre_rows = np.zeros(6), np.zeros((6, len(TYRE_COLUMNS)))
        data = self.data
        self._engine = (data.xpos, data.xmat, data.xipos, data.cvel, data.subtree_com)
        self._forces = data.xfrc_applied

    def carry(self, factor: float) -> None:
        """The implement has so many times its mass and inertia; its CG stays."""
        if factor == self._carried:
            return
        for of_bodies in (self.model.body_mass, self.model.body_inertia):
            of_bodies[IMPLEMENT] *= factor / self._carried
        self._carried = factor
        mujoco().mj_setConst(self.model, mujoco().MjData(self.model))

    def kinematics(self) -> None:
        """Places and velocities of all bodies at this instant: the first half of a step."""
        mujoco().mj_step1(self.model, self.data)

    def advance(self, delta: float, target_speed: float, tyres: TyreSet | None = None) -> None:
        """Forces, and the second half of a step.

        delta: mean wheel angle amid the step, rad. target_speed: m/s.
        """
        xpos, xmat, xipos, cvel, com = self._engine
        apply_forces(
            self.ground, tyres or self.tyres, self.soil, delta, target_speed, self.step,
            xpos, xmat, xipos, cvel, com, self.slip, self.drive, self._forces, self.tyre_rows,
        )  # fmt: skip
        mujoco().mj_step2(self.model, self.data)

    def bodies(self) -> Array:
        """BODY_COLUMNS of tractor and implement, after `kinematics`, shape (2, len(BODY_COLUMNS))."""
        rows = np.empty((2, len(BODY_COLUMNS)))
        xpos, xmat, _, cvel, com = self._engine
        for k, body in enumerate(BODIES):
            body_motion(xpos[body], xmat[body], cvel[body], com[TRACTOR], self.turns[k], rows[k])
            self.turns[k] = float(rows[k, 5])
        return rows


@kernel
def body_motion(place: Array, turn: Array, twist: Array, root: Array, before: float, out: Array) -> None:
    """Fill out, shape (len(BODY_COLUMNS),), with what BODY_COLUMNS says of one body.

    turn: its axes as columns, shape (9,), row by row. twist: its turn rate and the velocity of the point
    `root`, shape (6,). before: its heading at the last look, rad.
    """
    psi = math.atan2(turn[3], turn[0])
    psi += 2.0 * math.pi * math.floor((before - psi) / (2.0 * math.pi) + 0.5)  # the turn that is nearest
    pitch, roll = -math.asin(turn[6]), math.atan2(turn[7], turn[8])
    x, y, z = place[0] - root[0], place[1] - root[1], place[2] - root[2]
    north = twist[3] + twist[1] * z - twist[2] * y
    east = twist[4] + twist[2] * x - twist[0] * z
    for i in range(3):
        out[i] = place[i]
        out[11 + i] = turn[i] * twist[0] + turn[3 + i] * twist[1] + turn[6 + i] * twist[2]
    sine, cosine = math.sin(psi), math.cos(psi)
    yaw_rate = (out[12] * math.sin(roll) + out[13] * math.cos(roll)) / math.cos(pitch)
    out[3], out[4], out[5] = roll, pitch, psi
    out[6], out[7] = north * cosine + east * sine, east * cosine - north * sine
    out[8] = out[11] + yaw_rate * math.sin(pitch)
    out[9] = out[12] * math.cos(roll) - out[13] * math.sin(roll)
    out[10] = yaw_rate


def settled_plant(
    vehicle: Vehicle, ground: HeightField, step: float, heading: float, soil: Array, carried: float = 1.0
) -> SpatialPlant:
    """A plant that stands settled at the origin, both bodies heading there. soil: shape (6,). carried: as of
    SpatialPlant.carry.

    Raises CannotBeDriven.
    """
    plant = SpatialPlant(vehicle, ground, step)
    plant.carry(carried)
    plant.soil = np.ascontiguousarray(soil, np.float64)
    up, north, east = height(ground, 0.0, 0.0)
    plane_north, plane_east = (north, east) if not len(ground.rough) else map(float, ground.plane)
    ahead = plane_north * math.cos(heading) + plane_east * math.sin(heading)
    lateral_offset = plane_east * math.cos(heading) - plane_north * math.sin(heading)
    plant.data.qpos[2] = -up - vehicle.masses.h_t
    plant.data.qpos[3:7] = _quaternion(-math.atan(lateral_offset), math.atan(ahead), heading)
    thick = plant.tyres._replace(damping=SETTLING_DAMPING * plant.tyres.damping)
    for _ in range(round(SETTLING_S / step)):
        plant.kinematics()
        plant.advance(0.0, 0.0, thick)
    plant.data.time = 0.0
    check_upright(plant.bodies(), ground, None)
    plant.turns = [heading, heading]
    return plant


def check_upright(rows: Array, ground: HeightField, at_s: float | None) -> None:
    """Raises CannotBeDriven where a body has turned over.

    rows: as SpatialPlant.bodies. at_s: when, s; None before the run begins.
    """
    tilts = np.degrees(np.abs(rows[:, [AT["roll"], AT["pitch"]]]))
    if np.isfinite(rows).all() and tilts.max() <= MOST_TILT_DEG:
        return
    when = "before it sets off" if at_s is None else f"at {at_s:.2f} s"
    if not np.isfinite(rows).all():
        raise CannotBeDriven(
            f"the rig's motion grows beyond all numbers {when}; "
            "give a lower speed, a smaller spatial.step, or softer tyres"
        )
    k, angle = np.unravel_index(np.argmax(tilts), tilts.shape)
    north, east = rows[k, [AT["north"], AT["east"]]]
    where = f"{abs(north):.1f} m {'south' if north < 0 else 'north'} and "
    where += f"{abs(east):.1f} m {'west' if east < 0 else 'east'} of the start"
    cures = ["a lower speed", "smaller wheel angles"] if at_s else []
    cures += ["lower bumps with longer ramps"] if len(ground.bump) else []
    cures += ["a smaller ground.rms"] if len(ground.rough) else []
    body, tilt = ("tractor", "implement")[k], ("roll", "pitch")[angle]
    raise CannotBeDriven(
        f"the {body} turns over {when}, {where}: its {tilt} passes {MOST_TILT_DEG:g}°; "
        f"give {', '.join([*cures, 'stiffer tyres'])} or a wider track"
    )


def _quaternion(roll: float, pitch: float, heading: float) -> Array:
    """w, x, y, z of a body with these Euler angles, rad."""
    sr, cr = math.sin(roll / 2), math.cos(roll / 2)
    sp, cp = math.sin(pitch / 2), math.cos(pitch / 2)
    sh, ch = math.sin(heading / 2), math.cos(heading / 2)
    return np.array([
        ch * cp * cr + sh * sp * sr,
        ch * cp * sr - sh * sp * cr,
        ch * sp * cr + sh * cp * sr,
        sh * cp * cr - ch * sp * sr,
    ])  # fmt: skip


def _set_going(plant: SpatialPlant, speed: float) -> None:
    """Give the rig its first speed, m/s, along the tractor."""
    plant.data.qvel[:3] += speed * plant.data.xmat[TRACTOR, 0::3]


def _state(plant: SpatialPlant, rows: Array, delta: float, rate: float) -> Array:
    """As Motion.states, shape (13,)."""
    t, i = rows
    x = np.empty(13)
    x[[0, 1, 2, 4, 5, 6]] = t[_OF_THE_TRACTOR]
    x[[3, 7]] = i[_OF_THE_IMPLEMENT]
    slip = plant.tyre_rows[:, _SLIP]
    x[8:11] = (slip[0::2] + slip[1::2]) / 2
    x[11], x[12] = delta, rate
    return x


def run(
    plant: SpatialPlant,
    start: Array,
    steering: SteeringSource,
    valve: tuple[float, float] | None,
    soil: Callable[[float, Array], Array],
    n: int,
    hold: int,
    progress: Callable[[float], None] | None = None,
    carried: Callable[[float], float] = lambda t: 1.0,
) -> Motion:
    """Drive for n samples; `steering` gives commands for every `hold` of them.

    start: first state, shape (13,), of which speed and wheel angle are taken. valve: wheel's angular
    acceleration per command, 1/s^2, and its damping, 1/s; None: the wheels are turned directly. soil: of time
    and state, shape (6,). carried: of time, as of SpatialPlant.carry. Raises CannotBeDriven.
    """
    substeps = round(STEP_S / plant.step)
    into = Motion(
        np.zeros((n, 13)), np.zeros((n, 2, len(BODY_COLUMNS))), np.zeros((n, 6, len(TYRE_COLUMNS))),
        np.zeros(n), np.zeros(n), np.zeros((n, 6)),
    )  # fmt: skip
    _set_going(plant, float(start[4]))
    delta, rate = float(start[11]), 0.0
    plant.kinematics()
    for k in range(0, n, hold):
        end = min(k + hold, n)
        rows = plant.bodies()
        check_upright(rows, plant.ground, k * STEP_S)
        x = _state(plant, rows, delta, rate)
        pair = steering.steer(k, min(end, n - 1), x)
        shape = (min(end, n - 1) - k + 1,)
        commands, speeds = (np.broadcast_to(np.asarray(one, np.float64), shape).tolist() for one in pair)
        plant.soil = np.ascontiguousarray(soil(k * STEP_S, x), np.float64)
        plant.carry(carried(k * STEP_S))
        for j in range(k, end):
            now, after = j - k, min(j - k + 1, len(commands) - 1)
            if valve is None:
                delta, rate = commands[now], (commands[after] - commands[now]) / STEP_S
            rows, beam = plant.bodies(), float(plant.data.qpos[7])
            check_upright(rows, plant.ground, j * STEP_S)
            at_sample = delta, rate
            for s in range(substeps):
                share = (s + 0.5) / substeps
                command = commands[now] + share * (commands[after] - commands[now])
                if valve is not None:
                    rate += plant.step * (valve[0] * command - valve[1] * rate)
                    delta += plant.step * rate
                amid = command if valve is None else delta - 0.5 * plant.step * rate
                plant.advance(amid, speeds[now] + share * (speeds[after] - speeds[now]))
                if s == 0:
                    into.states[j], into.bodies[j] = _state(plant, rows, *at_sample), rows
                    into.tyres[j], into.soil[j] = plant.tyre_rows, plant.soil
                    into.drive[j], into.beam[j] = plant.drive[0], beam
                plant.kinematics()
        if progress is not None:
            progress(k * STEP_S)
    return into
