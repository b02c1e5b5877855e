"""How stiffly the bodies roll on their tyres, with damping and inertia: what the estimators begin with."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from tilth.estimator.models.parameters import rig_of, static_loads
from tilth.estimator.tuning import tuned
from tilth.schemas.machine import Machine


@dataclass(frozen=True, slots=True)
class RollTuning:
    """What rolls of rigs have in common. Each is unknown to a filter, as a factor or a sum (`UNKNOWNS`)."""

    deflection: float = tuned(0.045, "m", "of tyres under their static load")
    front_deflection: float = tuned(0.06, "m", "same of the front tyres: smaller, and near their rated load")
    pivot_height: float = tuned(0.7, "m", "of the front wheels' pivot above the ground")
    damping: float = tuned(0.08, "1", "of the roll modes")
    gyration: float = tuned(0.48, "1", "radius of gyration in roll, over the track")


ROLL: Final = RollTuning()


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


def nominal_roll(machine: Machine) -> RollModes:
    """What mass, CG and track let expect."""
    rig = rig_of(machine)
    front, rear, implement = static_loads(rig)
    k_t = rear / ROLL.deflection * (rig.w_r / 2) ** 2
    k_i = implement / ROLL.deflection * (rig.w_i / 2) ** 2
    j_t, j_i = rig.m_t * (ROLL.gyration * rig.w_r) ** 2, rig.m_i * (ROLL.gyration * rig.w_i) ** 2
    d_t = 2 * ROLL.damping * math.sqrt(k_t * (j_t + rig.m_t * rig.h_t**2))
    d_i = 2 * ROLL.damping * math.sqrt(k_i * (j_i + rig.m_i * rig.h_i**2))
    k_f = front / ROLL.front_deflection * (rig.w_f / 2) ** 2
    return RollModes(k_t, k_i, d_t, d_i, j_t, j_i, ROLL.pivot_height, k_f)
