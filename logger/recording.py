"""The daemon's log: files one after another, synced each second, and no error of the disk ends a run."""

import os
import shutil
import uuid
from collections.abc import Callable
from pathlib import Path

from tilth.logger.clock import Clock, utc_text
from tilth.logger.disk import Disk
from tilth.logger.mcap_log import LogWriter, Run
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine

SYNC_NS = 1_000_000_000
RETRY_NS = 5_000_000_000  # longest wait between tries; the first is a second after the failure
ROOM_BYTES = 16_000_000  # free space below which no file is begun
SLOW_DISK = 10  # jobs waiting, about as many seconds

Report = Callable[[str, str], None]  # kind and text of an event


class Recording:
    """Writes frames and results; while the disk fails it counts what is not recorded and tries again."""

    def __init__(
        self,
        folder: Path,
        machine: Machine,
        machine_text: str,
        clock: Clock,
        report: Report,
        state: Callable[[], str] | None = None,
    ) -> None:
        """state: gives what the fold begins with, where that is not its state before any frame."""
        self.folder = folder
        self.files: list[Path] = []
        self.frames = 0  # recorded
        self.missed = 0  # frames that came while nothing could be recorded, or were in a spoilt chunk
        self.problem = ""
        self._machine = machine
        self._machine_text = machine_text
        self._clock = clock
        self._report = report
        self._started_ns = clock.t_ns()
        self._run_id = uuid.uuid4().hex
        self._writer: LogWriter | None = None
        self._closed_bytes = 0
        self._safe_frames = 0  # of the open file, at its last flush
        self._now_ns = self._started_ns  # of the last tick
        self._part_ns = self._started_ns
        self._next_ns = self._started_ns + SYNC_NS
        self._retry_ns = SYNC_NS
        self._disk = Disk(folder)
        self._open(state)

    @property
    def run_id(self) -> str:
        return self._run_id

    @property
    def recording(self) -> bool:
        return self._writer is not None

    @property
    def size_bytes(self) -> int:
        """Of the whole run, flushed."""
        return self._closed_bytes + (self._writer.flushed_bytes if self._writer else 0)

    @property
    def free_bytes(self) -> int | None:
        return self._disk.free_bytes

    def frame(self, frame: Frame) -> None:
        if self._writer is None:
            self.missed += 1
            return
        try:
            self._writer.frame(frame)
        except OSError as error:
            self._fail(error)

    def message(self, topic: str, t_ns: int, data: bytes) -> None:
        if self._writer is not None:
            try:
                self._writer.message(topic, t_ns, data)
            except OSError as error:
                self._fail(error)

    def clocks(self, why: str) -> None:
        """Note in the log what the computer's clocks say."""
        if self._writer is not None:
            try:
                self._writer.clocks(self._clock.relation(), why)
            except OSError as error:
                self._fail(error)

    def beside(self, job: Callable[[], None]) -> None:
        """Let the thread that waits for the disk do something besides the log; what it raises, it tells."""
        self._disk.beside(job, lambda error: self._report("log", _sentence(error, self.folder)))

    def tick(self, t_ns: int, renew: Callable[[], str]) -> None:
        """Each second: flush and sync, begin a new file where it is time to. Call between two frames.

        `renew` gives the fold's state as text and makes the fold go on from just that text: it is called
        before each file after the first, so that the file replays alone.
        """
        if t_ns < self._next_ns:
            return
        self._now_ns = t_ns
        if self._writer is None:
            self._next_ns = t_ns + SYNC_NS
            self._open(renew)
            if self._writer is None:
                self._try_later()
            return
        self._next_ns = t_ns + SYNC_NS
        try:
            self._flush(self._writer)
            if self._is_due(self._writer):
                self._finish(self._writer, "rotation")
                self._open(renew)
        except OSError as error:
            self._fail(error)

    def close(self) -> None:
        """Finish the file and wait for the disk."""
        if self._writer is not None:
            try:
                self._finish(self._writer, "end")
            except OSError as error:
                self._fail(error)
        if not self._disk.stop():
            self._report("log", f"{self.folder}: the disk does not answer; the end of the log may be missing")
        for late in self._disk.errors:
            self._report("log", f"the end of the log may be missing: {_sentence(late, self.folder)}")

    def _flush(self, writer: LogWriter) -> None:
        writer.flush()
        if self._disk.errors:
            raise self._disk.errors.popleft()
        if os.fstat(writer.fileno()).st_nlink == 0:
            raise FileNotFoundError(None, "the file was removed", str(writer.path))
        self._safe_frames = writer.frames
        if self._now_ns - self._part_ns >= RETRY_NS:  # a disk that fails each file soon is not tried so often
            self._retry_ns = SYNC_NS
        slow = self._disk.waiting > SLOW_DISK
        self.problem = f"{self.folder}: the disk does not keep up; use a faster one" if slow else ""
        self._disk.sync(writer)

    def _is_due(self, writer: LogWriter) -> bool:
        log = self._machine.log
        large = writer.flushed_bytes >= log.rotate_megabytes * 1e6
        return large or self._now_ns - self._part_ns >= log.rotate_minutes * 60e9

    def _finish(self, writer: LogWriter, why: str) -> None:
        writer.clocks(self._clock.relation(), why)
        stream = writer.finish()
        self._writer = None
        self._closed_bytes += writer.flushed_bytes
        self.frames += writer.frames
        self._disk.close(stream)

    def _open(self, renew: Callable[[], str] | None) -> None:
        """Begin the next file; where that cannot be, say so once and leave it to the next try."""
        try:
            path = self._free_path()
            self._begin(path, renew)
        except OSError as error:
            self._say(f"not recording: {_sentence(error, self.folder)}")
            return
        if self.problem:
            self._report("log", f"recording again in {path.name}; {self.missed} frames were not recorded")
            self.problem = ""

    def _begin(self, path: Path, renew: Callable[[], str] | None) -> None:
        run = Run(self._run_id, len(self.files) + 1, self._started_ns)
        writer = LogWriter(path, self._machine, self._machine_text, run)
        try:
            writer.clocks(self._clock.relation(), "new file" if self.files else "start")
            if renew is not None:
                writer.snapshot(self._now_ns, renew())
            writer.flush()
        except OSError:  # not even the head of the file: leave no empty file behind at every try
            writer.abandon()
            path.unlink(missing_ok=True)
            raise
        self._disk.errors.clear()  # of a file given up
        self._writer = writer
        self._safe_frames = 0
        self._part_ns = self._now_ns
        self.files.append(path)
        self._disk.sync_folder()

    def _free_path(self) -> Path:
        self.folder.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(self.folder).free
        if free < ROOM_BYTES:
            raise OSError(None, f"only {free / 1e6:.0f} MB free; make room", str(self.folder))
        # The first file that was really made settles the name: another run may be quicker with it.
        base = self.files[0].stem.removesuffix("_001") if self.files else self._unused_base()
        return self.folder / f"{base}_{len(self.files) + 1:03d}.mcap"

    def _unused_base(self) -> str:
        """<machine>_<UTC>, a second later while a run has that name: a computer without a battery-backed
        clock starts every day at the same instant."""
        t_ns = self._started_ns
        while True:
            base = f"{self._machine.name}_{utc_text(t_ns, '%Y%m%dT%H%M%SZ')}"
            if not any(self.folder.glob(f"{base}_*.mcap")):
                return base
            t_ns += 1_000_000_000

    def _fail(self, error: OSError) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            self.frames += self._safe_frames
            self.missed += writer.frames - self._safe_frames
            self._closed_bytes += writer.flushed_bytes
            self._disk.abandon(writer)
        self._try_later()
        self._say(f"not recording: {_sentence(error, self.folder)}")

    def _try_later(self) -> None:
        self._next_ns = self._now_ns + self._retry_ns
        self._retry_ns = min(2 * self._retry_ns, RETRY_NS)

    def _say(self, problem: str) -> None:
        if problem != self.problem:
            self.problem = problem
            self._report("log", problem)


def _sentence(error: OSError, folder: Path) -> str:
    place = error.filename or folder
    return f"{place}: {(error.strerror or str(error)).lower()}; check disk and folder, it is tried again"
