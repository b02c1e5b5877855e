"""Which message holds the wheel angle: a word of any message that goes with the way that is driven.

What is known of a wheel angle: its tangent is wheelbase times turn rate over speed, at every speed; it comes
before the turn, and longer at speed, since tyres have to roll to build up their force and the rig has to be
turned; what the steering is asked for comes before it. So a turn rate is none, nor a curvature
that somebody computes from one.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration.calibrate import TractorMotion
from tilth.estimator.calibration.faults import FAULTS
from tilth.estimator.calibration.initial_guess import INITIAL_GUESS
from tilth.estimator.calibration.least_squares import solve
from tilth.estimator.rig.residuals import path_angle, wheel_slopes
from tilth.replay.wheel_search import FEWEST_SAMPLES, SLOWEST_HZ, Words, may_hold_it, with_sign, words_of
from tilth.schemas.can_id import split
from tilth.schemas.fields import DEG
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine, WheelAngle
from tilth.schemas.wheel_angle import RUDDER

Array = NDArray[np.float64]

APART_NS: Final = 90_000_000  # between frames of one message that are looked at
FEWEST_VALUES: Final = 8
FEWEST_ROWS: Final = 150  # 30 s of driving
LIKELY: Final = 0.8  # correlation of a word with the way, before its lead is known
LEADS_S: Final = np.arange(-0.5, 1.201, 0.02)
LONGER_S: Final = 0.08
"""A weaving tractor turns later than its wheels, by 0.13 to 0.2 s more than in slow circles (both plants): a
word that goes with the turn alike at all speeds is computed from it, whatever is late."""
WINDING: Final = 0.01  # rad, sd of the way's angle, at least
NEARLY: Final = 2.0  # times the unexplained variance of the best: as good
AS_EARLY_S: Final = 0.1
PRIORS: Final = np.array([3.0, 20.0, 0.05])  # of zero, rad, gain and understeer of a word in about radians
NO_DATA: Final = {16: (0x7FFF, 0xFFFF), 8: (0x7F, 0xFF)}
"""By bits: of a signed word, and of one that is not."""
SHOWN: Final = 3  # runners-up


@dataclass(frozen=True, slots=True)
class WheelWord:
    """A word that goes with the way."""

    bus: str
    can_id: int
    extended: bool
    start_byte: int
    byte_order: str  # big | little
    bits: int
    signed: bool
    instance: int | None  # byte 0 of PGN 127245
    no_data: int | None  # raw value that was seen and means none
    zero: float  # raw when straight
    per_degree: float  # raw, positive where a right turn is
    explained: float  # share of its variance, in slow driving
    lead_s: float  # by which it comes before the turn, at speed if that was driven
    longer_s: float | None  # by how much that is more than in slow driving

    @property
    def rudder(self) -> bool:
        return self.extended and split(self.can_id).pgn == RUDDER

    @property
    def words(self) -> str:
        """For people."""
        where = f"0x{self.can_id:X} on {self.bus}"
        if self.rudder:
            return f"PGN 127245 from address {self.can_id & 0xFF} on {self.bus}"
        kind = f"{self.byte_order} endian, " if self.bits > 8 else ""
        sign = "signed" if self.signed else "unsigned"
        return f"{where}, byte {self.start_byte}, {self.bits} bits, {kind}{sign}"


@dataclass(slots=True)
class WheelMessages:
    """The frames of all messages that may hold it, about ten a second of each."""

    times_ns: dict[tuple[str, int, bool], list[int]] = field(default_factory=dict)
    data: dict[tuple[str, int, bool], list[bytes]] = field(default_factory=dict)

    def take(self, frame: Frame) -> None:
        """Keep a frame, if it may be of use."""
        key = (frame.bus, frame.can_id, frame.extended)
        times = self.times_ns.get(key)
        if times is None:
            if frame.error or not may_hold_it(frame.can_id, frame.extended):
                return
            times = self.times_ns[key] = []
            self.data[key] = []
        if not times or frame.rx_ns - times[-1] >= APART_NS:
            times.append(frame.rx_ns)
            self.data[key].append(frame.data)


@dataclass(frozen=True, slots=True)
class WheelFound:
    """What a search gives."""

    best: WheelWord | None
    others: tuple[WheelWord, ...]  # that go with the way as well, the likeliest first
    refused: tuple[tuple[WheelWord, str], ...]  # and what speaks against them

    @property
    def sentences(self) -> list[str]:
        """For people, of what is not the best."""
        said = [f"may be it, too: {word.words}" for word in self.others[:SHOWN]]
        return said + [f"is not it: {word.words}: {why}" for word, why in self.refused[:SHOWN]]


def find(messages: WheelMessages, motion: TractorMotion, given: WheelAngle) -> WheelFound:
    """given: of the machine file; between equals its own message is preferred."""
    found: list[tuple[WheelWord, float]] = []
    for (bus, can_id, extended), times in messages.times_ns.items():
        fits = _of_message((bus, can_id, extended), times, messages.data[bus, can_id, extended], motion)
        best = max(fits, key=lambda one: (one[0].explained, one[0].bits), default=None)
        if best is not None:
            found.append(best)
    return _chosen(found, given)


def _chosen(found: Sequence[tuple[WheelWord, float]], given: WheelAngle) -> WheelFound:
    """found: each with the unexplained variance at all speeds over that of a turn rate."""
    refused, left = list[tuple[WheelWord, str]](), list[WheelWord]()
    for word, against_rate in found:
        if against_rate > 1.0:
            refused.append((word, "it is a turn rate, at different speeds it is no angle"))
        elif word.longer_s is not None and word.longer_s < LONGER_S:
            refused.append((word, "it goes with the turn at any speed, so it is computed from it"))
        else:
            left.append(word)
    if not left:
        return WheelFound(None, (), tuple(refused))
    least = min(1.0 - word.explained for word in left)
    good = [word for word in left if 1.0 - word.explained <= NEARLY * max(least, 0.01)]
    latest = min(word.lead_s for word in good)

    def rank(word: WheelWord) -> tuple[bool, bool, bool, float]:
        asked = word.lead_s > latest + AS_EARLY_S  # what the steering is asked for comes earlier
        return word not in good, asked, not _is_of(word, given), -word.explained

    left.sort(key=rank)
    return WheelFound(left[0], tuple(left[1:]), tuple(refused))


def _is_of(word: WheelWord, given: WheelAngle) -> bool:
    if word.bus != given.bus:
        return False
    if given.pgn is not None:
        return word.rudder and word.can_id & 0xFF == given.source
    return given.id is not None and (word.can_id ^ given.id) & given.mask == 0


def _of_message(
    key: tuple[str, int, bool], times_ns: Sequence[int], data: Sequence[bytes], motion: TractorMotion
) -> Iterator[tuple[WheelWord, float]]:
    bus, can_id, extended = key
    seconds = (times_ns[-1] - times_ns[0]) * 1e-9
    if len(data) < FEWEST_SAMPLES or len({len(d) for d in data}) != 1 or len(data) < seconds * SLOWEST_HZ:
        return
    times, rudder = np.array(times_ns, np.int64), extended and split(can_id).pgn == RUDDER
    for start_byte, byte_order, bits, words in _all_words(data, rudder):
        if len(np.unique(words)) < FEWEST_VALUES:
            continue
        signed, _ = with_sign(words[~np.isin(words, NO_DATA[bits])], bits)
        none = words == NO_DATA[bits][0 if signed else 1]
        if np.count_nonzero(none) > 0.1 * len(words):
            continue
        half = 1 << bits - 1
        values = np.where(signed & (words >= half), words - 2 * half, words)[~none]
        made = _fitted(times[~none], values, motion)
        if made is None:
            continue
        if made.explained >= FAULTS.explained and made.gain != 0.0:
            seen = int(words[none][0]) if none.any() else None
            word = WheelWord(
                bus, can_id, extended, start_byte, byte_order, bits, signed or rudder,
                data[0][0] if rudder else None, seen, made.zero, made.gain * DEG,
                made.explained, made.lead_s, made.longer_s,
            )  # fmt: skip
            yield word, made.against_rate


def _all_words(data: Sequence[bytes], rudder: bool) -> Iterator[tuple[int, str, int, Words]]:
    """(first byte, byte order, bits, words); single bytes last."""
    for start_byte, byte_order, words in words_of(data, rudder):
        yield start_byte, byte_order, 16, words
    if not rudder and data[0]:
        octets = np.frombuffer(b"".join(data), np.uint8).reshape(len(data), -1).astype(np.int64)
        for place in range(octets.shape[1]):
            yield place, "little", 8, octets[:, place]


class _Fitted(NamedTuple):
    """Of one word."""

    zero: float  # raw
    gain: float  # raw per rad
    explained: float
    lead_s: float
    longer_s: float | None
    against_rate: float  # unexplained variance at all speeds over that of a turn rate


def _fitted(times_ns: Words, values: Words, motion: TractorMotion) -> _Fitted | None:
    """None where the word hardly goes with the way, or too little was driven."""
    u, r = motion.speed, motion.yaw_rate
    path = path_angle(motion.wheelbase, np.where(u > INITIAL_GUESS.moving, u, 1.0), r)
    known = (u > INITIAL_GUESS.moving) & np.isfinite(r) & np.isfinite(u)
    known &= (motion.t_ns > times_ns[0] + 2e9) & (motion.t_ns < times_ns[-1] - 2e9)
    slow, fast = known & (u < INITIAL_GUESS.slow), known & (u >= INITIAL_GUESS.slow)
    slow = slow if np.count_nonzero(slow) > FEWEST_ROWS else known
    if np.count_nonzero(slow) < FEWEST_ROWS or np.std(path[slow]) < WINDING:
        return None

    def word(lead: float) -> Array:
        then = motion.t_ns.astype(np.float64) - lead * 1e9
        return np.interp(then, times_ns.astype(np.float64), values.astype(np.float64))

    usual = word(0.0)
    if np.std(usual[slow]) == 0.0 or abs(np.corrcoef(usual[slow], path[slow])[0, 1]) < LIKELY:
        return None
    size, shift = float(np.std(usual[slow]) / np.std(path[slow])), float(np.median(usual[slow]))
    design = wheel_slopes(path, u * r)
    lead, longer = _lead(design[slow], lambda at: word(at)[slow]), None
    reading = (word(lead) - shift) / size
    told = solve(design[slow], reading[slow], PRIORS, 1e-4)
    explained = 1.0 - float(np.var(reading[slow] - design[slow] @ told.value) / np.var(reading[slow]))
    if np.count_nonzero(fast) >= FEWEST_ROWS and np.std(path[fast]) > WINDING:
        quick = _lead(design[fast], lambda at: word(at)[fast])
        lead, longer = quick, quick - lead
    rate = np.column_stack([np.ones(len(u)), r])[known]
    of_rate = np.linalg.lstsq(rate, reading[known], rcond=None)[0]
    by_rate = float(np.var(reading[known] - rate @ of_rate))
    against = float(np.var(reading[known] - design[known] @ told.value)) / max(by_rate, 1e-12)
    zero, gain = told.value[0] * size + shift, told.value[1] * size
    return _Fitted(float(zero), float(gain), explained, lead, longer, against)


def _lead(design: Array, word: Callable[[float], Array]) -> float:
    """By how much a word comes before what explains it, s. design: (m, 3); word: by a lead, (m,)."""

    def left(lead: float) -> float:
        reading = word(lead)
        found = np.linalg.lstsq(design, reading, rcond=None)[0]
        return float(np.var(reading - design @ found) / max(float(np.var(reading)), 1e-12))

    return float(min(LEADS_S.tolist(), key=left))


def reading_as(machine: Machine, word: WheelWord) -> Machine:
    """The machine file with this word for its wheel angle, its scale and sign by the way."""
    given = machine.wheel_angle
    per = abs(word.per_degree)
    sign = 1 if word.per_degree > 0.0 else -1
    update: dict[str, object] = {
        "bus": word.bus, "id": word.can_id, "mask": 0x1FFFFFFF, "extended": word.extended, "dbc": None,
        "dbc_text": None, "signal": None, "pgn": None, "source": None, "instance": None,
        "byte_order": word.byte_order, "start_byte": word.start_byte, "start_bit": None, "bits": word.bits,
        "signed": word.signed, "lookup": None, "sign": sign, "not_available": word.no_data,
    }  # fmt: skip
    if word.rudder:
        update |= {
            "id": None, "start_byte": None, "pgn": RUDDER, "source": word.can_id & 0xFF,
            "instance": word.instance, "bits": 16, "byte_order": "little", "not_available": None,
        }  # fmt: skip
    elif _is_of(word, given) and given.bits == word.bits and _alike(per * abs(given.scale)):
        update |= {"mask": given.mask, "lookup": given.lookup, "sign": given.sign}
        update["not_available"] = given.not_available
    else:
        scale = float(f"{1.0 / per:.3g}")
        straight = word.zero * scale
        update |= {"scale": scale, "offset": -round(straight, 2) if abs(straight) > LARGE_ZERO else 0.0}
    return machine.model_copy(update={"wheel_angle": given.model_copy(update=update)})


LARGE_ZERO: Final = 5.0  # degrees: beyond, it is no zero of a sensor but an offset of its number
ALIKE: Final = 1.35


def _alike(ratio: float) -> bool:
    return 1.0 / ALIKE < ratio < ALIKE
