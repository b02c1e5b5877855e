"""A test's own process that obeys: its orders are JSON lines on stdin, and it ends when that is closed."""

import json
import socket
import subprocess
import sys
import threading
from types import TracebackType
from typing import Any, Self

from loopback import PATIENCE_S, free_port


class Ordered:
    """`python FILE PORT WORD…`, which speaks Zenoh at that port."""

    def __init__(self, file: str, port: int | None, *words: str) -> None:
        """Returns when it is ready."""
        self.port = port or free_port(socket.SOCK_STREAM)
        self.endpoint = f"tcp/127.0.0.1:{self.port}"
        self.process = subprocess.Popen(
            [sys.executable, file, str(self.port), *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n"

    def order(self, **orders: Any) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(orders) + "\n")
        self.process.stdin.flush()

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self.process.stdout is not None
        if not self.process.stdout.closed:  # else `kill` has seen to it
            self.process.communicate(timeout=PATIENCE_S)


def take_orders(orders: dict[str, Any]) -> threading.Event:
    """In the process: keeps what is ordered up to date. Set when there are no more."""
    ended = threading.Event()

    def read() -> None:
        for line in sys.stdin:
            orders.update(json.loads(line))
        ended.set()

    threading.Thread(target=read, daemon=True).start()
    return ended


def ready() -> None:
    print("ready", flush=True)  # noqa: T201
