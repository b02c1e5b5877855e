"""A run's driving as the estimators take it: each pose with the raw measurements before it.

Made by the same fold as live, without its estimators; kept, since fits ask for it again and again.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

from tilth.analysis.runs.kept import Progress, cache_folder, key_of, load, no_progress, store
from tilth.analysis.runs.run import Run
from tilth.estimator import fold
from tilth.estimator.record.record import Segment
from tilth.estimator.snapshot import NotRestorable, restore_decoder
from tilth.replay.readers.any_log import open_log
from tilth.schemas.flow import Frame, Pose
from tilth.schemas.proto.tilth_pb2 import Snapshot

SHOWN_EVERY: Final = 8192  # frames between two looks at a progress bar
_ENDS: Final = 1 << 20  # bytes at both ends of a file that tell it from another


@dataclass(frozen=True, slots=True)
class Driven:
    """A pose, and what was measured between the two poses before it; None before the third pose."""

    pose: Pose
    segment: Segment | None

    @property
    def t_ns(self) -> int:
        return self.pose.t_ns


def driving(run: Run, progress: Progress = no_progress, cache: Path | None = None) -> tuple[Driven, ...]:
    """All of a run, in its order. Raises LogError, OSError.

    progress: takes (done, all) of bytes.
    """
    files = [identity(file.path) for file in run.files]
    name = key_of(*files, run.machine_file.sha256)
    kept = (cache or cache_folder()) / f"{name}.driving"
    found = _loaded(kept, kept.stat().st_mtime_ns) if kept.exists() else None
    if found is None:
        damage = list[str]()
        found = tuple(_drive(run, progress, damage))
        if not damage:  # what is kept is known by both ends of a file alone
            store(kept, found, run.machine.log)
        for text in damage:
            run.reader.tell(text)
    return found


def _drive(run: Run, progress: Progress, damage: list[str]) -> list[Driven]:
    """damage: gets what is damaged in the logs, in sentences."""
    state = fold.initial(run.machine)
    state.ready = False  # no estimator
    whole, before = sum(file.path.stat().st_size for file in run.files), 0
    found: list[Driven] = []
    for file in run.files:
        log = open_log(file.path)
        with log.file:
            for record in log.records:
                if isinstance(record, Frame):
                    values = (publication.value for publication in fold.step(state, record))
                    poses = [value for value in values if isinstance(value, Pose)]
                    found += map(Driven, poses, state.segments)
                    if state.frames % SHOWN_EVERY == 0:
                        progress(before + log.position(), whole)
                elif isinstance(record, Snapshot) and not state.frames:
                    _take_addresses(run, state, record)
        damage += [f"{file.path}: {text}" for text in log.told_damage()]
        before += log.size
    return found


def _take_addresses(run: Run, state: fold.State, stored: Snapshot) -> None:
    """Of the receivers, which claim them only at their start: of a run whose first part is missing."""
    try:
        state.decoder = restore_decoder(run.machine, stored.state_json)
    except NotRestorable:
        return


def identity(path: Path) -> str:
    """Of a log: its size, and the bytes at its beginning and end, where the index has all checksums."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_ENDS)
        file.seek(max(0, size - _ENDS))
        return key_of(size, head, file.read(_ENDS))


@lru_cache(maxsize=1)
def _loaded(kept: Path, _written_ns: int) -> tuple[Driven, ...] | None:
    """Segments of a run are asked for one by one; a file that was written again is read again."""
    return load(kept, tuple[Driven, ...])
