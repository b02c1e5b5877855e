"""A scenario on the spatial plant, from what is drawn to what was true. simulator/drive.py calls it."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tilth.simulator import noise
from tilth.simulator.noise import generator
from tilth.simulator.pilots import HOLD, Driver
from tilth.simulator.scenario import STEP_S
from tilth.simulator.spatial.engine import check_inertia
from tilth.simulator.spatial.height_field import height_field
from tilth.simulator.spatial.plant import AT, Space, run, settled_plant
from tilth.simulator.spatial.vehicle import Masses, Vehicle, check_tyres, vehicle_of
from tilth.simulator.tractor import BodyTrack, Setting, Truth, rig_seed

Array = NDArray[np.float64]


def vehicle_in(setting: Setting) -> Vehicle:
    """The rig of a run in space, drawn where the scenario says so."""
    masses = Masses(*(getattr(setting.rig, name) for name in Masses._fields))
    drawn = generator(rig_seed(setting.scenario, setting.seed), noise.SPATIAL)
    return vehicle_of(masses, setting.scenario, drawn)


def drive_spatial(setting: Setting, driver: Driver, progress: Callable[[float], None] | None) -> Truth:
    """Raises NotInstalled, CannotBeDriven."""
    scenario, vehicle = setting.scenario, vehicle_in(setting)
    ground = height_field(scenario.ground, vehicle.rms, generator(setting.seed, noise.GROUND))
    step = STEP_S / math.ceil(STEP_S / scenario.spatial.step - 1e-9)
    check_inertia(vehicle)
    # Tyres follow their loads here by themselves; what they come to is for the truth.
    loads = tuple(replace(change, exponent=vehicle.load_exponent) for change in setting.soil.loads)
    by_load, soil = replace(setting.soil, loads=loads), replace(setting.soil, loads=())

    def carried(t: float) -> float:
        return by_load.rig_at(t).m_i / setting.rig.m_i

    for factor in {1.0, *(carried(change.at_s + change.over) for change in loads)}:
        masses = vehicle.masses._replace(m_i=factor * vehicle.masses.m_i, I_i=factor * vehicle.masses.I_i)
        check_tyres(vehicle._replace(masses=masses), step)
    start = driver.start()
    plant = settled_plant(vehicle, ground, step, float(start[2]), soil.theta, carried(0.0))
    act = driver.actuator
    valve = None if act is None else (act.gain / act.inertia, act.damping / act.inertia)
    motion = run(plant, start, driver, valve, soil.at, len(setting.time), HOLD, progress, carried)
    under_axles = motion.soil * np.exp(by_load.by_load(setting.time))
    front, rear, implement = vehicle.track
    rig = setting.rig._replace(
        w_f=front,
        w_r=rear,
        w_i=implement,
        h_h=vehicle.hitch_height,
        load_exponent=vehicle.load_exponent,
        front_drive=vehicle.front_drive,
        **dict.fromkeys(("grip_f", "grip_r", "grip_i"), vehicle.grip),
    )
    tractor, cart = (_track(motion.bodies[:, k]) for k in range(2))
    return Truth(
        setting.seed, scenario, setting.parameters, rig.geometry, setting.nuisances, setting.time,
        motion.states[:, -2], tractor, cart, rig, under_axles, motion.states, Space(vehicle, motion),
    )  # fmt: skip


def _track(rows: Array) -> BodyTrack:
    """One body's, of plant.BODY_COLUMNS, shape (n, len(BODY_COLUMNS))."""
    names = ("north", "east", "heading", "forward", "right", "yaw_rate", "roll", "pitch", "gyro_z")
    return BodyTrack(*(np.ascontiguousarray(rows[:, AT[name]]) for name in names))
