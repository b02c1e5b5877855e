"""Events for flags of poses that begin or end."""

from collections.abc import Collection
from typing import Final

from tilth.schemas.flow import Flag, FlagKind
from tilth.schemas.notices import Notice, NoticeCode, notice

ENDS: Final = frozenset({
    FlagKind.LOST, FlagKind.WAITING, FlagKind.FLOATING, FlagKind.NO_RTK, FlagKind.NO_FIX, FlagKind.REPEATING,
    FlagKind.SWAPPED, FlagKind.MOVED, FlagKind.DOUBTFUL, FlagKind.LATE, FlagKind.LATENCY, FlagKind.SPIKES,
    FlagKind.FIX_UNKNOWN,
})  # fmt: skip
"""Of which the beginning and the end are told."""
BEGINS: Final = ENDS | {FlagKind.LATE_FRAMES}
"""Of which the beginning is told."""
OFTEN: Final = frozenset({FlagKind.LATE})
"""What a slow receiver, or one on a busy bus, has all day: told the first time, the tenth, the hundredth."""


def flag_events(
    before: Collection[Flag], now: Collection[Flag], times: dict[str, int]
) -> list[tuple[str, Notice]]:
    """(kind, notice) of the events, from the flags of the pose before and of this one.

    times: how often each flag of OFTEN has begun; changed in place.
    """
    out: list[tuple[str, Notice]] = []
    for flag in now:
        if flag in before or flag.kind not in BEGINS:
            continue
        count = 1
        if flag.kind in OFTEN:
            count = times[str(flag)] = times.get(str(flag), 0) + 1
        if _is_told(times, flag):
            again = {"times": count} if count > 1 else {}
            out.append((flag.kind, notice(NoticeCode.FLAG, flag=flag.kind, of=flag.of, **again)))
    for flag in before:
        if flag not in now and flag.kind in ENDS and _is_told(times, flag):
            out.append((flag.kind, notice(NoticeCode.OVER, of=flag.of)))
    return out


def _is_told(times: dict[str, int], flag: Flag) -> bool:
    """Whether it has begun 1, 10, 100 … times, or counts each time."""
    return str(times.get(str(flag), 1)).rstrip("0") == "1"
