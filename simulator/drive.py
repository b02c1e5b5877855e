"""A run of a virtual tractor, on the plant that its scenario names."""

from collections.abc import Callable

from tilth.schemas.machine import Machine
from tilth.simulator.autosteers import autosteer_of
from tilth.simulator.pilots import Driver, driver_of
from tilth.simulator.scenario import Scenario
from tilth.simulator.spatial_run import drive_spatial
from tilth.simulator.tractor import Setting, Truth, integrate, setting_of


def drive(
    machine: Machine,
    seed: int,
    seconds: float,
    scenario: Scenario | None = None,
    *,
    progress: Callable[[float], None] | None = None,
    driven_by: Callable[[Setting], Driver] | None = None,
) -> Truth:
    """Drive the machine of a machine file for so long. `progress` is told the seconds driven.

    driven_by: instead of the scenario's own driver. Raises ValueError where the machine is none that can be
    driven, and, which are such too, CannotBeDriven where the scenario asks too much of it and NotInstalled
    where the spatial plant lacks its package.
    """
    scenario = scenario or Scenario()
    setting = setting_of(machine, seed, seconds, scenario)
    return drive_in(
        setting, driver_in(machine, setting) if driven_by is None else driven_by(setting), progress
    )


def driver_in(machine: Machine, setting: Setting) -> Driver:
    """The driver of the setting's scenario."""
    autosteer = autosteer_of(machine, setting)
    return driver_of(setting.scenario, setting.believed, setting.time, setting.seed, autosteer)


def drive_in(setting: Setting, driver: Driver, progress: Callable[[float], None] | None = None) -> Truth:
    """`drive`, with what is drawn as it is. Raises CannotBeDriven, NotInstalled."""
    if setting.scenario.plant == "spatial":
        return drive_spatial(setting, driver, progress)
    states, theta = integrate(setting.rig, driver, setting.land, setting.soil, setting.time, progress)
    return setting.truth(setting.time, 0.0, states, theta)
