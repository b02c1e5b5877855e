"""The files of the run under way: their names, and which of them were really made.

A run's name tells when it began. A computer without a battery-backed clock learns the time only from the
receivers: the files are given their right name then.
"""

import uuid
from pathlib import Path

from tilth.logger.clock import WRONG_NS, Clock
from tilth.logger.log.disk import Disk, Spool
from tilth.logger.log.mcap_log import RunPart
from tilth.logger.log.runs import file_name, unused_name
from tilth.schemas.flow import EventKind
from tilth.schemas.notices import NoticeCode, Report, notice


class RunFiles:
    def __init__(self, folder: Path, machine_name: str, note: str, clock: Clock, simulated: str) -> None:
        """note, simulated: as of RunPart."""
        self.folder = folder
        self._machine_name = machine_name
        self._note = note
        self._clock = clock
        self._simulated = simulated
        self.begin_run()

    def begin_run(self) -> None:
        self.run_id = uuid.uuid4().hex
        self._started_ns = self._clock.t_ns()
        self._correction_ns = self._clock.correction_ns  # that the name was made with
        self._spools: list[Spool] = []
        self.choose_name()

    def choose_name(self) -> None:
        """One that no run in the folder has."""
        utc_ns = self._started_ns + self._correction_ns
        self.name = unused_name(self.folder, self._machine_name, utc_ns)

    @property
    def paths(self) -> list[Path]:
        """As far as they were really made."""
        return [spool.path for spool in self._spools if spool.opened]

    @property
    def newest(self) -> Path:
        """The file that was begun last, whether it was made or not."""
        return self._spools[-1].path

    def next_part(self, disk: Disk) -> tuple[Spool, RunPart]:
        """The next file, not made yet, and its place in the run."""
        if self._spools and self._spools[-1].error is not None and not self._spools[-1].opened:
            self._spools.pop()  # never made; one that the disk has only not come to yet will be
        part = len(self._spools) + 1
        spool = Spool(disk, self.folder / file_name(self.name, part))
        self._spools.append(spool)
        return spool, RunPart(self.run_id, part, self._started_ns, self._note, self._simulated)

    def rename(self) -> None:
        """Give the files the run's name, where it has another one by now."""
        for part, spool in enumerate(self._spools, 1):
            name = file_name(self.name, part)
            if spool.path.name != name:
                spool.rename(name)

    def correct_name(self, report: Report) -> bool:
        """Whether it has turned out that the name tells a wrong time. Chooses another one then."""
        correction_ns = self._clock.correction_ns
        if abs(correction_ns - self._correction_ns) <= WRONG_NS:
            return False
        self._correction_ns = correction_ns
        report(EventKind.CLOCK, notice(NoticeCode.CLOCK_WRONG, ahead_s=correction_ns * 1e-9))
        self.choose_name()
        return True
