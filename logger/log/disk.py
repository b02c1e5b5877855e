"""One thread does all disk work: the loop hands bytes over and never waits.

A disk that stalls for seconds costs nothing: what it has not taken waits in memory, in order. Each batch is
synced when it is written; where others wait behind it, one sync does for all.
"""

import contextlib
import os
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue

from tilth.logger.log.lock import lock

LEAVE_S = 10.0  # how long the end of a run waits for a disk that does not answer


class Disk:
    """The thread and what waits for it. `free_bytes` is of the disk, None until known."""

    def __init__(self, folder: Path) -> None:
        self.free_bytes: int | None = None
        self.folder = folder
        self._jobs: SimpleQueue[tuple[Callable[[], None], int] | None] = SimpleQueue()
        self._queued_bytes = 0  # counted by the loop
        self._done_bytes = 0  # counted by the thread
        self._busy_since_s: float | None = None
        self._unsynced: Callable[[], None] | None = None  # the thread's: brings what was written to the disk
        self._thread = threading.Thread(target=self._work, name="tilth-disk", daemon=True)
        self._thread.start()

    @property
    def waiting_bytes(self) -> int:
        """Handed over and not yet on the disk."""
        return self._queued_bytes - self._done_bytes

    @property
    def stalled_s(self) -> float:
        """How long the disk has been at the job it is at; 0 where it has none."""
        since_s = self._busy_since_s
        return 0.0 if since_s is None else time.monotonic() - since_s

    @property
    def idle(self) -> bool:
        """Whether nothing waits behind the job under way."""
        return self._jobs.empty()

    def do(self, job: Callable[[], None], size: int = 0) -> None:
        """Queue a job for the thread, after all earlier ones. It must not raise."""
        self._queued_bytes += size
        self._jobs.put((job, size))

    def do_independent(self, job: Callable[[], None], failed: Callable[[Exception], None]) -> None:
        """Queue a job that the log does not depend on. failed: takes what it raises."""

        def guarded() -> None:
            try:
                job()
            except Exception as error:  # whatever it is, the log's own jobs come after it
                failed(error)

        self.do(guarded)

    def stop(self) -> bool:
        """Wait until all is done; False where the disk does not answer."""
        self._jobs.put(None)
        self._thread.join(LEAVE_S)
        return not self._thread.is_alive()

    def _work(self) -> None:
        while (queued := self._jobs.get()) is not None:
            job, size = queued
            self._busy_since_s = time.monotonic()
            job()
            if self.idle:
                self._sync()
            self.look()
            self._done_bytes += size
            self._busy_since_s = None
        self._sync()

    def _sync(self) -> None:
        if self._unsynced is not None:
            sync, self._unsynced = self._unsynced, None
            sync()

    def sync_when_idle(self, sync: Callable[[], None]) -> None:
        """In the thread: call that when nothing waits any more, whichever job was the last. It must not
        raise."""
        self._unsynced = sync

    def look(self) -> None:
        """See how much room there is."""
        try:
            self.free_bytes = shutil.disk_usage(self.folder).free
        except OSError:  # the folder is gone: whoever writes there notices
            self.free_bytes = None


class Spool:
    """A file that the thread writes. `error` says why it no longer can, None while it can.

    `safe_bytes`, `safe_frames`: what is on the disk for good. mcap.writer.Writer takes it for a stream.
    """

    def __init__(self, disk: Disk, path: Path) -> None:
        self.path = path
        self.opened = False
        self.closed = False  # nothing will change any more
        self.locked = True  # False where its file system has no locks
        self.error: OSError | None = None
        self.safe_bytes = 0
        self.safe_frames = 0
        self._disk = disk
        self._size = 0
        self._unsent: list[bytes] = []
        # The thread's own.
        self._descriptor = -1
        self._written = 0
        self._written_frames = 0

    def write(self, data: bytes) -> int:
        """Keep for the next `send`."""
        self._unsent.append(data)
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        return self._size

    def flush(self) -> None:
        """Nothing: it is `send` that hands over."""

    def send(self, frames: int) -> None:
        """Hand over what was written; with it the file holds so many frames."""
        batch, self._unsent = b"".join(self._unsent), []
        if batch:
            self._disk.do(lambda: self._guarded(lambda: self._append(batch, frames)), len(batch))

    def close(self) -> None:
        """Sync and close, when all that was sent is written. What was not sent is forgotten."""
        self._disk.do(self._close)

    def make(self, keep_free_bytes: float) -> None:
        """In the thread, or before there is anything to keep waiting: make the file, so that its name
        survives a power cut, and lock it, so that nobody takes it for an unfinished one."""
        self._guarded(lambda: self._make(keep_free_bytes))

    def settle(self, then: Callable[[OSError | None], None]) -> None:
        """Call `then`, in the thread, when all that was sent is on the disk, or cannot be brought there."""

        def settled() -> None:
            self._guarded(self._sync)
            then(self.error)

        self._disk.do(settled)

    def _guarded(self, job: Callable[[], None]) -> None:
        if self.error is None:
            try:
                job()
            except OSError as error:
                self.error = error

    def _make(self, keep_free_bytes: float) -> None:
        folder = self.path.parent
        folder.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(folder).free
        if free < keep_free_bytes:
            raise OSError(None, f"only {free / 1e6:.0f} MB free; make room", str(folder))
        self._descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        # Another program's recovery may have been quicker to take the empty file, and to finish it as such.
        self.locked = lock(self._descriptor, wait=True)
        os.ftruncate(self._descriptor, 0)
        sync_folder(folder)
        self.opened = True

    def _append(self, batch: bytes, frames: int) -> None:
        rest = memoryview(batch)
        try:
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
        except OSError:
            # Half a batch is of no use, and a file with nothing whole in it only clutter.
            if self._written:
                with contextlib.suppress(OSError):
                    os.ftruncate(self._descriptor, self._written)
                    self._sync()
            else:
                self.path.unlink(missing_ok=True)
                self.opened = False
            raise
        self._written += len(batch)
        self._written_frames = frames
        self._disk.sync_when_idle(self._sync_if_open)

    def _sync(self) -> None:
        if self.safe_bytes < self._written:
            os.fdatasync(self._descriptor)
        if os.fstat(self._descriptor).st_nlink == 0:
            raise FileNotFoundError(None, "the file was removed", str(self.path))
        self.safe_bytes = self._written
        self.safe_frames = self._written_frames

    def _sync_if_open(self) -> None:
        if self._descriptor >= 0:
            self._guarded(self._sync)

    def _close(self) -> None:
        self._sync_if_open()
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
        self.closed = True

    def rename(self, name: str) -> None:
        """Rename a finished file within its folder."""
        self._disk.do(lambda: self._guarded(lambda: self._rename(self.path.with_name(name))))

    def _rename(self, path: Path) -> None:
        try:
            os.link(self.path, path)  # raises where that name is taken; at every instant there is one name
        except FileExistsError:
            return
        except OSError:  # a file system without links: its rename is one step as well
            self.path.rename(path)
        else:
            sync_folder(path.parent)
            self.path.unlink()
        self.path = path
        sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make the names in a folder survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
