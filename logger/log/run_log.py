"""The daemon's log: files one after another, on the disk within a second; no error of the disk ends a run.

A run is what lies between ignition on and off: it begins with the daemon, or with the first frame after all
buses were silent for [log] ignition_off_s. Its files are <machine>_<UTC>_<part>.mcap.
"""

import threading
import uuid
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import IO, cast

from tilth.logger.clock import WRONG_NS, Clock
from tilth.logger.log import recovery
from tilth.logger.log.disk import Disk, Spool
from tilth.logger.log.mcap_log import LogWriter, Run
from tilth.logger.log.runs import delete, file_name, may_go, stored_runs, unused_name
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine

FLUSH_NS = 400_000_000  # with a turn of the loop and the sync itself, no frame waits a second for the disk
SECOND_NS = 1_000_000_000
RETRY_NS = 5_000_000_000  # longest wait between tries; the first is a second after the failure
ROOM_BYTES = 16e6  # above what is left alone: less is not worth a file
SLOW_S = 2.0  # at one write or sync
MOST_WAITING = 64_000_000  # bytes kept in memory for a disk that does not take them: minutes of a full bus
SAMPLE_NS = 20 * SECOND_NS  # of recording before its rate is believed
ROTATION = "rotation"  # why a file ended: the run goes on in the next one
MOST_KEPT = 1000  # messages kept while ignition is off

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
        renew: Callable[[], str],
        *,
        with_state: bool = False,
        note: str = "",
    ) -> None:
        """renew: gives the fold's state as text and makes the fold go on from just that text. It is called
        before each file that does not begin where the fold did, so that the file replays alone; before the
        first only `with_state`. note: what the operator says of the run.
        """
        self.folder = folder
        self.frames = 0  # recorded
        self.missed = 0  # frames that came while nothing could be recorded, or were in what was not written
        self.problem = ""
        self.resting = False  # ignition is off: the next frame begins a run
        self._log = machine.log
        self._machine = machine
        self._machine_text = machine_text
        self._clock = clock
        self._report = report
        self._renew = renew
        self._note = note
        self._disk = Disk(folder)
        self._writer: LogWriter | None = None
        self._spools: list[Spool] = []  # of the run's files
        self._closing: list[tuple[Spool, int]] = []  # finished, not yet on the disk; and its frames
        self._kept: deque[tuple[str, int, bytes]] = deque(maxlen=MOST_KEPT)
        self._closed_bytes = 0
        self._closed_ns = 0  # how long those files were recorded
        self._now_ns = clock.t_ns()  # of the last tick
        self._heard_ns = self._now_ns  # of the last frame
        self._next_ns = self._now_ns + FLUSH_NS
        self._retry_ns = SECOND_NS
        self._retry_at_ns = 0
        self._room_ns = 0  # when room was last made
        self._begin_run()
        self._open(with_state, at_once=True)
        threading.Thread(target=self._recover, name="tilth-recovery", daemon=True).start()

    @property
    def run_id(self) -> str:
        return self._run_id

    @property
    def files(self) -> list[Path]:
        """Of the run, as far as they were really made."""
        return [spool.path for spool in self._spools if spool.opened]

    @property
    def recording(self) -> bool:
        if self._writer is None or self._spools[-1].error is not None:
            return False
        return not self.problem.startswith("not recording")  # a new try, of which nothing is on the disk yet

    @property
    def size_bytes(self) -> int:
        """Of all that was recorded, flushed."""
        return self._closed_bytes + (self._writer.flushed_bytes if self._writer else 0)

    @property
    def bytes_per_s(self) -> float | None:
        """While it recorded; None while it is too young to tell."""
        recorded_ns = self._closed_ns + (self._now_ns - self._part_ns if self._writer else 0)
        return self.size_bytes / recorded_ns * 1e9 if recorded_ns > SAMPLE_NS else None

    @property
    def free_bytes(self) -> float | None:
        """What may still be written."""
        free = self._disk.free_bytes
        return None if free is None else max(0.0, free - self._keep_free)

    def frame(self, frame: Frame) -> None:
        self._heard_ns = frame.t_ns
        if self.resting:
            self._wake(frame.t_ns)
        if self._writer is None:
            self.missed += 1
        else:
            self._writer.frame(frame)

    def message(self, topic: str, t_ns: int, data: bytes) -> None:
        if self._writer is not None:
            self._writer.message(topic, t_ns, data)
        elif self.resting and topic == "/event":
            self._kept.append((topic, t_ns, data))

    def clocks(self, why: str) -> None:
        """Note in the log what the computer's clocks say."""
        if self._writer is not None:
            self._writer.clocks(self._clock, why)

    def beside(self, job: Callable[[], None]) -> None:
        """Let the thread that waits for the disk do something besides the log; what it raises, it tells."""
        self._disk.beside(job, lambda error: self._report("log", _sentence(error, self.folder)))

    def settle(self, then: Callable[[str], None]) -> None:
        """Have `then` told, in another thread, when all that was logged is on the disk: "", or why not."""
        if self.resting:
            self._wake(self._clock.t_ns())
        if self._writer is None:
            then(self.problem or "not recording")
            return
        self._flush(self._writer)
        spool = self._spools[-1]
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
        self._count_closing()
        self._make_room(t_ns)
        if self._writer is not None:
            self._keep_up(self._writer)
        elif not self.resting and t_ns >= self._retry_at_ns:
            self._try_again()

    def close(self) -> None:
        """Finish the file and wait for the disk."""
        if self._writer is not None:
            self._finish(self._writer, "end")
        stopped = self._disk.stop()
        self._count_closing(at_end=True)
        if not stopped:
            self._report("log", f"{self.folder}: the disk does not answer; the end of the log may be missing")

    @property
    def _keep_free(self) -> float:
        return self._log.keep_free_megabytes * 1e6

    def _begin_run(self) -> None:
        self._run_id = uuid.uuid4().hex
        self._started_ns = self._clock.t_ns()
        self._correction_ns = self._clock.correction_ns
        utc_ns = self._started_ns + self._correction_ns
        self._name = unused_name(self.folder, self._machine.name, utc_ns)
        self._spools = []

    def _keep_up(self, writer: LogWriter) -> None:
        """All is well until now: flush, and see whether it still is."""
        spool = self._spools[-1]
        if spool.error is not None:
            self._fail(writer, spool.error)
            return
        self._flush(writer)
        stalled_s = self._disk.stalled_s
        if stalled_s > SLOW_S and not self.problem.startswith("not recording"):
            waits = f"the disk has not answered for {stalled_s:.0f} s; the log waits in memory"
            self.problem = f"{self.folder}: {waits}"
        elif spool.safe_bytes:
            self._recovered(spool)
        if self._disk.waiting_bytes > MOST_WAITING:
            self._finish(writer, "the disk does not keep up")
            self._say(f"not recording: {self.folder}: the disk does not keep up; use a faster one")
        elif (free := self._disk.free_bytes) is not None and free < self._keep_free:
            self._finish(writer, "no room")
            self._say(f"not recording: {self.folder}: only {free / 1e6:.0f} MB free; make room")
        elif self._log.ignition_off_s and self._now_ns - self._heard_ns > self._log.ignition_off_s * 1e9:
            self._finish(writer, "ignition off")
            self.resting = True
        elif self._is_due(writer) or self._is_misnamed():
            self._finish(writer, ROTATION)
            self._open(with_state=True)

    def _flush(self, writer: LogWriter) -> None:
        writer.flush()
        self._spools[-1].send(writer.frames)

    def _recovered(self, spool: Spool) -> None:
        """What was written is on the disk."""
        if self._now_ns - self._part_ns >= RETRY_NS:  # a disk that fails each file soon is not tried so often
            self._retry_ns = SECOND_NS
        if self.problem.startswith("not recording"):
            self._report(
                "log", f"recording again in {spool.path.name}; {self.missed} frames were not recorded"
            )
        self.problem = ""

    def _is_due(self, writer: LogWriter) -> bool:
        large = writer.flushed_bytes >= self._log.rotate_megabytes * 1e6
        return large or self._now_ns - self._part_ns >= self._log.rotate_minutes * 60e9

    def _is_misnamed(self) -> bool:
        """Whether it has turned out that the run's name tells a wrong time. Gives it another one then."""
        correction_ns = self._clock.correction_ns
        if abs(correction_ns - self._correction_ns) <= WRONG_NS:
            return False
        self._correction_ns = correction_ns
        self._report("clock", f"the computer's clock is {_span(correction_ns)} than UTC; the log says so")
        utc_ns = self._started_ns + correction_ns
        self._name = unused_name(self.folder, self._machine.name, utc_ns)
        return True

    def _finish(self, writer: LogWriter, why: str) -> None:
        writer.clocks(self._clock, why)
        writer.finish()
        spool = self._spools[-1]
        spool.send(writer.frames)
        spool.close()
        for part, each in enumerate(self._spools, 1):
            if each.path.name != (name := file_name(self._name, part)):
                each.rename(name)
        self._leave(writer)
        self.frames += writer.frames
        self._closing.append((spool, writer.frames))

    def _count_closing(self, at_end: bool = False) -> None:
        """See what became of files that were finished; at_end: also of those that the disk never took."""
        waiting = [] if at_end else [each for each in self._closing if not each[0].closed]
        for spool, frames in [each for each in self._closing if each not in waiting]:
            self.missed += frames - spool.safe_frames
            self.frames -= frames - spool.safe_frames
            if spool.error is not None and spool.opened:
                self._report(
                    "log", f"the end of the log may be missing: {_sentence(spool.error, spool.path)}"
                )
            elif spool.error is not None:  # a last try, of which nothing is there
                self._say(f"not recording: {_sentence(spool.error, self.folder)}")
        self._closing = waiting

    def _try_again(self) -> None:
        """Begin a file where there seems to be room, and nothing is left of what waited for the disk."""
        free = self._disk.free_bytes
        self._disk.do(self._disk.look)
        if self._disk.waiting_bytes or (free is not None and free < self._keep_free + ROOM_BYTES):
            self._try_later()
        else:
            self._open(with_state=True)

    def _try_later(self) -> None:
        self._retry_at_ns = self._now_ns + self._retry_ns
        self._retry_ns = min(2 * self._retry_ns, RETRY_NS)

    def _open(self, with_state: bool, at_once: bool = False) -> None:
        """Begin the next file. at_once: nothing is waiting yet, so wait for the disk."""
        if self._spools and self._spools[-1].error is not None and not self._spools[-1].opened:
            self._spools.pop()  # never made; one that the disk has only not come to yet will be
        part = len(self._spools) + 1
        spool = Spool(self._disk, self.folder / file_name(self._name, part))
        needed = self._keep_free + ROOM_BYTES
        if at_once:
            spool.make(needed)
        else:
            self._disk.do(lambda: spool.make(needed))
        self._spools.append(spool)
        self._part_ns = self._now_ns
        run = Run(self._run_id, part, self._started_ns, self._note)
        writer = LogWriter(spool.path, self._machine, self._machine_text, run, cast(IO[bytes], spool))
        self._writer = writer
        if spool.error is not None:
            self._fail(writer, spool.error)
            return
        writer.clocks(self._clock, "new file" if part > 1 else "start")
        if with_state:
            writer.snapshot(self._now_ns, self._renew())
        while self._kept:
            writer.message(*self._kept.popleft())
        self._flush(writer)

    def _wake(self, t_ns: int) -> None:
        """Ignition is on again."""
        self.resting = False
        self._now_ns = self._heard_ns = t_ns
        self._begin_run()
        self._open(with_state=True)
        self._report("log", f"ignition is on: a new run begins in {self._spools[-1].path.name}")

    def _leave(self, writer: LogWriter) -> None:
        self._writer = None
        self._closed_bytes += writer.flushed_bytes
        self._closed_ns += self._now_ns - self._part_ns

    def _fail(self, writer: LogWriter, error: OSError) -> None:
        self._leave(writer)
        spool = self._spools[-1]
        self.frames += spool.safe_frames
        self.missed += writer.frames - spool.safe_frames
        spool.close()
        if isinstance(error, FileExistsError):  # another run was quicker with that name
            self._name = unused_name(self.folder, self._machine.name, self._started_ns + self._correction_ns)
        self._try_later()
        self._say(f"not recording: {_sentence(error, self.folder)}")

    def _say(self, problem: str) -> None:
        if problem != self.problem:
            if not self.problem.startswith("not recording"):
                self._report("log", problem)
            self.problem = problem

    def _make_room(self, t_ns: int) -> None:
        free = self._disk.free_bytes
        ahead = max(2 * self._log.rotate_megabytes * 1e6, 2 * ROOM_BYTES)
        low = free is not None and free < self._keep_free + ahead
        if low and self._log.when_full == "delete_oldest" and t_ns - self._room_ns >= RETRY_NS:
            self._room_ns = t_ns
            trusted = self._clock.gnss_ahead_ns is not None
            now_ns = t_ns + self._clock.correction_ns if trusted else None
            current = self._name
            self.beside(lambda: self._delete_oldest(current, now_ns))

    def _delete_oldest(self, current: str, utc_ns: int | None) -> None:
        """In the disk's thread."""
        for run in stored_runs(self.folder):
            if run.name != current and may_go(run, utc_ns, self._log.expire_days):
                size = delete(run)
                self._report("log", f"{run.name} was deleted to make room: {size / 1e6:.0f} MB")
                return

    def _recover(self) -> None:
        """In a thread of its own: finish what earlier runs could not."""
        for path in recovery.unfinished(self.folder):
            try:
                done = recovery.finish(path)
            except FileNotFoundError:  # deleted meanwhile to make room
                continue
            except (recovery.NoLog, OSError) as error:
                self._report("log", f"{path.name} was left unfinished and stays so: {error}")
            else:
                self._report(
                    "log", f"{path.name} was left unfinished; finished now: {done.messages} messages"
                )


def _span(ahead_ns: int) -> str:
    days = abs(ahead_ns) / 86400e9
    size = f"{days:.1f} days" if days > 1 else f"{abs(ahead_ns) * 1e-9:.0f} s"
    return f"{size} {'less' if ahead_ns > 0 else 'more'}"


def _sentence(error: Exception, folder: Path) -> str:
    if not isinstance(error, OSError):
        return f"{folder}: {type(error).__name__}: {error}"
    place = error.filename or folder
    if error.errno is None:  # in our words
        return f"{place}: {error.strerror}"
    return f"{place}: {(error.strerror or str(error)).lower()}; check disk and folder, it is tried again"
