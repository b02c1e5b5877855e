"""A `map` over the cores of this computer, for kernels that take seconds."""

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

Map = Callable[..., Iterable[Any]]


@contextmanager
def side_by_side(count: int, jobs: int | None = None) -> Iterator[Map]:
    """count: how often it will be called at least. jobs: processes, as many as there are cores if None.

    Results come in order and are the same for any number of processes. Functions and arguments are pickled.
    """
    processes = min(count, jobs or os.cpu_count() or 1)
    if processes < 2:
        yield map
        return
    # Forked, so that a process has all modules at once.
    pool = ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("fork"))
    try:
        yield pool.map
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
