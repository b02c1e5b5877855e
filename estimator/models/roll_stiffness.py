"""How stiffly the bodies roll on their tyres, with damping and inertia: what the estimators begin with."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from tilth.estimator.models import upright
from tilth.estimator.models.parameters import rig_of, static_loads, upright_axles
from tilth.estimator.tuning import tuned
from tilth.schemas.machine import Machine


@dataclass(frozen=True, slots=True)
class RollTuning:
    """What rolls of rigs have in common. Each is unknown to a filter, as a factor or a sum (`UNKNOWNS`)."""

    damping: float = tuned(0.08, "1", "of the roll modes")
    gyration: float = tuned(0.044, "m/kg^(1/3)", "a tractor's in roll: 0.93 m of one of 9.4 t")
    axle_share: float = tuned(0.07, "1", "of the tractor's mass: front axle with wheels, not in `gyration`")
    axle_gyration: float = tuned(0.75, "1", "of that axle in roll, over half its track")
    cart_gyration: float = tuned(0.48, "1", "an implement's, over its track")
    least_upright: float = tuned(0.2, "1", "of its tyres' roll stiffness, that gravity leaves a body")


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
    """What masses, CGs, tracks and tyres let expect."""
    rig = rig_of(machine)
    front, rear, implement = upright_axles(machine)
    pivot = upright.pivot_height(machine).value
    on_pivot = static_loads(rig)[0] * pivot  # tips the front axle, and rights the body that hangs on the pin
    k_t = _left(rear.roll_stiffness, rig.g * rig.m_t * rig.h_t - on_pivot)
    k_i = _left(implement.roll_stiffness, rig.g * rig.m_i * rig.h_i)
    j_t = rig.m_t * (ROLL.gyration * math.cbrt(rig.m_t)) ** 2
    if (told := machine.tractor.front_axle_mass) is not None:  # it tips about its pin, and not with the body
        usual = ROLL.axle_share * rig.m_t
        j_t -= (told.value - usual) * (ROLL.axle_gyration * rig.w_f / 2) ** 2
    j_i = rig.m_i * (ROLL.cart_gyration * rig.w_i) ** 2
    d_t = 2 * ROLL.damping * math.sqrt(k_t * (j_t + rig.m_t * rig.h_t**2))
    d_i = 2 * ROLL.damping * math.sqrt(k_i * (j_i + rig.m_i * rig.h_i**2))
    return RollModes(k_t, k_i, d_t, d_i, j_t, j_i, pivot, _left(front.roll_stiffness, on_pivot))


def _left(stiffness: float, gravity: float) -> float:
    """Of a roll stiffness, when gravity has taken its part off."""
    return max(stiffness - gravity, ROLL.least_upright * stiffness)
