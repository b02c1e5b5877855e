"""A run's driving as the estimators take it, how it is kept, and where.

It is packed minute by minute: as JSON in one piece an hour takes 200 MB, and a fit asks for a minute of it.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from tilth.analysis.runs.kept import compressed, expanded, key_of, load_bytes, store_bytes
from tilth.estimator.record.record import Segment
from tilth.schemas.flow import Pose
from tilth.schemas.log_settings import Log

BLOCK: Final = 300  # poses, a minute, that are packed together
_HEAD: Final = struct.Struct("<qqI")  # of a block: its two times, and its bytes
_ENDS: Final = 1 << 20  # bytes at both ends of a file that tell it from another


@dataclass(frozen=True, slots=True)
class Driven:
    """A pose, and what was measured between the two poses before it; None before the third pose."""

    pose: Pose
    segment: Segment | None

    @property
    def t_ns(self) -> int:
        return self.pose.t_ns


class DrivenBlock(NamedTuple):
    """Up to BLOCK poses that follow each other."""

    first_ns: int  # t_ns of the earliest, and of the latest
    last_ns: int
    told: bytes  # tuple[Driven, ...], `compressed`

    def driven(self) -> tuple[Driven, ...] | None:
        """The poses; None where they were stored in another form."""
        return expanded(self.told, tuple[Driven, ...])


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
        times = [at.t_ns for at in self._open]
        self._blocks.append(DrivenBlock(min(times), max(times), compressed(tuple(self._open))))
        self._open = []


def store_blocks(path: Path, blocks: Sequence[DrivenBlock], log: Log) -> None:
    """Raises nothing, as `store`."""
    told = (_HEAD.pack(one.first_ns, one.last_ns, len(one.told)) + one.told for one in blocks)
    store_bytes(path, b"".join(told), log)


def load_blocks(path: Path) -> tuple[DrivenBlock, ...] | None:
    """What `store_blocks` wrote there; None as from `load`."""
    told, at = load_bytes(path), 0
    if told is None:
        return None
    blocks = list[DrivenBlock]()
    try:
        while at < len(told):
            first_ns, last_ns, size = _HEAD.unpack_from(told, at)
            at += _HEAD.size + size
            blocks.append(DrivenBlock(first_ns, last_ns, told[at - size : at]))
    except struct.error:
        return None
    return tuple(blocks)


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
