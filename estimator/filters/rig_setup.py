"""What the filters need from a machine file."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.models import upright
from tilth.estimator.models.parameters import Rig, rig_of, static_loads, upright_axles
from tilth.estimator.once import once_for_a_machine
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RigSetupTuning:
    """What filters assume of a rig beyond its machine file."""

    slow_share: float = tuned(0.3, "1", "of a position's sd, that varies slowly, in each receiver by itself")
    speed_share: float = tuned(0.4, "1", "sd of the speed over a receiver's: two of them, between fixes")
    damping: float = tuned(0.08, "1", "of the roll modes")
    gyration: float = tuned(0.044, "m/kg^(1/3)", "a tractor's in roll: 0.93 m of one of 9.4 t")
    cart_gyration: float = tuned(0.48, "1", "an implement's, over its track")
    least_upright: float = tuned(0.2, "1", "of its tyres' roll stiffness, that gravity leaves a body")
    small: float = tuned(1e-4, "1", "scale of motions for which the model is linear")


RIG_SETUP: Final = RigSetupTuning()


class RollModes(NamedTuple):
    """How the bodies roll on their tyres, by names of rolling_terms.PARAMETERS."""

    k_t: float  # N m/rad, less what gravity takes off
    k_i: float
    d_t: float  # N m s/rad
    d_i: float
    j_t: float  # kg m^2, about a line through the CG
    j_i: float
    pivot_height: float  # m, of the front axle's pivot above the ground
    k_f: float  # N m/rad, of the front axle about its pivot


class RigSetup(NamedTuple):
    """A machine file as arrays for kernels."""

    geometry: Array  # (9,), as parameters.GEOMETRY
    levers: Array  # (4, 2), forward and right of each receiver, m, in the order of flow.Mount
    middles: Array  # (2, 2), forward and right of the middle of each body's receivers, m
    sds: Array  # (4,): of the wheel angle at a tick, of the slow heading error of either pair (rad), and of
    # the slow lateral error of the implement's antennas relative to the tractor's (m)
    rig: Rig
    roll: RollModes
    heights: Array  # (4,), of antennas above the ground, m; 0 where the receiver corrects for roll
    corrected: Array  # (4,), the same where it does, 0 where it does not
    speed_sd: float  # m/s, of the measured speed
    bank_sd: float = 0.7  # m/s^2, of gravity along the cross slope: 4 degrees
    scale: float = 1.0  # of all motions, which makes the model linear where it is small


def slow_pair_sd(machine: Machine, body: str) -> float | None:
    """Sd of the slow heading error of a body's antenna pair, rad: slow multipath over the baseline.

    None without a pair, or if both antennas are at one place. body: tractor or implement.
    """
    pair = [r for r in machine.receiver if r.mount.body == body]
    if len(pair) != 2:
        return None
    length = math.dist(pair[0].position[:2], pair[1].position[:2])
    return (
        RIG_SETUP.slow_share * math.hypot(*(r.position_sd for r in pair)) / length if length > 0.1 else None
    )


def nominal_roll(machine: Machine) -> RollModes:
    """What masses, CGs, tracks and tyres let expect."""
    rig = rig_of(machine)
    front, rear, implement = upright_axles(machine)
    pin = upright.pivot_height(machine).value
    on_pin = static_loads(rig)[0] * pin  # it tips the front axle, and rights the body that hangs on the pin
    k_t = _left(rear.roll_stiffness, rig.g * rig.m_t * rig.h_t - on_pin)
    k_i = _left(implement.roll_stiffness, rig.g * rig.m_i * rig.h_i)
    j_t = rig.m_t * (RIG_SETUP.gyration * math.cbrt(rig.m_t)) ** 2
    j_i = rig.m_i * (RIG_SETUP.cart_gyration * rig.w_i) ** 2
    d_t = 2 * RIG_SETUP.damping * math.sqrt(k_t * (j_t + rig.m_t * rig.h_t**2))
    d_i = 2 * RIG_SETUP.damping * math.sqrt(k_i * (j_i + rig.m_i * rig.h_i**2))
    return RollModes(k_t, k_i, d_t, d_i, j_t, j_i, pin, _left(front.roll_stiffness, on_pin))


def _left(stiffness: float, gravity: float) -> float:
    """Of a roll stiffness, when gravity has taken its part off."""
    return max(stiffness - gravity, RIG_SETUP.least_upright * stiffness)


def _heights(machine: Machine, corrected: bool) -> Array:
    by_mount = {r.mount: r.position[2] for r in machine.receiver if r.roll_corrected == corrected}
    return np.array([by_mount.get(mount, 0.0) for mount in Mount])


def rig_setup(machine: Machine, linear: bool = False) -> RigSetup:
    """The setup of a machine. linear: small motions of a rig that does not roll, as in models.relaxation."""
    setup = _setup(machine)
    if not linear:
        return setup
    low, modes = (
        setup.rig._replace(h_t=0.0, h_i=0.0, h_h=0.0),
        setup.roll._replace(pivot_height=0.0, k_f=1e30),
    )
    none = np.zeros(4)
    return setup._replace(
        rig=low, roll=modes, heights=none, corrected=none, speed_sd=0.0, bank_sd=0.0, scale=RIG_SETUP.small
    )


@once_for_a_machine
def _setup(machine: Machine) -> RigSetup:
    slow = [slow_pair_sd(machine, body) or 0.0 for body in ("tractor", "implement")]
    slow.append(RIG_SETUP.slow_share * float(np.mean([r.position_sd for r in machine.receiver])))
    sds = np.array([math.radians(machine.wheel_angle.sd) / math.sqrt(2.0), *slow])
    middles, levers = unknowns.pair_middles(machine), unknowns.levers(machine)
    return RigSetup(
        unknowns.base_geometry(machine), levers, middles, sds, rig_of(machine), nominal_roll(machine),
        _heights(machine, False), _heights(machine, True),
        RIG_SETUP.speed_share * float(np.mean([r.velocity_sd for r in machine.receiver])),
    )  # fmt: skip
