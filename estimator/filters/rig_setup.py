"""What the filters need from a machine file."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.models.parameters import Rig, rig_of, static_loads
from tilth.estimator.models.rolling import RollModes
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

SLOW_SHARE: Final = 0.3  # share of a position's sd that varies slowly and is independent between receivers


class RigSetup(NamedTuple):
    """A machine file as arrays for kernels."""

    geometry: Array  # (9,), as parameters.GEOMETRY
    levers: Array  # (4, 2), forward and right of each receiver, m, in the order of flow.Mount
    middles: Array  # (2, 2), forward and right of the middle of each body's receivers, m
    sds: Array  # (3,), rad: of the wheel angle at a tick, and of the slow heading error of either pair
    rig: Rig
    roll: RollModes
    heights: Array  # (4,), of antennas above the ground, m; 0 where the receiver corrects for roll
    planar: bool = True  # whether what the nonlinear model has beyond the relaxation model is added


def slow_pair_sd(machine: Machine, body: str) -> float | None:
    """Sd of the slow heading error of a body's antenna pair, rad: slow multipath over the baseline.

    None without a pair, or if both antennas are at one place. body: tractor or implement.
    """
    pair = [r for r in machine.receiver if r.mount.body == body]
    if len(pair) != 2:
        return None
    length = math.dist(pair[0].position[:2], pair[1].position[:2])
    return SLOW_SHARE * math.hypot(*(r.position_sd for r in pair)) / length if length > 0.1 else None


DEFLECTION: Final = 0.06  # m, of tyres under their static load
PIN: Final = 0.7  # of the front wheels' pin above the ground, m
DAMPING: Final = 0.12  # of the roll modes


def nominal_roll(machine: Machine) -> RollModes:
    """What mass, CG and track let expect."""
    rig = rig_of(machine)
    front, rear, implement = static_loads(rig)
    k_t = rear / DEFLECTION * (rig.w_r / 2) ** 2
    k_i = implement / DEFLECTION * (rig.w_i / 2) ** 2
    j_t, j_i = rig.m_t * rig.h_t**2, rig.m_i * rig.h_i**2
    d_t, d_i = 2 * DAMPING * math.sqrt(2 * k_t * j_t), 2 * DAMPING * math.sqrt(2 * k_i * j_i)
    k_f = front / DEFLECTION * (rig.w_f / 2) ** 2
    return RollModes(k_t, k_i, d_t, d_i, j_t, j_i, PIN, k_f)


def _heights(machine: Machine) -> Array:
    by_mount = {r.mount: 0.0 if r.roll_corrected else r.position[2] for r in machine.receiver}
    return np.array([by_mount.get(mount, 0.0) for mount in Mount])


def rig_setup(machine: Machine, planar: bool = True) -> RigSetup:
    """The setup of a machine. planar: False for the relaxation model alone, without nonlinear correction."""
    slow = [slow_pair_sd(machine, body) or 0.0 for body in ("tractor", "implement")]
    sds = np.array([math.radians(machine.wheel_angle.sd) / math.sqrt(2.0), *slow])
    middles, levers = unknowns.pair_middles(machine), unknowns.levers(machine)
    return RigSetup(
        unknowns.base_geometry(machine),
        levers,
        middles,
        sds,
        rig_of(machine),
        nominal_roll(machine),
        _heights(machine),
        planar,
    )
