"""A run's driving as the estimators take it, and where it is kept."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tilth.analysis.runs.kept import key_of
from tilth.estimator.record.record import Segment
from tilth.schemas.flow import Pose

_ENDS: Final = 1 << 20  # bytes at both ends of a file that tell it from another


@dataclass(frozen=True, slots=True)
class Driven:
    """A pose, and what was measured between the two poses before it; None before the third pose."""

    pose: Pose
    segment: Segment | None

    @property
    def t_ns(self) -> int:
        return self.pose.t_ns


def kept_driving(folder: Path, files: Sequence[Path], machine_sha256: str) -> Path:
    """Where the driving of a run is kept. files: all of its logs, in their order. Raises OSError."""
    return folder / f"{key_of(*map(identity, files), machine_sha256)}.driving"


def identity(path: Path) -> str:
    """Of a log: its size, and the bytes at its beginning and end, where the index has all checksums."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_ENDS)
        file.seek(max(0, size - _ENDS))
        return key_of(size, head, file.read(_ENDS))
