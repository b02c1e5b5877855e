"""One line of what `tilth check` answers."""

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    OK = "ok"
    NOTE = "note"  # worth knowing, nothing to do
    WARNING = "warning"  # may be wrong: look at it
    PROBLEM = "problem"


@dataclass(frozen=True, slots=True)
class CheckFinding:
    what: str
    state: Level
    text: str
