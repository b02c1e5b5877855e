"""Which wheel carries the sensor, and how curved its linkage is: by circles to both sides.

Of a right turn and the same turn to the left, a sensor on one kingpin shows different angles, and so does a
curved linkage; slip of the tyres is the same to both sides, and so is what a scale does. So both show as
what is even in the angle, and nothing else does but the zero.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration.changes import Changes, Linkage, linkage_of
from tilth.estimator.calibration.drive import DRIVE
from tilth.estimator.calibration.faults import RigFault
from tilth.estimator.calibration.initial_guess import INITIAL_GUESS, Pairs
from tilth.estimator.calibration.least_squares import solve
from tilth.estimator.rig.numbers import NUMBER
from tilth.estimator.rig.residuals import path_angle, wheel_slopes
from tilth.estimator.tuning import tuned
from tilth.schemas.machine import Machine
from tilth.schemas.wheel_angle import linkage_reading

Array = NDArray[np.float64]

KINGPIN: Final = "wheel_kingpin"  # kind of the fault
CURVE_SD: Final = NUMBER["wheel_curve"].prior_sd  # 1.3 degrees at 30 degrees


@dataclass(frozen=True, slots=True)
class LinkageTuning:
    """How the curve of the wheel's linkage is told."""

    floor: float = tuned(0.006, "1/rad", "of what the model leaves out, 0.1° at 30°")
    loose: float = tuned(5.0, "1/rad", "a prior that says nothing")
    steady: float = tuned(0.03, "rad/s", "by which the turn rate changes within a second: tyres lag little")
    clearly: float = tuned(4.0, "chi^2", "by which another kingpin must fit better than that of the file")
    fewest: int = tuned(75, "instants", "15 s, of turns to either side")
    smallest: float = tuned(math.radians(5.0), "rad", "of such turns")
    priors: tuple[float, ...] = tuned((0.5, 20.0, 0.05), "rad, 1, 1", "sds of zero, gain and understeer")
    largest: float = tuned(0.3, "1/rad", "as in schemas/limits.py")


LINKAGE: Final = LinkageTuning()

PLACES: Final = ("mean", "left", "right")


class LinkageFound(NamedTuple):
    """Of the kingpin that fits best."""

    linkage: Linkage
    curve_sd: float  # 1/rad
    wheel: tuple[float, float] | None = None  # zero, rad, and gain of Changes that go with it


def find(
    machine: Machine, changes: Changes, view: Pairs, lateral_offset: tuple[float, float]
) -> LinkageFound:
    """machine: as it was read. view: with the file's own wheel angle. lateral_offset: of the tractor's
    middle from its
    middle line, after the changes, and its sd, m: it makes one side slower than the other."""
    own = changes.linkage_before
    base = machine.tractor.wheelbase
    u = view.along[:, 0] + view.rate[:, 0] * lateral_offset[0]
    rows = _steady(view) & (u > INITIAL_GUESS.moving) & (u < INITIAL_GUESS.slow) & np.isfinite(view.wheel)
    if np.count_nonzero(rows) < LINKAGE.fewest:
        return LinkageFound(own, CURVE_SD)
    u, r = u[rows], view.rate[rows, 0]
    angle = path_angle(base, u, r)
    read = [changes.wheel_sign * linkage_reading(a, own.curve, own.ackermann) for a in view.wheel[rows]]
    if (
        min(np.count_nonzero(angle > LINKAGE.smallest), np.count_nonzero(angle < -LINKAGE.smallest))
        < LINKAGE.fewest
    ):
        return LinkageFound(own, CURVE_SD)
    found = []
    for place in PLACES:
        tried = linkage_of(machine, place)
        curve, sd, zero, gain = _curve(
            np.array(read), angle, u * r, tried.ackermann, lateral_offset[1] / base
        )
        penalty = curve**2 / (CURVE_SD**2 + sd**2) + (LINKAGE.clearly if place != own.kingpin else 0.0)
        found.append((penalty, tried, curve, sd, (changes.wheel_sign * zero, gain)))
    _, best, curve, sd, wheel = min(found, key=lambda one: one[0])
    share = CURVE_SD**2 / (CURVE_SD**2 + sd**2)
    told = sd < CURVE_SD / 2 and wheel[1] > 0.0
    return LinkageFound(best._replace(curve=share * curve), math.sqrt(share) * sd, wheel if told else None)


def _curve(
    read: Array, angle: Array, pull: Array, ackermann: float, lateral_offset_share: float
) -> tuple[float, float, float, float]:
    """(curve, its sd, zero, gain) by the readings of a sensor on that kingpin, without the prior. Of a wheel
    at a the sensor reads zero + gain (a - curve a^2), nearly."""
    own = np.array([linkage_reading(a, 0.0, ackermann) for a in angle])
    curve, zero, gain, sd = 0.0, 0.0, 1.0, LINKAGE.loose
    for _ in range(3):  # what a^2 leaves out of the inverse is put back
        bent = np.array([linkage_reading(a, curve, 0.0) for a in own])
        design = np.column_stack([wheel_slopes(bent, pull), -(bent**2)])
        told = solve(design, read, np.array([*LINKAGE.priors, LINKAGE.loose]), 0.002)
        zero, gain = float(told.value[0]), float(told.value[1])
        per = max(abs(gain), 1e-6)
        curve = min(max(curve + float(told.value[3]) / per, -LINKAGE.largest), LINKAGE.largest)
        sd = float(told.sds[3]) / per
    return curve, math.hypot(sd, LINKAGE.floor, lateral_offset_share), zero, gain


def _steady(view: Pairs) -> NDArray[np.bool_]:
    """(n,): where the tractor's turn rate hardly changes."""
    half = round(0.5 / DRIVE.step_s)
    rate = view.rate[:, 0]
    steady = np.zeros(len(rate), bool)
    if len(rate) > 2 * half:
        steady[half:-half] = np.abs(rate[2 * half :] - rate[: -2 * half]) < LINKAGE.steady
    return np.asarray(steady & view.known & np.isfinite(rate))


def kingpin_faults(before: Linkage, after: Linkage) -> list[RigFault]:
    """Where the sensor is on another wheel than the file says."""
    if before.kingpin == after.kingpin:
        return []
    where = {"mean": "shows the mean of both wheels", "left": "is on the left kingpin",
             "right": "is on the right kingpin"}  # fmt: skip
    text = (
        f"the wheel-angle sensor {where[after.kingpin]}, the file says {before.kingpin}; "
        "wheel_angle.kingpin is changed in the file"
    )
    return [RigFault(KINGPIN, "wheel_angle.kingpin", text)]
