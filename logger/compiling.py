"""Compiles the kernels that the estimators of a machine call, and finds the folder that caches them.

`python -m tilth.logger.compiling MACHINE.toml` does it in advance, what fits call too, for whoever runs it:
the installer, and the build of a wheel, whose word "only" has all other kernels removed from the package.
With "-" it is the recorder's own process (logger/preparing.py): the machine comes in a line, what goes out
are lines that say how far it is. Each has a second process beside it ("fits"), on another core: what one has
compiled the other finds on disk. That one begins with the slopes by parameters and with what only rows need,
so that they don't both compile the rig's motion.
"""

import contextlib
import os
import platform
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any, Final, NamedTuple

from tilth.estimator.compiled import Kernel
from tilth.estimator.methods.estimators import rows_for
from tilth.logger.child import packed, unpacked, words_of
from tilth.logger.fit_worker import in_order, rehearse
from tilth.logger.machine_file import read_machine
from tilth.schemas.machine import Machine, MachineError

TEXT: Final = "compiling kernels, once per machine: half a minute, a few minutes on a small computer"
NO_CACHE_FOLDER: Final = (
    "compiled kernels cannot be kept, since neither the program's folder nor the user's cache folder can be "
    "written: every start compiles them anew; set NUMBA_CACHE_DIR to a folder that this user may write"
)
UNTRUSTED: Final = (
    "can be written by others, so compiled kernels are not taken from there: every start compiles them anew; "
    "empty that folder, and let nobody but this user write it (chmod go-w)"
)
LACKING: Final = (
    "this processor ({}) lacks {}: a package's kernels are not for it, so they are compiled for it once, "
    "at the installation or the first start"
)
SECONDS: Final = {"over_ticks": 10.0, "motion_by_parameter": 1.5, "motion_by_state": 2.0, "motion": 0.8}
"""How long functions that take long take to compile, of a processor that does other work too. Slopes by
parameters take longer, but the second process has them ready."""
OTHERS_S: Final = 0.2
MOST: Final = 0.99  # share that is said to be done while anything is still compiled


class KernelsDone(NamedTuple):
    """How far the compiling is."""

    functions: int
    of: int
    share: float  # of the work, 0 to 1


Progress = Callable[[KernelsDone], None]


class NoCacheFolder(Exception):
    """There is no place for compiled kernels; one sentence that says what to set."""


class CompilingStopped(BaseException):
    """Raised by `progress` to stop. A BaseException: an Exception would make the kernel run interpreted."""


def kernels_of(machine: Machine) -> list[Kernel[..., Any]]:
    """What the estimators of a machine call."""
    return [kernel for row in rows_for(machine) for kernel in row.kernels]


def is_prepared(machine: Machine) -> bool:
    """Whether all of it is in this process already."""
    return all(kernel.called for kernel in kernels_of(machine))


def interpreted(machine: Machine) -> str:
    """Which kernels the compiler refused, and why; "" where none."""
    kernels = kernels_of(machine) if _compiles() else []
    return "; ".join(f"{k.function.__name__} is {k.how}" for k in kernels if k.how.startswith("interpreted"))


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
    if not _compiles():
        return
    from numba.core import event

    class Compilations(event.Listener):
        """numba's; loading from disk is none."""

        of_kernels: tuple[tuple[Kernel[..., Any], set[FunctionType]], ...] = ()  # once: it takes a while
        uncompiled: set[FunctionType] | None = None  # the second kernel to call one finds it kept
        work, functions = 0.0, 0

        def on_start(self, event: Any) -> None:
            if self.uncompiled is None:
                self.of_kernels = tuple((one, set(one.functions())) for one in kernels_of(machine))
                self.uncompiled = self.of_waiting()
                self.work, self.functions = _work(self.uncompiled), len(self.uncompiled)
                progress(KernelsDone(0, self.functions, 0.0))

        def on_end(self, event: Any) -> None:
            code, waiting = event.data["dispatcher"].py_func.__code__, self.uncompiled or set()
            ended = next((one for one in waiting if one.__code__ is code), None)
            if ended is None:
                return  # one of numba's own, or one for other types
            # Without those of kernels that were found on disk.
            self.uncompiled = (waiting - {ended}) & self.of_waiting()
            share = min(1.0 - _work(self.uncompiled) / self.work, MOST)
            progress(KernelsDone(self.functions - len(self.uncompiled), self.functions, share))

        def of_waiting(self) -> set[FunctionType]:
            """Functions of kernels that were not called yet, and of what they call."""
            return set().union(*(found for kernel, found in self.of_kernels if not kernel.called))

    listener = Compilations()
    event.register("numba:compile", listener)
    try:
        for row in rows_for(machine):
            row.prepare(machine)
    finally:
        event.unregister("numba:compile", listener)


def _work(functions: set[FunctionType]) -> float:
    """About how long they take to compile, as SECONDS."""
    return sum(SECONDS.get(function.__name__, OTHERS_S) for function in functions)


def _compiles() -> bool:
    """False where kernels are interpreted."""
    try:
        from numba.core import config
    except (ImportError, OSError):
        return False
    return not getattr(config, "DISABLE_JIT", 0)  # set at run time


def cache_folder(machine: Machine) -> str:
    """The folder where compiled kernels are kept; "" where nothing is compiled. Raises
    NoCacheFolder."""
    if not _compiles():
        return ""
    from numba.core.caching import FunctionCache

    kernels = kernels_of(machine)
    try:
        return str(FunctionCache(kernels[0].function).cache_path) if kernels else ""
    except RuntimeError:
        raise NoCacheFolder(NO_CACHE_FOLDER) from None


def lacking() -> str:
    """Why kernels of a package are not used on this processor; "" where they are."""
    if not _compiles():
        return ""
    from tilth.estimator import kernel_store

    lacks = kernel_store.lacking()
    return lacks and LACKING.format(platform.machine(), lacks)


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


@contextlib.contextmanager
def keeping_in(folder: str) -> Iterator[None]:
    """Keep kernels there instead, in this process and in those that it starts meanwhile."""
    from numba.core import config

    settings: Any = config  # numba sets its attributes itself
    before = settings.CACHE_DIR  # that of the environment; "" is none, to numba too
    os.environ["NUMBA_CACHE_DIR"] = settings.CACHE_DIR = folder
    try:
        yield
    finally:
        os.environ["NUMBA_CACHE_DIR"] = settings.CACHE_DIR = before


def main(words: list[str]) -> int:
    """Of one machine file; 2 where there is none that can be read."""
    if words == ["fits"]:
        machine = unpacked(sys.stdin.buffer.readline())
        for fitting in in_order(machine):
            fitting.rehearse_alone()
        for fitting in in_order(machine):
            rehearse(fitting, machine)
        return 0
    if words == ["-"]:
        machine = unpacked(sys.stdin.buffer.readline())
        with _fits_beside(machine):
            prepare(machine, lambda done: _print(" ".join(map(str, done))))
        return 0
    try:
        if words[1:] not in ([], ["only"]) or not words:
            raise MachineError("usage: python -m tilth.logger.compiling MACHINE.toml [only]")
        machine = read_machine(Path(words[0])).machine
    except MachineError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    if why_anew := lacking():
        _print(why_anew)
    with _fits_beside(machine):
        prepare(machine, lambda done: None if done.share else _print(TEXT))
    for fitting in in_order(machine) if _compiles() else ():
        rehearse(fitting, machine)
    if words[1:]:
        _remove_others()
    return 0


def _remove_others() -> None:
    """The package then holds what this process has used, and nothing else."""
    from tilth.estimator import kernel_store

    folder = Path(str(kernel_store.PACKAGED))
    for name in kernel_store.others([path.name for path in folder.glob("*.nb[ic]")]):
        (folder / name).unlink()


@contextlib.contextmanager
def _fits_beside(machine: Machine) -> Iterator[None]:
    """A second process compiles what fits call, if there is a core for it. What it can't do is done later."""
    if not _compiles() or len(os.sched_getaffinity(0)) < 2:
        yield
        return
    words = words_of("tilth.logger.compiling", "fits")  # it ends with this process
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL) as beside:
        assert beside.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it ended at once
            beside.stdin.write(packed(machine) + b"\n")
            beside.stdin.flush()
        yield


def _print(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
