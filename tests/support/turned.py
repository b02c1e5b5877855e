"""A daemon that goes round in a thread of its own."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from tilth.logger.daemon import Daemon


@contextmanager
def turning(daemon: Daemon) -> Iterator[Daemon]:
    """The daemon, going round until this ends."""
    stop = threading.Event()

    def turn() -> None:
        while not stop.is_set():
            daemon.turn(0.01)
        daemon.close()

    thread = threading.Thread(target=turn)
    thread.start()
    try:
        yield daemon
    finally:
        stop.set()
        thread.join()
