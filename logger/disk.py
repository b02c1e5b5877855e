"""All waiting for the disk, in one thread: the loop hands files over and never stands still for them."""

import os
import shutil
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from typing import IO

from tilth.logger.mcap_log import LogWriter

LEAVE_S = 10.0  # how long the end of a run waits for a disk that does not answer


class Disk:
    """Syncs and closes files in the order asked for. `free_bytes` is of the disk, None until known."""

    def __init__(self, folder: Path) -> None:
        self.free_bytes: int | None = None
        self.errors: deque[OSError] = deque()
        self._folder = folder
        self._jobs: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._asked = 0
        self._done = 0
        self._thread = threading.Thread(target=self._work, name="tilth-disk", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Jobs not done yet: more than a few means that the disk does not keep up."""
        return self._asked - self._done

    def sync(self, log: LogWriter) -> None:
        """Bring what the log has flushed on to the disk; nothing where that is still under way."""
        if self.waiting == 0:
            self._ask(lambda: os.fdatasync(log.fileno()))

    def sync_folder(self) -> None:
        """Make the name of a new file survive a power cut."""
        self._ask(lambda: _sync_folder(self._folder))

    def close(self, stream: IO[bytes]) -> None:
        """Sync and close a finished file."""
        self._ask(lambda: _sync_and_close(stream))

    def abandon(self, log: LogWriter) -> None:
        # Here and not in the loop: a sync of the same file may be under way.
        self._ask(log.abandon)

    def beside(self, job: Callable[[], None], failed: Callable[[OSError], None]) -> None:
        """Something that the log does not depend on."""

        def guarded() -> None:
            try:
                job()
            except OSError as error:
                failed(error)

        self._ask(guarded)

    def stop(self) -> bool:
        """Wait until all is done; False where the disk does not answer."""
        self._jobs.put(None)
        self._thread.join(LEAVE_S)
        return not self._thread.is_alive()

    def _ask(self, job: Callable[[], None]) -> None:
        self._asked += 1
        self._jobs.put(job)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                job()
                self.free_bytes = shutil.disk_usage(self._folder).free
            except OSError as error:
                self.errors.append(error)
            self._done += 1


def _sync_and_close(stream: IO[bytes]) -> None:
    with stream:
        os.fsync(stream.fileno())


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
