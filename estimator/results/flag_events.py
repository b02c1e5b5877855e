"""Events for flags of poses that begin or end."""

from collections.abc import Collection

from tilth.schemas.flow import Flag, FlagKind

_TEXT = {
    FlagKind.LOST: "gives no usable position",
    FlagKind.WAITING: "has given no position yet",
    FlagKind.FLOATING: "lost its RTK fix (float)",
    FlagKind.NO_RTK: "has no RTK fix",
    FlagKind.NO_FIX: "has no position fix",
    FlagKind.REPEATING: "repeats old positions",
    FlagKind.SWAPPED: "stands in another's place: two receivers are exchanged",
    FlagKind.MOVED: "is not where the machine file says",
    FlagKind.DOUBTFUL: "does not fit the rig at this instant",
    FlagKind.LATE: "is late; its position is carried on",
    FlagKind.LATENCY: "reports later than the machine file allows, or was moved along",
    FlagKind.SPIKES: "sends readings that jump to and fro; they are left out: look at its cable and plugs",
    FlagKind.FIX_UNKNOWN: "has stopped telling its fix",
}


_SENTENCES = {
    FlagKind.LATE_FRAMES: "frames came late: this computer, or the one that sends, is busy; meanwhile "
    "nothing is learned",
}


OFTEN = frozenset({FlagKind.LATE})
"""What a slow receiver, or one on a busy bus, has all day: told the first time, the tenth, the hundredth."""


def flag_events(
    before: Collection[Flag], now: Collection[Flag], times: dict[str, int]
) -> list[tuple[str, str]]:
    """(kind, text) of the events, from the flags of the pose before and of this one.

    times: how often each flag of OFTEN has begun; changed in place.
    """
    out: list[tuple[str, str]] = []
    for flag in now:
        if flag not in before and flag.kind in _TEXT:
            silent = flag.of == "wheel_angle" and flag.kind is not FlagKind.SPIKES
            text = f"{flag.of} {'is silent' if silent else _TEXT[flag.kind]}"
            if flag.kind in OFTEN:
                count = times[str(flag)] = times.get(str(flag), 0) + 1
                text += f" (for the {count}th time)" if count > 1 else ""
            if _is_told(times, flag):
                out.append((flag.kind, text))
        elif flag not in before and flag.kind in _SENTENCES:
            out.append((flag.kind, _SENTENCES[flag.kind]))
    for flag in before:
        if flag not in now and flag.kind in _TEXT and _is_told(times, flag):
            out.append((flag.kind, f"{flag.of}: over"))
    return out


def _is_told(times: dict[str, int], flag: Flag) -> bool:
    """Whether it has begun 1, 10, 100 … times, or counts each time."""
    return str(times.get(str(flag), 1)).rstrip("0") == "1"
