"""One field of a message: its bits, scale, unit, and raw values that mean "no data".

The same row decodes and encodes. Messages are little-endian; bit b of byte B has the number 8 B + b, and a
field's `start` is its least significant bit.

    value = (raw * scale + offset) * factor

`scale` and `offset` stand as in the document, in its unit; `factor` turns that unit and its sign into ours.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from tilth.schemas.flow import Word
from tilth.schemas.rejections import Rejection, count

DEG = math.pi / 180.0
KMH = 1.0 / 3.6


def _nmea2000(bits: int, signed: bool) -> int:
    """The top values say unknown, out of range, reserved: three of them from 8 bits up, two from 4, one from
    2, none in a single bit (canboat, special values)."""
    sentinels = 0 if bits == 1 else 1 if bits < 4 else 2 if bits < 8 else 3
    return (1 << bits - signed) - sentinels


def _j1939(bits: int, signed: bool) -> int:
    """From 8 bits up a leading byte of 0xFB or more is no value; below, the top value says not available and
    the one before it error (SAE J1939-71, table 1)."""
    return 0xFB << bits - 8 if bits >= 8 else (1 << bits) - 2


def _name(bits: int, signed: bool) -> int:
    """Every pattern in a NAME is a value."""
    return 1 << bits


FAMILIES: dict[str, Callable[[int, bool], int]] = {"nmea2000": _nmea2000, "j1939": _j1939, "name": _name}
"""By family of messages: the raw value from which on there is none, for a field of (bits, signed)."""


@dataclass(frozen=True, slots=True)
class Field:
    key: str  # a key of SIGNALS, a part of a composed one, or what no signal needs
    start: int
    bits: int
    scale: float = 1.0
    offset: float = 0.0
    factor: float = 1.0
    signed: bool = False
    names: Mapping[int, str] | None = None  # of an enumeration: raw -> word; others are not available
    no_data: tuple[int, ...] = ()  # raw values that a vendor sends in place of "not available"
    no_data_alone: tuple[int, ...] = ()  # the same, but only while nothing else in the message is available
    text: bool = False  # characters, filled up at their end; starts at a byte

    @property
    def end(self) -> int:
        """The first bit after it."""
        return self.start + self.bits

    def limit(self, family: str) -> int:
        """The raw value from which on there is no value."""
        return FAMILIES[family](self.bits, self.signed)

    def resolution(self) -> float:
        """One bit, in our unit."""
        return abs(self.scale * self.factor)

    def raw(self, value: Word, family: str) -> int:
        """Raw bits of a value. Raises ValueError where it does not fit."""
        if self.text:
            return self._raw_text(value)
        if self.names is not None:
            for raw, name in self.names.items():
                if name == value:
                    return raw
            raise ValueError(f"{self.key} = {value!r} is none of {', '.join(self.names.values())}")
        number = _number(self.key, value)
        raw = round((number / self.factor - self.offset) / self.scale)
        if not -(1 << self.bits - 1) * self.signed <= raw < self.limit(family):
            raise ValueError(f"{self.key} = {value!r} does not fit into its {self.bits} bits")
        return raw & (1 << self.bits) - 1

    def _raw_text(self, value: Word) -> int:
        size = self.bits // 8
        characters = str(value).encode("latin-1", "replace")
        if len(characters) > size:
            raise ValueError(f"{self.key} = {value!r} has more than {size} characters")
        return int.from_bytes(characters.ljust(size, b" "), "little")


def _text(characters: bytes) -> str:
    """Devices pad with spaces, zeros, ones or @. Unprintable characters become question marks."""
    text = characters.partition(b"\0")[0].rstrip(b" @\xff").decode("latin-1")
    return "".join(c if c.isprintable() else "?" for c in text)


def _number(key: str, value: Word) -> float:
    if isinstance(value, str) or not math.isfinite(value):
        raise ValueError(f"{key} = {value!r} is not a number")
    return value


@dataclass(frozen=True, slots=True)
class Composed:
    """A signal made of several fields, such as a date and a time."""

    key: str
    parts: tuple[str, ...]  # that must be there
    join: Callable[[Mapping[str, Word]], Word | None]  # None: not available; ValueError: out of range
    split: Callable[[Word], Mapping[str, Word]]
    also: tuple[str, ...] = ()  # parts that need not be there


@dataclass(frozen=True, slots=True)
class Group:
    """Fields that a message repeats behind its others, once for each satellite, say."""

    key: str
    count: str  # the field that says how often: a whole byte
    start: int  # byte of the first
    size: int  # bytes of each
    fields: tuple[Field, ...]  # as they stand in the first byte of one


Rows = Sequence[Mapping[str, Word]]
"""What a Group holds: one mapping for each repetition."""


@dataclass(frozen=True, slots=True)
class Range:
    """Physical range of a signal; what lies outside is rejected."""

    low: float = -math.inf
    high: float = math.inf


ANYTHING = Range()

_INTEGER, _DIVIDE, _MULTIPLY = range(3)


class _Step(NamedTuple):
    """A field, ready for the inner loop."""

    key: str
    start: int
    mask: int
    half: int  # the sign bit's weight; 0 for unsigned
    limit: int
    how: int
    zero: float
    scale: float
    names: Mapping[int, str] | None
    no_data: tuple[int, ...]
    low: float
    high: float
    end: int


def _step(field: Field, family: str, allowed: Range) -> _Step:
    scale = field.scale * field.factor
    zero = field.offset / field.scale
    how = _MULTIPLY
    # Dividing whole numbers gives the nearest float to the decimal that the document means.
    inverse = round(1.0 / scale)
    if zero == round(zero) and inverse != 0 and math.isclose(inverse * scale, 1.0, rel_tol=1e-12):
        zero, scale = round(zero), inverse
        how = _INTEGER if inverse == 1 else _DIVIDE
    return _Step(
        field.key, field.start, (1 << field.bits) - 1, 1 << field.bits - 1 if field.signed else 0,
        field.limit(family), how, zero, scale, field.names, field.no_data,
        allowed.low, allowed.high, field.end,
    )  # fmt: skip


class Layout:
    """Fields of one message, compiled: payload to signals and back."""

    __slots__ = (
        "_all", "_alone", "_composed", "_decoded", "_family", "_fields", "_groups", "_measured", "_needed",
        "_parts", "_size", "_texts",
    )  # fmt: skip

    def __init__(
        self,
        fields: tuple[Field, ...],
        composed: tuple[Composed, ...],
        family: str,
        size: int,
        signals: Mapping[str, Range],
        measured: frozenset[str] = frozenset(),
        groups: tuple[Group, ...] = (),
    ) -> None:
        """size: bytes that `encode` writes; signals: the keys that `decode` gives, with their ranges;
        measured: those of them that `measured` gives."""
        self._fields = {field.key: field for field in fields}
        self._family = family
        self._size = size
        self._needed = max((field.end + 7) // 8 for field in fields)
        self._composed = composed
        self._parts = {part for rule in composed for part in (*rule.parts, *rule.also)}
        plain = [field for field in fields if not field.text]
        self._all = [_step(f, family, signals.get(f.key, ANYTHING)) for f in plain]
        self._decoded = [step for step in self._all if step.key in signals or step.key in self._parts]
        self._measured = [step for step in self._decoded if step.key in measured or step.key in self._parts]
        self._texts = [(f.key, f.start // 8, f.end // 8) for f in fields if f.text]
        self._groups = [(group, _layout_of(group, family)) for group in groups]
        self._alone = [
            (f.key, f.start, (1 << f.bits) - 1, f.no_data_alone) for f in fields if f.no_data_alone
        ]

    def decode(
        self, payload: bytes, rejected: dict[str, int], dropped: dict[str, Word] | None = None
    ) -> dict[str, Word]:
        """Words that the payload carries; absent where not available. Never raises.

        dropped: takes the signals that are outside of their range, so that somebody may see them.
        """
        values = self._composed_of(self._read(self._decoded, payload, rejected, dropped), rejected, dropped)
        return values | self._read_texts(payload) if self._texts else values

    def measured(self, payload: bytes, rejected: dict[str, int]) -> dict[str, Word]:
        """Those of the signals that measurements are made of."""
        return self._composed_of(self._read(self._measured, payload, rejected), rejected)

    def fields(self, payload: bytes) -> dict[str, Word]:
        """Every field of the layout, also those that no signal needs, before composing."""
        return self._read(self._all, payload, {}) | self._read_texts(payload)

    def groups(self, payload: bytes, rejected: dict[str, int]) -> dict[str, Rows]:
        """What the payload repeats, by the key of the group; absent where it does not say how often."""
        found: dict[str, Rows] = {}
        for group, layout in self._groups:
            number = self._fields[group.count]
            repeats = payload[number.start // 8] if number.end <= 8 * len(payload) else 0xFF
            if repeats >= number.limit(self._family):
                continue
            whole = min(repeats, max(0, len(payload) - group.start) // group.size)
            if whole < repeats:
                count(rejected, Rejection.SHORT_FRAME)
            starts = range(group.start, group.start + whole * group.size, group.size)
            found[group.key] = [layout.decode(payload[at : at + group.size], rejected) for at in starts]
        return found

    def _composed_of(
        self, values: dict[str, Word], rejected: dict[str, int], dropped: dict[str, Word] | None = None
    ) -> dict[str, Word]:
        if not self._composed:
            return values
        for rule in self._composed:
            try:
                joined = rule.join(values) if all(part in values for part in rule.parts) else None
            except ValueError:
                count(rejected, Rejection.OUT_OF_RANGE)
                joined = None
                if dropped is not None:
                    dropped[rule.key] = " ".join(f"{part}={values[part]:g}" for part in rule.parts)
            if joined is not None:
                values[rule.key] = joined
        for part in self._parts:
            values.pop(part, None)
        return values

    def _read_texts(self, payload: bytes) -> dict[str, Word]:
        whole = [(key, payload[start:end]) for key, start, end in self._texts if end <= len(payload)]
        return {key: text for key, characters in whole if (text := _text(characters))}

    def _read(
        self,
        steps: list[_Step],
        payload: bytes,
        rejected: dict[str, int],
        dropped: dict[str, Word] | None = None,
    ) -> dict[str, Word]:
        if len(payload) < self._needed:
            count(rejected, Rejection.SHORT_FRAME)
            steps = [step for step in steps if step.end <= 8 * len(payload)]
        whole = int.from_bytes(payload, "little")
        values: dict[str, Word] = {}
        for key, start, mask, half, limit, how, zero, scale, names, no_data, low, high, _ in steps:
            raw = whole >> start & mask
            if half and raw >= half:
                raw -= half + half
            if raw >= limit or raw in no_data:
                continue
            if names is not None:
                if raw in names:
                    values[key] = names[raw]
                continue
            value = (
                (raw + zero) / scale if how == _DIVIDE
                else (raw + zero) * scale if how == _MULTIPLY
                else raw + zero
            )  # fmt: skip
            if low <= value <= high:
                values[key] = value
            else:
                count(rejected, Rejection.OUT_OF_RANGE)
                if dropped is not None:
                    dropped[key] = value
        return {} if len(values) == 1 and self._says_no_data(values, whole) else values

    def _says_no_data(self, values: Mapping[str, Word], whole: int) -> bool:
        """Whether a value that stands alone is one of those by which its device says that it has no data."""
        return any(key in values and whole >> start & mask in raws for key, start, mask, raws in self._alone)

    def encode(self, values: Mapping[str, Word], groups: Mapping[str, Rows] | None = None) -> bytes:
        """Payload of signals, and of any further field by its key; what is absent is not available.

        groups: what is repeated, by the key of the group. Raises ValueError for a key that the message does
        not have and for a value that does not fit.
        """
        parts = dict(values)
        for rule in self._composed:
            if rule.key in parts:
                parts |= rule.split(parts.pop(rule.key))
        repeated = self._encode_groups(groups or {}, parts)
        whole = (1 << 8 * self._size) - 1
        for key, value in parts.items():
            field = self._fields.get(key)
            if field is None:
                raise ValueError(f"this message has no {key}; it has {', '.join(self._fields)}")
            mask = (1 << field.bits) - 1 << field.start
            whole = whole & ~mask | field.raw(value, self._family) << field.start
        # All ones is "not available" for unsigned fields; a signed one says it with its highest value.
        for field in self._fields.values():
            if field.signed and field.key not in parts:
                whole &= ~(1 << field.end - 1)
        return whole.to_bytes(self._size, "little") + repeated

    def _encode_groups(self, groups: Mapping[str, Rows], parts: dict[str, Word]) -> bytes:
        """Bytes of what is repeated; writes into parts how often."""
        unknown = groups.keys() - {group.key for group, _ in self._groups}
        if unknown:
            raise ValueError(f"this message repeats no {', '.join(sorted(unknown))}")
        repeated = b""
        for group, layout in self._groups:
            if group.key in groups:
                parts[group.count] = len(groups[group.key])
                repeated += b"".join(layout.encode(row) for row in groups[group.key])
        return repeated


def _layout_of(group: Group, family: str) -> Layout:
    return Layout(group.fields, (), family, group.size, {field.key: ANYTHING for field in group.fields})
