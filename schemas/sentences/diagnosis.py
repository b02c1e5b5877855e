"""Words of what is wrong with a machine file, or has been moved (`schemas/diagnosis.py`)."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from tilth.schemas.reasons import Code
from tilth.schemas.spread import interval, plus_minus

Words = Callable[[Sequence[str], Sequence[float]], str]
"""(of, numbers) of a reason."""

PARKED: Final[Mapping[str, str]] = {
    "longer_t": "length of the tractor's pair", "longer_i": "length of the implement's pair",
    "c": "hitch, along", "aside_i": "hitch, across",
}  # fmt: skip
FOUND: Final[Mapping[str, tuple[str, str]]] = {
    "wheel_zero": ("the zero of the wheel angle off by {}", "°"),
    "pair_t": ("the pair on the tractor off by {}", "°"),
    "pair_i": ("the pair on the implement off by {}", "°"),
    "latency": ("a latency of {} beyond the file's", "s"),
    "aside_i": ("the implement's receivers off by {}", "m"), "e": ("the implement's axle off by {}", "m"),
}  # fmt: skip
"""Number of the rig -> how far it is from the file, unit. Of the others a share is said."""
DEGREES: Final = (20.0, 160.0)  # factors near 57.3: degrees and radians were confused
LARGEST: Final = 5.0  # of a logarithm, in words


def measured(n: Sequence[float], k: int, unit: str = "") -> str:
    """The k-th of n, of which the second half are sds."""
    value, sd = n[k], n[k + len(n) // 2]
    if unit == "°":
        value, sd = math.degrees(value), math.degrees(sd)
    return plus_minus(value, sd, unit)


def _parked(of: Sequence[str], n: Sequence[float]) -> str:
    what = PARKED.get(of[1], of[1])
    return f"{what} is off by {n[0]:+.2f} m while the rig stands still: {of[0]}?"


def _wheel_scale(of: Sequence[str], n: Sequence[float]) -> str:
    larger = max(n[0], 1.0 / max(n[0], 1e-3))
    size = f"{n[0]:.2g} times" if n[0] >= 1.0 else f"1/{larger:.2g} of"
    text = f"the wheel angle is {size} what the yaw rate requires: {of[0]}?"
    return f"{text} (degrees per bit, not radians)" if DEGREES[0] < larger < DEGREES[1] else text


def _by_driving(of: Sequence[str], n: Sequence[float]) -> str:
    others = "".join(f", or {key}" for key in of[2:])
    return f"driving finds {_how_far(of[0], of[1], n)}: {of[0]}{others}?"


def _off(words: Words) -> Words:
    """With the key, and others that may be it."""
    return lambda of, n: f"driving finds {words(of, n)}: {', or '.join([of[0], *of[2:]])}?"


def _how_far(key: str, number: str, n: Sequence[float]) -> str:
    if number in FOUND:
        words, unit = FOUND[number]
        return words.format(measured(n, 0, unit))
    low, high = interval(math.exp(min(n[0], LARGEST)), min(n[1], LARGEST))
    what = "reading of the wheel angle" if number == "wheel_gain" else key.partition(" or ")[0]
    return f"{what} {low:.2f} to {high:.2f} times what the file says (95 %)"


def _leans(value: str) -> Words:
    return lambda of, n: (
        f"{of[1]}: it moves with roll by {measured(n, 0)} of its height: set roll_corrected = {value} in "
        "the machine file"
    )


def _moved(words: Words) -> Words:
    """With what else it may be."""
    return lambda of, n: ", or it is ".join([words(of, n), *of[2:]])


def _tyres(of: Sequence[str], n: Sequence[float]) -> str:
    now, before, sd_now, sd_before = n[:4]
    share = 100.0 * math.hypot(sd_now / now, sd_before / before)
    return f"the tyres' radius has changed by {plus_minus(100.0 * (before / now - 1.0), share, '%')}: {of[0]}"


DIAGNOSES: Final[Mapping[Code, Words]] = {
    Code.RECEIVER_NOT_THERE: lambda of, n: (
        f"{of[1]} is not where the machine file says: its position, or the lengths to the hitch?"
    ),
    Code.RECEIVER_EXCHANGED: lambda of, n: (
        f"{of[1]} is in another receiver's place: are names or sources exchanged?"
    ),
    Code.RECEIVER_AT_ANOTHER_TIME: lambda of, n: (
        f"{of[1]} seems to report at another time than the file allows: its latency or position?"
    ),
    Code.OFF_WHERE_PARKED: _parked,
    Code.NO_LIKELY_LATENCY: lambda of, n: f"distances between the receivers fit no likely latency: {of[0]}?",
    Code.WHEEL_MOVES_ALONE: lambda of, n: f"the wheel angle changes, but the tractor does not turn: {of[0]}?",
    Code.WHEEL_OPPOSITE: lambda of, n: f"the wheel angle has the opposite sign of the yaw rate: {of[0]}?",
    Code.WHEEL_SCALE: _wheel_scale,
    Code.WHEEL_UNRELATED: lambda of, n: (
        f"the wheel angle is unrelated to the yaw rate: {of[0]} (id, bytes, delay)?"
    ),
    Code.FARTHER_THAN_SPEED: lambda of, n: (
        f"the {of[1]} travels {n[0]:.2f} times as far as its receivers' speed indicates: {of[0]}?"
    ),
    Code.ROLL_FOLLOWS_TURNS: lambda of, n: (
        f"the {of[1]}'s measured roll follows its turns by {math.degrees(n[0]):+.1f}° per m/s² of lateral "
        f"acceleration, as no vehicle leans: {of[0]}?"
    ),
    Code.LEAN_APART: lambda of, n: (
        f"tractor and implement lean apart by {math.degrees(n[0]):+.0f}° on average, on the same ground: "
        f"{of[0]}?"
    ),
    Code.CORRECTED_TWICE: _leans("true"),
    Code.NOT_CORRECTED: _leans("false"),
    Code.ROLL_CORRECTION_UNCLEAR: lambda of, n: (
        "the hitch moves with roll as if roll_corrected were wrong on the tractor or on the implement: "
        "compare it with the settings of their receivers"
    ),
    Code.YAW_RATE_SMOOTHED: lambda of, n: (
        f"{of[1]}: its turn rate lags by {measured(n, 0, 's')} and is not used, and what was learned "
        "with it is forgotten: turn its smoothing off"
    ),
    Code.DRIVING_FINDS: _by_driving,
    Code.METHOD_FINDS: lambda of, n: f"{of[2]} finds {_how_far(of[0], of[1], n)}: {of[0]}?",
    Code.RECEIVER_OFF: _off(
        lambda of, n: (
            f"{of[1]} {measured(n, 0, 'm')} forward and {measured(n, 1, 'm')} to the right of its "
            "place in the file"
        )
    ),
    Code.DRAWBAR_OFF: _off(
        lambda of, n: (
            f"the implement's receivers {plus_minus(-n[0], n[1], 'm')} further behind the hitch than in "
            "the file"
        )
    ),
    Code.MOST_REJECTED: lambda of, n: (
        f"{100 * n[0]:.0f} % of the receivers' readings do not fit this rig: receiver, tractor or implement?"
    ),
    Code.NO_TYRE: lambda of, n: (
        f"no tyre has a stiffness of {n[0]:.2g} times its load per rad ({of[1]}): {of[0]}?"
    ),
    Code.RECEIVER_MOVED: _moved(
        lambda of, n: (
            f"{of[1]} has been moved {measured(n, 0, 'm')} forward and {measured(n, 1, 'm')} to the right"
        )
    ),
    Code.PAIR_TURNED: _moved(
        lambda of, n: (
            f"the pair on the {of[1].removeprefix('pair_')} has been turned by {measured(n, 0, '°')}"
        )
    ),
    Code.WHEEL_SLIPPED: _moved(
        lambda of, n: f"the wheel-angle sensor has slipped by {measured(n, 0, '°')}: {of[0]}"
    ),
    Code.DRAWBAR_CHANGED: _moved(
        lambda of, n: f"the drawbar is {plus_minus(-n[0], n[len(n) // 2], 'm')} longer: {of[0]}"
    ),
    Code.TYRES_CHANGED: _tyres,
}
