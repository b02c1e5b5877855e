"""No driving is used twice: what two logs hold alike would count as two drives that agree."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from mcap.reader import make_reader

from tilth.analysis.runs.log_file import DAEMON_RUN, LogFile
from tilth.logger.log.mcap_file import DAMAGE
from tilth.logger.log.mcap_log import CAN_TOPIC
from tilth.replay.readers.log import LogError
from tilth.replay.simulated import REPLAY
from tilth.schemas.invocation import command
from tilth.schemas.proto import tilth_pb2 as pb

Ends = tuple[tuple[int, int, bytes], ...]  # (time, identifier, data) of the first and the last frame
_UNKNOWN: Final[Ends] = ()


class GivenTwice(LogError):
    """Two logs hold the same driving."""

    status = 2


def check_given_once(logs: Sequence[tuple[Path, LogFile]]) -> None:
    """logs: as given, and what is read of each. Raises GivenTwice, OSError."""
    seen: dict[object, tuple[Path, LogFile]] = {}
    for path, file in logs if len(logs) > 1 else ():
        for mark in _marks(path, file):
            other, before = seen.setdefault(mark, (path, file))
            if before is not file and file.first_ns <= before.last_ns and before.first_ns <= file.last_ns:
                raise GivenTwice(
                    f"{other} and {path} hold the same driving, which would count twice: give one of them; "
                    f"`{command('compare', str(other), str(path))}` tells how two replays of a log differ"
                )


def _marks(path: Path, file: LogFile) -> list[object]:
    """What two files share only if they hold the same driving, as far as their times overlap."""
    found: list[object] = [str(path.resolve()), *file.metadata.get(REPLAY, {}).get("logs", "").splitlines()]
    ends = _ends(file.path)
    run = file.metadata.get("run", {})
    part = (run.get("id", ""), run.get("part", ""))
    return found + [ends] * bool(ends) + [part] * bool(DAEMON_RUN.fullmatch(part[0]))


def _ends(path: Path) -> Ends:
    """Of a whole file; _UNKNOWN of any other. Raises OSError."""
    with path.open("rb") as file:
        try:
            reader = make_reader(file)
            summary = reader.get_summary()
            if summary is None or not summary.chunk_indexes:
                return _UNKNOWN
            buses = [c.topic for c in summary.channels.values() if c.topic.startswith(CAN_TOPIC)]
            rows = [next(reader.iter_messages(buses, reverse=back), None) for back in (False, True)]
            frames = [(row[2].log_time, pb.CanFrame.FromString(row[2].data)) for row in rows if row]
            return tuple((t_ns, frame.can_id, frame.data) for t_ns, frame in frames)
        except DAMAGE:
            return _UNKNOWN
