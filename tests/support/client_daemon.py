"""A daemon as a client hears it: the daemon's own Zenoh sink in a process of its own, to order.

`Publisher` starts it; it publishes ten estimates a second, or what it is told. `Way` is a network that can
be cut and can stall.
"""

import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from loopback import PATIENCE_S, TEXT
from ordered import Ordered, ready, take_orders

from tilth.logger.zenoh.sink import ZenohSink
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import PARAMETERS, Estimate, Event, ParameterEstimate, Status
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.notices import in_words
from tilth.schemas.reasons import Code, Reason

NAME = "jd7930-parker500"
THETA = (200e3, 450e3, 150e3, 0.8, 1.1, 0.7)
LOG_SD = 0.1
EVERY_S = 0.1
RULE = Reason(Code.FIRST_WITH_NUMBERS, ("pem", "pem"))
NOTHING = (ParameterEstimate(None, None, Status.ESTIMATED, None),) * 6  # as another version might send it


def estimate(t_ns: int = 1, scale: float = 1.0, **changes: Any) -> Estimate:
    """All six estimated, sd 10 %."""
    covariance = [0.0] * 36
    covariance[::7] = [LOG_SD**2] * 6
    rows = tuple(
        ParameterEstimate(value * scale, value * scale * LOG_SD, Status.ESTIMATED, None, 0.5)
        for value in THETA
    )
    fields: dict[str, Any] = {
        "t_ns": t_ns, "method": "pem", "model": "relaxation", "parameters": rows,
        "log_covariance": tuple(covariance), "per_mass": (None,) * 3, "rule": RULE,
    }  # fmt: skip
    return Estimate(**(fields | changes))


def encoded(result: Estimate) -> bytes:
    return CHANNEL["/soil_tire"].encode(result)


def text_on(port: int) -> str:
    return TEXT.replace('prefix = "tilth"', f'prefix = "tilth"\nlisten = ["tcp/127.0.0.1:{port}"]')


class Publisher(Ordered):
    """Its orders: scale of the stiffnesses, an event, silence, estimates that give no numbers."""

    def __init__(self, port: int | None = None, suffix: str = "") -> None:
        super().__init__(__file__, port, suffix)


class Way:
    """A TCP connection through this process: forwards to a port, until it is told to stall or is cut."""

    def __init__(self, to: int) -> None:
        self._to = to
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self.open = threading.Event()  # what is sent goes through
        self.open.set()
        self._cut = False
        self._ends: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        self._cut = True
        for end in self._ends:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        self._ends.clear()

    def restore(self) -> None:
        self._cut = False

    def close(self) -> None:
        self.cut()
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                if self._cut:
                    near.close()
                    continue
                try:
                    far = socket.create_connection(("127.0.0.1", self._to))
                except OSError:
                    near.close()
                    continue
                self._ends += [near, far]
                for a, b in ((near, far), (far, near)):
                    threading.Thread(target=self._forward, args=(a, b), daemon=True).start()

    def _forward(self, near: socket.socket, far: socket.socket) -> None:
        with suppress(OSError), near, far:
            while data := near.recv(65536):
                self.open.wait()
                far.sendall(data)


def until(condition: Callable[[], bool], seconds: float = PATIENCE_S) -> None:
    """Fails where it never is so."""
    deadline = time.monotonic() + seconds
    tick = threading.Event()
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        tick.wait(0.01)


def main() -> None:
    port, suffix = int(sys.argv[1]), sys.argv[2]
    sink = ZenohSink(parse_machine(text_on(port)), suffix)
    orders: dict[str, Any] = {"scale": 1.0, "silent": False, "event": "", "absent": False}
    ended = take_orders(orders)
    start_ns = 1_790_000_000_000_000_000 - time.monotonic_ns()
    ready()
    while not ended.wait(EVERY_S):
        t_ns = start_ns + time.monotonic_ns()
        if not orders["silent"]:
            result = {"parameters": NOTHING} if orders["absent"] else {}
            sink.put("/soil_tire", encoded(estimate(t_ns, orders["scale"], **result)))
        if orders["event"]:
            event = Event(t_ns, orders["event"], in_words("the soil is another"))
            sink.put("/event", CHANNEL["/event"].encode(event))
            orders["event"] = ""
    sink.close()


if __name__ == "__main__":
    assert len(PARAMETERS) == len(THETA)
    main()
