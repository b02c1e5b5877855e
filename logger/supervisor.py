"""Tells systemd how the daemon is, where systemd has started it: sd_notify(3), one datagram at a time.

The loop itself says that it lives, so one that hangs falls silent and is started anew. Nothing here waits,
and nothing here can end a run.
"""

import contextlib
import os
import socket
from collections.abc import Mapping, MutableMapping

PER_PERIOD = 4  # times that the loop says so in the period that systemd waits for it


class Supervisor:
    """Says nothing where there is nobody to hear. `failures`: datagrams that could not be delivered."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        """environment: NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID, as systemd sets them."""
        self.failures = 0
        self._address = _address(environment.get("NOTIFY_SOCKET", ""))
        self._socket: socket.socket | None = None
        if self._address is not None:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
        self._period_ns = _watchdog_us(environment) * 1000 // PER_PERIOD
        self._next_ns = 0
        self._ready = False

    def turned(self, t_ns: int) -> None:
        """The loop has come round."""
        if not self._ready:
            self._ready = self._tell("READY=1")
        if self._period_ns and t_ns >= self._next_ns:
            self._next_ns = t_ns + self._period_ns
            self._tell("WATCHDOG=1")

    def status(self, text: str) -> None:
        """One line for `systemctl status`."""
        self._tell("STATUS=" + " ".join(text.split()))

    def stopping(self) -> None:
        self._tell("STOPPING=1")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _tell(self, text: str) -> bool:
        """Whether it was delivered, or nobody wants to know."""
        if self._socket is None or self._address is None:
            return True
        try:
            self._socket.sendto(text.encode(), self._address)
        except OSError:
            self.failures += 1
            return False
        return True


def of_environment(environment: MutableMapping[str, str]) -> Supervisor:
    """systemd's, if it is there, and not for the processes that this one starts."""
    supervisor = Supervisor(environment)
    for name in ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"):
        environment.pop(name, None)
    return supervisor


def _address(setting: str) -> str | None:
    """A path, or a name in the abstract namespace, told with an @."""
    if setting.startswith("@"):
        return "\0" + setting[1:]
    return setting if setting.startswith("/") else None


def _watchdog_us(environment: Mapping[str, str]) -> int:
    """0 where none is wanted, or another process's is."""
    if environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return 0
    with contextlib.suppress(ValueError):
        return max(0, int(environment.get("WATCHDOG_USEC", "0")))
    return 0
