"""What the updater has to tell (deploy/update.py): it is an event of the run that records then, once.

The updater keeps it in updates.json of the installation, the newest last. What is in a log is noted beside
the logs, in .updates.told.
"""

import json
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from tilth.logger.log import whole_file
from tilth.schemas.flow import EventKind
from tilth.schemas.notices import Notice, NoticeCode, Report, in_words, notice

if TYPE_CHECKING:  # the updater looks each minute, and needs no more than the name of its file
    from tilth.logger.log.run_log import Recording

STATE: Final = "updates.json"
TOLD: Final = ".updates.told"


def installed() -> Path | None:
    """Where this release's updater keeps it; None where this is none, but a checkout."""
    releases = Path(sys.prefix).parent
    return releases.with_name(STATE) if releases.name == "releases" else None


class UpdateNews:
    """Looks once a second, at no cost while nothing has changed."""

    def __init__(
        self,
        path: Path | None,
        folder: Path,
        report: Report,
        recording: "Recording",
    ) -> None:
        """path: of the updater's file. folder: of the logs."""
        self._path = path
        self._told = folder / TOLD
        self._report = report
        self._recording = recording
        self._seen: tuple[int, int] | None = None  # of the file: its number and when it was changed
        self._newest = ""  # that was reported
        self._noted = True

    def turn(self) -> None:
        """Report what has not been told. Nothing that lies there can end a run."""
        if self._path is None:
            return
        self._report_new(self._path)
        # At rest an event waits for the next run. Where the recorder ends before, the next one tells it.
        if not self._noted and not self._recording.resting:
            self._recording.on_disk_thread(partial(whole_file.write, self._told, self._newest.encode()))
            self._noted = True

    def _report_new(self, path: Path) -> None:
        try:
            found = path.stat()
            if (found.st_ino, found.st_mtime_ns) == self._seen:
                return
            self._seen = found.st_ino, found.st_mtime_ns
            entries = json.loads(whole_file.read(path))["news"]
            names = [str(entry["id"]) for entry in entries]
            told = self._newest or (whole_file.read(self._told).decode() if self._told.exists() else "")
            fresh = entries[names.index(told) + 1 :] if told in names else entries
            for entry in fresh:
                self._report(EventKind.UPDATE, _of(entry))
            if fresh:
                self._newest, self._noted = names[-1], False
        except FileNotFoundError:
            return
        except (OSError, ValueError, KeyError, TypeError) as error:
            self._report(EventKind.UPDATE, notice(NoticeCode.UPDATE_UNREADABLE, file=STATE, why=str(error)))


def _of(entry: dict[str, Any]) -> Notice:
    """In the words of then, where this release does not know the code: it may be the one before."""
    if entry["code"] not in tuple(NoticeCode):
        return in_words(str(entry["text"]))
    return notice(NoticeCode(entry["code"]), **entry["values"])
