"""The process that makes fits, started by logger/fitting.py.

Its parent tells it the machine and then jobs, each in a line; it answers each job with one.
"""

import contextlib
import hashlib
import json
import os
import queue
import threading
import time
from typing import IO, Any, Final, get_type_hints

from threadpoolctl import threadpool_limits

from tilth.estimator.methods.estimators import ROW, Fitting, rows_for
from tilth.estimator.state_json import from_json_data, to_json_data
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


def as_text(made: Any) -> str:
    """A result as JSON, for the log."""
    return json.dumps(to_json_data(made), separators=(",", ":"))


def of_text(method: str, text: str) -> Any:
    """The result that `as_text` wrote. Raises ValueError, also for one of another version."""
    fitting = ROW[method].fitting
    assert fitting is not None
    return from_json_data(get_type_hints(fitting.fit)["return"], json.loads(text))


def job_sha256(machine: Machine, job: Any) -> str:
    """Of all that a result depends on, besides the code and the arithmetic of the computer."""
    made_of = json.dumps([machine.model_dump(mode="json"), to_json_data(job)])
    return hashlib.sha256(made_of.encode()).hexdigest()


def rehearse(fitting: Fitting, machine: Machine) -> None:
    """Compile what fits of a method need."""
    with contextlib.suppress(Exception):  # what fails here fails at the fit, where it is told
        fitting.rehearse(machine)


def in_order(machine: Machine) -> list[Fitting]:
    """What is to be compiled, first what is asked for soonest: rows tell nothing before two minutes."""
    fitted = [row.fitting for row in rows_for(machine) if row.fitting is not None]
    return sorted(fitted, key=lambda fitting: fitting.latency_ns)


def _listen(requests: IO[bytes], waiting: queue.SimpleQueue[bytes | None]) -> None:
    for request in requests:
        waiting.put(request)
    waiting.put(None)


def main() -> None:
    """Answer jobs from stdin on stdout until stdin ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not stand among the answers
    requests = os.fdopen(os.dup(0), "rb")
    machine = unpacked(requests.readline())
    waiting = queue.SimpleQueue[bytes | None]()
    threading.Thread(target=_listen, args=(requests, waiting), daemon=True).start()
    uncompiled = in_order(machine)
    while True:
        while uncompiled and waiting.empty():  # a fit that is asked for goes before
            rehearse(uncompiled.pop(0), machine)
        if (request := waiting.get()) is None:
            return
        ticket, method, job = unpacked(request)
        started = time.perf_counter()
        made, error = make(machine, method, job)
        answer: Answer = (ticket, made, error, time.perf_counter() - started)
        answers.write(packed(answer) + b"\n")
        answers.flush()


if __name__ == "__main__":
    main()
