"""Whether a virtual tractor drove what a log tells, as everything says that shows it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from tilth.logger.log.mcap_log import SIMULATED
from tilth.replay.readers.any_log import metadata, open_log
from tilth.replay.readers.log import LogError

REPLAY: Final = "replay"  # metadata record of a log that a replay wrote: the logs that it read
TRUTH: Final = ".truth.json"  # what a simulation puts beside a log
SAID: Final = "simulated: no tractor drove this"
_HOPS: Final = 2  # from a replay to the logs that it was made from, where it has no mark itself


def mark_of(found: Mapping[str, Mapping[str, str]]) -> str:
    """What simulated a log, by its metadata records; "" where nothing did. Before the run itself told it,
    `tilth simulate` wrote a record of its own, and `tilth demo` a note."""
    run = found.get("run", {})
    if SIMULATED in run:
        return run[SIMULATED]
    if SIMULATED in found:
        return "tilth simulate"
    return "tilth demo" if run.get("note", "") == SIMULATED else ""


def simulated_by(paths: Sequence[Path]) -> str:
    """What simulated the first of these logs that was simulated; "" where none was, as far as they tell."""
    return next(filter(None, (_simulated_by(path, _HOPS) for path in paths)), "")


def _simulated_by(path: Path, hops: int) -> str:
    if path.with_name(path.name + TRUTH).exists():
        return "tilth simulate"
    try:
        log = open_log(path)
        with log.file:
            found = metadata(log)
    except (LogError, OSError):
        return ""
    before = found.get(REPLAY, {}).get("logs", "").splitlines() if hops else []
    return mark_of(found) or next(filter(None, (_simulated_by(Path(one), hops - 1) for one in before)), "")
