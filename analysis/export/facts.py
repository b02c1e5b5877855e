"""What is said of an export: where it comes from, what it was made with, what its columns are."""

from collections.abc import Sequence

from tilth.analysis.export.columns import FRAMES, ExportColumn
from tilth.analysis.runs.kept import sha256_of
from tilth.analysis.runs.run import Run
from tilth.logger.log.software import software
from tilth.schemas.readable import readable


def facts_of(run: Run) -> dict[str, object]:
    """Plain data, the same for all files of a run. Raises OSError."""
    text, dbc = run.machine_file.text, run.machine.dbc_text
    machine = {"toml": text, "sha256": run.machine_file.sha256} | ({"dbc": dbc} if dbc else {})
    clock = run.reader.clock
    sources = [
        {"file": readable(path.name), "bytes": path.stat().st_size, "sha256": sha256_of(path)}
        for path in run.sources
    ]
    return {
        "tilth": software()["version"],
        "recorded_by": run.software.get("version", ""),
        "run": run.id,
        "note": run.note,
        "simulated": bool(run.simulated),
        "start_ns": clock.start_ns,
        "utc_minus_ns": clock.utc_minus_ns,
        "duration_s": round(run.duration_s, 9),
        "whole": run.whole,
        "sources": sources,
        "machine": machine,
        "frames": dict(FRAMES),
    }


def described(columns: Sequence[ExportColumn]) -> dict[str, dict[str, str]]:
    """Column -> what is known of it, without what is empty."""
    return {
        column.name: {
            key: value for key in ("kind", "unit", "frame", "meaning") if (value := str(getattr(column, key)))
        }
        for column in columns
    }
