"""Makes room on a disk that fills: deletes the oldest reports, then the oldest run that nobody wants."""

from pathlib import Path

from tilth.logger.log.derived import reports_in
from tilth.logger.log.runs import delete, may_go, stored_runs
from tilth.schemas.flow import EventKind
from tilth.schemas.log_settings import Log
from tilth.schemas.notices import NoticeCode, Report, notice

LEAST_BYTES = 16e6  # above what is left alone: less is not worth a file
AGAIN_NS = 5_000_000_000  # not so soon after one run was deleted another one


class Room:
    """What may be written on the disk, by [log] of the machine file."""

    def __init__(self, folder: Path, log: Log, report: Report) -> None:
        self._folder = folder
        self._log = log
        self._report = report
        self._made_ns = 0  # when room was last made

    @property
    def keep_free_bytes(self) -> float:
        return self._log.keep_free_megabytes * 1e6

    @property
    def needed_bytes(self) -> float:
        """Free, for a file to be begun."""
        return self.keep_free_bytes + LEAST_BYTES

    def is_out(self, free_bytes: float | None) -> bool:
        """Whether nothing more may be written. free_bytes: of the disk, None where that is not known."""
        return free_bytes is not None and free_bytes < self.keep_free_bytes

    def is_wanted(self, free_bytes: float | None, t_ns: int) -> bool:
        """Whether `make` should be called now."""
        low = free_bytes is not None and free_bytes < self._wanted_bytes
        wanted = low and t_ns - self._made_ns >= AGAIN_NS
        if wanted:
            self._made_ns = t_ns
        return wanted

    @property
    def _wanted_bytes(self) -> float:
        """Free, before it gets tight."""
        return self.keep_free_bytes + max(2 * self._log.rotate_megabytes * 1e6, 2 * LEAST_BYTES)

    def make(self, current: str, utc_ns: int | None) -> None:
        """In the disk's thread. current: the run that stays; utc_ns: now, as far as it is known."""
        if reports_in(self._folder, self._wanted_bytes).make_room() or self._log.when_full != "delete_oldest":
            return
        for run in stored_runs(self._folder):
            if run.name != current and may_go(run, utc_ns, self._log.expire_days):
                size = delete(run)
                self._report(EventKind.LOG, notice(NoticeCode.DELETED, run=run.name, megabytes=size / 1e6))
                return
