"""The rig's rigid bodies in MuJoCo: tractor, front axle beam on its pin, implement on its ball.

The engine integrates the bodies under gravity and under the forces that simulator/spatial/forces.py applies;
it knows no ground and no contacts. World: x north, y east, z down. Ten degrees of freedom: six of the
tractor, one of the beam about the pin's longitudinal axis, three of the ball at the drawbar's end. MuJoCo is
free software under Apache-2.0 and comes with the extra `spatial`. A suspended front axle has one more.
"""

import importlib
import importlib.util
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.schemas.invocation import installing
from tilth.simulator.scenario import CannotBeDriven
from tilth.simulator.spatial.vehicle import BEAM_GYRATION, GRAVITY, PITCH_INERTIA, Vehicle, static_loads

Array = NDArray[np.float64]

TRACTOR, BEAM, IMPLEMENT = 1, 2, 3  # numbers of the engine's bodies
GYRATIONS: Final = (0.2, 3.005, 0.01)  # m, from, to and by: those that a scenario may give
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
    package = importlib.import_module("mujoco")
    # Its warnings would go to MUJOCO_LOG.TXT where one stands; plant.check_upright looks for what they tell.
    package.set_mju_user_warning(lambda text: None)
    return package


def engine(vehicle: Vehicle, step: float) -> tuple[Any, Any]:
    """MuJoCo's model and data of a rig that stands at the origin, heading north. Raises NotInstalled."""
    model = mujoco().MjModel.from_xml_string(_mjcf(vehicle, step))
    data = mujoco().MjData(model)
    data.qpos[2] = -vehicle.masses.h_t
    mujoco().mj_forward(model, data)
    return model, data


def check_inertia(vehicle: Vehicle) -> None:
    """Raises CannotBeDriven where no distribution of a body's mass rolls as it is to."""
    for k, name in enumerate(("tractor", "implement")):
        if _is_a_body(_inertias(vehicle)[k]):
            continue
        given, fitting = list(vehicle.roll_gyration), []
        for radius in np.arange(*GYRATIONS).tolist():
            given[k] = radius
            if _is_a_body(_inertias(vehicle._replace(roll_gyration=(given[0], given[1])))[k]):
                fitting.append(radius)
        cure = f"give {fitting[0]:.2f} to {fitting[-1]:.2f}" if fitting else "check its yaw_inertia"
        raise CannotBeDriven(
            f"spatial.roll_gyration[{k + 1}] = {vehicle.roll_gyration[k]:g} m: no body with the mass and yaw "
            f"inertia of the {name} has it; {cure}"
        )


def _is_a_body(inertia: Tensor) -> bool:
    """Whether some distribution of mass has this inertia."""
    least, middle, most = np.linalg.eigvalsh(inertia)
    return bool(least > 0.0 and least + middle >= most)


def _pin(vehicle: Vehicle) -> Array:
    """Of the front axle, in the frame of T, z down, m."""
    m = vehicle.masses
    return np.array([m.a, 0.0, m.h_t - vehicle.pin_height])


def _inertias(vehicle: Vehicle) -> tuple[Tensor, Tensor, Tensor]:
    """Of the tractor without its front axle, of the implement and of the front axle, each about its CG."""
    m = vehicle.masses
    pin, beam = _pin(vehicle), vehicle.beam_mass
    side = BEAM_GYRATION[0] * vehicle.track[0] / 2
    beam_inertia = beam * np.diag([side**2, BEAM_GYRATION[1] ** 2, side**2])
    roll_t, roll_i = vehicle.roll_gyration
    whole = np.diag([m.m_t * roll_t**2, PITCH_INERTIA * m.I_t, m.I_t])
    chassis = m.m_t - beam
    centre = -beam / chassis * pin
    inertia = whole - _about(beam, pin) - _about(chassis, centre)
    inertia -= np.diag([0.0, beam_inertia[1, 1], beam_inertia[2, 2]])  # the beam rolls by itself
    cart = np.diag([m.m_i * roll_i**2, PITCH_INERTIA * m.I_i, m.I_i])
    return inertia, cart, beam_inertia


def _mjcf(vehicle: Vehicle, step: float) -> str:
    m = vehicle.masses
    beam = vehicle.beam_mass
    chassis, pin = m.m_t - beam, _pin(vehicle)
    centre = -beam / chassis * pin
    inertia, cart, beam_inertia = _inertias(vehicle)
    return f"""<mujoco>
  <compiler boundmass="1" balanceinertia="false"/>
  <option timestep="{step!r}" gravity="0 0 {GRAVITY}" integrator="Euler">
    <flag contact="disable" energy="enable" autoreset="disable"/>
  </option>
  <worldbody>
    <body name="tractor">
      <freejoint/>
      <inertial pos="{_numbers(centre)}" mass="{chassis!r}" fullinertia="{_tensor(inertia)}"/>
      <body name="beam" pos="{_numbers(pin)}">
        <joint type="hinge" axis="1 0 0"/>{_suspension(vehicle)}
        <inertial pos="0 0 0" mass="{beam!r}" fullinertia="{_tensor(beam_inertia)}"/>
      </body>
      <body name="implement" pos="{_numbers([-m.c - m.d, 0.0, m.h_t - m.h_i])}">
        <joint type="ball" pos="{_numbers([m.d, 0.0, m.h_i - vehicle.hitch_height])}"/>
        <inertial pos="0 0 0" mass="{m.m_i!r}" fullinertia="{_tensor(cart)}"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""


def _suspension(vehicle: Vehicle) -> str:
    """The joint in which a suspended front axle moves up and down; at rest it is where a rigid one is."""
    stiffness, damping = vehicle.suspension
    if stiffness == 0.0:
        return ""
    at_rest = (static_loads(vehicle)[0] - vehicle.beam_mass * GRAVITY) / stiffness
    return (
        f'<joint type="slide" axis="0 0 1" stiffness="{stiffness!r}" damping="{damping!r}" '
        f'springref="{at_rest!r}"/>'
    )


def _about(mass: float, place: Array) -> Tensor:
    """Inertia of a mass at a place about the origin."""
    return np.asarray(mass * (place @ place * np.eye(3) - np.outer(place, place)))


def _tensor(inertia: Tensor) -> str:
    return _numbers([inertia[at] for at in _UPPER])


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
