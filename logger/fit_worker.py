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
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import partial
from typing import IO, Any, Final, get_type_hints

import numpy as np
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
    found = hashlib.sha256(machine.model_dump_json().encode())
    for part in _parts(job):
        found.update(part)
    return found.hexdigest()


def _parts(value: Any) -> Iterator[bytes]:
    """The bytes of data of dataclasses, lists and arrays; megabytes in milliseconds, since the loop waits."""
    if isinstance(value, np.ndarray):
        yield repr((value.shape, value.dtype.str)).encode()
        yield value.tobytes()
    elif is_dataclass(value) or isinstance(value, list):
        inner = value if isinstance(value, list) else (getattr(value, one.name) for one in fields(value))
        yield b"("
        for one in inner:
            yield from _parts(one)
        yield b")"
    else:
        yield repr(value).encode()


def in_order(machine: Machine) -> list[Fitting]:
    """What is to be compiled, first what is asked for soonest: rows tell nothing before two minutes."""
    fitted = [row.fitting for row in rows_for(machine) if row.fitting is not None]
    return sorted(fitted, key=lambda fitting: fitting.latency_ns)


def rehearse(uncompiled: list[Callable[[], None]]) -> None:
    """Compile the first of what is left of `rehearsals`."""
    with contextlib.suppress(Exception):  # what fails here fails at the fit, where it is told
        uncompiled.pop(0)()


def rehearsals(machine: Machine) -> list[Callable[[], None]]:
    """What compiles all that fits need: first what no other process begins with."""
    fits = in_order(machine)
    return [*(one.rehearse_alone for one in fits), *(partial(one.rehearse, machine) for one in fits)]


def _listen(requests: IO[bytes], waiting: queue.SimpleQueue[bytes | None]) -> None:
    for request in requests:
        waiting.put(request)
    waiting.put(None)


def main() -> None:
    """Answer jobs from stdin on stdout until stdin ends and all is compiled."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not stand among the answers
    requests = os.fdopen(os.dup(0), "rb")
    machine = unpacked(requests.readline())
    waiting = queue.SimpleQueue[bytes | None]()
    threading.Thread(target=_listen, args=(requests, waiting), daemon=True).start()
    uncompiled = rehearsals(machine)
    while True:
        while uncompiled and waiting.empty():  # a fit that is asked for goes before
            rehearse(uncompiled)
        if (request := waiting.get()) is None:
            break
        ticket, method, job = unpacked(request)
        started = time.perf_counter()
        made, error = make(machine, method, job)
        answer: Answer = (ticket, made, error, time.perf_counter() - started)
        answers.write(packed(answer) + b"\n")
        answers.flush()
    while uncompiled:
        rehearse(uncompiled)


if __name__ == "__main__":
    main()
