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
# Where nobody has weighed the axles or seen a data sheet: value, sd, of the same ranges.
FRONT_SHARE: Final = Quantity(value=0.40, sd=0.03)  # of the tractor's weight, on the front axle
TONGUE_SHARE: Final = Quantity(value=0.08, sd=0.03)  # of the implement's, on the hitch
CG_OVER_WHEELBASE: Final = Quantity(value=0.36, sd=0.03)  # height of the tractor's CG
IMPLEMENT_CG_HEIGHT: Final = Quantity(value=1.25, sd=0.20)  # m

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


class TapedLengths(NamedTuple):
    """By tape, m."""

    wheelbase: float
    hitch: float  # behind the rear axle
    drawbar: float  # from the hitch to the implement's axle


class BodyWeight(NamedTuple):
    """mass: kg. share: of it what stands on the front axle, or of an implement on the hitch."""

    mass: Quantity
    share: Quantity


def by_scale(weights: Weights, lengths: TapedLengths) -> Mapping[str, Mapping[str, Quantity]]:
    """Keys of [tractor] and of [implement] that follow, with sds."""
    tractor = weighed(weights.front, weights.rear, SCALE_SHARE)
    implement = weighed(weights.tongue, weights.axle, SCALE_SHARE)
    return by_shares(tractor, implement, lengths, TapedLengths(TAPE_SD, TAPE_SD, TAPE_SD))


def weighed(ahead: float, behind: float, scale_share: float) -> BodyWeight:
    """Of what stands on the scale, kg: the front axle or the tongue, and the axle behind it."""
    mass = ahead + behind
    share = ahead / mass
    share_sd = scale_share * share * (1.0 - share) * math.sqrt(2.0)  # both weights are off
    return BodyWeight(Quantity(value=mass, sd=scale_share * mass), Quantity(value=share, sd=share_sd))


def by_shares(
    tractor: BodyWeight, implement: BodyWeight, lengths: TapedLengths, sds: TapedLengths
) -> Mapping[str, Mapping[str, Quantity]]:
    """Keys of [tractor] and of [implement] that follow, with sds. sds: of the lengths, m."""
    b = lengths.wheelbase * tractor.share.value
    e = lengths.drawbar * implement.share.value
    cg_sd = math.hypot(lengths.wheelbase * tractor.share.sd, sds.wheelbase)
    behind_sd = math.hypot(lengths.drawbar * implement.share.sd, sds.drawbar)
    return {
        "tractor": {
            "a": _rounded(lengths.wheelbase - b, cg_sd, 3),
            "b": _rounded(b, cg_sd, 3),
            "c": _rounded(b + lengths.hitch, max(cg_sd, sds.hitch), 3),
            "mass": _rounded(*_of(tractor.mass), 0),
            "yaw_inertia": yaw_inertia(tractor.mass.value, lengths.wheelbase, TRACTOR_SHARE),
        },
        "implement": {
            "d": _rounded(lengths.drawbar - e, behind_sd, 3),
            "e": _rounded(e, behind_sd, 3),
            "mass": _rounded(*_of(implement.mass), 0),
            "yaw_inertia": yaw_inertia(implement.mass.value, lengths.drawbar, IMPLEMENT_SHARE),
        },
    }


def yaw_inertia(mass: float, length: float, share: tuple[float, float]) -> Quantity:
    """kg m^2, of a body of that mass, kg, with that wheelbase or length from hitch to axle, m."""
    value = mass * (share[0] * length) ** 2
    return _rounded(value, 2.0 * share[1] / share[0] * value, -2 if value > 1000.0 else 0)


def _of(quantity: Quantity) -> tuple[float, float]:
    return quantity.value, quantity.sd


def _rounded(value: float, sd: float, digits: int) -> Quantity:
    return Quantity(value=round(value, digits), sd=round(sd, digits) or 10.0**-digits)
