"""The rig's rigid bodies in MuJoCo: tractor, front axle beam on its pin, implement on its ball.

The engine integrates the bodies under gravity and under the forces that simulator/spatial/forces.py applies;
it knows no ground and no contacts. World: x north, y east, z down. Ten degrees of freedom: six of the
tractor, one of the beam about the pin's longitudinal axis, three of the ball at the drawbar's end. MuJoCo is
free software under Apache-2.0 and comes with the extra `spatial`.
"""

import importlib
import importlib.util
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.schemas.invocation import installing
from tilth.simulator.spatial.vehicle import BEAM_GYRATION, BEAM_MASS, GRAVITY, PITCH_INERTIA, Vehicle

Array = NDArray[np.float64]

TRACTOR, BEAM, IMPLEMENT = 1, 2, 3  # numbers of the engine's bodies
Tensor = NDArray[np.float64]
"""Inertia, kg m^2, shape (3, 3)."""

_UPPER: Final = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # in MuJoCo's order


class NotInstalled(ValueError):
    """The spatial plant needs a package that is not there; the text says how to install it."""


def check_installed() -> None:
    """Raises NotInstalled."""
    if importlib.util.find_spec("mujoco") is None:
        raise NotInstalled(f"the spatial plant needs one package more: {installing('spatial')}")


@cache
def mujoco() -> Any:
    """The package. Raises NotInstalled."""
    check_installed()
    return importlib.import_module("mujoco")


def engine(vehicle: Vehicle, step: float) -> tuple[Any, Any]:
    """MuJoCo's model and data of a rig that stands at the origin, heading north. Raises NotInstalled."""
    model = mujoco().MjModel.from_xml_string(_mjcf(vehicle, step))
    data = mujoco().MjData(model)
    data.qpos[2] = -vehicle.masses.h_t
    mujoco().mj_forward(model, data)
    return model, data


def _mjcf(vehicle: Vehicle, step: float) -> str:
    m = vehicle.masses
    beam = BEAM_MASS * m.m_t
    pin = np.array([m.a, 0.0, m.h_t - vehicle.pin_height])  # of T, z down
    side = BEAM_GYRATION[0] * vehicle.track[0] / 2
    beam_inertia = beam * np.diag([side**2, BEAM_GYRATION[1] ** 2, side**2])
    roll_t, roll_i = vehicle.roll_gyration
    whole = np.diag([m.m_t * roll_t**2, PITCH_INERTIA * m.I_t, m.I_t])
    chassis = m.m_t - beam
    centre = -beam / chassis * pin
    inertia = whole - _about(beam, pin) - _about(chassis, centre)
    inertia -= np.diag([0.0, beam_inertia[1, 1], beam_inertia[2, 2]])  # the beam rolls by itself
    cart = np.diag([m.m_i * roll_i**2, PITCH_INERTIA * m.I_i, m.I_i])
    return f"""<mujoco>
  <compiler boundmass="1" balanceinertia="false"/>
  <option timestep="{step!r}" gravity="0 0 {GRAVITY}" integrator="Euler">
    <flag contact="disable" energy="enable"/>
  </option>
  <worldbody>
    <body name="tractor">
      <freejoint/>
      <inertial pos="{_numbers(centre)}" mass="{chassis!r}" fullinertia="{_tensor(inertia)}"/>
      <body name="beam" pos="{_numbers(pin)}">
        <joint type="hinge" axis="1 0 0"/>
        <inertial pos="0 0 0" mass="{beam!r}" fullinertia="{_tensor(beam_inertia)}"/>
      </body>
      <body name="implement" pos="{_numbers([-m.c - m.d, 0.0, m.h_t - m.h_i])}">
        <joint type="ball" pos="{_numbers([m.d, 0.0, m.h_i - vehicle.hitch_height])}"/>
        <inertial pos="0 0 0" mass="{m.m_i!r}" fullinertia="{_tensor(cart)}"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""


def _about(mass: float, place: Array) -> Tensor:
    """Inertia of a mass at a place about the origin."""
    return np.asarray(mass * (place @ place * np.eye(3) - np.outer(place, place)))


def _tensor(inertia: Tensor) -> str:
    return _numbers([inertia[at] for at in _UPPER])


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
