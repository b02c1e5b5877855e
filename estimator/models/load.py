"""What an implement carries: the rig with it, and how long what was said of it is true.

Tyres grow stiffer with their load, C ~ load^n, so an implement's stiffness over its mass moves with
m^(n - 1): by 1.5 from 8 t to 2 t at n = 0.7, not at all at n = 1. That is what driving sees of a load; its
mass alone it does not tell. So between two words of who knows it, the logarithm of the mass walks while the
rig drives, and may be any other after a stop: carts are tipped, filled and weighed while they stand.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.parameters import rig_of, static_loads
from tilth.estimator.models.upright import UPRIGHT
from tilth.estimator.tuning import tuned
from tilth.schemas import carried
from tilth.schemas.ballast import carrying, inertia_sd_over_mass
from tilth.schemas.flow import Carried
from tilth.schemas.machine import Machine, Quantity, Tyre, Tyres

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LoadTuning:
    """How loads change, and what that does to tyres."""

    weighed: float = tuned(0.02, "1", "sd of a scale, over the mass of the implement with its load")
    change: float = tuned(0.1, "1", "of the logarithm of that mass, by which a scale's word is used at once")
    small_change: float = tuned(0.02, "1", "the same, by which it is used after `settled_s`")
    settled_s: float = tuned(30.0, "s", "after a word of the scale's was used")
    smoothed_s: float = tuned(3.0, "s", "over which a scale's words are averaged: on rough ground they dance")
    step_ns: int = tuned(10_000_000_000, "ns", "between two steps of the walk")
    unknown_ns: int = tuned(
        600_000_000_000, "ns", "since the last one, in which the log's clock may have stepped"
    )
    stop_ns: int = tuned(
        20_000_000_000, "ns", "not driven, in which a cart may be tipped: a shorter stop is one at a gate"
    )
    scale_lost_ns: int = tuned(20_000_000_000, "ns", "without a scale's word, after which nobody weighs it")
    couples: float = tuned(
        0.3, "1", "by which stiffnesses over masses err, over the error of the mass' logarithm"
    )
    relaxation: float = tuned(0.3, "1", "sd of how a relaxation length's logarithm follows that of its load")
    another: float = tuned(
        0.8, "1", "sd of the logarithm of its mass, by which another load differs: from 8 t to 2 t"
    )


LOAD: Final = LoadTuning()


def laden(machine: Machine, now: Carried | None) -> Machine:
    """The rig with what its implement carries. machine: with the empty one; itself where it carries
    nothing. The sd of its inertia is what remains over the mass."""
    load = machine.implement.load
    if now is None or load is None:
        return machine
    mass = Quantity(value=now.mass, sd=now.sd)
    full = carrying(machine, mass)
    heavier, exponent = np.exp(heavier_by(machine, full)), load.exponent.value
    axles = {
        name: _tyre(getattr(machine.tyres, name), factor, exponent)
        for name, factor in zip(Tyres.model_fields, heavier.tolist(), strict=True)
    }
    sd = inertia_sd_over_mass(full.implement, [load.model_copy(update={"mass": mass})])
    inertia = full.implement.yaw_inertia.model_copy(update={"sd": sd})
    implement = full.implement.model_copy(update={"yaw_inertia": inertia})
    tyres = machine.tyres.model_copy(update=axles)
    return full.model_copy(update={"tyres": tyres, "implement": implement})


def _tyre(tyre: Tyre, heavier: float, exponent: float) -> Tyre:
    """As the prior has it, under a load that is heavier by a factor. Its spring stays what it is."""
    told = tyre.deflection
    if told is None and tyre.size is None:
        sd = UPRIGHT.deflection * UPRIGHT.deflection_log_sd
        told = Quantity(value=UPRIGHT.deflection, sd=sd)
    stiffness = tyre.cornering_stiffness * heavier**exponent
    pressed = told and Quantity(value=told.value * heavier, sd=told.sd * heavier)
    return tyre.model_copy(update={"cornering_stiffness": stiffness, "deflection": pressed})


def heavier_by(before: Machine, after: Machine) -> Array:
    """Logarithms of the loads of front, rear and implement's axle, after over before, (3,)."""
    return np.log(static_loads(rig_of(after))) - np.log(static_loads(rig_of(before)))


def range_variance(machine: Machine) -> float:
    """Of the logarithm of the implement's mass, while nobody knows what it carries. machine: with the
    empty one."""
    load = machine.implement.load
    return 0.0 if load is None else carried.log_range(machine, load) ** 2 / 12.0


def another_variance(machine: Machine) -> float:
    """Of the logarithm of the implement's mass, by a load that has become any other: from one end of what is
    possible to the other is 1.7 sds. machine: with the empty one."""
    return 4.0 * range_variance(machine)


def of_nobody(machine: Machine, t_ns: int) -> Carried | None:
    """What it carries where nobody has said it; None where it carries nothing. machine: with the empty
    one."""
    load = machine.implement.load
    return None if load is None else carried.of_nobody(machine, load, t_ns)


def aged(machine: Machine, told: Carried, seconds: float) -> Carried:
    """As sure as a word is so many seconds later. machine: with the empty implement."""
    whole = machine.implement.mass.value + told.mass
    variance = (told.sd / whole) ** 2 + walked(machine, told, seconds)
    return replace(told, sd=max(told.sd, whole * math.sqrt(min(variance, _any_variance(machine, told)))))


def walked(machine: Machine, told: Carried, seconds: float) -> float:
    """By how much the variance of the logarithm of its mass grows, about what was told. machine: with the
    empty implement."""
    load = machine.implement.load
    return 0.0 if load is None else _any_variance(machine, told) * max(seconds, 0.0) / load.lasts


def _any_variance(machine: Machine, told: Carried) -> float:
    """About what was told, where all may be."""
    middle = of_nobody(machine, told.t_ns)
    own = machine.implement.mass.value
    off = math.log((own + told.mass) / (own + middle.mass)) if middle else 0.0
    return range_variance(machine) + off**2


def of_scale(machine: Machine, whole: float | None, content: float | None) -> float | None:
    """kg that it carries, as a scale says; None where that cannot be. machine: with the empty implement."""
    load, own = machine.implement.load, machine.implement.mass.value
    if load is None or (whole is None and content is None):
        return None
    mass = content if content is not None else (whole or 0.0) - own
    slack = 5.0 * LOAD.weighed * own
    return max(mass, 0.0) if -slack <= mass <= carried.BEYOND * load.mass.value + slack else None


def moved_by(machine: Machine, variance: float) -> Array:
    """Covariance of the six logarithms, (6, 6), learned over masses as told, by that variance of the
    logarithm of the implement's mass: its stiffness over it moves with the exponent less one."""
    load, covariance = machine.implement.load, np.zeros((6, 6))
    if load is not None:
        covariance[2, 2] = variance * ((load.exponent.value - 1.0) ** 2 + load.exponent.sd**2)
        covariance[5, 5] = variance * LOAD.relaxation**2
    return covariance


def by_another_load(machine: Machine) -> Array:
    """As `moved_by`, by a load that has become any other. machine: with the implement as it is."""
    return moved_by(machine, LOAD.another**2)
