"""The recorded simulated drive that `tilth demo` shows while a computer gets ready.

    uv run python -m tilth.simulator.first_drive LOG     writes it anew, of a log of `tilth demo`

It holds what the page hears and nothing else, so that it stays far below 1 MB.
"""

import sys
from contextlib import closing, suppress
from importlib import resources
from pathlib import Path
from typing import Final

from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.replay.readers.rig import machine_in
from tilth.replay.recorded import RecordedRun
from tilth.replay.simulated import simulated_by

NAME: Final = "first_drive.mcap"
SHOWN: Final = frozenset({"/status", "/pose", "/soil_tire", "/event"})


def path() -> Path:
    """Where it is in this package."""
    return Path(str(resources.files("tilth.simulator") / NAME))


def write(log: Path, target: Path) -> None:
    """Raises LogError, OSError; FileExistsError where the target is there."""
    with closing(RecordedRun([log])) as run:
        rows = [row for row in run.after(-1) if row.topic in SHOWN]
    part = RunPart("recorded-drive", 1, rows[0].t_ns, simulated=simulated_by([log]))
    with closing(LogWriter(target, machine_in([log]), part)) as writer:
        for row in rows:
            writer.message(row.topic, row.t_ns, row.data)


if __name__ == "__main__":
    with suppress(FileNotFoundError):
        path().unlink()
    write(Path(sys.argv[1]), path())
