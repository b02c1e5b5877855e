"""A log that holds no results, as a replay gives it: made once and kept."""

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path

from tilth.analysis.runs.driven import Driven, DrivingPacker, kept_driving, store_blocks
from tilth.analysis.runs.kept import Progress, Say, cache_folder, caches, key_of, sha256_of
from tilth.estimator.fold import State
from tilth.estimator.record.record import Segment
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.replay.kept_room import room_for
from tilth.replay.offline import ReplayOutputs, replay
from tilth.replay.readers.any_log import open_log
from tilth.replay.simulated import simulated_by
from tilth.schemas.flow import Frame, Pose
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.readable import readable


def replayed(
    path: Path,
    machine_file: MachineFile,
    buses: Mapping[str, str],
    progress: Progress,
    say: Say,
    cache: Path | None = None,
) -> Path:
    """The log as a replay gives it, with frames and results, made now unless it is kept; with its driving.

    Raises LogError, NoRoom where its disk is too full, OSError. An interrupted replay leaves nothing under
    the final name.
    """
    folder = cache or cache_folder()
    names = sorted(buses.items())
    kept = folder / f"{key_of(sha256_of(path), machine_file.sha256, names)}.mcap"
    if kept.exists():
        with contextlib.suppress(OSError):  # it is in use
            kept.touch()
        return kept
    room = room_for(caches(folder, machine_file.machine.log), [path])
    say(f"{path}: is replayed for its poses, once; they are kept")
    folder.mkdir(parents=True, exist_ok=True)
    unfinished = kept.with_suffix(f".{os.getpid()}.part")
    size = path.stat().st_size
    run = RunPart(readable(path.stem), 1, _first_ns(path), simulated=simulated_by([path]))
    writer = LogWriter(unfinished, machine_file, run)
    driven = _HeardDriving()
    try:
        with contextlib.closing(writer):
            outputs = ReplayOutputs(
                writer, progress=lambda done: progress(room(done), size), pose=driven.take
            )
            replay([path], machine_file, buses=buses, outputs=outputs, say=say)
        unfinished.replace(kept)
    finally:
        unfinished.unlink(missing_ok=True)
    if not driven.of_another_rig:
        found = kept_driving(folder, [kept], machine_file.sha256)
        store_blocks(found, driven.packer.blocks(), machine_file.machine.log)
    return kept


class _HeardDriving:
    """The driving of a run, as its poses come."""

    def __init__(self) -> None:
        self.packer = DrivingPacker()
        self.of_another_rig = False
        """Whether it may be that of a rig with other numbers than the machine file's, for which it is fitted:
        under way a value was accepted, or another load."""

    def take(self, state: State, pose: Pose, segment: Segment | None) -> None:
        self.packer.add(Driven(pose, segment))
        self.of_another_rig |= bool(state.accepted or state.carried)


def _first_ns(path: Path) -> int:
    """t_ns of the first frame, 0 without any."""
    log = open_log(path)
    with log.file:
        return next((record.t_ns for record in log.records if isinstance(record, Frame)), 0)
