"""A run's driving as the estimators take it: each pose with the raw measurements before it.

Made by the same fold as live, without its estimators; kept, since fits ask for it again and again. That of a
log that is replayed for its results is kept then (replayed.py).
"""

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Final

from tilth.analysis.runs.driven import (
    Driven,
    DrivenBlock,
    DrivingPacker,
    kept_driving,
    load_blocks,
    store_blocks,
)
from tilth.analysis.runs.kept import Progress, cache_folder, no_progress
from tilth.analysis.runs.run import Run
from tilth.estimator import fold
from tilth.estimator.snapshot import NotRestorable, restore_decoder
from tilth.replay.readers.any_log import open_log
from tilth.schemas.flow import Frame, Pose
from tilth.schemas.proto.tilth_pb2 import Snapshot

SHOWN_EVERY: Final = 8192  # frames between two looks at a progress bar


def driving(
    run: Run, progress: Progress = no_progress, cache: Path | None = None,
    between_ns: tuple[float, float] = (-math.inf, math.inf),
) -> tuple[Driven, ...]:  # fmt: skip
    """Of a run, in its order. Raises LogError, OSError.

    progress: takes (done, all) of bytes. between_ns: t_ns of poses that are wanted, both included.
    """
    files = [file.path for file in run.files]
    kept = kept_driving(cache or cache_folder(), files, run.machine_file.sha256)
    found = _within(_loaded(kept, kept.stat().st_mtime_ns), between_ns) if kept.exists() else None
    if found is None:
        damage = list[str]()
        packer = DrivingPacker()
        for one in _drive(run, progress, damage):
            packer.add(one)
        blocks = packer.blocks()
        if not damage:  # what is kept is known by both ends of a file alone
            store_blocks(kept, blocks, run.machine.log)
        for text in damage:
            run.reader.tell(text)
        found = _within(blocks, between_ns)
        assert found is not None
    return tuple(found)


def _within(blocks: Sequence[DrivenBlock] | None, between_ns: tuple[float, float]) -> list[Driven] | None:
    """What is wanted of blocks; None where they cannot be read."""
    first_ns, last_ns = between_ns
    found: list[Driven] = []
    for block in blocks or ():
        if block.first_ns > last_ns or block.last_ns < first_ns:
            continue
        driven = block.driven()
        if driven is None:
            return None
        found += (at for at in driven if first_ns <= at.t_ns <= last_ns)
    return None if blocks is None else found


def _drive(run: Run, progress: Progress, damage: list[str]) -> Iterator[Driven]:
    """damage: gets what is damaged in the logs, in sentences."""
    state = fold.initial(run.machine)
    state.ready = False  # no estimator
    whole, before = sum(file.path.stat().st_size for file in run.files), 0
    for file in run.files:
        log = open_log(file.path)
        with log.file:
            for record in log.records:
                if isinstance(record, Frame):
                    values = (publication.value for publication in fold.step(state, record))
                    poses = [value for value in values if isinstance(value, Pose)]
                    yield from map(Driven, poses, state.segments)
                    if state.frames % SHOWN_EVERY == 0:
                        progress(before + log.position(), whole)
                elif isinstance(record, Snapshot) and not state.frames:
                    _take_addresses(run, state, record)
        damage += [f"{file.path}: {text}" for text in log.told_damage()]
        before += log.size


def _take_addresses(run: Run, state: fold.State, stored: Snapshot) -> None:
    """Of the receivers, which claim them only at their start: of a run whose first part is missing."""
    try:
        state.decoder = restore_decoder(run.machine, stored.state_json)
    except NotRestorable:
        return


@lru_cache(maxsize=1)
def _loaded(kept: Path, _written_ns: int) -> tuple[DrivenBlock, ...] | None:
    """Segments of a run are asked for one by one; a file that was written again is read again."""
    return load_blocks(kept)
