"""The daemon's log: files one after another, on the disk within a second; no error of the disk ends a run.

A run is what lies between ignition on and off: it begins with the daemon, or with the first frame after all
buses were silent for [log] ignition_off_s. Its files are <machine>_<UTC>_<part>.mcap.
"""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

from tilth.logger.back_off import BackOff
from tilth.logger.clock import Clock
from tilth.logger.log import recovery
from tilth.logger.log.counts import RecordedCounts
from tilth.logger.log.disk import Disk
from tilth.logger.log.mcap_log import ClockReason
from tilth.logger.log.open_file import OpenFile
from tilth.logger.log.recorder_state import Happening, RecorderState, RecorderStates
from tilth.logger.log.room import Room
from tilth.logger.log.run_files import RunFiles
from tilth.schemas.channels import ADDRESSES_TOPIC, encode_addresses
from tilth.schemas.flow import EventKind, Frame
from tilth.schemas.identity import KnownAddress
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import NoticeCode, Report, notice
from tilth.schemas.readable import reason_of

FLUSH_NS = 400_000_000  # with a turn of the loop and the sync itself, no frame waits a second for the disk
FIRST_RETRY_NS = 1_000_000_000  # after a failure
LONGEST_RETRY_NS = 5_000_000_000
SLOW_S = 2.0  # at one write or sync
MOST_WAITING = 64_000_000  # bytes kept in memory for a disk that does not take them: minutes of a full bus
MOST_RETAINED = 1000  # messages kept while ignition is off


class Recording:
    """Writes frames and results; while the disk fails it counts what is not recorded and tries again."""

    def __init__(
        self,
        folder: Path,
        machine_file: MachineFile,
        clock: Clock,
        report: Report,
        renew: Callable[[], str],
        *,
        addresses: Callable[[], Sequence[KnownAddress]] = tuple,
        with_state: bool = False,
        note: str = "",
        simulated: str = "",
    ) -> None:
        """renew: gives the fold's state as text and makes the fold go on from just that text. It is called
        before each file that does not begin where the fold did, so that the file replays alone; before the
        first only `with_state`. addresses: who has which address, for the head of each file. note, simulated:
        as of RunPart.
        """
        self.counts = RecordedCounts()
        self._machine_file = machine_file
        self._settings = machine_file.machine.log
        self._clock = clock
        self._report = report
        self._renew = renew
        self._addresses = addresses
        self._states = RecorderStates(report)
        self._disk = Disk(folder)
        self._room = Room(folder, self._settings, report)
        self._run = RunFiles(folder, machine_file.machine.name, note, clock, simulated)
        self._file: OpenFile | None = None  # the one that is written
        self._retained: deque[tuple[str, int, bytes]] = deque(maxlen=MOST_RETAINED)
        self._now_ns = clock.t_ns()  # of the last tick
        self._last_frame_ns = self._now_ns
        self._next_ns = self._now_ns + FLUSH_NS
        self._said_unlocked = False
        self._back_off = BackOff(FIRST_RETRY_NS, LONGEST_RETRY_NS)
        self._open(with_state, at_once=True)
        threading.Thread(
            target=lambda: recovery.finish_all(folder, report, lambda: self.files),
            name="tilth-recovery",
            daemon=True,
        ).start()

    @property
    def folder(self) -> Path:
        return self._run.folder

    @property
    def run_id(self) -> str:
        return self._run.run_id

    @property
    def files(self) -> list[Path]:
        """Of the run, as far as they were really made."""
        return self._run.paths

    @property
    def problem(self) -> str:
        """What a person should know of it; "" where all is well."""
        return self._states.problem

    @property
    def resting(self) -> bool:
        """Ignition is off: the next frame begins a run."""
        return self._states.resting

    @property
    def recording(self) -> bool:
        """Whether frames are being written."""
        return self._states.recording and self._file is not None and self._file.spool.error is None

    @property
    def frames(self) -> int:
        """Recorded, in the files that are finished."""
        return self.counts.frames

    @property
    def missed(self) -> int:
        """Frames that came while nothing could be recorded, or were in what was not written."""
        return self.counts.missed

    @property
    def size_bytes(self) -> int:
        """Of all that was recorded, flushed."""
        return self.counts.size_bytes(self._file)

    @property
    def bytes_per_s(self) -> float | None:
        """While it recorded; None while it is too young to tell."""
        return self.counts.bytes_per_s(self._file, self._now_ns)

    @property
    def free_bytes(self) -> float | None:
        """What may still be written."""
        free = self._disk.free_bytes
        return None if free is None else max(0.0, free - self._room.keep_free_bytes)

    def frame(self, frame: Frame) -> None:
        """Log a raw frame; after ignition off it begins a new run."""
        self._last_frame_ns = frame.t_ns
        if self._file is None and self.resting:
            self._wake(frame.t_ns)
        if self._file is None:
            self.counts.missed += 1
        else:
            self._file.writer.frame(frame)

    def message(self, topic: str, t_ns: int, data: bytes) -> None:
        """Log the bytes of a publication; `topic` is a row of CHANNELS."""
        if self._file is not None:
            self._file.writer.message(topic, t_ns, data)
        elif self.resting and topic == "/event":
            self._retained.append((topic, t_ns, data))

    def clocks(self, why: ClockReason) -> None:
        """Note in the log what the computer's clocks say."""
        if self._file is not None:
            self._file.writer.clocks(self._clock, why)

    def on_disk_thread(self, job: Callable[[], None]) -> None:
        """Run a job in the disk thread that the log does not depend on; what it raises is reported."""
        self._disk.do_independent(
            job,
            lambda error: self._report(
                EventKind.LOG, notice(NoticeCode.DISK_TROUBLE, why=_sentence(error, self.folder))
            ),
        )

    def settle(self, then: Callable[[str], None]) -> None:
        """Call `then`, in another thread, when all that was logged is on the disk: with "", or why not."""
        if self.resting:
            self._wake(self._clock.t_ns())
        if self._file is None:
            then(self.problem or "not recording")
            return
        self._file.flush()
        spool = self._file.spool
        spool.settle(
            lambda error: then("" if error is None else f"not recorded: {_sentence(error, spool.path)}")
        )

    def tick(self, t_ns: int) -> None:
        """At least some times a second, between two frames: bring the log to the disk, begin a file where it
        is time to."""
        if t_ns < self._next_ns:
            return
        self._next_ns = t_ns + FLUSH_NS
        self._now_ns = t_ns
        self._look_at_closed()
        self._make_room(t_ns)
        if self._file is not None:
            self._keep_up(self._file)
        elif not self.resting and self._back_off.is_due(t_ns):
            self._try_again()

    def close(self) -> None:
        """Finish the file and wait for the disk."""
        if self._file is not None:
            self._finish(self._file, ClockReason.END)
            self._states.after(Happening.END)
        stopped = self._disk.stop()
        self._look_at_closed(at_end=True)
        if not stopped:
            self._report(EventKind.LOG, notice(NoticeCode.DISK_SILENT, folder=str(self.folder)))

    def _keep_up(self, file: OpenFile) -> None:
        """All is well until now: flush, and see whether it still is."""
        if file.spool.error is not None:
            self._fail(file, file.spool.error)
            return
        self._say_unlocked(file)
        file.flush()
        stalled_s = self._disk.stalled_s
        if stalled_s > SLOW_S and self._states.recording:
            waits = f"the disk has not answered for {stalled_s:.0f} s; the log waits in memory"
            self._states.slow(f"{self.folder}: {waits}")
        elif file.spool.safe_bytes:
            self._recovered(file)
        free = self._disk.free_bytes
        if self._disk.waiting_bytes > MOST_WAITING:
            self._stop(file, ClockReason.SLOW_DISK, "the disk does not keep up; use a faster one")
        elif free is not None and self._room.is_out(free):
            self._stop(file, ClockReason.NO_ROOM, f"only {free / 1e6:.0f} MB free; make room")
        elif self._is_silent():
            self._finish(file, ClockReason.IGNITION_OFF)
            self._states.after(Happening.IGNITION_OFF)
        elif file.is_due(self._now_ns, self._settings) or self._run.correct_name(self._report):
            self._finish(file, ClockReason.ROTATION)
            self._open(with_state=True)

    def _say_unlocked(self, file: OpenFile) -> None:
        if not (file.spool.locked or self._said_unlocked):
            self._said_unlocked = True
            self._report(EventKind.LOG, notice(NoticeCode.UNLOCKED, folder=str(self.folder)))

    def _is_silent(self) -> bool:
        """Whether no frame has come for so long that the ignition must be off."""
        silent_s = (self._now_ns - self._last_frame_ns) * 1e-9
        limit_s = self._settings.ignition_off_s
        return bool(limit_s) and silent_s > limit_s

    def _recovered(self, file: OpenFile) -> None:
        """What was written is on the disk."""
        if file.age_ns(self._now_ns) >= LONGEST_RETRY_NS:  # one that fails each file soon is tried less often
            self._back_off.worked()
        if self._states.state is RecorderState.TRYING:
            again = notice(NoticeCode.RECORDING_AGAIN, file=file.spool.path.name, missed=self.missed)
            self._report(EventKind.LOG, again)
        self._states.after(Happening.ON_DISK)

    def _finish(self, file: OpenFile, why: ClockReason) -> None:
        file.writer.clocks(self._clock, why)
        file.finish()
        self._run.rename()
        self._file = None
        self.counts.finished(file, self._now_ns)

    def _stop(self, file: OpenFile, why: ClockReason, problem: str) -> None:
        """Finish a file after which there may be no other for now. why: for the log."""
        self._finish(file, why)
        self._states.failed(Happening.FILE_FAILED, f"{self.folder}: {problem}")

    def _fail(self, file: OpenFile, error: OSError) -> None:
        """Leave a file that can no longer be written."""
        self._file = None
        self.counts.failed(file, self._now_ns)
        file.spool.close()
        if isinstance(error, FileExistsError):  # another run was quicker with that name
            self._run.choose_name()
        self._back_off.failed(self._now_ns)
        self._states.failed(Happening.FILE_FAILED, _sentence(error, self.folder))

    def _look_at_closed(self, at_end: bool = False) -> None:
        """See what became of files that were finished; at_end: also of those that the disk never took."""
        for spool in self.counts.take_closed(at_end):
            if spool.error is not None and spool.opened:
                why = _sentence(spool.error, spool.path)
                self._report(EventKind.LOG, notice(NoticeCode.END_MISSING, why=why))
            elif spool.error is not None:  # a last try, of which nothing is there
                self._states.failed(Happening.EARLIER_FAILED, _sentence(spool.error, self.folder))

    def _try_again(self) -> None:
        """Begin a file where there seems to be room, and nothing is left of what waited for the disk."""
        free = self._disk.free_bytes
        self._disk.do(self._disk.look)
        if self._disk.waiting_bytes or (free is not None and free < self._room.needed_bytes):
            self._back_off.failed(self._now_ns)
        else:
            self._open(with_state=True)

    def _open(self, with_state: bool, at_once: bool = False) -> None:
        """Begin the next file. at_once: nothing is waiting yet, so wait for the disk."""
        spool, run = self._run.next_part(self._disk)
        needed = self._room.needed_bytes
        if at_once:
            spool.make(needed)
        else:
            self._disk.do(lambda: spool.make(needed))
        self._file = file = OpenFile(spool, self._machine_file, run, self._now_ns)
        self._states.after(Happening.FILE_BEGUN)
        if spool.error is not None:
            self._fail(file, spool.error)
            return
        file.writer.clocks(self._clock, ClockReason.NEW_FILE if run.part > 1 else ClockReason.START)
        if known := self._addresses():
            data = encode_addresses(self._now_ns, known, self._machine_file.sha256)
            file.writer.message(ADDRESSES_TOPIC, self._now_ns, data)
        if with_state:
            file.writer.snapshot(self._now_ns, self._renew())
        while self._retained:
            file.writer.message(*self._retained.popleft())
        file.flush()

    def _wake(self, t_ns: int) -> None:
        """Ignition is on again."""
        self._now_ns = self._last_frame_ns = t_ns
        self._run.begin_run()
        self._open(with_state=True)
        self._report(EventKind.LOG, notice(NoticeCode.NEW_RUN, file=self._run.newest.name))

    def _make_room(self, t_ns: int) -> None:
        if self._room.is_wanted(self._disk.free_bytes, t_ns):
            trusted = self._clock.gnss_ahead_ns is not None
            utc_ns = t_ns + self._clock.correction_ns if trusted else None
            current = self._run.name
            self.on_disk_thread(lambda: self._room.make(current, utc_ns))


def _sentence(error: Exception, folder: Path) -> str:
    if not isinstance(error, OSError):
        return f"{folder}: {type(error).__name__}: {error}"
    place = error.filename or folder
    if error.errno is None:  # in our words
        return f"{place}: {error.strerror}"
    return f"{place}: {reason_of(error)}; check disk and folder, it is tried again"
