"""How a rig stands on its tyres: what the machine file tells, else what is usual, each with its sd.

Tyres are springs upwards. What an axle holds of the roll is the stiffness of its tyres times the square of
half the track. Of dual wheels all are counted: half the load presses each, at two tracks.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from tilth.estimator.tuning import tuned
from tilth.schemas.axle_loads import axle_loads
from tilth.schemas.machine import Machine, Quantity, Tyre
from tilth.schemas.plausible import GRAVITY
from tilth.schemas.tyre_size import tyre_size, upright_stiffness


@dataclass(frozen=True, slots=True)
class UprightTuning:
    """What rigs have where the machine file does not tell; tractors of 3 to 15 t, implements of 1 to 15 t."""

    deflection: float = tuned(0.065, "m", "of tyres under their load: 40 to 110 mm")
    deflection_log_sd: float = tuned(0.35, "1", "of a logarithm: carts that are empty stand on less")
    rule_log_sd: float = tuned(0.2, "1", "of a stiffness by size and pressure: how measured tyres differ")
    wheelbase: float = tuned(2.9, "m", "of a tractor with the track of parameters.TABLE_5_1")
    track_share: float = tuned(0.18, "1", "sd of a track over it: 1.5 to 2.5 m")
    hitch_height_sd: float = tuned(0.12, "m", "drawbars and balls are 0.3 to 0.8 m high")
    pivot_height: float = tuned(0.7, "m", "of the front axle's pin: about the hub's")
    pivot_height_sd: float = tuned(0.15, "m", "of that")
    suspended_sd: float = tuned(0.3, "m", "the same of a suspended axle, whose links act as a pin elsewhere")
    springs_log_sd: float = tuned(0.7, "1", "by which a suspended axle tilts more, or less")
    rolling_log_sd: float = tuned(0.2, "1", "of a rolling tyre's stiffness over load by deflection at rest")


UPRIGHT: Final = UprightTuning()


class AxleUpright(NamedTuple):
    """Of one axle."""

    track: float  # m, one that holds the roll as the tyres do
    track_share: float  # its sd over it
    stiffness: float  # of all tyres together, N/m
    stiffness_share: float  # sd of its logarithm

    @property
    def roll_stiffness(self) -> float:
        """N m/rad, with what gravity takes off."""
        return self.stiffness * (self.track / 2) ** 2

    @property
    def roll_log_sd(self) -> float:
        """Of its logarithm, for a body that rolls on it while driving."""
        return math.hypot(self.stiffness_share, 2 * self.track_share, UPRIGHT.rolling_log_sd)


def axles_upright(
    machine: Machine, usual_tracks: tuple[float, float, float]
) -> tuple[AxleUpright, AxleUpright, AxleUpright]:
    """Of front, rear and implement's axle. usual_tracks: m, where the file has none, of a rig with
    UPRIGHT.wheelbase."""
    tractor, implement = machine.tractor, machine.implement
    loads = axle_loads(
        tractor.a.value, tractor.b.value, tractor.c.value, implement.d.value, implement.e.value,
        tractor.mass.value, implement.mass.value, GRAVITY,
    )  # fmt: skip
    grown = math.sqrt(tractor.wheelbase / UPRIGHT.wheelbase)
    tyres, usual = machine.tyres, usual_tracks
    return (
        _axle(tyres.front, loads[0], usual[0] * grown),
        _axle(tyres.rear, loads[1], usual[1] * grown),
        _axle(tyres.implement, loads[2], usual[2]),
    )


def _axle(tyre: Tyre, load: float, usual_track: float) -> AxleUpright:
    track, share = usual_track, UPRIGHT.track_share
    if tyre.track is not None:
        tracks = [tyre.track] if tyre.dual_track is None else [tyre.track, tyre.dual_track]
        track = math.sqrt(sum(one.value**2 for one in tracks) / len(tracks))
        share = math.hypot(*(one.value * one.sd for one in tracks)) / len(tracks) / track**2
    if tyre.size is not None and tyre.pressure is not None:
        each = upright_stiffness(tyre_size(tyre.size), tyre.pressure)
        wheels = 2 if tyre.dual_track is None else 4
        return AxleUpright(track, share, wheels * each, UPRIGHT.rule_log_sd)
    told = tyre.deflection
    if told is None:
        return AxleUpright(track, share, load / UPRIGHT.deflection, UPRIGHT.deflection_log_sd)
    return AxleUpright(track, share, load / told.value, told.sd / told.value)


def hitch_height(machine: Machine, usual: float) -> Quantity:
    """Above the ground, m."""
    return machine.tractor.hitch_height or Quantity(value=usual, sd=UPRIGHT.hitch_height_sd)


def pivot_height(machine: Machine) -> Quantity:
    """Of the front axle's pin above the ground, m."""
    told = machine.tractor.pivot_height or Quantity(value=UPRIGHT.pivot_height, sd=UPRIGHT.pivot_height_sd)
    if not machine.tractor.suspended_front_axle:
        return told
    return Quantity(value=told.value, sd=math.hypot(told.sd, UPRIGHT.suspended_sd))


def front_log_sd(machine: Machine, front: AxleUpright) -> float:
    """Of the front axle's stiffness about its pin, of its logarithm."""
    springs = UPRIGHT.springs_log_sd if machine.tractor.suspended_front_axle else 0.0
    return math.hypot(front.roll_log_sd, springs)
