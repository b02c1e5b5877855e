"""One file of a run, as its head and its end tell of it."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

DAEMON_RUN: Final = re.compile(r"[0-9a-f]{32}")  # an id by which the daemon tells its runs apart


@dataclass(slots=True)
class LogFile:
    """Metadata records are by name."""

    path: Path
    metadata: dict[str, dict[str, str]]
    first_ns: int
    last_ns: int
    whole: bool
