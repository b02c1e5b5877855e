"""A replay that gives what was logged live."""

from collections.abc import Sequence
from pathlib import Path

from tilth.replay.compare import Comparison
from tilth.replay.offline import ReplayOutputs, ReplaySummary, replay
from tilth.schemas.machine_toml import MachineFile


def verified(logs: Sequence[Path], file: MachineFile, least: int = 1) -> ReplaySummary:
    """Of a replay all of whose results, `least` or more, are those of the logs."""
    comparison = Comparison()
    summary = replay(logs, file, outputs=ReplayOutputs(comparison=comparison))
    assert comparison.difference == "" and comparison.compared >= least
    return summary
