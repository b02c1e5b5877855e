"""The interface of an open bus, and its implementation by python-can."""

import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import can

from tilth.logger.can import receive_buffer
from tilth.logger.can.can_errors import Health
from tilth.logger.clock import Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus


class StampedBy(StrEnum):
    """Whose clock gave a frame its rx_ns, best first; the words are those of tilth.BusStatus."""

    ADAPTER = "adapter"
    KERNEL = "kernel"
    DRIVER = "driver"
    COMPUTER = "computer"


STAMPED: Mapping[StampedBy, str] = {
    StampedBy.ADAPTER: "the adapter, by its own clock",
    StampedBy.KERNEL: "the kernel, on arrival",
    StampedBy.DRIVER: "the driver behind python-can",
    StampedBy.COMPUTER: "this program, as it reads them",
}
_BY_KERNEL = ("mavlink", "socketcan", "udp_multicast")  # of python-can's
ID_BITS = 0x1FFF_FFFF


@dataclass(slots=True)
class Tally:
    """Counts of one bus besides its usable frames; kept from one opening to the next."""

    error_frames: int = 0
    remote_frames: int = 0
    fd_frames: int = 0
    garbled: int = 0  # pieces that are no frame
    health: Health = field(default_factory=Health)


class Port(Protocol):
    """An open bus. Any method may raise what its device raises."""

    @property
    def descriptor(self) -> int | None:
        """File descriptor for a selector; None where the port must be polled."""
        ...

    @property
    def stamp(self) -> StampedBy:
        """Whose clock stamped the frames taken last."""
        ...

    @property
    def renewable(self) -> bool:
        """Whether opening it afresh may wake one that has gone silent."""
        ...

    @property
    def note(self) -> str:
        """A remark on how the interface is set up; "" where there is none."""
        ...

    @property
    def problem(self) -> str:
        """What is wrong with the interface at present; "" where nothing is."""
        ...

    def take(self, frames: list[Frame], most: int) -> int:
        """Append the frames that have arrived; does not wait.

        Returns the number of frames of any kind, `most` or more where others may be waiting. Raises what the
        device raises, after the frames that came before it.
        """
        ...

    def ask(self, t_ns: int) -> None:
        """Called about once a second: query what the device reports only on request."""

    def lost(self) -> int:
        """Frames since the opening that the kernel has dropped because nobody took them; of an autopilot its
        messages, of any kind, that were lost on the way."""
        ...

    def close(self) -> None:
        """May take long: not for the loop."""


class LibraryPort:
    """A python-can bus."""

    problem = ""
    renewable = True

    def __init__(self, bus: can.BusABC, config: Bus, clock: Clock, tally: Tally) -> None:
        self.bus = bus
        self.note = ""
        self.stamp = StampedBy.KERNEL if config.interface in _BY_KERNEL else StampedBy.DRIVER
        self._name = config.name
        self._clock = clock
        self._tally = tally
        self._empty_ns = clock.t_ns()
        self.descriptor = _descriptor(bus)
        # A second handle on its socket, where there is one.
        self._socket = None if self.descriptor is None else receive_buffer.socket_of(self.descriptor)
        if self._socket is not None:
            receive_buffer.enlarge(self._socket)

    def take(self, frames: list[Frame], most: int) -> int:
        receive, clock, tally, name = self.bus.recv, self._clock, self._tally, self._name
        ahead_ns = clock.wall_ahead_ns()
        for count in range(most):
            message = receive(0)
            if message is None:
                self._empty_ns = clock.t_ns()
                return count
            if message.is_remote_frame or message.is_fd:
                tally.remote_frames += message.is_remote_frame
                tally.fd_frames += message.is_fd and not message.is_remote_frame
                continue
            t_ns = clock.t_ns()
            rx_ns = clock.rx_ns(int(message.timestamp * 1e9) - ahead_ns, t_ns, self._empty_ns)
            identifier, extended, data = message.arbitration_id, message.is_extended_id, bytes(message.data)
            error = message.is_error_frame
            if error:
                tally.error_frames += 1
                tally.health.hear(t_ns, identifier, data)
            frames.append(Frame(t_ns, rx_ns, name, identifier, extended, error, data))
        return most

    def ask(self, t_ns: int) -> None:
        return

    def lost(self) -> int:
        if self._socket is not None:
            return receive_buffer.dropped(self._socket)
        return int(getattr(self.bus, "messages_lost", 0))

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self.bus.shutdown()


def _descriptor(bus: can.BusABC) -> int | None:
    try:
        descriptor = bus.fileno()
    except NotImplementedError:
        # The socketcand bus keeps its socket to itself; there is only the one.
        sockets = [value for value in vars(bus).values() if isinstance(value, socket.socket)]
        descriptor = sockets[0].fileno() if len(sockets) == 1 else -1
    return descriptor if descriptor >= 0 else None
