"""What calibration changes of a machine file, and how measurements made by the file read after it."""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration.drive import MOUNTS
from tilth.schemas.flow import Measurement, WheelAngle
from tilth.schemas.machine import Machine, Quantity, Receiver
from tilth.schemas.machine import WheelAngle as WheelFile
from tilth.schemas.wheel_angle import ackermann_of, linkage_angle, linkage_reading

Array = NDArray[np.float64]

BODIES: Final = ("tractor", "implement")
BODY: Final = (0, 0, 1, 1)  # of each mount
SHORTEST_LATENCY_S: Final = 0.0
KINGPIN_DISTANCE_M: Final = 1.7  # where the file has none; a kingpin needs it


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


def _kingpin_keys(machine: Machine, kingpin: str) -> dict[str, Any]:
    if kingpin == "mean" or machine.tractor.kingpin_distance is not None:
        return {}
    return {"kingpin_distance": KINGPIN_DISTANCE_M}


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


def applied(machine: Machine, changes: Changes) -> Machine:
    """The machine file after the changes, sds as they were. It is not checked for what cannot be."""
    by_mount = {r.mount: r for r in machine.receiver}
    receivers = []
    for k, mount in enumerate(MOUNTS):
        there, device = by_mount.get(mount), by_mount.get(MOUNTS[changes.assignment[k]])
        if there is not None and device is not None:
            receivers.append(_receiver(machine, changes, k, there, device))
    tractor, implement = machine.tractor, machine.implement
    c, d = tractor.c, implement.d
    return machine.model_copy(
        update={
            "tractor": tractor.model_copy(
                update={
                    "c": _moved(c, changes.hitch[0]),
                    "ackermann": _moved(tractor.ackermann, changes.ackermann),
                    **_kingpin_keys(
                        machine,
                        "mean" if changes.linkage == changes.linkage_before else changes.linkage.kingpin,
                    ),
                }
            ),
            "implement": implement.model_copy(update={"d": _moved(d, changes.hitch[1])}),
            "receiver": receivers,
            "wheel_angle": machine.wheel_angle.model_copy(update=wheel_keys(machine.wheel_angle, changes)),
        }
    )


def not_early(machine: Machine, assignment: tuple[int, ...], delay: Array) -> Array:
    """Changes of the latencies, (4,), s, raised together where one would make a latency shorter than can be:
    cut off there, what is known of their differences would be lost. assignment: as in Changes."""
    stated = {r.mount: r.latency.value for r in machine.receiver}
    least = min(
        stated.get(MOUNTS[device], 0.0) + by for device, by in zip(assignment, delay.tolist(), strict=True)
    )
    return np.asarray(delay + max(SHORTEST_LATENCY_S - least, 0.0))


def _moved(quantity: Quantity, by: float) -> Quantity:
    return Quantity(value=quantity.value + float(by), sd=quantity.sd)


def _receiver(machine: Machine, changes: Changes, k: int, there: Receiver, device: Receiver) -> Receiver:
    """The receiver that stands at place k."""
    body = BODY[k]
    pair = [r.position for r in machine.receiver if r.mount.body == there.mount.body]
    middle = np.mean([position[:2] for position in pair], axis=0)
    arm = np.array(there.position[:2]) - middle
    length = float(np.hypot(*arm))
    stretched = arm * (1.0 + changes.longer[body] / (2.0 * length)) if length > 0.0 else arm
    cosine, sine = math.cos(changes.pair[body]), math.sin(changes.pair[body])
    turned = np.array([[cosine, -sine], [sine, cosine]]) @ stretched
    forward, right = middle + turned + [changes.forward[body], changes.lateral_offset[body]]
    delay = max(device.latency.value + float(changes.delay[k]), SHORTEST_LATENCY_S)
    zero = device.roll_zero or Quantity(value=0.0, sd=math.degrees(0.01))
    sign = changes.roll_sign[k]
    at_level = sign * zero.value + math.degrees(changes.roll_zero[k])
    update: dict[str, Any] = {
        "mount": there.mount,
        "position": (float(forward), float(right), there.position[2]),
        "latency": Quantity(value=delay, sd=device.latency.sd),
        "roll_sign": sign * device.roll_sign,
        "yaw_rate_sign": changes.yaw_rate_sign[k] * device.yaw_rate_sign,
    }
    if device.roll_zero is not None or changes.roll_zero[k] != 0.0:
        update["roll_zero"] = Quantity(value=at_level, sd=zero.sd)
    corrected = changes.roll_corrected[k]
    if corrected is not None:
        update["roll_corrected"] = corrected
    return device.model_copy(update=update)


def wheel_keys(wheel: WheelFile, changes: Changes) -> dict[str, Any]:
    """Keys of [wheel_angle] that change: x = sign (raw scale + offset) - zero, degrees."""
    gain, sign = changes.wheel_gain, changes.wheel_sign
    zero = sign * (wheel.zero.value + math.degrees(changes.wheel_zero)) / gain
    keys: dict[str, Any] = {"sign": sign * wheel.sign, "zero": Quantity(value=zero, sd=wheel.zero.sd)}
    if changes.linkage != changes.linkage_before:
        keys["kingpin"] = changes.linkage.kingpin
        keys["curve"] = Quantity(value=changes.linkage.curve, sd=wheel.curve.sd)
    if gain == 1.0:
        return keys
    if wheel.lookup is not None:
        return {**keys, "lookup": [(reading, angle / gain) for reading, angle in wheel.lookup]}
    if wheel.pgn is not None:
        return {**keys, "lookup": [(-90.0, -90.0 / gain), (90.0, 90.0 / gain)]}
    return {**keys, "scale": wheel.scale / gain, "offset": wheel.offset / gain}
