"""A run's driving as the estimators take it, how it is kept, and where.

It is packed minute by minute: as JSON in one piece an hour takes 200 MB, and a fit asks for a minute of it.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tilth.analysis.runs.kept import key_of, packed, unpacked
from tilth.estimator.record.record import Segment
from tilth.schemas.flow import Pose

BLOCK: Final = 300  # poses, a minute, that are packed together
_ENDS: Final = 1 << 20  # bytes at both ends of a file that tell it from another


@dataclass(frozen=True, slots=True)
class Driven:
    """A pose, and what was measured between the two poses before it; None before the third pose."""

    pose: Pose
    segment: Segment | None

    @property
    def t_ns(self) -> int:
        return self.pose.t_ns


@dataclass(frozen=True, slots=True)
class DrivenBlock:
    """Up to BLOCK poses that follow each other."""

    first_ns: int  # t_ns of the earliest, and of the last
    last_ns: int
    text: str  # base 64 of what `packed` gives

    def driven(self) -> tuple[Driven, ...] | None:
        """What `of` was given; None where it was stored in another form."""
        return unpacked(base64.b64decode(self.text), tuple[Driven, ...])

    @classmethod
    def of(cls, driven: Sequence[Driven]) -> "DrivenBlock":
        """driven: at least one."""
        times = [at.t_ns for at in driven]
        return cls(min(times), max(times), base64.b64encode(packed(tuple(driven))).decode("ascii"))


class DrivingPacker:
    """Packs driving as it comes."""

    def __init__(self) -> None:
        self._blocks: list[DrivenBlock] = []
        self._open: list[Driven] = []

    def add(self, driven: Driven) -> None:
        """Of the next pose."""
        self._open.append(driven)
        if len(self._open) == BLOCK:
            self._close()

    def blocks(self) -> tuple[DrivenBlock, ...]:
        """All that was added."""
        if self._open:
            self._close()
        return tuple(self._blocks)

    def _close(self) -> None:
        self._blocks.append(DrivenBlock.of(self._open))
        self._open = []


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
