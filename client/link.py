"""A Zenoh session that hears one daemon: it opens at once, and connects as soon and as often as it can. And
who lives at its other end."""

import atexit
import json
import logging
import queue
import re
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import zenoh

from tilth.schemas.invocation import command

ENDPOINT: Final = "tcp/127.0.0.1:7447"
_ENDPOINT: Final = re.compile(r"[a-z-]+/.")
_NAME: Final = re.compile(r"[A-Za-z0-9_.-]+")
_RETRY: Final = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2.0}
_ENDING_S: Final = 10.0  # longest wait for a thread whose session was closed; on a busy computer not at once
_LOGGER: Final = logging.getLogger(__name__)

T = TypeVar("T")


def base_key(machine: str, prefix: str, replay: bool) -> str:
    """What every key of a machine begins with. Raises ValueError."""
    if not _NAME.fullmatch(machine):
        raise ValueError(f"machine = {machine!r}: give its name in the machine file, like jd7930-parker500")
    if not all(map(_NAME.fullmatch, prefix.split("/"))):
        raise ValueError(f"prefix = {prefix!r}: give the prefix in the machine file, such as tilth")
    return "/".join((prefix, machine, *(("replay",) if replay else ())))


def open_session(endpoint: str = ENDPOINT, config: Path | None = None) -> zenoh.Session:
    """config: a Zenoh configuration file instead (certificates, several routers); endpoint is not used then.

    A daemon that is not there yet is no error. Raises ValueError in a person's words.
    """
    if config is None and not _ENDPOINT.match(endpoint):
        raise ValueError(f"{endpoint}: not an endpoint; one looks like {ENDPOINT}")
    try:
        if config is not None:
            return zenoh.open(zenoh.Config.from_file(str(config)))
        settings = zenoh.Config()
        for key, value in (
            ("mode", "peer"),
            ("scouting/multicast/enabled", False),
            ("scouting/gossip/enabled", False),
            ("listen/endpoints", []),
            ("connect/endpoints", [endpoint]),
            ("connect/timeout_ms", -1),  # try as long as it lives …
            ("connect/exit_on_failure", False),  # … behind the back of who opens it
            ("connect/retry", _RETRY),
        ):
            settings.insert_json5(key, json.dumps(value))
        return zenoh.open(settings)
    except zenoh.ZError as error:
        why = str(error).partition("\n")[0].partition(" at /")[0].rstrip(" .;")
        if config is not None:
            raise ValueError(
                f"{config}: {why}; give a Zenoh configuration, or a key of `{command('keys')}`"
            ) from None
        raise ValueError(f"{endpoint}: {why}; an endpoint looks like {ENDPOINT}") from None


class Link:
    """A session and the threads that hear over it. It ends at the latest with the program."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []
        self._closed = False
        atexit.register(self.close)  # before Python is taken down under its threads

    def hear(self, come: Iterable[T], take: Callable[[T], None]) -> None:
        """Hand over each that comes to a subscriber or as an answer, in a thread of its own.

        Callbacks of Zenoh's run in threads that keep a program from ending; these do not.
        """
        thread = threading.Thread(target=_take_each, args=(come, take), name="tilth.hear", daemon=True)
        with self._lock:
            if self._closed:  # nobody would wait for a thread that begins now
                return
            self._threads = [*filter(threading.Thread.is_alive, self._threads), thread]
            thread.start()

    def close(self) -> None:
        """Close the session, which ends its threads; wait for them, but not for the caller's own.

        A thread that is within Zenoh while Python is taken down would take the whole process with it.
        """
        atexit.unregister(self.close)
        with self._lock:
            self._closed = True
            threads = [thread for thread in self._threads if thread is not threading.current_thread()]
        self.session.close()
        for thread in threads:
            thread.join(_ENDING_S)


def _take_each(come: Iterable[T], take: Callable[[T], None]) -> None:
    for one in come:
        try:
            take(one)
        except Exception:  # whatever a stranger sent: what comes next must be heard
            _LOGGER.exception("what came over Zenoh could not be taken")


def first_heard(
    session: zenoh.Session, key: str, use: Callable[[zenoh.Sample], T | None], within_s: float
) -> T | None:
    """What `use` makes of the first sample on a key of which it makes something; None where none comes in
    time. A sample that it raises at counts as none."""
    found: queue.Queue[T] = queue.Queue()

    def take(sample: zenoh.Sample) -> None:
        with suppress(Exception):  # whatever a stranger sent
            if (made := use(sample)) is not None:
                found.put(made)

    subscriber = session.declare_subscriber(key, take)
    try:
        return found.get(timeout=within_s)
    except queue.Empty:
        return None
    finally:
        subscriber.undeclare()


class Alive(NamedTuple):
    """A daemon that lives. In order, those on a tractor come before replays and simulations."""

    replay: bool
    machine: str

    def base(self, prefix: str) -> str:
        """Key prefix of everything that this daemon publishes."""
        return base_key(self.machine, prefix, self.replay)


def tokens(prefix: str, machine: str = "") -> str:
    """The key expression of all tokens that say that a daemon lives, or of that machine's: who has a key of
    one machine may not ask for others."""
    return f"{prefix}/{machine}/**/alive" if machine else f"{prefix}/**/alive"


def alive_of(token: str, prefix: str) -> Alive | None:
    """Whose token this is; None where it is nobody's that can be followed."""
    match token.removeprefix(f"{prefix}/").split("/"):
        case [machine, "alive"] | [machine, "replay", "alive"] as parts if _NAME.fullmatch(machine):
            return Alive(len(parts) == 3, machine)
    return None


def living(session: zenoh.Session, prefix: str, machine: str = "") -> list[Alive]:
    """The daemons that are heard now."""
    replies = session.liveliness().get(tokens(prefix, machine))
    found = {alive_of(str(reply.ok.key_expr), prefix) for reply in replies if reply.ok}
    return sorted(one for one in found if one is not None)
