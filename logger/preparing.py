"""Makes ready what the estimators call, while frames are recorded.

Compiling takes a minute and would hold up the loop for seconds at a time. So a process of its own does it,
into the folder where kernels are kept, and a thread here then only loads them. Where they cannot be kept a
folder is lent for this run; where there is not even that, or the process fails, the thread compiles.
"""

import contextlib
import math
import os
import tempfile
import threading
import time
from typing import Final

from tilth.logger import compiling
from tilth.logger.child import packed, words_of
from tilth.logger.compiling import KernelsDone
from tilth.logger.job import Job, JobEnded
from tilth.logger.priority import COMPILING as BEHIND
from tilth.schemas.flow import EventKind
from tilth.schemas.machine import Machine
from tilth.schemas.notices import NoticeCode, Report, notice

LOADING: Final = "loading kernels"
COMPILING: Final = "compiling kernels, once per machine"
ANEW: Final = "compiling kernels, which cannot be kept here"
FOLLOW: Final = "frames are recorded meanwhile, estimates follow"
LEAVE_S: Final = 2.0  # how long the end of a run waits for it
SURE: Final = 0.1  # share of the work that must be done before the rest is foretold


class Preparing:
    """Begins at once. `ready` is True from when the estimators can be called without waiting."""

    def __init__(self, machine: Machine, report: Report) -> None:
        """report: takes kind and text of an event, called from a thread."""
        self.ready = compiling.is_prepared(machine)
        self.seconds = 0.0  # of compiling
        self._doing = "" if self.ready else LOADING
        self._machine = machine
        self._report = report
        self._done = KernelsDone(0, 0, 0.0)
        self._began_s: float | None = None  # monotonic
        self._foretold = (0.0, math.inf)  # when a kernel was done last, monotonic, and what was left then, s
        self._job: Job | None = None
        self._closing = False
        self._lock = threading.Lock()  # of the two before
        self._lent = contextlib.ExitStack()
        self._thread = threading.Thread(target=self._work, name="tilth-preparing", daemon=True)
        if not self.ready:
            self._thread.start()

    @property
    def text(self) -> str:
        """What is being done, in a person's words; "" where nothing is."""
        done = self._done
        return (
            f"{self._doing}: {done.functions} of {done.of} done" if done.of and self._doing else self._doing
        )

    @property
    def remaining_s(self) -> float | None:
        """About how long it still takes, less each time it is asked for; None where not known."""
        at_s, left_s = self._foretold
        if self.ready or math.isinf(left_s):
            return None
        # A second less each second at first; where a kernel takes longer than foretold, ever more slowly.
        return left_s * left_s / max(left_s + time.monotonic() - at_s, 1e-9)

    def close(self) -> None:
        with self._lock:
            self._closing = True
            if self._job is not None:
                self._job.kill()
        if self._thread.ident is not None:
            self._thread.join(LEAVE_S)
        self._lent.close()

    # What follows runs in the thread.

    def _work(self) -> None:
        try:
            untrusted = compiling.untrusted()
            if untrusted:  # before anything in it is looked at
                self._lend()
            if not compiling.load(self._machine):
                self._compile(untrusted)
            if why := compiling.interpreted(self._machine):
                self._report(EventKind.COMPILED, notice(NoticeCode.KERNELS_REFUSED, why=why))
        except compiling.CompilingStopped:
            return
        except Exception as error:  # whatever it is, the fold has a guard of its own
            refused = notice(NoticeCode.KERNELS_REFUSED, why=f"{type(error).__name__}: {error}")
            self._report(EventKind.COMPILED, refused)
        self._doing, self.ready = "", True

    def _compile(self, not_kept: str) -> None:
        """not_kept: why what is compiled is not kept, or ""."""
        began_s = time.monotonic()
        if not not_kept:
            try:
                compiling.cache_folder(self._machine)
            except compiling.NoCacheFolder as why:
                not_kept = str(why)
                self._lend()
        self._doing = ANEW if not_kept else COMPILING
        if not_kept:
            self._report(EventKind.COMPILED, notice(NoticeCode.CACHE_REFUSED, why=not_kept))
        self._report(
            EventKind.COMPILED, notice(NoticeCode.COMPILING_ANEW if not_kept else NoticeCode.COMPILING)
        )
        self._compile_in_process()
        compiling.prepare(self._machine, self._progress)  # loads, unless the process could not
        self.seconds = time.monotonic() - began_s

    def _lend(self) -> None:
        """Lend a folder for this run; without one the kernels are compiled here."""
        folder = os.devnull  # where nothing can be kept, nor found
        with contextlib.suppress(OSError):
            folder = self._lent.enter_context(
                tempfile.TemporaryDirectory(prefix="tilth-kernels-", ignore_cleanup_errors=True)
            )
        self._lent.enter_context(compiling.keeping_in(folder))

    def _compile_in_process(self) -> None:
        """Compile in a process of its own."""
        try:
            with self._lock:
                if self._closing:
                    return
                words = words_of("tilth.logger.compiling", "-")
                self._job = Job(words, [packed(self._machine)], niceness=BEHIND)
            with contextlib.closing(self._job):
                if why_not := self._job.not_behind:
                    self._report(EventKind.COMPILED, notice(NoticeCode.COMPILES_AT_OWN_PRIORITY, why=why_not))
                for line in self._job.lines():
                    functions, of, share = line.split()
                    self._progress(KernelsDone(int(functions), int(of), float(share)))
        except (JobEnded, ValueError) as why:
            if not self._closing:
                self._report(EventKind.COMPILED, notice(NoticeCode.COMPILER_FAILED, why=str(why)))

    def _progress(self, done: KernelsDone) -> None:
        if self._closing:
            raise compiling.CompilingStopped
        now_s = time.monotonic()
        if not done.functions:
            self._began_s, self._foretold = now_s, (now_s, math.inf)
        elif self._began_s is not None and done.share >= SURE:
            said_s = self.remaining_s
            left_s = (now_s - self._began_s) * (1.0 / done.share - 1.0)
            self._foretold = (now_s, min(left_s, left_s if said_s is None else said_s))
        self._done = done
