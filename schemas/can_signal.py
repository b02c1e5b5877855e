"""A number in the frames of one identifier: by its bits, or as a signal of a DBC file."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from tilth.schemas.can_id import split
from tilth.schemas.flow import Frame
from tilth.schemas.machine import MachineError
from tilth.schemas.rejections import Rejection

_PGN_ONLY: Final = 0x03FFFF00
_J1939_ANY_SOURCE: Final = 0xFE  # source address of a message in a J1939 DBC file: whoever sends it


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
class CanSignal:
    """A signal as the machine file describes it: reading = raw * scale + offset."""

    bus: str
    can_id: int
    mask: int
    extended: bool
    bits: Bits
    scale: float
    offset: float
    no_data: tuple[
        int, int
    ]  # lowest and highest unsigned raw value that means none; none if lowest > highest

    def hears(self, frame: Frame) -> bool:
        """Is this signal in the frame?"""
        return (
            frame.bus == self.bus
            and frame.extended == self.extended
            and (frame.can_id ^ self.can_id) & self.mask == 0
        )

    def reading(self, data: bytes) -> float | Rejection:
        """In the signal's unit; or the reason why there is none."""
        raw = self.bits.read(data)
        if raw is None:
            return Rejection.SHORT_FRAME
        if self.no_data[0] <= raw <= self.no_data[1]:
            return Rejection.NOT_AVAILABLE
        if self.bits.signed and raw >> self.bits.bits - 1:
            raw -= 1 << self.bits.bits
        return raw * self.scale + self.offset


class DbcSignal(NamedTuple):
    """What a DBC file says of a signal."""

    can_id: int
    mask: int
    extended: bool
    bits: Bits
    scale: float  # of its unit, per bit
    offset: float
    unit: str  # "" where the file has none


def no_data(section: str, given: int | Sequence[int] | None) -> tuple[int, int]:
    """CanSignal.no_data of a key not_available. section: of the machine file. Raises MachineError."""
    if given is None:
        return 1, 0
    if isinstance(given, int):
        return given, given
    if len(given) != 2 or given[0] > given[1]:
        raise MachineError(
            f"{section}.not_available = {list(given)}: give one raw value, or [lowest, highest] of them"
        )
    return given[0], given[1]


def bits_from(big_endian: bool, first: int, bits: int, signed: bool) -> Bits:
    """first: number of the least significant bit, of the most significant one if big endian (8 B + b)."""
    if not big_endian:
        return Bits((first + bits + 7) // 8, False, first, bits, signed)
    from_top = first // 8 * 8 + 7 - first % 8  # bits before it, read from the front
    size = (from_top + bits + 7) // 8
    return Bits(size, True, 8 * size - from_top - bits, bits, signed)


def dbc_signal(section: str, dbc: str, text: str | None, name: str, mask: int) -> DbcSignal:
    """A signal of a DBC file, by its name. section: of the machine file, for a sentence; dbc: the file that
    it names; mask: bits of the identifier that must match. Raises MachineError."""
    # Imported here: half a second that only machines with a DBC file pay.
    import cantools

    if text is None:
        raise MachineError(f'{section}.dbc = "{dbc}": its text was not read; give the path of the file')
    try:
        database: Any = cantools.database.load_string(text, "dbc", strict=False)
    except (cantools.Error, ValueError, KeyError) as error:
        raise MachineError(f'{section}.dbc = "{dbc}": not a DBC file: {error}') from None
    found = [
        (message, signal)
        for message in database.messages
        for signal in message.signals
        if signal.name == name
    ]
    if len(found) != 1:
        there = ", ".join(sorted({s.name for message in database.messages for s in message.signals}))
        many = f"stands in {len(found)} messages" if found else "is not in it"
        raise MachineError(f'{section}.signal = "{name}": {many}; the signals there are: {there or "none"}')
    message, signal = found[0]
    if signal.multiplexer_ids or signal.is_float:
        plain = [s.name for s in message.signals if not s.multiplexer_ids and not s.is_float]
        kind = "multiplexed" if signal.multiplexer_ids else "a floating-point number"
        raise MachineError(
            f'{section}.signal = "{name}": is {kind}, which is not supported; '
            f"plain signals of that message: {', '.join(plain) or 'none'}"
        )
    bits = bits_from(signal.byte_order == "big_endian", signal.start, signal.length, signal.is_signed)
    if message.is_extended_frame and split(message.frame_id).source == _J1939_ANY_SOURCE:
        mask &= _PGN_ONLY
    return DbcSignal(
        message.frame_id, mask, message.is_extended_frame, bits,
        float(signal.scale), float(signal.offset), signal.unit or "",
    )  # fmt: skip
