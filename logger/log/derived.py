"""What was made of logs and can be made again, reports and caches: kept while there is room, the oldest goes
first. Never a log, and never what somebody makes or has just used.
"""

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISREG
from typing import Final

from tilth.logger.clock import Clock

MB: Final = 1e6
RECENT_S: Final = 3600.0  # what was written or used since may be in use
REPORTS: Final = "reports"  # folder in the log's folder
MOST_REPORT_BYTES: Final = 500e6  # of all in it
_REPORT: Final = re.compile(r".+_report_\d+\.(html|json|pdf)")
_UNFINISHED: Final = re.compile(r".+\.(\d+)\.(part|unfinished)")  # the process that makes it


@dataclass(frozen=True, slots=True)
class Derived:
    """The files of a folder whose names are so, seen from it. Those of one stem belong together, and so do
    those of a folder within."""

    folder: Path
    names: re.Pattern[str]
    most_bytes: float  # of all together
    keep_free_bytes: float  # of the disk, left alone

    @property
    def free_bytes(self) -> float:
        """Of the disk that the folder is on, or will be. Raises OSError."""
        there = next(one for one in (self.folder, *self.folder.absolute().parents) if one.exists())
        return shutil.disk_usage(there).free

    def is_low(self, wanted_bytes: float = 0.0) -> bool:
        """Whether so much may not be written. Raises OSError."""
        return self.free_bytes - wanted_bytes < self.keep_free_bytes

    def no_room(self) -> str:
        """What to say then. Raises OSError."""
        return (
            f"{self.folder}: only {self.free_bytes / MB:.0f} MB are free on its disk, and "
            f"{self.keep_free_bytes / MB:.0f} MB are left alone ([log] keep_free_megabytes)"
        )

    def make_room(self, wanted_bytes: float = 0.0) -> bool:
        """Remove what is oldest, as far as needed; whether so much may be written then. Raises OSError."""
        groups: dict[Path, list[tuple[Path, os.stat_result]]] = {}
        for path, stat in self._files():
            own = path.parent if path.parent != self.folder else self.folder / path.stem
            groups.setdefault(own, []).append((path, stat))
        size = wanted_bytes + sum(stat.st_size for group in groups.values() for _, stat in group)
        now_s = Clock().t_ns() * 1e-9
        last_s = {own: max(stat.st_mtime for _, stat in group) for own, group in groups.items()}
        for own in sorted(groups, key=lambda own: (last_s[own], own)):
            enough = size <= self.most_bytes and not self.is_low(wanted_bytes)
            if enough or now_s - last_s[own] < RECENT_S:
                break
            for path, stat in groups[own]:
                path.unlink(missing_ok=True)
                size -= stat.st_size
            with suppress(OSError):  # a folder within, empty now
                own.rmdir()
        return not self.is_low(wanted_bytes)

    def _files(self) -> Iterator[tuple[Path, os.stat_result]]:
        for path in self.folder.rglob("*") if self.folder.is_dir() else ():
            if self.names.fullmatch(path.relative_to(self.folder).as_posix()) and not _is_made(path):
                with suppress(FileNotFoundError):  # another process makes room as well
                    stat = path.lstat()
                    if S_ISREG(stat.st_mode):
                        yield path, stat


def reports_in(log_folder: Path, keep_free_bytes: float) -> Derived:
    """Of the daemon's runs, made on request."""
    return Derived(log_folder / REPORTS, _REPORT, MOST_REPORT_BYTES, keep_free_bytes)


def _is_made(path: Path) -> bool:
    """Whether the process that makes it is there."""
    made_by = _UNFINISHED.fullmatch(path.name)
    if made_by is None:
        return False
    try:
        os.kill(int(made_by[1]), 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True
