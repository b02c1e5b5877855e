"""Which channels there are to export, and how they are called: their topic with `_` for `/`."""

import difflib
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from typing import Final

from tilth.analysis.runs.reading import indexed_topics
from tilth.analysis.runs.run import Run, topics
from tilth.logger.log.mcap_log import CAN_TOPIC

CAN: Final = "can"  # raw frames of all buses
TOPICS: Final[dict[str, str]] = {topic.strip("/").replace("/", "_"): topic for topic in topics()}
"""Channel -> topic; CAN has one for each bus."""
NAMES: Final = (*TOPICS, CAN)
AGES_S: Final[dict[str, float]] = {
    "pose": 0.5,
    "measurement_fix": 2.5,
    "measurement_time": 2.5,
    "measurement_*": 0.5,
    "gnss_*": 0.5,
    "soil_tire*": 3.0,
    "status": 3.0,
}
"""Channel -> how old a value may be on a common clock, s; the first row that fits. Poses come each 0.2 s,
estimates and the daemon's status each second; an estimate is used for 3 s, as controllers do."""
_NO_VALUES: Final = (
    "measurement_address_claim",
    "event",
    "accepted",
    "load",
    "addresses",
    "fit",
    "ready",
    "tie",
    "rig",
    "report",
    CAN,
)


class UnknownChannel(ValueError):
    """The text says which there are."""


def choose(wanted: Sequence[str], on_clock: bool = False) -> tuple[str, ...]:
    """Channels of names, topics and patterns such as `measurement_*`; all where none is wanted.

    on_clock: only those whose values hold for a while. Raises UnknownChannel.
    """
    there = [name for name in NAMES if not on_clock or name not in _NO_VALUES]
    chosen: list[str] = []
    for word in wanted or ["*"]:
        pattern = word.strip().strip("/").replace("/", "_")
        found = [name for name in there if fnmatchcase(name, pattern)]
        if not found:
            raise UnknownChannel(_unknown(pattern, on_clock, there))
        chosen += found
    return tuple(name for name in there if name in chosen)


def _unknown(name: str, on_clock: bool, there: Sequence[str]) -> str:
    if on_clock and name in _NO_VALUES:
        return (
            f"{name} has no values that hold for a while, as a common clock needs; export it without --clock"
        )
    near = difflib.get_close_matches(name, there, 1, 0.5)
    return f"{name}: no such channel" + (f"; {near[0]}?" if near else f"; there are {', '.join(there)}")


def age_s(channel: str) -> float:
    """How old a value of a channel may be on a common clock."""
    return next(age for pattern, age in AGES_S.items() if fnmatchcase(channel, pattern))


def channels_in(run: Run) -> tuple[str, ...] | None:
    """What a run holds, by the index of its files; None where one has no index, since it was cut off."""
    found: set[str] = set()
    for file in run.files:
        there = set(indexed_topics(file.path).values())
        if not there:
            return None
        found |= there
    return tuple(name for name in NAMES if _is_in(name, found))


def _is_in(name: str, found: Iterable[str]) -> bool:
    if name == CAN:
        return any(topic.startswith(CAN_TOPIC) for topic in found)
    return TOPICS[name] in found
