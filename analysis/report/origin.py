"""Where a run comes from: its logs and their sums, the machine file, versions; and what makes it doubtful."""

from pathlib import Path
from typing import Any, Final

from tilth.analysis.runs.kept import sha256_of
from tilth.analysis.runs.run import Run
from tilth.logger.log.mcap_log import machine_sha256, software
from tilth.replay.readers.any_log import metadata, open_log
from tilth.replay.readers.log import LogError
from tilth.schemas.readable import readable

SIMULATED: Final = "simulated"  # metadata record of a simulated log, and the fix of its receivers
REPLAY: Final = "replay"  # metadata record of a log that a replay wrote: the logs that it read
TRUTH: Final = ".truth.json"  # what a simulation puts beside a log


def origin_of(run: Run) -> dict[str, Any]:
    """Plain data. Raises OSError."""
    replayed = any(file.path not in run.sources for file in run.files)
    return {
        "logs": [
            {"path": readable(path), "bytes": path.stat().st_size, "sha256": sha256_of(path)}
            for path in run.sources
        ],
        "whole": run.whole,
        "cut": [readable(file.path.name) for file in run.files if not file.whole],
        "replayed": replayed,
        "machine_sha256": machine_sha256(run.machine, run.machine_text),
        "recorded_with": {} if replayed else dict(run.software),
        "reported_with": software(),
        "simulated": any(map(_is_simulated, run.sources)),
    }


def _is_simulated(path: Path, hops: int = 2) -> bool:
    """Whether a simulation made the log, or a log that it was replayed from, as far as that is here."""
    if path.with_name(path.name + TRUTH).exists():
        return True
    try:
        log = open_log(path)
        with log.file:
            found = metadata(log)
    except (LogError, OSError):
        return False
    if SIMULATED in found or found.get("run", {}).get("note", "") == SIMULATED:
        return True
    before = found.get(REPLAY, {}).get("logs", "").splitlines()
    return hops > 0 and any(_is_simulated(Path(one), hops - 1) for one in before)
