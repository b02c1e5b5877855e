"""Stores what the estimators have learned in a file next to the logs, for the next run."""

from pathlib import Path

from tilth.logger import warm_start_file
from tilth.logger.clock import Clock
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log import whole_file
from tilth.logger.log.run_log import Recording
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Report

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
        self._written = self._standing()

    def take_up(self, t_ns: int) -> bool:
        """Before the first frame: go on from what earlier runs have learned. Whether there was anything."""
        taken_up = warm_start_file.take_up(self._path, self._machine, t_ns, self._fold.warm, self._report)
        self._written = self._standing()
        return taken_up

    def is_due(self, t_ns: int) -> bool:
        """At once where a value was accepted, or the file came into doubt: the power may go at any time."""
        return t_ns >= self._next_ns or self._standing() != self._written

    def keep(self, t_ns: int, recording: Recording) -> None:
        """Write it in the thread that waits for the disk.

        While the file is not confirmed, what is there stays; while it is contradicted, nothing that was
        learned with it may be used again.
        """
        self._next_ns = t_ns + EVERY_NS
        learned, accepted, moved = self._fold.keep(t_ns), self._fold.accepted, self._fold.unsettled
        standing, before = self._standing(), self._written
        self._written = standing
        if learned or standing != before or (moved and self._fold.contradicted):
            text = warm_start_file.text_of(
                self._machine, learned, t_ns, accepted, moved, self._fold.carried(t_ns)
            )
            recording.on_disk_thread(lambda: whole_file.write(self._path, text.encode()))

    def _standing(self) -> tuple[int, tuple[str, ...], bool, float]:
        """What the next run has to know at once: values accepted, what has been moved, a contradiction, kg
        that
        the implement carries."""
        moved = tuple(name for one in self._fold.unsettled for name in one.names)
        load = self._fold.carried(0)
        return len(self._fold.accepted), moved, bool(self._fold.contradicted), load.mass if load else 0.0
