"""Opens runs to be played. One that holds frames only is replayed first, once, and the new log is kept.

Its name comes from all that could make other results: the files, the machine file, this software's version.
"""

import contextlib
import hashlib
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tilth.logger.log.derived import Derived
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.logger.log.software import software
from tilth.replay.catalogue import CatalogueRun, has_results
from tilth.replay.kept_room import room_for
from tilth.replay.offline import ReplayOutputs, replay
from tilth.replay.readers.any_log import open_log
from tilth.replay.readers.log import EmptyLog, ForeignLog, LogError
from tilth.replay.readers.rig import Say, bus_names, machine_in
from tilth.replay.recorded import Progress, RecordedRun
from tilth.replay.simulated import simulated_by
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine, MachineError, Zenoh
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.readable import readable

MOST_BYTES: Final = 10e9  # of all that is kept
_OURS: Final = re.compile(r".+_[0-9a-f]{16}(\.\d+)?\.\w+")
REPLAYING: Final = "replaying the log, which holds frames only"
READING: Final = "reading the run"


@dataclass(frozen=True, slots=True)
class OpenedRun:
    """A run that can be played."""

    name: str
    run: RecordedRun
    machine: Machine


@dataclass(frozen=True, slots=True)
class Opening:
    """How runs are opened. given: a machine file, for logs without one. kept: the folder of the
    logs that a replay gave. buses: as of replay. prefix: of the keys on which they are published."""

    kept: Path
    prefix: str
    given: MachineFile | None = None
    buses: tuple[str, ...] = ()
    say: Say = lambda text: None

    def prepared(self, run: CatalogueRun) -> Path | None:
        """Where the results of a replay are kept, if it has no others. Raises LogError, MachineError,
        OSError."""
        if has_results(run.paths):
            return None
        _check_content(run.paths)
        return prepared_path(self.kept, run.paths, self.given or machine_in(run.paths))

    def machine(self, run: CatalogueRun) -> Machine:
        """Raises LogError where it has none and none was given, MachineError."""
        found = self.given or machine_in(run.paths, plausible=False)
        return found.machine.model_copy(update={"zenoh": Zenoh(prefix=self.prefix)})

    def open(self, run: CatalogueRun, progress: Callable[[str, float], None]) -> OpenedRun:
        """progress takes a text and the share that is done; what it raises ends this. Raises LogError,
        MachineError, OSError."""
        target, paths = self.prepared(run), run.paths
        if target is not None:
            with contextlib.suppress(OSError):
                os.utime(target)  # it is in use
            if not target.exists():
                self._prepare(run, target, lambda share: progress(REPLAYING, share))
            paths = (target,)
        recorded = RecordedRun(paths, lambda share: progress(READING, share))
        if not recorded.has_poses:
            recorded.close()
            raise EmptyLog(f"{run.paths[0]}: no pose is in it, so there is nothing to show")
        return OpenedRun(run.name, recorded, self.machine(run))

    def _prepare(self, run: CatalogueRun, target: Path, progress: Progress) -> None:
        found = self.given or machine_in(run.paths)
        try:
            buses = bus_names(self.buses, found.machine)
        except MachineError as error:
            raise ForeignLog(str(error)) from None
        prepare(run.paths, found, target, progress, buses=buses, say=self.say)


def prepared_path(folder: Path, paths: Sequence[Path], machine_file: MachineFile) -> Path:
    """Where the results of these logs are kept, whether they are there or not. Raises OSError."""
    known = hashlib.sha256(f"{software()['version']} {machine_file.sha256}".encode())
    for path in paths:
        stat = path.stat()
        known.update(f"\n{readable(path.resolve())} {stat.st_size} {stat.st_mtime_ns}".encode())
    return folder / f"{paths[0].stem[:60]}_{known.hexdigest()[:16]}.mcap"


def prepare(
    paths: Sequence[Path],
    machine_file: MachineFile,
    target: Path,
    progress: Progress = lambda share: None,
    *,
    buses: Mapping[str, str] | None = None,
    say: Say = lambda text: None,
) -> None:
    """Write the target, whole or not at all. What `progress` raises ends it.

    Raises LogError, NoRoom where its disk is too full, OSError.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    unfinished = target.with_suffix(f".{os.getpid()}.part")
    unfinished.unlink(missing_ok=True)
    size = sum(path.stat().st_size for path in paths)
    kept = Derived(target.parent, _OURS, MOST_BYTES, machine_file.machine.log.keep_free_megabytes * 1e6)
    room = room_for(kept, paths)
    try:
        run = RunPart(readable(target.stem), 1, _first_ns(paths), simulated=simulated_by(paths))
        writer = LogWriter(unfinished, machine_file, run)
        try:
            outputs = ReplayOutputs(
                writer, progress=lambda done: progress(min(room(done) / max(size, 1), 1.0))
            )
            summary = replay(paths, machine_file, buses=buses, outputs=outputs, say=say)
        finally:
            writer.close()
        if not summary.poses:
            raise EmptyLog(
                f"{paths[0]}: no pose comes of it, so there is nothing to show; {_why(summary.rejected)}"
            )
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)


def _check_content(paths: Sequence[Path]) -> None:
    """Raises LogError where none has a frame: then a machine file would not help."""
    why: EmptyLog | None = None
    for path in paths:
        try:
            open_log(path).file.close()
            return
        except EmptyLog as error:
            why = why or error
    if why is not None:
        raise why


def _why(rejected: Mapping[str, int]) -> str:
    if not rejected:
        return "is it a log of this machine, with its positions? `tilth decode` shows what is in it"
    reason, count = max(rejected.items(), key=lambda item: item[1])
    return f"{count} messages were rejected as {reason}: look at the machine file"


def _first_ns(paths: Sequence[Path]) -> int:
    for path in paths:
        try:
            log = open_log(path)
        except LogError:
            continue
        with log.file:
            return next((record.t_ns for record in log.records if isinstance(record, Frame)), 0)
    return 0
