"""Stores what the estimators have learned in a file next to the logs, for the next run."""

from pathlib import Path

from tilth.logger import warm_start_file
from tilth.logger.clock import Clock
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log.run_log import Recording
from tilth.logger.warm_start_file import Report
from tilth.schemas.machine import Machine

EVERY_NS = 60_000_000_000


class Keeping:
    def __init__(
        self, folder: Path, machine: Machine, fold: GuardedFold, clock: Clock, report: Report
    ) -> None:
        self._path = warm_start_file.path_of(folder, machine)
        self._machine = machine
        self._fold = fold
        self._report = report
        self._next_ns = clock.t_ns() + EVERY_NS

    def take_up(self, t_ns: int) -> bool:
        """Before the first frame: go on from what earlier runs have learned. Whether there was anything."""
        return warm_start_file.take_up(self._path, self._machine, t_ns, self._fold.warm, self._report)

    def is_due(self, t_ns: int) -> bool:
        return t_ns >= self._next_ns

    def keep(self, t_ns: int, recording: Recording) -> None:
        """Write it in the thread that waits for the disk."""
        self._next_ns = t_ns + EVERY_NS
        learned, accepted = self._fold.keep(t_ns), self._fold.accepted
        if learned or accepted:
            text = warm_start_file.text_of(self._machine, learned, t_ns, accepted)
            recording.on_disk_thread(lambda: warm_start_file.write(self._path, text))
