"""What calibration changes of a machine file, and how measurements made by the file read after it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration.drive import MOUNTS
from tilth.estimator.rig.adjustments import SHORTEST_LATENCY_S, Amount, updated
from tilth.estimator.rig.numbers import BODIES as BODIES
from tilth.estimator.rig.numbers import changed
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Measurement, WheelAngle
from tilth.schemas.machine import Machine, Quantity
from tilth.schemas.wheel_angle import ackermann_of, linkage_angle, linkage_reading

Array = NDArray[np.float64]

BODY: Final = (0, 0, 1, 1)  # of each mount
LATENCIES: Final = tuple(f"latency_{mount.value}" for mount in MOUNTS)
ROLL_ZEROS: Final = tuple(f"roll_zero_{mount.value}" for mount in MOUNTS)


@dataclass(frozen=True, slots=True)
class ChangeTuning:
    """What is assumed where the file has nothing."""

    kingpin_distance: float = tuned(1.7, "m", "where the file has none; a kingpin needs it")


CHANGES: Final = ChangeTuning()


class Linkage(NamedTuple):
    """Which wheel carries the sensor, and how its linkage is curved."""

    kingpin: str = "mean"  # as in the machine file
    ackermann: float = 0.0  # as WheelAngleSensor.ackermann
    curve: float = 0.0  # 1/rad


PLAIN: Final = Linkage()


def linkage_of(machine: Machine, kingpin: str | None = None) -> Linkage:
    """Of a machine file; with a kingpin, of a straight linkage on that one."""
    wheel = machine.wheel_angle
    if kingpin is None:
        return Linkage(wheel.kingpin, ackermann_of(machine), wheel.curve.value)
    tractor = machine.tractor.model_copy(update=_kingpin_keys(machine, kingpin))
    there = wheel.model_copy(update={"kingpin": kingpin})
    return Linkage(
        kingpin, ackermann_of(machine.model_copy(update={"tractor": tractor, "wheel_angle": there}))
    )


def _kingpin_keys(machine: Machine, kingpin: str) -> dict[str, object]:
    if kingpin == "mean" or machine.tractor.kingpin_distance is not None:
        return {}
    return {"kingpin_distance": CHANGES.kingpin_distance}


@dataclass(frozen=True, slots=True)
class Changes:
    """Relative to the file as it was read. Receivers in the order of flow.Mount, bodies tractor first."""

    assignment: tuple[int, ...] = (0, 1, 2, 3)  # which receiver of the file stands at each place
    delay: Array = field(default_factory=lambda: np.zeros(4))  # s, of the receiver at each place
    forward: Array = field(default_factory=lambda: np.zeros(2))  # m, of both receivers of a body
    lateral_offset: Array = field(default_factory=lambda: np.zeros(2))  # m, to the right
    pair: Array = field(default_factory=lambda: np.zeros(2))  # rad, clockwise about the middle of a pair
    longer: Array = field(default_factory=lambda: np.zeros(2))  # m, from rear to front receiver
    hitch: Array = field(default_factory=lambda: np.zeros(2))  # m, on tractor.c and implement.d
    wheel_sign: int = 1
    wheel_zero: float = 0.0  # rad, of what the file's own angle reads when straight
    wheel_gain: float = 1.0  # of the file's own angle over the true one
    linkage_before: Linkage = PLAIN  # of the file as it was read; zero and gain are of what it turns
    linkage: Linkage = PLAIN
    ackermann: float = 0.0  # on tractor.ackermann
    roll_zero: Array = field(default_factory=lambda: np.zeros(4))  # rad
    roll_sign: tuple[int, ...] = (1, 1, 1, 1)
    yaw_rate_sign: tuple[int, ...] = (1, 1, 1, 1)
    roll_corrected: tuple[bool | None, ...] = (None,) * 4  # None: as the file says


def heard_after(measurement: Measurement, changes: Changes) -> Measurement:
    """A measurement that the file as it was read made, as the changed file makes it."""
    if isinstance(measurement, WheelAngle):
        return replace(measurement, angle=wheel_after(measurement.angle, changes))
    mount = measurement.origin.mount
    if mount is None or changes.assignment == (0, 1, 2, 3):
        return measurement
    stands = MOUNTS[changes.assignment.index(MOUNTS.index(mount))]
    return replace(measurement, origin=replace(measurement.origin, mount=stands))


def wheel_after(angle: float, changes: Changes) -> float:
    """A wheel angle of the file as it was read, rad, as the changed file reads it."""
    before, after = changes.linkage_before, changes.linkage
    x = linkage_reading(angle, before.curve, before.ackermann)
    x = changes.wheel_sign * (x - changes.wheel_zero) / changes.wheel_gain
    return linkage_angle(x, after.curve, after.ackermann)


def further_wheel(changes: Changes, zero: float, log_gain: float) -> Changes:
    """After these, what is left: reading when straight, rad, and logarithm of reading over true angle.

    Of a linkage that is curved it is right as far as these are small.
    """
    gain = changes.wheel_gain * math.exp(log_gain)
    at_zero = changes.wheel_zero + changes.wheel_sign * zero * changes.wheel_gain
    return replace(changes, wheel_zero=at_zero, wheel_gain=gain)


def named(changes: Changes) -> dict[str, float]:
    """Name of a number of the rig -> by how much it changes, SI."""
    found = {"wheel_zero": changes.wheel_zero, "wheel_gain": math.log(changes.wheel_gain)}
    found["ackermann"] = changes.ackermann
    for names, values in (
        (("longer_t", "longer_i"), changes.longer), (("pair_t", "pair_i"), changes.pair),
        (("lever_t", "lever_i"), changes.forward), (("aside_t", "aside_i"), changes.lateral_offset),
        (("c", "d"), changes.hitch), (LATENCIES, changes.delay), (ROLL_ZEROS, changes.roll_zero),
    ):  # fmt: skip
        found |= dict(zip(names, values.tolist(), strict=True))
    return found


def applied(machine: Machine, changes: Changes, sds: Mapping[str, float] | None = None) -> Machine:
    """The machine file after the changes, not checked for what cannot be. sds: of numbers of the rig by name,
    SI; of the others they are as they were."""
    known = sds or {}
    amounts = {name: Amount(by, known.get(name)) for name, by in named(changes).items()}
    if "wheel_curve" in known:
        amounts["wheel_curve"] = Amount(0.0, known["wheel_curve"])
    return _wheel_set(changed(_placed(machine, changes), amounts), changes)


def not_early(machine: Machine, assignment: tuple[int, ...], delay: Array) -> Array:
    """Changes of the latencies, (4,), s, raised together where one would make a latency shorter than can be:
    cut off there, what is known of their differences would be lost. assignment: as in Changes."""
    stated = {r.mount: r.latency.value for r in machine.receiver}
    least = min(
        stated.get(MOUNTS[device], 0.0) + by for device, by in zip(assignment, delay.tolist(), strict=True)
    )
    return np.asarray(delay + max(SHORTEST_LATENCY_S - least, 0.0))


def _placed(machine: Machine, changes: Changes) -> Machine:
    """With the receivers in each other's places, and the signs of what they send."""
    by_mount = {r.mount: r for r in machine.receiver}
    receivers = []
    for k, mount in enumerate(MOUNTS):
        there, device = by_mount.get(mount), by_mount.get(MOUNTS[changes.assignment[k]])
        if there is None or device is None:
            continue
        sign, zero, corrected = changes.roll_sign[k], device.roll_zero, changes.roll_corrected[k]
        update: dict[str, object] = {
            "mount": mount, "position": there.position, "roll_sign": sign * device.roll_sign,
            "yaw_rate_sign": changes.yaw_rate_sign[k] * device.yaw_rate_sign,
        }  # fmt: skip
        if zero is not None:
            update["roll_zero"] = Quantity(value=sign * zero.value, sd=zero.sd)
        if corrected is not None:
            update["roll_corrected"] = corrected
        receivers.append(device.model_copy(update=update))
    return machine.model_copy(update={"receiver": receivers})


def _wheel_set(machine: Machine, changes: Changes) -> Machine:
    """With the sign of the wheel angle, and which wheel carries the sensor."""
    wheel = machine.wheel_angle
    zero = Quantity(value=changes.wheel_sign * wheel.zero.value, sd=wheel.zero.sd)
    keys: dict[str, object] = {"sign": changes.wheel_sign * wheel.sign, "zero": zero}
    if changes.linkage != changes.linkage_before:
        curve = Quantity(value=changes.linkage.curve, sd=wheel.curve.sd)
        keys |= {"kingpin": changes.linkage.kingpin, "curve": curve}
        machine = updated(machine, "tractor", **_kingpin_keys(machine, changes.linkage.kingpin))
    return updated(machine, "wheel_angle", **keys)
