"""Where a run comes from: its logs and their sums, the machine file, versions; and what makes it doubtful."""

from tilth.analysis.report.data import OriginFacts
from tilth.analysis.runs.kept import sha256_of
from tilth.analysis.runs.run import Run
from tilth.logger.log.software import software
from tilth.schemas.readable import readable


def origin_of(run: Run) -> OriginFacts:
    """Raises OSError."""
    replayed = any(file.path not in run.sources for file in run.files)
    return {
        "logs": [
            {"path": readable(path), "bytes": path.stat().st_size, "sha256": sha256_of(path)}
            for path in run.sources
        ],
        "whole": run.whole,
        "cut": [readable(file.path.name) for file in run.files if not file.whole],
        "replayed": replayed,
        "machine_sha256": run.machine_file.sha256,
        "recorded_with": {} if replayed else dict(run.software),
        "reported_with": software(),
        "simulated": bool(run.simulated),
    }
