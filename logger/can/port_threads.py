"""Opens and closes ports in threads of their own: both may take seconds, or never end.

A serial adapter needs two seconds, a dead server ten. The loop asks here, goes on reading the other buses,
and takes up later what has come of it.
"""

import threading
from collections.abc import Callable, Iterator
from queue import SimpleQueue
from typing import NamedTuple

from tilth.logger.can.bus_opening import why_not
from tilth.logger.can.live_bus import LiveBus
from tilth.logger.can.port import Port, Tally
from tilth.logger.clock import Clock
from tilth.schemas.machine import Bus

Opener = Callable[[Bus, Clock, Tally], Port]


class Opened(NamedTuple):
    """What came of an attempt to open a bus: the port, or what its interface raised."""

    bus: LiveBus
    attempt: int
    result: Port | BaseException


class PortThreads:
    def __init__(self, opener: Opener, clock: Clock) -> None:
        self._opener = opener
        self._clock = clock
        self._opened: SimpleQueue[Opened] = SimpleQueue()
        self._not_closed: SimpleQueue[tuple[LiveBus, str]] = SimpleQueue()

    def open(self, bus: LiveBus, old: Port | None = None) -> None:
        """Begin to open it; old: to be closed before."""
        attempt = bus.connection.begin_attempt(self._clock.t_ns())
        self._start(bus, lambda: self._open(bus, attempt, old))

    def close(self, bus: LiveBus, port: Port) -> None:
        self._start(bus, lambda: self._close(bus, port))

    def opened(self) -> Iterator[Opened]:
        """What has come of attempts since the last call."""
        while not self._opened.empty():
            yield self._opened.get()

    def not_closed(self) -> Iterator[tuple[LiveBus, str]]:
        """Whose closing has failed since the last call, and why."""
        while not self._not_closed.empty():
            yield self._not_closed.get()

    def _start(self, bus: LiveBus, job: Callable[[], None]) -> None:
        thread = threading.Thread(target=job, name="tilth-bus", daemon=True)
        bus.connection.threads.append(thread)
        thread.start()

    def _open(self, bus: LiveBus, attempt: int, old: Port | None) -> None:
        """In a thread."""
        if old is not None:
            self._close(bus, old)
        try:
            self._opened.put(Opened(bus, attempt, self._opener(bus.config, self._clock, bus.tally)))
        except Exception as error:  # handed to the loop, which reports it
            self._opened.put(Opened(bus, attempt, error))

    def _close(self, bus: LiveBus, port: Port) -> None:
        """In a thread."""
        try:
            port.close()
        except Exception as error:  # a driver whose device is gone
            self._not_closed.put((bus, why_not(error, bus.config)))
