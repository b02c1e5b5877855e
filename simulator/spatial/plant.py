"""The virtual tractor in space, driven: the engine's steps between the samples of a run.

Steering is kinematic: a wheel angle is what it is asked to be, or what a hydraulic valve makes of a command.
The drive holds the speed by a proportional and integral governor, so that a rig that is told to stand stands
on any slope. It stands and settles before the run begins.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from tilth.simulator.scenario import STEP_S
from tilth.simulator.spatial.engine import IMPLEMENT, TRACTOR, engine, mujoco
from tilth.simulator.spatial.forces import TOLD, TyreSet, apply_forces, tyres_of
from tilth.simulator.spatial.height_field import HeightField, height
from tilth.simulator.spatial.vehicle import Vehicle

Array = NDArray[np.float64]

SETTLING_S: Final = 2.0
SETTLING_DAMPING: Final = 6.0  # times that of the tyres, meanwhile
BODIES: Final = (TRACTOR, IMPLEMENT)
MOVED: Final = (
    "north", "east", "down", "roll", "pitch", "heading", "forward", "right", "roll_rate", "pitch_rate",
    "yaw_rate", "gyro_x", "gyro_y", "gyro_z",
)  # fmt: skip
"""Of each body: place of its CG in the world, m; Euler angles (heading, pitch, roll), rad, the heading not
wrapped; horizontal velocity of the CG along and across the heading, m/s; rates of those angles, rad/s; turn
rates about its own axes, rad/s."""
AT: Final = {name: k for k, name in enumerate(MOVED)}


class Hand(Protocol):
    """Who steers: the part of simulator/pilots.py's Driver that the plant needs."""

    def steer(self, k: int, end: int, x: Array) -> tuple[Array | float, Array | float]: ...


@dataclass(frozen=True, slots=True)
class Motion:
    """What the plant did, at samples STEP_S apart."""

    states: (
        Array  # (n, 13), as the planar plant's: CGs, headings, velocities, mean slip, wheel angle and rate
    )
    bodies: Array  # (n, 2, len(MOVED)), tractor and implement
    tyres: Array  # (n, 6, len(TOLD))
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
    told: Array = field(init=False)  # (6, len(TOLD)), of the last step
    drive: Array = field(default_factory=lambda: np.zeros(2))  # N; m, what the governor has added up
    soil: Array = field(default_factory=lambda: np.zeros(6))
    turns: list[float] = field(default_factory=lambda: [0.0, 0.0])  # headings of the last look, not wrapped
    _engine: tuple[Array, ...] = field(init=False)  # views of the engine's places and velocities
    _forces: Array = field(init=False)

    def __post_init__(self) -> None:
        """Raises NotInstalled."""
        self.tyres = tyres_of(self.vehicle)
        self.model, self.data = engine(self.vehicle, self.step)
        self.slip, self.told = np.zeros(6), np.zeros((6, len(TOLD)))
        data = self.data
        self._engine = (data.xpos, data.xmat, data.xipos, data.cvel, data.subtree_com)
        self._forces = data.xfrc_applied

    def kinematics(self) -> None:
        """Places and velocities of all bodies at this instant: the first half of a step."""
        mujoco().mj_step1(self.model, self.data)

    def advance(self, delta: float, wanted: float, tyres: TyreSet | None = None) -> None:
        """Forces, and the second half of a step. delta: mean wheel angle amid the step, rad; wanted: m/s."""
        xpos, xmat, xipos, cvel, com = self._engine
        apply_forces(
            self.ground, tyres or self.tyres, self.soil, delta, wanted, self.step,
            xpos, xmat, xipos, cvel, com, self.slip, self.drive, self._forces, self.told,
        )  # fmt: skip
        mujoco().mj_step2(self.model, self.data)

    def bodies(self) -> Array:
        """MOVED of tractor and implement, after `kinematics`, shape (2, len(MOVED))."""
        rows = np.empty((2, len(MOVED)))
        root = self.data.subtree_com[TRACTOR]
        for k, body in enumerate(BODIES):
            place, turn, twist = self.data.xpos[body], self.data.xmat[body], self.data.cvel[body]
            rows[k] = _moved(place, turn.reshape(3, 3), twist, root, self.turns[k])
            self.turns[k] = rows[k, AT["heading"]]
        return rows


def _moved(place: Array, turn: Array, twist: Array, root: Array, before: float) -> Array:
    """As SpatialPlant.bodies, of one. turn: its axes as columns; twist: turn rate and velocity of `root`."""
    psi = math.atan2(turn[1, 0], turn[0, 0])
    psi = before + math.remainder(psi - before, math.tau)
    pitch, roll = -math.asin(turn[2, 0]), math.atan2(turn[2, 1], turn[2, 2])
    velocity = twist[3:] + np.cross(twist[:3], place - root)
    gyro = turn.T @ twist[:3]
    sine, cosine = math.sin(psi), math.cos(psi)
    across = gyro[1] * math.sin(roll) + gyro[2] * math.cos(roll)
    yaw_rate = across / math.cos(pitch)
    return np.array([
        *place, roll, pitch, psi,
        velocity[0] * cosine + velocity[1] * sine,
        velocity[1] * cosine - velocity[0] * sine,
        gyro[0] + yaw_rate * math.sin(pitch),
        gyro[1] * math.cos(roll) - gyro[2] * math.sin(roll),
        yaw_rate, *gyro,
    ])  # fmt: skip


def placed(vehicle: Vehicle, ground: HeightField, step: float, heading: float, soil: Array) -> SpatialPlant:
    """A plant that stands settled at the origin, both bodies heading there. soil: shape (6,)."""
    plant = SpatialPlant(vehicle, ground, step)
    plant.turns = [heading, heading]
    plant.soil = np.ascontiguousarray(soil, np.float64)
    up, north, east = height(ground, 0.0, 0.0)
    plane_north, plane_east = (north, east) if not len(ground.wave) else map(float, ground.plane)
    ahead = plane_north * math.cos(heading) + plane_east * math.sin(heading)
    aside = plane_east * math.cos(heading) - plane_north * math.sin(heading)
    plant.data.qpos[2] = -up - vehicle.masses.h_t
    plant.data.qpos[3:7] = _quaternion(-math.atan(aside), math.atan(ahead), heading)
    thick = plant.tyres._replace(damping=SETTLING_DAMPING * plant.tyres.damping)
    for _ in range(round(SETTLING_S / step)):
        plant.kinematics()
        plant.advance(0.0, 0.0, thick)
    plant.data.time = 0.0
    return plant


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
    alpha = plant.told[:, TOLD.index("slip")].reshape(3, 2).mean(axis=1)
    return np.array([
        t[AT["north"]], t[AT["east"]], t[AT["heading"]], i[AT["heading"]], t[AT["forward"]], t[AT["right"]],
        t[AT["yaw_rate"]], i[AT["yaw_rate"]], *alpha, delta, rate,
    ])  # fmt: skip


def run(
    plant: SpatialPlant,
    start: Array,
    hand: Hand,
    valve: tuple[float, float] | None,
    soil: Callable[[float, Array], Array],
    n: int,
    hold: int,
    progress: Callable[[float], None] | None = None,
) -> Motion:
    """Drive for n samples; `hand` is asked every `hold` of them.

    start: first state, shape (13,), of which speed and wheel angle are taken. valve: wheel's angular
    acceleration per command, 1/s^2, and its damping, 1/s; None: the wheels are turned directly. soil: of time
    and state, shape (6,).
    """
    substeps = round(STEP_S / plant.step)
    into = Motion(
        np.zeros((n, 13)), np.zeros((n, 2, len(MOVED))), np.zeros((n, 6, len(TOLD))),
        np.zeros(n), np.zeros(n), np.zeros((n, 6)),
    )  # fmt: skip
    _set_going(plant, float(start[4]))
    delta, rate = float(start[11]), 0.0
    plant.kinematics()
    x = _state(plant, plant.bodies(), delta, rate)
    for k in range(0, n, hold):
        end = min(k + hold, n)
        told = hand.steer(k, min(end, n - 1), x)
        asked, speeds = (
            np.broadcast_to(np.asarray(one, np.float64), (min(end, n - 1) - k + 1,)) for one in told
        )
        plant.soil = np.ascontiguousarray(soil(k * STEP_S, x), np.float64)
        for j in range(k, end):
            after = min(j - k + 1, len(asked) - 1)
            for s in range(substeps):
                share = (s + 0.5) / substeps
                command = asked[j - k] + share * (asked[after] - asked[j - k])
                if valve is None:
                    rate = (asked[after] - asked[j - k]) / STEP_S
                    delta = float(command)
                if j > k or s > 0 or k > 0:
                    plant.kinematics()
                wanted = speeds[j - k] + share * (speeds[after] - speeds[j - k])
                rows = plant.bodies() if s == 0 else None
                plant.advance(delta, float(wanted))
                if rows is not None:
                    x = _state(plant, rows, delta, rate)
                    _record(into, j, plant, x, rows)
                if valve is not None:
                    rate += plant.step * (valve[0] * float(command) - valve[1] * rate)
                    delta += plant.step * rate
        if progress is not None:
            progress(k * STEP_S)
    return into


def _record(into: Motion, j: int, plant: SpatialPlant, x: Array, rows: Array) -> None:
    into.states[j], into.bodies[j], into.tyres[j] = x, rows, plant.told
    into.drive[j], into.soil[j] = plant.drive[0], plant.soil
    into.beam[j] = plant.data.qpos[7]
