"""Searches for the wheel angle: a 16-bit word that moves smoothly, best with the yaw rate."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.schemas.can_id import split
from tilth.schemas.pgn_table import PGNS, row
from tilth.schemas.wheel_angle import RUDDER

HAND_WHEEL: Final = 61469  # SAE J1939: the angle of the driver's wheel
_TABLE: Final = frozenset(known.pgn for known in PGNS) | {HAND_WHEEL}
_SELECTED: Final = frozenset(known.pgn for known in PGNS if known.selector is not None)
PROPRIETARY: Final = frozenset((61184, 126720, *range(65280, 65536)))
FEWEST_SAMPLES: Final = 40
SLOWEST_HZ: Final = 5.0
FEWEST_VALUES: Final = 16
SMOOTHEST_NOISE: Final = 0.5  # white noise has a smoothness of 0, a wheel angle at 100 Hz more than 0.9
COUNTER_SHARE: Final = 0.8  # of equal steps: a counter, no angle
TURNING: Final = 0.03  # rad/s, sd of the yaw rate: enough to compare with
LIKELY: Final = 0.8  # correlation with the yaw rate
NO_DATA: Final = (0x7FFF, 0xFFFF)

Words = NDArray[np.int64]
Series = Sequence[tuple[int, float]]
"""(ns, value), ascending"""


def may_hold_it(can_id: int, extended: bool) -> bool:
    """Whether a message may hold the wheel angle: it is not known to hold something else."""
    pgn = split(can_id).pgn if extended else None
    return pgn not in _TABLE or pgn in _SELECTED or pgn == RUDDER


@dataclass(frozen=True, slots=True)
class WheelCandidate:
    """A 16-bit word that moves as a wheel angle does."""

    bus: str
    can_id: int
    extended: bool
    start_byte: int
    byte_order: str  # big | little
    signed: bool
    lowest: int
    highest: int
    per_s: float
    smoothness: float  # 0: as noise, 1: a straight line
    yaw_correlation: float | None  # None: no yaw rate was heard, or there was no turn

    @property
    def pgn(self) -> int | None:
        return split(self.can_id).pgn if self.extended else None

    @property
    def likely(self) -> bool:
        """Good enough to stand in a draft of a machine file."""
        return self.pgn == RUDDER or abs(self.yaw_correlation or 0.0) >= LIKELY

    @property
    def score(self) -> float:
        """For sorting: high where it correlates with the yaw rate and has no other known use."""
        unassigned = not self.extended or self.pgn in PROPRIETARY or self.pgn == RUDDER
        return abs(self.yaw_correlation or 0.0) + 0.3 * unassigned + 0.2 * self.smoothness


def candidates(
    bus: str, can_id: int, extended: bool, times_ns: Sequence[int], data: Sequence[bytes], yaw: Series
) -> Iterator[WheelCandidate]:
    """Every word of one identifier's frames that may be a wheel angle; yaw: yaw rate in rad/s."""
    seconds = (times_ns[-1] - times_ns[0]) * 1e-9
    if not 0.0 < seconds <= len(data) / SLOWEST_HZ:  # 0 where a log has no stamps
        return
    if len(data) < FEWEST_SAMPLES or len({len(d) for d in data}) != 1:
        return
    times = np.array(times_ns, np.int64)
    for start_byte, byte_order, words in words_of(data, extended and split(can_id).pgn == RUDDER):
        good = ~np.isin(words, NO_DATA)
        if np.count_nonzero(good) < 0.9 * len(words):
            continue
        signed, values = with_sign(words[good])
        smoothness = _smoothness(values)
        if smoothness is not None:
            yield WheelCandidate(
                bus, can_id, extended, start_byte, byte_order, signed, int(values.min()), int(values.max()),
                (len(data) - 1) / seconds, smoothness, _correlation(times[good], values, yaw),
            )  # fmt: skip


def words_of(data: Sequence[bytes], rudder: bool) -> Iterator[tuple[int, str, Words]]:
    """(first byte, byte order, words): at every place, of a rudder message at its own."""
    octets = np.frombuffer(b"".join(data), np.uint8).reshape(len(data), -1).astype(np.int64)
    if rudder:
        angle = next(f for f in row(RUDDER).fields if f.key == "wheel_angle_rad")
        places = [angle.start // 8] if octets.shape[1] * 8 >= angle.end else []
    else:
        places = list(range(octets.shape[1] - 1))
    for place in places:
        first, second = octets[:, place], octets[:, place + 1]
        yield place, "little", first | second << 8
        if not rudder:
            yield place, "big", first << 8 | second


def with_sign(words: Words, bits: int = 16) -> tuple[bool, Words]:
    """Signed where the word steps across the top: (whether, values)."""
    half = 1 << bits - 1
    signed = bool(np.any(np.abs(np.diff(words)) > half))
    return signed, np.where(words >= half, words - 2 * half, words) if signed else words


def _smoothness(values: Words) -> float | None:
    """1 − rms step / (sqrt 2 sd); None for what is no angle: too few values, a counter, noise."""
    steps = np.diff(values)
    moving = steps[steps != 0]
    if len(np.unique(values)) < FEWEST_VALUES or len(np.unique(values >> 8)) < 2 or not len(moving):
        return None
    _, counts = np.unique(moving, return_counts=True)
    if counts.max() > COUNTER_SHARE * len(moving):
        return None
    smoothness = 1.0 - float(np.sqrt(np.mean(steps**2.0)) / (np.sqrt(2.0) * np.std(values)))
    return smoothness if smoothness > SMOOTHEST_NOISE else None


def _correlation(times_ns: Words, values: Words, yaw: Series) -> float | None:
    if len(yaw) < FEWEST_SAMPLES:
        return None
    at, rates = np.array(yaw).T
    there = np.interp(times_ns.astype(np.float64), at, rates)
    if np.std(there) < TURNING:
        return None
    return float(np.corrcoef(values, there)[0, 1])
