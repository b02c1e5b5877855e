"""Makes the fits that the fold requests: in a worker process for the live loop, in a thread for a replay.

A fit takes a tenth of a second or more, a frame has microseconds. A request is decided a fixed time
of the log later: it is there and is used, or it is late and is used when it is ready. Both are logged before,
so that a replay does alike.
"""

import contextlib
import threading
from collections.abc import Mapping
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any, Final, Protocol

from tilth.estimator.methods.fitted import alike
from tilth.logger.child import packed, unpacked, words_of
from tilth.logger.fit_worker import Answer, as_text, job_sha256, make, of_text
from tilth.logger.job import STOPPED, Job, JobEnded
from tilth.logger.log.software import computed_elsewhere
from tilth.logger.log.software import software as here
from tilth.logger.priority import FITS
from tilth.schemas.flow import EventKind, FitOutcome
from tilth.schemas.machine import Machine
from tilth.schemas.notices import NoticeCode, Report, notice

UNDECIDED: Final = object()
LATE: Final = object()
GIVEN_UP: Final = "it was given up when the next was asked for"
LEAVE_S: Final = 2.0  # how long the end of a run waits for the worker
ONE_THREAD: Final[Mapping[str, str]] = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)  # a sum split among threads is rounded otherwise, and the other core belongs to the loop


class Fitter(Protocol):
    """Makes fits. At most one job of a method is pending."""

    def ask(self, method: str, job: Any) -> None:
        """Request a fit; does nothing where the same one is under way. Takes microseconds."""
        ...

    def outcome(self, method: str, job: Any, t_ns: int, awaited: bool = False) -> Any:
        """The result; None if there will be none; LATE if it is not ready; UNDECIDED if nothing is known at
        t_ns. awaited: it was LATE before."""
        ...

    def made(self, method: str, job: Any) -> Any:
        """The result, waited for; None if it failed."""
        ...

    def use(self, machine: Machine) -> None:
        """Another description of the rig, from now on. No fit is pending."""
        ...


class InPlace:
    """Makes each fit when it is due, always in time."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    def ask(self, method: str, job: Any) -> None:
        return

    def outcome(self, method: str, job: Any, t_ns: int, awaited: bool = False) -> Any:
        return self.made(method, job)

    def made(self, method: str, job: Any) -> Any:
        return make(self._machine, method, job)[0]

    def use(self, machine: Machine) -> None:
        self._machine = machine


class Worker:
    """Makes fits in a separate process: a crash or a slow fit costs no more than that fit.

    A thread talks to the process: a job is larger than what a pipe holds, and the loop must not wait for it.
    """

    def __init__(self, machine: Machine, report: Report) -> None:
        """report: takes kind and text of an event, from that thread."""
        self.seconds: float | None = None  # computing time of the last fit
        self._machine = machine
        self._report = report
        self._count = 0
        self._tickets: dict[str, tuple[int, int]] = {}  # method -> (asked_ns, ticket) of the job that counts
        self._results: dict[int, object] = {}  # ticket -> result
        self._changed = threading.Condition()  # guards all that both threads touch
        self._asks: SimpleQueue[tuple[int, str, Any] | None] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self._job: Job | None = None
        self._busy = 0  # ticket of what the process is at
        self._closing = False
        self._said_priority = False

    def start(self) -> None:
        """Start the process and compile, if that has not been done: the first fit would be late for it."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="tilth-fits", daemon=True)
            self._thread.start()

    def ask(self, method: str, job: Any) -> None:
        with self._changed:
            before = self._tickets.get(method)
            if before is not None and before[0] == job.asked_ns:
                return
            if before is not None:
                if self._busy == before[1] and self._job is not None:
                    self._job.kill(GIVEN_UP)  # what is asked for instead must not wait for it
                self._results.pop(before[1], None)
            self._count += 1
            self._tickets[method] = (job.asked_ns, self._count)
        self.start()
        self._asks.put((self._count, method, job))

    def outcome(self, method: str, job: Any, t_ns: int, awaited: bool = False) -> Any:
        with self._changed:
            return self._take(method, job)

    def made(self, method: str, job: Any) -> Any:
        self.ask(method, job)
        with self._changed:
            ticket = self._tickets[method][1]
            self._changed.wait_for(lambda: ticket in self._results)
            return self._take(method, job)

    def use(self, machine: Machine) -> None:
        with self._changed:
            self._machine = machine
            if self._job is not None:
                self._job.kill()  # its successor is told of this machine
            self._tickets.clear()
            self._results.clear()

    def close(self) -> None:
        """End the process; a fit under way is lost."""
        if self._thread is None:
            return
        with self._changed:
            self._closing = True
            if self._job is not None:
                self._job.kill()
        self._asks.put(None)
        self._thread.join(LEAVE_S)
        self._thread = None

    def _take(self, method: str, job: Any) -> Any:
        asked_ns, ticket = self._tickets.get(method, (None, 0))
        if asked_ns != job.asked_ns:
            return None
        if ticket not in self._results:
            return LATE
        del self._tickets[method]
        return self._results.pop(ticket)

    # What follows runs in the thread.

    def _work(self) -> None:
        try:
            with contextlib.suppress(JobEnded):  # told at the first fit
                self._running()
            while (request := self._asks.get()) is not None:
                self._answer(*request)
        finally:
            self._end()

    def _answer(self, ticket: int, method: str, job: Any) -> None:
        with self._changed:
            if self._tickets.get(method, (0, 0))[1] != ticket:
                return
            self._busy = ticket
        try:
            process = self._running()
            process.send(packed((ticket, method, job)))
            answer: Answer = unpacked(process.next() or b"")
            _, made, error, self.seconds = answer
        except (JobEnded, ValueError) as lost:
            made, error = None, f"{lost}; its process is started again for the next"
            self._end()
        if error and not self._closing:
            _report_failure(self._report, method, error)
        with self._changed:
            self._busy = 0
            if self._tickets.get(method, (0, 0))[1] == ticket:
                self._results[ticket] = made
            self._changed.notify_all()

    def _running(self) -> Job:
        """The process, started where it does not run. Raises JobEnded."""
        if self._job is not None and not self._job.stopped:
            return self._job
        self._end()
        with self._changed:
            if self._closing:
                raise JobEnded(STOPPED)
            words, machine = words_of("tilth.logger.fit_worker"), packed(self._machine)
            self._job = Job(words, [machine], niceness=FITS, environment=ONE_THREAD)
        if self._job.not_behind and not self._said_priority:
            self._said_priority = True
            why_not = self._job.not_behind
            self._report(EventKind.FIT, notice(NoticeCode.FITS_AT_OWN_PRIORITY, why=why_not))
        return self._job

    def _end(self) -> None:
        with self._changed:
            job, self._job = self._job, None
        if job is not None:
            job.close()


def _report_failure(report: Report, method: str, error: str) -> None:
    report(EventKind.FIT, notice(NoticeCode.FIT_FAILED, method=method, why=error))


class ReplayedFits:
    """Fits of a replay: in time, late or dropped as the log says; where it says nothing, in time.

    Each is made in a thread, so that a replay in real time goes on meanwhile. None is made where the log
    holds its result, of the same job, machine file, code and arithmetic, unless the log is verified. A log
    that is verified on another kind of computer goes on from its own results, where those here are alike.
    """

    def __init__(self, machine: Machine, report: Report) -> None:
        """report: takes kind and text of an event, from a thread."""
        self.holds_outcomes = False  # whether the log records outcomes of fits
        self._machine = machine
        self._report = report
        self._asked: dict[str, tuple[int, Future[Any]]] = {}  # method -> asked_ns of its job, and the result
        self.ties = 0  # results of the log that were used though here they are others
        self._elsewhere = False  # the log is verified, and was recorded where the last digits are others
        self._trusted = False  # the results of the log are those that would be computed here
        self._outcomes: dict[tuple[str, int], FitOutcome] = {}
        self._first: dict[tuple[str, int], int] = {}  # t_ns at which an outcome was first asked for

    def recorded_by(self, software: Mapping[str, str], verified: bool) -> None:
        """What follows was computed by this (metadata "tilth" of its log). verified: it is compared."""
        other = bool(computed_elsewhere(software))
        self._elsewhere = verified and other
        self._trusted = not verified and not other and software.get("estimator") == here()["estimator"]

    def add_outcome(self, outcome: FitOutcome) -> None:
        """Take an outcome from the log."""
        self._outcomes[outcome.method, outcome.asked_ns] = outcome

    def forget(self) -> None:
        """The log goes on with another state, or another run."""
        self._asked.clear()
        self._outcomes.clear()
        self._first.clear()

    def ask(self, method: str, job: Any) -> None:
        if not self._trusted:  # else it is made only if the log has another, or none
            self._begin(method, job)

    def _begin(self, method: str, job: Any) -> None:
        if method in self._asked and self._asked[method][0] == job.asked_ns:
            return
        result: Future[Any] = Future()
        self._asked[method] = job.asked_ns, result
        # A daemon: Ctrl-C does not wait for a fit.
        threading.Thread(target=self._make, args=(method, job, result), name="tilth-fit", daemon=True).start()

    def _make(self, method: str, job: Any, result: Future[Any]) -> None:
        found, error = make(self._machine, method, job)
        if error:
            _report_failure(self._report, method, error)
        result.set_result(found)

    def outcome(self, method: str, job: Any, t_ns: int, awaited: bool = False) -> Any:
        """UNDECIDED until the log has the outcome: right after the frame at which the fit is due, or, for a
        late one, where it was ready."""
        key = (method, job.asked_ns)
        if key not in self._outcomes and (
            awaited or (self.holds_outcomes and t_ns <= self._first.setdefault(key, t_ns))
        ):
            return UNDECIDED
        self._first.pop(key, None)
        logged = self._outcomes.pop(key, None)
        if logged is None:
            return self.made(method, job)
        return self._adopted(job, logged) if logged.adopted else LATE if logged.awaited else None

    def _adopted(self, job: Any, logged: FitOutcome) -> Any:
        """The result of a job that was adopted: the logged one if it is known to be the same, or as good."""
        method, text = logged.method, logged.result
        if text and self._trusted and logged.job_sha256 == job_sha256(self._machine, job):
            return of_text(method, text)
        made = self.made(method, job)
        if not (text and self._elsewhere) or made is None or as_text(made) == text:
            return made
        try:
            of_log = of_text(method, text)
        except ValueError:  # of another version
            return made
        if not (hasattr(made, "covariance") and alike(made, of_log)):
            return made
        self.ties += 1
        return of_log

    def made(self, method: str, job: Any) -> Any:
        self._begin(method, job)
        return self._asked.pop(method)[1].result()

    def use(self, machine: Machine) -> None:
        self._machine = machine
        self._asked.clear()
