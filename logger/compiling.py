"""Compiles the kernels that the estimators of a machine call, and keeps them in a folder.

Compiling takes a minute and would hold up a loop for seconds at a time. So the recorder has a process do it,
into the folder where kernels are kept, and a thread then only loads them (`Preparing`). Where they cannot be
kept a folder is lent for this run; where there is not even that, or the process fails, the thread compiles.

`python -m tilth.logger.compiling MACHINE.toml` does it in advance, what fits call too, for whoever runs it:
the installer, and the build of a wheel, whose word "only" has all other kernels removed from the package.
With "-" it is the recorder's process: the machine comes in a line, what goes out are lines that say how far
it is. Each has a second process beside it, on another core: what one has compiled the other finds on disk.
That one begins with the slopes by parameters and with what only rows need, so that they don't both compile
the rig's motion.
"""

import contextlib
import math
import os
import stat
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any, Final, NamedTuple

from tilth.estimator.compiled import Kernel
from tilth.estimator.methods.estimators import rows_for
from tilth.logger.child import packed, unpacked, words_of
from tilth.logger.fit_worker import rehearsals, rehearse
from tilth.logger.job import Job, JobEnded
from tilth.logger.machine_file import read_machine
from tilth.logger.priority import COMPILING as BEHIND
from tilth.schemas.flow import EventKind
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.notices import NoticeCode, Report, notice

TEXT: Final = "compiling kernels, once per machine: half a minute, a few minutes on a small computer"
LOADING: Final = "loading kernels"
COMPILING: Final = "compiling kernels, once per machine"
ANEW: Final = "compiling kernels, which cannot be kept here"
NO_CACHE_FOLDER: Final = (
    "compiled kernels cannot be kept, since neither the program's folder nor the user's cache folder can be "
    "written: every start compiles them anew; set NUMBA_CACHE_DIR to a folder that this user may write"
)
UNTRUSTED: Final = (
    "can be written by others, so compiled kernels are not taken from there: every start compiles them anew; "
    "empty that folder, and let nobody but this user write it (chmod go-w)"
)
SECONDS: Final = {"over_ticks": 10.0, "motion_by_parameter": 1.5, "motion_by_state": 2.0, "motion": 0.8}
"""How long functions that take long take to compile, of a processor that does other work too. Slopes by
parameters take longer, but the second process has them ready."""
OTHERS_S: Final = 0.2
MOST: Final = 0.99  # share that is said to be done while anything is still compiled
SURE: Final = 0.1  # share of the work that must be done before the rest is foretold
LEAVE_S: Final = 2.0  # how long the end of a run waits for it


class KernelsDone(NamedTuple):
    """How far the compiling is."""

    functions: int
    of: int
    share: float  # of the work, 0 to 1


Progress = Callable[[KernelsDone], None]


class CompilingStopped(BaseException):
    """Raised by `progress` to stop. A BaseException: an Exception would make the kernel run interpreted."""


def kernels_of(machine: Machine) -> list[Kernel[..., Any]]:
    """What the estimators of a machine call."""
    return [kernel for row in rows_for(machine) for kernel in row.kernels]


def is_prepared(machine: Machine) -> bool:
    """Whether all of it is in this process already."""
    return all(kernel.called for kernel in kernels_of(machine))


def load(machine: Machine) -> bool:
    """Take what was kept on disk; False as soon as something would have to be compiled."""

    def stop(done: KernelsDone) -> None:
        raise CompilingStopped

    try:
        prepare(machine, stop)
    except CompilingStopped:
        return False
    return True


def prepare(machine: Machine, progress: Progress) -> None:
    """Take what was kept on disk, compile the rest.

    progress: gets a share of 0.0 when the first kernel has to be compiled, more after each function; may
    raise CompilingStopped.
    """
    if not compiles():
        return
    from numba.core import event

    class Compilations(event.Listener):
        """numba's; loading from disk is none."""

        of_kernels: tuple[tuple[Kernel[..., Any], list[FunctionType]], ...] = ()  # once: it takes a while
        first, left = frozenset[FunctionType](), frozenset[FunctionType]()

        def on_start(self, event: Any) -> None:
            if not self.of_kernels:
                self.of_kernels = tuple((one, one.functions()) for one in kernels_of(machine))
                self.first = self.left = self.waiting()
                progress(KernelsDone(0, len(self.first), 0.0))

        def on_end(self, event: Any) -> None:
            code = event.data["dispatcher"].py_func.__code__
            ended = next((one for one in self.left if one.__code__ is code), None)
            if ended is None:
                return  # one of numba's own, or one for other types
            # Without those of kernels that were found on disk; the second kernel to call one finds it kept.
            self.left = (self.left - {ended}) & self.waiting()
            share = min(1.0 - _work(self.left) / _work(self.first), MOST)
            progress(KernelsDone(len(self.first) - len(self.left), len(self.first), share))

        def waiting(self) -> frozenset[FunctionType]:
            """Those of kernels that were not called yet, and of what they call."""
            return frozenset().union(*(found for kernel, found in self.of_kernels if not kernel.called))

    with event.install_listener("numba:compile", Compilations()):
        # The tracker before what runs without it: fits, compiled beside, find there what they share with it.
        for row in reversed(rows_for(machine)):
            row.prepare(machine)


def _work(functions: frozenset[FunctionType]) -> float:
    """About how long they take to compile, as SECONDS."""
    return sum(SECONDS.get(function.__name__, OTHERS_S) for function in functions)


def compiles() -> bool:
    """False where kernels are interpreted."""
    with contextlib.suppress(ImportError, OSError):
        from numba.core import config

        return not getattr(config, "DISABLE_JIT", 0)  # set at run time
    return False


def why_not_kept() -> str:
    """Why compiled kernels can neither be taken from where they are kept nor kept there, in a sentence that
    says what to do; "" where they can."""
    if not compiles():
        return ""
    from tilth.estimator import kernel_store

    if refused := untrusted():  # before anything there is looked at
        return refused
    return "" if kernel_store.folder() else NO_CACHE_FOLDER


def untrusted() -> str:
    """Why no code is taken from the folder of NUMBA_CACHE_DIR: others than root and this user can write
    there, or could, and numba runs what it finds. "" where nobody can, or no folder is named."""
    folder = Path(os.environ.get("NUMBA_CACHE_DIR", ""))
    if folder == Path() or not folder.is_dir():
        return ""
    folder = folder.resolve()
    for place in (folder, *folder.parents, *folder.rglob("*")):
        found = place.lstat()
        # Who may write a folder above may put another one there, but not where the sticky bit is set.
        sticky = place in folder.parents and bool(found.st_mode & stat.S_ISVTX)
        link = stat.S_ISLNK(found.st_mode)
        loose = found.st_mode & (stat.S_IWGRP | stat.S_IWOTH) and not (sticky or link)
        if loose or found.st_uid not in (0, os.geteuid()):
            return f"{place} {UNTRUSTED}"
    return ""


class Preparing:
    """Makes ready what the estimators call, while frames are recorded. Begins at once. `ready` is True from
    when the estimators can be called without waiting."""

    def __init__(self, machine: Machine, report: Report) -> None:
        """report: takes kind and text of an event, called from a thread."""
        self.ready = is_prepared(machine)
        self.seconds = 0.0  # of compiling
        self._doing = "" if self.ready else LOADING
        self._machine = machine
        self._report = report
        self._done = KernelsDone(0, 0, 0.0)
        self._began_s = 0.0  # monotonic
        self._foretold = (0.0, math.inf)  # when a kernel was done last, monotonic, and what was left then, s
        self._job: Job | None = None
        self._closing = False
        self._lent = contextlib.ExitStack()
        self._thread = threading.Thread(target=self._work, name="tilth-preparing", daemon=True)
        if not self.ready:
            self._thread.start()

    @property
    def text(self) -> str:
        """What is being done, in a person's words; "" where nothing is."""
        done, doing = self._done, self._doing
        return f"{doing}: {done.functions} of {done.of} done" if done.of and doing else doing

    @property
    def remaining_s(self) -> float | None:
        """About how long it still takes, less each time it is asked for; None where not known."""
        at_s, left_s = self._foretold
        if self.ready or math.isinf(left_s):
            return None
        # A second less each second at first; where a kernel takes longer than foretold, ever more slowly.
        return left_s * left_s / max(left_s + time.monotonic() - at_s, 1e-9)

    def close(self) -> None:
        self._closing = True
        if self._job is not None:
            self._job.kill()
        if self._thread.ident is not None:
            self._thread.join(LEAVE_S)
        self._lent.close()

    # What follows runs in the thread.

    def _work(self) -> None:
        try:
            if not_kept := why_not_kept():
                self._lend()
            if not load(self._machine):
                self._compile(not_kept)
            kernels = kernels_of(self._machine) if compiles() else []
            refused = [(k.function.__name__, k.how) for k in kernels if k.how.startswith("interpreted")]
            why_not = "; ".join(f"{name} is {how}" for name, how in refused)
        except CompilingStopped:
            return
        except Exception as error:  # whatever it is, the fold has a guard of its own
            why_not = f"{type(error).__name__}: {error}"
        if why_not:
            self._say(NoticeCode.KERNELS_REFUSED, why=why_not)
        self._doing, self.ready = "", True

    def _say(self, code: NoticeCode, **values: str) -> None:
        self._report(EventKind.COMPILED, notice(code, **values))

    def _lend(self) -> None:
        """Lend a folder for this run; without one the kernels are compiled here."""
        folder = os.devnull  # where nothing can be kept, nor found
        with contextlib.suppress(OSError):
            folder = self._lent.enter_context(
                tempfile.TemporaryDirectory(prefix="tilth-kernels-", ignore_cleanup_errors=True)
            )
        self._lent.callback(_keep_in, _keep_in(folder))

    def _compile(self, not_kept: str) -> None:
        """not_kept: why what is compiled is not kept, or ""."""
        began_s = time.monotonic()
        self._doing = ANEW if not_kept else COMPILING
        if not_kept:
            self._say(NoticeCode.CACHE_REFUSED, why=not_kept)
        self._say(NoticeCode.COMPILING_ANEW if not_kept else NoticeCode.COMPILING)
        try:
            words = words_of("tilth.logger.compiling", "-")
            self._job = Job(words, [packed(self._machine)], niceness=BEHIND)
            with contextlib.closing(self._job):
                if self._closing:  # meanwhile, so that `close` has not seen it
                    raise CompilingStopped
                if why_not := self._job.not_behind:
                    self._say(NoticeCode.COMPILES_AT_OWN_PRIORITY, why=why_not)
                for line in self._job.lines():
                    functions, of, share = line.split()
                    self._progress(KernelsDone(int(functions), int(of), float(share)))
        except (JobEnded, ValueError) as why:
            if not self._closing:
                self._say(NoticeCode.COMPILER_FAILED, why=str(why))
        prepare(self._machine, self._progress)  # loads, unless the process could not
        self.seconds = time.monotonic() - began_s

    def _progress(self, done: KernelsDone) -> None:
        if self._closing:
            raise CompilingStopped
        now_s = time.monotonic()
        if not done.functions:
            self._began_s, self._foretold = now_s, (now_s, math.inf)
        elif done.share >= SURE:
            said_s = self.remaining_s
            left_s = (now_s - self._began_s) * (1.0 / done.share - 1.0)
            self._foretold = (now_s, min(left_s, left_s if said_s is None else said_s))
        self._done = done


def _keep_in(folder: str) -> str:
    """Keep kernels there from now on, in this process and in those that it starts. Returns where they were
    kept before, "" if numba chose."""
    from numba.core import config

    settings: Any = config  # numba sets its attributes itself
    before: str = settings.CACHE_DIR
    os.environ["NUMBA_CACHE_DIR"] = settings.CACHE_DIR = folder
    return before


def main(words: list[str]) -> int:
    """Of one machine file; 2 where there is none that can be read."""
    told = words == ["-"]
    try:
        if not told and (not words or words[1:] not in ([], ["only"])):
            raise MachineError("usage: python -m tilth.logger.compiling MACHINE.toml [only]")
        machine = unpacked(sys.stdin.buffer.readline()) if told else read_machine(Path(words[0])).machine
    except MachineError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    if not compiles():
        return 0
    from tilth.estimator import kernel_store

    def progress(done: KernelsDone) -> None:
        if told or not done.share:
            _print(" ".join(map(str, done)) if told else TEXT)

    if not told and (why_anew := kernel_store.lacking()):
        _print(why_anew)
    fits: contextlib.AbstractContextManager[Job | None] = contextlib.nullcontext()
    if len(os.sched_getaffinity(0)) > 1:  # what the process that makes fits cannot compile is compiled later
        fits = contextlib.closing(Job(words_of("tilth.logger.fit_worker"), [packed(machine)]))
    with fits as beside:
        prepare(machine, progress)
        if beside is not None:
            beside.end()
    uncompiled = [] if told else rehearsals(machine)
    while uncompiled:
        rehearse(uncompiled)
    for path in list(Path(str(kernel_store.PACKAGED)).glob("*.nb[ic]")) if words[1:] else ():
        if not kernel_store.is_used(path.name):
            path.unlink()
    return 0


def _print(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
