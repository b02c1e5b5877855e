"""What of a rig can be had from scale and tape: where its CGs are, and its yaw inertias by a rule of thumb.

The rule: the radius of gyration is a share of the wheelbase, or of the length from hitch to axle. It is that
of the ranges from which the virtual fleet is drawn (simulator/fleet_ranges.py, with their sources): 0.55 to
0.70 for a tractor, 0.28 to 0.50 for a towed body. Karkee 2009, Table 5.1, has 0.67 and 0.47. A sprayer with
its boom folded out has more.
"""

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

from tilth.schemas.quantity import Quantity

TRACTOR_SHARE: Final = (0.62, 0.05)  # radius of gyration over wheelbase: value, sd
IMPLEMENT_SHARE: Final = (0.40, 0.07)  # the same over hitch to axle
SCALE_SHARE: Final = 0.01  # sd of a weight, of it
TAPE_SD: Final = 0.02  # m

DRAWING: Final = """\
front axle      CG      rear axle  hitch            CG    axle
    O-----------x-----------O--------o---------------x------O
    |<--- a --->|<--- b --->|        |<----- d ----->|<-e-->|
                |<-------- c ------->|
"""


class Weights(NamedTuple):
    """What stands on the scale, kg: each axle of the tractor alone, the implement's axle and its tongue."""

    front: float
    rear: float
    axle: float
    tongue: float


class Lengths(NamedTuple):
    """By tape, m."""

    wheelbase: float
    hitch: float  # behind the rear axle
    drawbar: float  # from the hitch to the implement's axle


def by_scale(weights: Weights, lengths: Lengths) -> Mapping[str, Mapping[str, Quantity]]:
    """Keys of [tractor] and of [implement] that follow, with sds."""
    mass_t, mass_i = weights.front + weights.rear, weights.axle + weights.tongue
    a = lengths.wheelbase * weights.rear / mass_t
    e = lengths.drawbar * weights.tongue / mass_i
    cg_sd = SCALE_SHARE * a * (1.0 - a / lengths.wheelbase) * math.sqrt(2.0)  # both weights are off
    behind_sd = SCALE_SHARE * e * (1.0 - e / lengths.drawbar) * math.sqrt(2.0)
    b = lengths.wheelbase - a
    places_t = {"a": a, "b": b, "c": b + lengths.hitch}
    places_i = {"d": lengths.drawbar - e, "e": e}
    return {
        "tractor": {
            **{key: _rounded(value, math.hypot(cg_sd, TAPE_SD), 3) for key, value in places_t.items()},
            "mass": _rounded(mass_t, SCALE_SHARE * mass_t, 0),
            "yaw_inertia": yaw_inertia(mass_t, lengths.wheelbase, TRACTOR_SHARE),
        },
        "implement": {
            **{key: _rounded(value, math.hypot(behind_sd, TAPE_SD), 3) for key, value in places_i.items()},
            "mass": _rounded(mass_i, SCALE_SHARE * mass_i, 0),
            "yaw_inertia": yaw_inertia(mass_i, lengths.drawbar, IMPLEMENT_SHARE),
        },
    }


def yaw_inertia(mass: float, length: float, share: tuple[float, float]) -> Quantity:
    """kg m^2, of a body of that mass, kg, with that wheelbase or length from hitch to axle, m."""
    value = mass * (share[0] * length) ** 2
    return _rounded(value, 2.0 * share[1] / share[0] * value, -2 if value > 1000.0 else 0)


def _rounded(value: float, sd: float, digits: int) -> Quantity:
    return Quantity(value=round(value, digits), sd=round(sd, digits) or 10.0**-digits)
