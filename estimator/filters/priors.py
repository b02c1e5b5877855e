"""Priors of the unknowns of the filters, by the machine file: means and sds before any data.

Those of the six parameters are log-normal about the machine file's `tyres` (`tyre`). The rows of `UNKNOWNS`
say which prior each unknown has.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from tilth.estimator.models import upright
from tilth.estimator.models.parameters import GEOMETRY, TABLE_5_1, upright_axles
from tilth.estimator.pose import latency
from tilth.estimator.tuning import tuned
from tilth.schemas.ballast import inertia_sd_over_mass
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Implement, Machine, Quantity, Tractor

Prior = tuple[float, float]  # mean, sd


@dataclass(frozen=True, slots=True)
class PriorTuning:
    """What is known of the unknowns beyond the machine file."""

    roll_zero_sd: float = tuned(0.01, "rad", "zero errors of up to a degree")
    cg_height_sd: float = tuned(0.05, "m", "of a CG's height whose sd the file does not tell")
    least_curvature: float = tuned(1e-3, "1", "of a tyre's curve")
    disturbance: tuple[float, ...] = tuned(
        (0.15, 0.15, 0.03), "m/s^2, m/s^2, rad/s^2", "a hundredth or two of the weight"
    )
    uneven: float = tuned(0.006, "rad", "unevenness of usual ground")
    rough: float = tuned(0.01, "rad", "such ground, some 3 cm rms, makes the loads of the wheels come and go")


PRIOR: Final = PriorTuning()


def constant(mean: float, sd: float) -> Callable[[Machine], Prior]:
    """The same for every rig."""
    return lambda machine: (mean, sd)


def tyre(k: int) -> Callable[[Machine], Prior]:
    """Of the k-th of PARAMETERS."""

    def found(machine: Machine) -> Prior:
        tyres = (machine.tyres.front, machine.tyres.rear, machine.tyres.implement)[k % 3]
        value = tyres.cornering_stiffness if k < 3 else tyres.relaxation_length
        return float(np.log(value)), tyres.log_sd

    return found


def _of_body(
    found: Callable[[Machine, str, Tractor | Implement], float],
) -> tuple[Callable[[Machine], Prior], ...]:
    """Sds of the tractor and of the implement, about zero."""
    return (
        lambda machine: (0.0, found(machine, "tractor", machine.tractor)),
        lambda machine: (0.0, found(machine, "implement", machine.implement)),
    )


def roll_zero(mount: Mount) -> Callable[[Machine], Prior]:
    def found(machine: Machine) -> Prior:
        for receiver in machine.receiver:
            if receiver.mount is mount:
                told = receiver.roll_zero
                return 0.0, PRIOR.roll_zero_sd if told is None else math.radians(told.sd)
        return 0.0, 0.0

    return found


def roll_compensation(machine: Machine) -> Prior:
    """Either of 0 and 1."""
    return (0.5, 0.5) if any(r.roll_corrected for r in machine.receiver) else (0.0, 0.0)


def surveyed(k: int) -> Callable[[Machine], Prior]:
    """Of the k-th of GEOMETRY: a share of its value, but of e, which may be zero, its sd. Of an inertia, as
    masses are taken as known (unknowns.MASSES): what ballast brings goes with them."""

    def found(machine: Machine) -> Prior:
        t, i = machine.tractor, machine.implement
        quantity = (t.a, t.b, t.c, i.d, i.e, t.mass, i.mass, t.yaw_inertia, i.yaw_inertia)[k]
        inertias = {"I_t": inertia_sd_over_mass(t, t.ballast), "I_i": inertia_sd_over_mass(i, i.ballast)}
        sd = inertias.get(GEOMETRY[k], quantity.sd)
        return 0.0, sd if GEOMETRY[k] == "e" else sd / abs(quantity.value)

    return found


def roll_stiffness(axle: int) -> Callable[[Machine], Prior]:
    """Factor on that of front, rear or implement's axle: its logarithm."""
    return lambda machine: (0.0, upright_axles(machine)[axle].roll_log_sd)


def front_axle(machine: Machine) -> Prior:
    """Factor on the front axle's stiffness about its pin: its logarithm."""
    return 0.0, upright.front_log_sd(machine, upright_axles(machine)[0])


def front_pivot(machine: Machine) -> Prior:
    """What the front axle's pin is higher than nominal, m."""
    return 0.0, upright.pivot_height(machine).sd


def hitch(machine: Machine) -> Prior:
    """What the hitch is higher than nominal, m."""
    return 0.0, upright.hitch_height(machine, TABLE_5_1.h_h).sd


def cg_height(body: str) -> Callable[[Machine], Prior]:
    """What a CG is higher than the file says, m. Nobody measures one: so without an sd it has one of ours."""

    def found(machine: Machine) -> Prior:
        told: Quantity = getattr(machine, body).cg_height
        return 0.0, told.sd or PRIOR.cg_height_sd

    return found


def level(typical: float, log_sd: float) -> Callable[[Machine], Prior]:
    """Of the natural logarithm of a noise level."""
    return lambda machine: (float(np.log(typical)), log_sd)


def common_latency(machine: Machine) -> float:
    by_mount = {r.mount: r.latency.sd for r in machine.receiver}
    sds = [by_mount[m] for m in Mount if m in by_mount]
    return latency.prior([*sds, *[0.0] * (4 - len(sds))]).sd_mean(list(range(len(sds))))


def survey(machine: Machine, body: str) -> float:
    """Sd of the middle of a body's receivers, m."""
    sds = [r.survey_sd for r in machine.receiver if r.mount.body == body]
    return math.hypot(*sds) / len(sds) if sds else 0.0


def _turned(machine: Machine, body: str) -> float:
    """Sd of the yaw of a body's two receivers, rad, by what is not known of their places to either side."""
    pair = [r for r in machine.receiver if r.mount.body == body]
    if len(pair) != 2:
        return 0.0
    return math.hypot(*(r.survey_sd for r in pair)) / math.dist(pair[0].position[:2], pair[1].position[:2])


PAIR_SD = _of_body(lambda m, of, body: math.hypot(math.radians(body.pair_yaw_sd), _turned(m, of)))
LEVER_SD = _of_body(lambda m, of, body: survey(m, of) if body.lever_sd is None else body.lever_sd)
CG_SD = _of_body(lambda m, of, body: body.cg_sd)
