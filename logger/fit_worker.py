"""The process that makes fits, started by logger/fitting.py.

Its parent tells it the machine and then jobs, each in a line; it answers each job with one.
"""

import contextlib
import os
import sys
import threading
import time
from typing import Any, Final

from threadpoolctl import threadpool_limits

from tilth.estimator.methods.estimators import ROW, rows_for
from tilth.logger.child import packed, unpacked
from tilth.schemas.machine import Machine

_ONE_FIT: Final = threading.Lock()  # how many threads linear algebra has is one setting of a process

Answer = tuple[int, Any, str, float]  # ticket, result or None, what went wrong or "", computing time in s


def make(machine: Machine, method: str, job: Any) -> tuple[Any, str]:
    """(result, "") of a job, or (None, reason): a fit that fails must not end the process.

    Linear algebra has one thread: sums that are split among several are rounded otherwise, and a replay gives
    the same bytes on any computer.
    """
    try:
        fitting = ROW[method].fitting
        assert fitting is not None
        with _ONE_FIT, threadpool_limits(1):
            return fitting.fit(machine, job), ""
    except Exception as error:  # whatever the numerics may say, it is a fit less
        return None, f"{type(error).__name__}: {error}"


def rehearse(machine: Machine) -> None:
    """Compile what fits need before the first of them is asked for."""
    for row in rows_for(machine):
        if row.fitting is not None:
            row.fitting.rehearse(machine)


def main() -> None:
    """Answer jobs from stdin on stdout until stdin ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not stand among the answers
    requests = sys.stdin.buffer
    machine = unpacked(requests.readline())
    with contextlib.suppress(Exception):  # what fails here fails at the fit, where it is told
        rehearse(machine)
    for request in requests:
        ticket, method, job = unpacked(request)
        started = time.perf_counter()
        made, error = make(machine, method, job)
        answer: Answer = (ticket, made, error, time.perf_counter() - started)
        answers.write(packed(answer) + b"\n")
        answers.flush()


if __name__ == "__main__":
    main()
