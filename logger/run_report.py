"""Makes the report of the run so far on request: starts `tilth report` over what is on the disk.

Asked for by queries below <prefix>/<machine>/: `report/make` is answered with a tilth.ReportState when it has
begun, `report/file` with the HTML of the last one. How it goes is published on `report`. The daemon's loop
only hands over: what may wait for a disk is done in a thread of its own.
"""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Final

import zenoh

from tilth.logger.clock import Clock
from tilth.logger.job import NO_ANSWER, OUT_OF_MEMORY, Job, JobEnded
from tilth.logger.log.derived import reports_in
from tilth.logger.outlets import Outlets
from tilth.logger.priority import REPORTS
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import EventKind
from tilth.schemas.invocation import command, in_background
from tilth.schemas.limiter import Limiter
from tilth.schemas.notices import NoticeCode, Report, notice
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.readable import readable

LONGEST_S: Final = 3600.0  # of making one
MOST_WAITING: Final = 4  # queries that are not answered yet
EACH: Final = 2  # of them, of one client
LARGEST: Final = 32 * 1024 * 1024  # bytes of a file that is sent
WANTED_BYTES: Final = 50e6  # for one, and for what it keeps for the next one
TOPIC: Final = "/report"
BUSY: Final = "a report is being made already; wait until it is ready"


class RunReport:
    """At most one at a time. `turn` it in the daemon's loop."""

    def __init__(self, outlets: Outlets, clock: Clock, report: Report, keep_free_bytes: float) -> None:
        """report: kind and text of an event, from any thread. keep_free_bytes: of the disk, left alone."""
        self._keep_free_bytes = keep_free_bytes
        self._outlets, self._clock, self._report = outlets, clock, report
        self._asked: deque[tuple[zenoh.Query, str]] = deque()
        self._limiter = Limiter(MOST_WAITING, EACH, "requests for a report", threading.Lock())
        self._states = deque([pb.ReportState()])  # to be published; first that there is none
        self._job: Job | None = None
        self._thread: threading.Thread | None = None
        self._last: Path | None = None  # the report that is ready
        self._ends = False

    @property
    def answers(self) -> dict[str, Callable[[zenoh.Query, str], None]]:
        """Key -> takes queries on it, and who asks."""
        return {"report/make": self.make, "report/file": self.send}

    def make(self, query: zenoh.Query, client: str) -> None:
        """Take a query on `report/make`; none by a wildcard. In a thread of Zenoh's."""
        if "*" in str(query.key_expr):
            return
        if refused := self._limiter.enter(client):
            query.reply_err(refused)
            return
        self._asked.append((query, client))

    def send(self, query: zenoh.Query, client: str) -> None:
        """Answer a query on `report/file`. In a thread of Zenoh's."""
        if "*" in str(query.key_expr):
            return
        if self._last is None:
            query.reply_err("no report has been made in this run yet")
            return
        if refused := self._limiter.enter(client):
            query.reply_err(refused)
            return
        try:
            if self._last.stat().st_size > LARGEST:
                query.reply_err(f"{self._last}: too large to be sent; open it on the recorder's computer")
            else:
                query.reply(query.key_expr, self._last.read_bytes(), encoding=zenoh.Encoding.TEXT_HTML)
        except OSError as error:
            query.reply_err(f"{self._last}: {(error.strerror or str(error)).lower()}")
        finally:
            self._limiter.leave(client)

    def turn(self) -> None:
        """Begin what is asked for, publish how it goes."""
        while self._asked:
            query, client = self._asked.popleft()
            self._limiter.leave(client)
            _answer(query, self._begin())
        while self._states:
            self._outlets.publish(TOPIC, self._states.popleft().SerializeToString())

    def close(self) -> None:
        """A report that is not ready by now is not made: `tilth report` makes it of the whole run."""
        self._ends = True
        if self._job is not None:
            self._job.kill()
        if self._thread is not None:
            self._thread.join(timeout=5.0)

    def _begin(self) -> pb.ReportState | str:
        """The state where it has begun, else why not."""
        if self._thread is not None and self._thread.is_alive():
            return BUSY
        logs = self._outlets.recording.files
        if not logs:
            return "nothing has been recorded yet"
        if not in_background("report"):
            return f"this program makes no reports; use `{command('report', *map(str, logs))}`"
        state = pb.ReportState(state="making", began_ns=self._clock.t_ns())
        self._states.append(state)
        self._thread = threading.Thread(
            target=self._make, args=(logs, state.began_ns), name="tilth.report", daemon=True
        )
        self._thread.start()
        return state

    def _make(self, logs: Sequence[Path], began_ns: int) -> None:
        out, why = self._run(logs)
        if self._ends:
            return
        state = pb.ReportState(state="failed" if why else "ready", began_ns=began_ns)
        state.text, state.ended_ns = readable(why or out.name), self._clock.t_ns()
        if why:
            self._report(EventKind.REPORT, notice(NoticeCode.NO_REPORT, why=why))
        else:
            self._last = out
            self._report(EventKind.REPORT, notice(NoticeCode.REPORT_MADE, file=str(out)))
        self._states.append(state)

    def _run(self, logs: Sequence[Path]) -> tuple[Path, str]:
        """The report's path, and why it is not there, "" where it is."""
        reports = reports_in(logs[0].parent, self._keep_free_bytes)
        folder = reports.folder
        out = folder
        try:
            folder.mkdir(exist_ok=True)
            if not reports.make_room(WANTED_BYTES):
                return out, f"{reports.no_room()}; make room"
            out = _unused(folder, logs[0].stem.rpartition("_")[0])
            words = in_background("report", *map(str, logs), "--out", str(out))
            self._job = Job(words, niceness=REPORTS, longest_s=LONGEST_S)
            with closing(self._job):
                if self._ends:  # meanwhile
                    self._job.kill()
                if why_not := self._job.not_behind:
                    self._report(EventKind.REPORT, notice(NoticeCode.REPORT_AT_OWN_PRIORITY, why=why_not))
                why = self._job.end() or NO_ANSWER
        except JobEnded as lost:
            return out, str(lost)
        except OSError as error:
            return out, f"{error.filename or folder}: {(error.strerror or str(error)).lower()}"
        finally:
            self._job = None
        if why == OUT_OF_MEMORY:
            elsewhere = command("report", *map(str, logs), "--out", "REPORT.html")
            why = f"{why}: make it on another one from the logs, with `{elsewhere}`"
        # An open log is cut off for who reads it: that is told in the report, and is no failure.
        return out, "" if out.exists() else why


def _answer(query: zenoh.Query, begun: pb.ReportState | str) -> None:
    with suppress(zenoh.ZError):  # who asked has gone
        if isinstance(begun, str):
            query.reply_err(begun)
        else:
            query.reply(query.key_expr, begun.SerializeToString(), encoding=CHANNEL[TOPIC].encoding)
        query.drop()


def _unused(folder: Path, run: str) -> Path:
    number = 1
    while (path := folder / f"{run}_report_{number}.html").exists():
        number += 1
    return path
