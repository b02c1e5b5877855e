"""How much of the wheel angle of a simulated drive is the steering's own.

The drive is made again on even ground and with receivers that make no error, all else as it was: rig, soil,
side slope, speed, what the steering itself brings (simulator/autosteers.py). What the wheels still do is its
own. What only answers the ground, or errors that Tilth hears as well, is gone.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.schemas.machine import Machine
from tilth.simulator import noise
from tilth.simulator.drive import drive_in, driver_in
from tilth.simulator.ground import terrain
from tilth.simulator.noise import generator
from tilth.simulator.scenario import STEP_S
from tilth.simulator.tractor import Setting, Truth, setting_of

Array = NDArray[np.float64]


class Own(NamedTuple):
    """rms of the wheel angle about its mean, degrees: as driven, and of what is the steering's own."""

    driven_deg: float
    own_deg: float

    @property
    def share(self) -> float:
        """Of the variance. More than 1 where uneven ground quenches a limit cycle."""
        return (self.own_deg / self.driven_deg) ** 2 if self.driven_deg else 0.0


def quiet(setting: Setting) -> Setting:
    """The same drive on even ground, with receivers that make no error."""
    scenario = setting.scenario
    rms = 0.0 if scenario.plant == "spatial" else None
    ground = replace(scenario.ground, roll_sd_deg=0.0, force_sd=0.0, bumps=(), rms=rms)
    land = terrain(ground, scenario.roll_deg, setting.rig, generator(setting.seed, noise.GROUND))
    return replace(setting, scenario=replace(scenario, ground=ground, noise=0.0), land=land)


def own_of(machine: Machine, truth: Truth, seconds: tuple[float, float]) -> Own:
    """Of a stretch (from, to, s) of a drive, which is driven anew. The seed is that of the drive."""
    setting = quiet(setting_of(machine, truth.seed, float(truth.time[-1]), truth.scenario))
    again = drive_in(setting, driver_in(machine, setting))
    return Own(*(_rms(made.wheel_angle, seconds) for made in (truth, again)))


def _rms(wheel_angle: Array, seconds: tuple[float, float]) -> float:
    begin, end = (round(at / STEP_S) for at in seconds)
    return math.degrees(float(np.std(wheel_angle[begin:end])))
