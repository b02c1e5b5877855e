"""Checks the wheel-angle sensor of a machine file: the range of its field and its place in a frame."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Final

from tilth.schemas.limits import Doubt, meant
from tilth.schemas.machine import Machine, MachineError, WheelAngle
from tilth.schemas.wheel_angle import WheelAngleSensor, compile_sensor

FRAME: Final = 8  # bytes of classic CAN
LAST_STANDARD: Final = 0x7FF
REACHED: Final = 10.0  # deg to each side: with less it tells no turns
USUALLY_REACHED: Final = 20.0
STEEP: Final = 90.0  # deg: no wheel turns so far
COARSEST: Final = 2.0  # deg per bit
COARSE: Final = 0.3  # deg per bit of a field that has many more bits than such steps need
FARTHEST: Final = 20_000.0  # deg


def wheel_doubts(machine: Machine) -> Iterator[Doubt]:
    """Doubts about [wheel_angle]: scale, range of the angle, place in the frame."""
    given = machine.wheel_angle
    if given.id is not None and not given.extended and given.id > LAST_STANDARD:
        yield Doubt(
            f"wheel_angle.id = 0x{given.id:X}: extended = false has identifiers up to 0x{LAST_STANDARD:X}; "
            "leave extended out",
            True,
        )
    if given.lookup is not None:
        yield from _linkage(given.lookup)
    if given.dbc is not None and given.dbc_text is None:
        return  # a text alone: who opens files brings it along
    try:
        sensor = compile_sensor(machine)
    except MachineError as error:
        yield Doubt(str(error), True)
        return
    if sensor.bits.size > FRAME:
        text = (
            f"wheel_angle: its field ends in byte {sensor.bits.size - 1}, a frame has bytes 0 to {FRAME - 1}"
        )
        yield Doubt(f"{text}; check start_byte, start_bit, bits and byte_order", True)
        return
    if not _empty(sensor.no_data) and sensor.no_data[0] >> sensor.bits.bits:
        text = f"wheel_angle.not_available = {sensor.no_data[0]}: a field of {sensor.bits.bits} bits never is"
        yield Doubt(f"{text}; give the raw value as read, unsigned", True)
    yield from _reach(sensor, given)


def _empty(no_data: tuple[int, int]) -> bool:
    return no_data[0] > no_data[1]


def _linkage(lookup: list[tuple[float, float]]) -> Iterator[Doubt]:
    angles = [angle for _, angle in lookup]
    steps = [after - before for before, after in pairwise(angles)]
    if not (all(step > 0 for step in steps) or all(step < 0 for step in steps)):
        yield Doubt("wheel_angle.lookup: its angles must rise or fall all along, as a linkage moves", True)
    if max(map(abs, angles)) > STEEP:
        angle = max(angles, key=abs)
        likely = meant(angle, "deg", lambda value: 1.0 < abs(value) <= STEEP)
        yield Doubt(
            f"wheel_angle.lookup: an angle of {angle:g} deg; wheels turn by {STEEP:g} at most{likely}", True
        )


def _reach(sensor: WheelAngleSensor, given: WheelAngle) -> Iterator[Doubt]:
    """Angles at the lowest and highest raw value of the field."""
    reached = _angles(sensor, sensor.scale)
    name = "wheel_angle.scale" if given.dbc is None else "wheel_angle: scale with that of the signal"
    if reached is None:
        low, high = sorted(_readings(sensor, sensor.scale))
        text = f"wheel_angle.lookup: the field reads from {low:g} to {high:g}, none of which is in the lookup"
        yield Doubt(f"{text}; check scale and offset", True)
    elif reached[0] > -REACHED or reached[1] < REACHED:
        text = (
            f"{name} = {sensor.scale:g}: the field's {sensor.bits.bits} bits can only tell {_range(reached)}"
        )
        yield Doubt(f"{text}, which is not both sides; check scale, offset, zero, bits and signed"
                    + _meant(sensor), True)  # fmt: skip
    elif given.lookup is None and _coarse(sensor.scale, reached):
        text = f"{name} = {sensor.scale:g} deg per bit: the field's {sensor.bits.bits} bits would tell"
        yield Doubt(f"{text} {_range(reached)}, no wheel sensor does{_meant(sensor)}", True)
    elif reached[0] > -USUALLY_REACHED or reached[1] < USUALLY_REACHED:
        text = f"{name} = {sensor.scale:g}: the field's {sensor.bits.bits} bits tell {_range(reached)}"
        yield Doubt(f"{text}, rarely enough for a wheel{_meant(sensor)}", False)


def _coarse(scale: float, reached: tuple[float, float]) -> bool:
    return abs(scale) > COARSEST or (abs(scale) > COARSE and reached[1] - reached[0] > FARTHEST)


def _meant(sensor: WheelAngleSensor) -> str:
    def likely(scale: float) -> bool:
        reached = _angles(sensor, scale)
        if reached is None or scale < 0 or _coarse(scale, reached):
            return False
        return reached[0] < -USUALLY_REACHED and reached[1] > USUALLY_REACHED

    return "" if sensor.lookup else meant(sensor.scale, "deg/bit", likely)


def _readings(sensor: WheelAngleSensor, scale: float) -> tuple[float, float]:
    """At the lowest and the highest raw value, degrees before sign and lookup."""
    half = 1 << sensor.bits.bits - 1
    low, high = (-half, half - 1) if sensor.bits.signed else (0, 2 * half - 1)
    return low * scale + sensor.offset, high * scale + sensor.offset


def _angles(sensor: WheelAngleSensor, scale: float) -> tuple[float, float] | None:
    """(lowest, highest) angle, degrees; None where no reading is in the lookup."""
    low, high = sorted(_readings(sensor, scale))
    if sensor.lookup:
        low, high = max(low, sensor.lookup[0][0]), min(high, sensor.lookup[-1][0])
        if low > high:
            return None
        ends = [_looked_up(sensor, low), _looked_up(sensor, high)]
        low, high = min(ends), max(ends)
    ends = [sensor.sign * low - sensor.zero, sensor.sign * high - sensor.zero]
    return min(ends), max(ends)


def _looked_up(sensor: WheelAngleSensor, reading: float) -> float:
    for (x0, y0), (x1, y1) in pairwise(sensor.lookup):
        if reading <= x1:
            return y0 + (y1 - y0) * (reading - x0) / (x1 - x0)
    return sensor.lookup[-1][1]


def _range(reached: tuple[float, float]) -> str:
    return f"{reached[0]:.4g} to {reached[1]:.4g} deg"
