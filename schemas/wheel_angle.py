"""The wheel-angle sensor that the machine file describes: a row, a signal of a DBC file, or PGN 127245.

    reading = raw * scale + offset          degrees
    x       = sign * lookup(reading) - zero
    angle   = x + curve * x^2, turned to the mean of the axle

The mean is the wheel in the middle of an Ackermann axle (kingpin distance w, wheelbase L), from its turning
circle: cot(mean) = cot(left) - w / 2L = cot(right) + w / 2L, right turns positive.
"""

import itertools
import math
from dataclasses import dataclass, replace

from tilth.schemas.can_id import join
from tilth.schemas.can_signal import Bits, CanSignal, bits_from, dbc_signal, no_data
from tilth.schemas.fields import DEG
from tilth.schemas.machine import Machine, WheelAngle
from tilth.schemas.pgn_table import row
from tilth.schemas.rejections import Rejection

RUDDER = 127245
_PGN_AND_SOURCE = 0x03FFFFFF

Points = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class WheelAngleSensor(CanSignal):
    """A wheel-angle sensor, compiled from the machine file; its signal is in degrees."""

    lookup: Points  # reading -> angle, degrees; empty: none
    sign: int
    zero: float  # degrees
    ackermann: (
        float  # w / 2L, positive for a sensor on the left kingpin, negative on the right, 0 for the mean
    )
    curve: float  # 1/rad, of the linkage
    sd: float  # rad
    instance: int | None = None  # byte 0 of PGN 127245

    def read(self, data: bytes) -> float | Rejection:
        """Mean road-wheel angle in rad, positive right; or the reason why there is none."""
        if self.instance is not None and len(data) >= self.bits.size and data[0] != self.instance:
            return Rejection.UNKNOWN_SOURCE
        reading = self.reading(data)
        if isinstance(reading, Rejection):
            return reading
        if self.lookup:
            looked_up = _between(self.lookup, reading)
            if looked_up is None:
                return Rejection.OUT_OF_RANGE
            reading = looked_up
        angle = (self.sign * reading - self.zero) * DEG
        if not -math.pi / 2 < angle < math.pi / 2:
            return Rejection.OUT_OF_RANGE
        return linkage_angle(angle, self.curve, self.ackermann)

    def data(self, angle: float) -> bytes:
        """Data of a frame that says this mean road-wheel angle (rad), at least eight bytes long.

        Raises ValueError where it does not fit.
        """
        turned = linkage_reading(angle, self.curve, self.ackermann)
        reading: float | None = (turned / DEG + self.zero) * self.sign
        if self.lookup and reading is not None:
            reading = _between(tuple(sorted((there, here) for here, there in self.lookup)), reading)
        raw = None if reading is None else round((reading - self.offset) / self.scale)
        half = 1 << self.bits.bits - 1
        low, high = (-half, half) if self.bits.signed else (0, half + half)
        if raw is None or not low <= raw < high or self.no_data[0] <= raw % (high - low) <= self.no_data[1]:
            raise ValueError(f"a wheel angle of {angle:g} rad does not fit into the sensor's message")
        data = self.bits.write(raw).ljust(8, b"\xff")
        return data if self.instance is None else bytes([self.instance]) + data[1:]


def compile_sensor(machine: Machine) -> WheelAngleSensor:
    """The sensor of a machine file. Raises MachineError where its DBC file does not give the signal."""
    given = machine.wheel_angle
    if given.pgn is not None:
        return _of_rudder(machine, given)
    if given.dbc is not None:
        return _of_dbc(machine, given)
    assert given.id is not None  # the machine file gives one of three
    first = given.start_bit
    if first is None:
        assert given.start_byte is not None
        first = 8 * given.start_byte + (7 if given.byte_order == "big" else 0)
    bits = bits_from(given.byte_order == "big", first, given.bits, given.signed)
    return _sensor(machine, given.id, given.mask, given.extended, bits, given.scale, given.offset)


def _sensor(
    machine: Machine, can_id: int, mask: int, extended: bool, bits: Bits, scale: float, offset: float
) -> WheelAngleSensor:
    given = machine.wheel_angle
    return WheelAngleSensor(
        given.bus,
        can_id & mask,
        mask,
        extended,
        bits,
        scale,
        offset,
        no_data("wheel_angle", given.not_available),
        tuple(given.lookup or ()),
        given.sign,
        given.zero.value,
        ackermann_of(machine),
        given.curve.value,
        given.sd * DEG,
    )


def ackermann_of(machine: Machine) -> float:
    """w / 2L of the kingpin that carries the sensor, as WheelAngleSensor.ackermann."""
    side = {"mean": 0, "left": 1, "right": -1}[machine.wheel_angle.kingpin]
    distance = machine.tractor.kingpin_distance or 0.0
    return side * distance / (2.0 * machine.tractor.wheelbase)


def _of_rudder(machine: Machine, given: WheelAngle) -> WheelAngleSensor:
    assert given.source is not None  # the machine file demands it
    table = row(RUDDER)
    field = next(field for field in table.fields if field.key == "wheel_angle_rad")
    bits = bits_from(False, field.start, field.bits, field.signed)
    can_id = join(table.priority, RUDDER, given.source)
    sensor = _sensor(machine, can_id, _PGN_AND_SOURCE, True, bits, field.resolution() / DEG, 0.0)
    top = (1 << field.bits - 1) - 1
    return replace(sensor, no_data=(field.limit(table.family), top), instance=given.instance)


def _of_dbc(machine: Machine, given: WheelAngle) -> WheelAngleSensor:
    assert given.dbc is not None and given.signal is not None  # the machine file demands it
    found = dbc_signal("wheel_angle", given.dbc, given.dbc_text, given.signal, given.mask)
    scale, offset = found.scale * given.scale, found.offset * given.scale + given.offset
    return _sensor(machine, found.can_id, found.mask, found.extended, found.bits, scale, offset)


def _between(points: Points, x: float) -> float | None:
    """Linear between points with ascending x; None outside of them."""
    for (x0, y0), (x1, y1) in itertools.pairwise(points):
        if x0 <= x <= x1:
            return y0 + (y1 - y0) * (x - x0) / (x1 - x0)
    return None


def linkage_angle(x: float, curve: float, ackermann: float) -> float:
    """Mean road-wheel angle, rad, where the sensor reads x, rad, more than when straight."""
    return _to_mean(x + curve * x * x, ackermann)


def linkage_reading(angle: float, curve: float, ackermann: float) -> float:
    """The inverse of linkage_angle."""
    turned = _to_mean(angle, -ackermann)
    # The root next to 0, written so that no curvature is no special case.
    return 2.0 * turned / (1.0 + math.sqrt(max(1.0 + 4.0 * curve * turned, 0.0)))


def _to_mean(angle: float, ackermann: float) -> float:
    """cot(mean) = cot(angle) - ackermann, written so that straight ahead is no special case."""
    if ackermann == 0.0:
        return angle
    return math.atan2(math.sin(angle), math.cos(angle) - ackermann * math.sin(angle))
