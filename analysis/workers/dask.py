"""Parts of work on a Dask cluster: what parts.here does on this computer, with the same results.

A worker that dies costs the parts it had: Dask gives them to another. One that hangs holds a part, or its
result; after a while the same part is asked of another worker too, and whichever answers first counts.
"""

import re
import ssl
import time
from asyncio import CancelledError
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

from tilth.analysis.workers.parts import LOST, Found, LostPart, Parts
from tilth.schemas.invocation import installing
from tilth.schemas.limiter import is_this_computer
from tilth.schemas.readable import reason_of

ANSWER_S: Final = 10.0  # how long a scheduler, and a first worker, are waited for
SLOW: Final = 5.0  # times what half of the parts took at most: then another worker is asked too
HUNG_S: Final = 60.0  # and not before
AHEAD: Final = 3  # parts asked for at once, for each thread of a worker
TRIES: Final = 5  # workers that may die over one part
GONE: Final = (OSError, TimeoutError, CancelledError)  # Dask's own errors of lost connections are OSErrors
PACKAGES: Final = ("tilth", "numpy", "numba")


class Certificates(NamedTuple):
    """Files, PEM: of the authority that both ends trust, and of this end."""

    ca: str
    certificate: str
    key: str


class DaskProblem(LostPart):
    """No part can be computed there; one sentence that says what to do."""


def on_dask(address: str, certificates: Certificates | None = None, *, hung_s: float = HUNG_S) -> Parts:
    """address: of the scheduler, tcp://host:8786, or tls://host:8786 with certificates. hung_s: after which
    a worker hangs, where parts do not take longer. Raises DaskProblem when it is used."""
    return partial(_on_dask, address, certificates, hung_s)


def caution(address: str) -> str:
    """What a person should know before that scheduler is used; "" where nothing is to be said."""
    protocol, _, rest = address.partition("://")
    host = rest.rpartition(":")[0].strip("[]")
    if protocol == "tls" or host == "localhost" or is_this_computer(host):
        return ""
    return (
        f"{address} is neither encrypted nor guarded: whoever reaches it runs what they like on all its "
        "computers; use certificates (--dask-tls), or a network that is yours alone"
    )


def versions() -> dict[str, str]:
    """What must be the same here and on all workers."""
    return {name: version(name) for name in PACKAGES}


def check_versions(here: dict[str, str], workers: dict[str, dict[str, str]]) -> None:
    """workers: address -> its versions. Raises DaskProblem where some differ."""
    for address, there in sorted(workers.items()):
        for name, wanted in here.items():
            if there.get(name) != wanted:
                raise DaskProblem(
                    f"the worker {address} has {name} {there.get(name, 'of no version')}, here is {wanted}: "
                    "install the same on all, then start the workers again; nothing was computed"
                )


def _on_dask(
    address: str,
    certificates: Certificates | None,
    hung_s: float,
    part: Callable[[Any], bytes],
    items: Sequence[Any],
) -> Found[Any]:
    if not items:
        return
    if re.fullmatch(r"\w+://\S+:\d+", address) is None:
        raise DaskProblem(f"{address} is no address of a Dask scheduler; give one such as tcp://host:8786")
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise DaskProblem(f"--dask needs one package more: {installing('dask')}") from None
    security = _security(distributed, address, certificates)
    try:
        client = distributed.Client(address, timeout=ANSWER_S, set_as_default=False, security=security)
    except (OSError, ValueError) as error:
        raise DaskProblem(
            f"no Dask scheduler answers at {address} ({type(error).__name__}): `dask scheduler --host "
            "127.0.0.1` starts one, and `dask worker ADDRESS` each worker"
            + ("; do its certificates and these have one authority?" if certificates else "")
        ) from None
    try:
        _check(client, address)
        yield from _computed(distributed, client, part, items, hung_s)
    except GONE as error:
        raise DaskProblem(
            f"the cluster at {address} is gone ({type(error).__name__}); what was finished is kept: start "
            "it, and give the same command again"
        ) from None
    finally:
        client.close(timeout=2.0)


def _security(distributed: Any, address: str, certificates: Certificates | None) -> Any:
    """None without certificates. Raises DaskProblem."""
    if (certificates is not None) != address.startswith("tls://"):
        raise DaskProblem(
            f"{address} and certificates do not fit: tls://host:8786 needs --dask-tls, and only that takes it"
        )
    if certificates is None:
        return None
    context = ssl.create_default_context()
    try:
        for path in certificates:
            Path(path).open("rb").close()  # an error of the next ones names no file
        context.load_verify_locations(certificates.ca)
        context.load_cert_chain(certificates.certificate, certificates.key)
    except OSError as error:  # of what is no PEM too
        name = error.filename or ", ".join(certificates)
        wanted = "give CA, certificate and key, as PEM files"
        raise DaskProblem(f"--dask-tls {name}: {reason_of(error)}; {wanted}") from None
    return distributed.Security(
        require_encryption=True, tls_ca_file=certificates.ca,
        tls_client_cert=certificates.certificate, tls_client_key=certificates.key,
    )  # fmt: skip


def _check(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=ANSWER_S)
    except TimeoutError:
        raise DaskProblem(
            f"the scheduler at {address} has no worker: `dask worker {address}` starts one"
        ) from None
    try:
        there = client.run(versions, on_error="return")
    except Exception as error:
        raise DaskProblem(f"the workers of {address} do not answer: {error}") from None
    for worker, found in sorted(there.items()):
        if isinstance(found, Exception):
            raise DaskProblem(
                f"the worker {worker} has no tilth that fits this one ({found}): install the same on all, "
                "then start the workers again; nothing was computed"
            )
    check_versions(versions(), there)


class _Asked:
    """Parts that are asked for, and the workers that did not answer: others are asked then."""

    def __init__(self, client: Any, part: Callable[[Any], bytes]) -> None:
        self._client, self._part = client, part
        self.asked: dict[Any, tuple[Any, float]] = {}  # future -> its item, when it was asked for
        self._silent: set[str] = set()

    @property
    def wanted(self) -> int:
        """How many are asked for at once."""
        threads: int = sum(self._client.nthreads().values())
        return AHEAD * max(threads, 1)

    def ask(self, item: Any) -> None:
        answering = [worker for worker in self._client.nthreads() if worker not in self._silent]
        future = self._client.submit(self._part, item, pure=False, retries=TRIES, workers=answering or None)
        self.asked[future] = (item, time.monotonic())

    def ask_another(self, future: Any, item: Any) -> None:
        """The workers that have it, or its result, are asked for nothing new."""
        holding = self._client.who_has([future]).get(future.key, ())
        working = self._client.processing().items()
        self._silent.update(holding or [worker for worker, keys in working if future.key in keys])
        self.ask(item)

    def repeat_late(self, late_s: float, open_ones: set[Any]) -> None:
        """Ask again for what has taken longer, once for each; give up what is no longer wanted."""
        for future, (item, since) in list(self.asked.items()):
            if item not in open_ones:
                del self.asked[future]
                self._client.cancel([future])
            elif time.monotonic() - since > late_s:
                self.asked[future] = (item, time.monotonic())
                self.ask_another(future, item)


def _computed(
    distributed: Any, client: Any, part: Callable[[Any], bytes], items: Sequence[Any], hung_s: float
) -> Found[Any]:
    asked = _Asked(client, part)
    open_ones = set(items)
    took_s: list[float] = []
    waiting = iter(items)
    while open_ones:
        for _ in range(asked.wanted - len(asked.asked)):
            item = next(waiting, None)
            if item is None:
                break
            asked.ask(item)
        try:
            with client.as_current():
                done = distributed.wait(
                    list(asked.asked), timeout=min(hung_s, 1.0), return_when="FIRST_COMPLETED"
                ).done
        except TimeoutError:
            done = set()
        for future in done:
            item, since = asked.asked.pop(future)
            if item not in open_ones:
                continue
            found = _result(distributed, future, hung_s)
            if found is None:
                asked.ask_another(future, item)
                continue
            took_s.append(time.monotonic() - since)
            open_ones.discard(item)
            yield item, found
        asked.repeat_late(max(hung_s, SLOW * median(took_s or [0.0])), open_ones)


def _result(distributed: Any, future: Any, within_s: float) -> bytes | LostPart | None:
    """None where the worker that computed it does not hand it over."""
    try:
        found: bytes = future.result(timeout=within_s)
    except TimeoutError:
        return None
    except GONE:
        raise
    except distributed.KilledWorker:
        return LostPart(LOST)
    except Exception as error:
        raise DaskProblem(
            f"a part could not be computed by the workers ({type(error).__name__}: {error}); what was "
            "finished is kept: give the same command again"
        ) from None
    return found
