"""The wheel-angle sensor that the machine file describes: a row, a signal of a DBC file, or PGN 127245.

    reading = raw * scale + offset          degrees
    x       = sign * lookup(reading) - zero
    angle   = x + curve * x^2, turned to the mean of the axle

The mean is the wheel in the middle of an Ackermann axle (kingpin distance w, wheelbase L), from its turning
circle: cot(mean) = cot(left) - w / 2L = cot(right) + w / 2L, right turns positive.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from tilth.schemas.can_id import join, split
from tilth.schemas.fields import DEG
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine, MachineError, WheelAngle
from tilth.schemas.pgn_table import row
from tilth.schemas.rejections import Rejection

RUDDER = 127245
_PGN_AND_SOURCE = 0x03FFFFFF
_PGN_ONLY = 0x03FFFF00
_J1939_ANY_SOURCE = 0xFE  # source address of a message in a J1939 DBC file: whoever sends it

Points = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Bits:
    """Where the raw value is."""

    size: int  # bytes that are needed
    big_endian: bool
    shift: int  # from the least significant bit of those bytes
    bits: int
    signed: bool

    def read(self, data: bytes) -> int | None:
        """Unsigned raw value; None where the data is too short."""
        if len(data) < self.size:
            return None
        whole = int.from_bytes(data[: self.size], "big" if self.big_endian else "little")
        return whole >> self.shift & (1 << self.bits) - 1

    def write(self, raw: int) -> bytes:
        """Data with the raw value in it and ones around it."""
        mask = (1 << self.bits) - 1 << self.shift
        whole = (1 << 8 * self.size) - 1 & ~mask | raw << self.shift & mask
        return whole.to_bytes(self.size, "big" if self.big_endian else "little")


@dataclass(frozen=True, slots=True)
class WheelAngleSensor:
    """A wheel-angle sensor, compiled from the machine file."""

    bus: str
    can_id: int
    mask: int
    extended: bool
    bits: Bits
    scale: float  # degrees per bit
    offset: float  # degrees
    no_data: tuple[
        int, int
    ]  # lowest and highest unsigned raw value that means none; empty if lowest > highest
    lookup: Points  # reading -> angle, degrees; empty: none
    sign: int
    zero: float  # degrees
    ackermann: (
        float  # w / 2L, positive for a sensor on the left kingpin, negative on the right, 0 for the mean
    )
    curve: float  # 1/rad, of the linkage
    sd: float  # rad
    instance: int | None = None  # byte 0 of PGN 127245

    def hears(self, frame: Frame) -> bool:
        """Is this frame the sensor's?"""
        return (
            frame.bus == self.bus
            and frame.extended == self.extended
            and (frame.can_id ^ self.can_id) & self.mask == 0
        )

    def read(self, data: bytes) -> float | Rejection:
        """Mean road-wheel angle in rad, positive right; or the reason why there is none."""
        raw = self.bits.read(data)
        if raw is None:
            return Rejection.SHORT_FRAME
        if self.instance is not None and data[0] != self.instance:
            return Rejection.UNKNOWN_SOURCE
        if self.no_data[0] <= raw <= self.no_data[1]:
            return Rejection.NOT_AVAILABLE
        if self.bits.signed and raw >> self.bits.bits - 1:
            raw -= 1 << self.bits.bits
        reading = raw * self.scale + self.offset
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
    bits = _bits(given.byte_order == "big", first, given.bits, given.signed)
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
        _no_data(given.not_available),
        tuple(given.lookup or ()),
        given.sign,
        given.zero.value,
        ackermann_of(machine),
        given.curve.value,
        given.sd * DEG,
    )


def _no_data(given: int | Sequence[int] | None) -> tuple[int, int]:
    if given is None:
        return 1, 0
    if isinstance(given, int):
        return given, given
    if len(given) != 2 or given[0] > given[1]:
        raise MachineError(
            f"wheel_angle.not_available = {list(given)}: give one raw value, or [lowest, highest] of them"
        )
    return given[0], given[1]


def ackermann_of(machine: Machine) -> float:
    """w / 2L of the kingpin that carries the sensor, as WheelAngleSensor.ackermann."""
    side = {"mean": 0, "left": 1, "right": -1}[machine.wheel_angle.kingpin]
    distance = machine.tractor.kingpin_distance or 0.0
    return side * distance / (2.0 * machine.tractor.wheelbase)


def _bits(big_endian: bool, first: int, bits: int, signed: bool) -> Bits:
    """first: number of the least significant bit, of the most significant one if big endian (8 B + b)."""
    if not big_endian:
        return Bits((first + bits + 7) // 8, False, first, bits, signed)
    from_top = first // 8 * 8 + 7 - first % 8  # bits before it, read from the front
    size = (from_top + bits + 7) // 8
    return Bits(size, True, 8 * size - from_top - bits, bits, signed)


def _of_rudder(machine: Machine, given: WheelAngle) -> WheelAngleSensor:
    assert given.source is not None  # the machine file demands it
    table = row(RUDDER)
    field = next(field for field in table.fields if field.key == "wheel_angle_rad")
    bits = _bits(False, field.start, field.bits, field.signed)
    can_id = join(table.priority, RUDDER, given.source)
    sensor = _sensor(machine, can_id, _PGN_AND_SOURCE, True, bits, field.resolution() / DEG, 0.0)
    top = (1 << field.bits - 1) - 1
    return replace(sensor, no_data=(field.limit(table.family), top), instance=given.instance)


def _of_dbc(machine: Machine, given: WheelAngle) -> WheelAngleSensor:
    # Imported here: half a second that only machines with a DBC file pay.
    import cantools

    if given.dbc_text is None:
        raise MachineError(
            f'wheel_angle.dbc = "{given.dbc}": its text was not read; give the path of the file'
        )
    try:
        database: Any = cantools.database.load_string(given.dbc_text, "dbc", strict=False)
    except (cantools.Error, ValueError, KeyError) as error:
        raise MachineError(f'wheel_angle.dbc = "{given.dbc}": not a DBC file: {error}') from None
    found = [
        (message, signal)
        for message in database.messages
        for signal in message.signals
        if signal.name == given.signal
    ]
    if len(found) != 1:
        there = ", ".join(sorted({s.name for message in database.messages for s in message.signals}))
        many = f"stands in {len(found)} messages" if found else "is not in it"
        raise MachineError(
            f'wheel_angle.signal = "{given.signal}": {many}; the signals there are: {there or "none"}'
        )
    return _of_signal(machine, given, *found[0])


def _of_signal(machine: Machine, given: WheelAngle, message: Any, signal: Any) -> WheelAngleSensor:
    if signal.multiplexer_ids or signal.is_float:
        plain = [s.name for s in message.signals if not s.multiplexer_ids and not s.is_float]
        kind = "multiplexed" if signal.multiplexer_ids else "a floating-point number"
        raise MachineError(
            f'wheel_angle.signal = "{signal.name}": is {kind}, which is not supported; '
            f"plain signals of that message: {', '.join(plain) or 'none'}"
        )
    bits = _bits(signal.byte_order == "big_endian", signal.start, signal.length, signal.is_signed)
    mask = given.mask
    if message.is_extended_frame and split(message.frame_id).source == _J1939_ANY_SOURCE:
        mask &= _PGN_ONLY
    scale = float(signal.scale) * given.scale
    offset = float(signal.offset) * given.scale + given.offset
    return _sensor(machine, message.frame_id, mask, message.is_extended_frame, bits, scale, offset)


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
