"""A `map` over the cores of this computer, for kernels that take seconds."""

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

from tilth.logger.child import end_with

Map = Callable[..., Iterable[Any]]


@contextmanager
def processes(count: int, start: str = "fork") -> Iterator[ProcessPoolExecutor]:
    """So many processes, which end with this one; after a failure nothing that waits is begun.

    start: forked, a process has all modules at once; "spawn" where this one has threads.
    """
    context = multiprocessing.get_context(start)
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=end_with, initargs=(os.getpid(),))
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()  # its threads are gone before the next ones fork


@contextmanager
def side_by_side(count: int, jobs: int | None = None) -> Iterator[Map]:
    """count: how often it will be called at least. jobs: processes, as many as there are cores if None.

    Results come in order and are the same for any number of processes. Functions and arguments are pickled.
    """
    wanted = min(count, jobs or os.cpu_count() or 1)
    if wanted < 2:
        yield map
        return
    with processes(wanted) as pool:
        yield pool.map
