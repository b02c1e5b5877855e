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


def flag_events(before: Collection[Flag], now: Collection[Flag]) -> list[tuple[str, str]]:
    """(kind, text) of the events, from the flags of the pose before and of this one."""
    out: list[tuple[str, str]] = []
    for flag in now:
        if flag not in before and flag.kind in _TEXT:
            silent = flag.of == "wheel_angle" and flag.kind is not FlagKind.SPIKES
            text = "is silent" if silent else _TEXT[flag.kind]
            out.append((flag.kind, f"{flag.of} {text}"))
        elif flag not in before and flag.kind in _SENTENCES:
            out.append((flag.kind, _SENTENCES[flag.kind]))
    out += [(flag.kind, f"{flag.of}: over") for flag in before if flag not in now and flag.kind in _TEXT]
    return out
