"""A CAN bus over TCP on this computer: plays frames in real time to every client, in socketcand's words.

So a whole rig can be tried with no CAN hardware, no privilege and no network beyond loopback. `main` is a
process of its own: it reads one JSON line (machine_text, seed, seconds), drives the tractor, answers with the
port, begins when the first client listens, plays until the end or until the next line, says how many frames
it has sent, and ends when its input is closed, so that it cannot outlive whoever started it.
"""

import json
import select
import socket
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import BinaryIO, Final

from tilth.logger.clock import Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.drive import drive
from tilth.simulator.scenario import from_json
from tilth.simulator.tractor import Truth
from tilth.simulator.traffic import traffic

TICK_S: Final = 0.001  # frames that are due are sent this often
SETTLE_S: Final = 0.05  # python-can wants the answer to "rawmode" alone in one packet
SEND_TIMEOUT_S: Final = 10.0
LONGEST: Final = 4096  # bytes of a client's words; who never ends one is dropped
MOST_WAITING: Final = 1000  # frames of clients that nobody has taken yet
START_DELAY_NS: Final = 300_000_000  # in which the first ten seconds of traffic are made


@dataclass(slots=True)
class SocketcandClient:
    connection: socket.socket
    received: bytes = b""
    listens_from: float | None = None  # monotonic s


@dataclass(frozen=True, slots=True)
class Sending:
    """What a client puts on the bus."""

    can_id: int
    extended: bool
    data: bytes
    by: SocketcandClient


@dataclass(slots=True)
class SocketcandServer:
    """Clients of one bus. All calls come from one thread."""

    listener: socket.socket
    clients: list[SocketcandClient] = field(default_factory=list)
    received: list[Sending] = field(default_factory=list)  # for who owns the bus to take and to pass on
    refused: int = 0  # words of clients that are no frame

    @property
    def port(self) -> int:
        return int(self.listener.getsockname()[1])

    def serve(self, timeout_s: float, orders: BinaryIO) -> bool:
        """Answer clients for at most so long; True as soon as there are orders to read."""
        watched: list[socket.socket | BinaryIO] = [self.listener, orders]
        watched += [client.connection for client in self.clients]
        ready, _, _ = select.select(watched, [], [], timeout_s)
        if self.listener in ready:
            connection, _ = self.listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.settimeout(SEND_TIMEOUT_S)
            client = SocketcandClient(connection)
            self.clients.append(client)
            self._say(client, b"< hi >")
        for client in [client for client in self.clients if client.connection in ready]:
            self._hear(client)
        return orders in ready

    def listening(self) -> list[SocketcandClient]:
        now = time.monotonic()
        return [c for c in self.clients if c.listens_from is not None and c.listens_from <= now]

    def send(self, frames: list[Frame], by: SocketcandClient | None = None) -> None:
        """Send frames to every client that listens, but to the one that sent them; one that has gone, or
        stands still, is dropped."""
        if frames:
            text = b"".join(map(_frame_command, frames))
            for client in self.listening():
                if client is not by:
                    self._say(client, text)

    def close(self) -> None:
        for client in list(self.clients):
            self._drop(client)
        self.listener.close()

    def _hear(self, client: SocketcandClient) -> None:
        try:
            received = client.connection.recv(4096)
        except OSError:
            received = b""
        if not received:
            self._drop(client)
            return
        *commands, client.received = (client.received + received).split(b">")
        if len(client.received) > LONGEST:
            self._drop(client)
            return
        for command in commands:
            words = command.replace(b"<", b" ").split()
            if words[:1] in ([b"open"], [b"rawmode"]):
                self._say(client, b"< ok >")
            if words[:1] == [b"send"]:
                self._take(client, words[1:])
            if words[:1] == [b"rawmode"]:
                client.listens_from = time.monotonic() + SETTLE_S

    def _take(self, client: SocketcandClient, words: list[bytes]) -> None:
        """A frame in socketcand's words: identifier, length, and its bytes, all but the length in
        hexadecimal."""
        try:
            identifier, length, *values = words
            can_id, data = int(identifier, 16), bytes(int(value, 16) for value in values)
            extended = len(identifier) > 3
            if len(data) != int(length) or len(data) > 8 or not 0 <= can_id < (1 << (29 if extended else 11)):
                raise ValueError
        except ValueError:
            self.refused += 1
            return
        if len(self.received) < MOST_WAITING:
            self.received.append(Sending(can_id, extended, data, client))
        else:
            self.refused += 1

    def _say(self, client: SocketcandClient, text: bytes) -> None:
        try:
            client.connection.sendall(text)
        except OSError:
            self._drop(client)

    def _drop(self, client: SocketcandClient) -> None:
        if client in self.clients:
            client.connection.close()
            self.clients.remove(client)


def open_server() -> SocketcandServer:
    """A server on 127.0.0.1, on any free port."""
    return SocketcandServer(socket.create_server(("127.0.0.1", 0)))


def _frame_command(frame: Frame) -> bytes:
    can_id = f"{frame.can_id:08X}" if frame.extended else f"{frame.can_id:03X}"
    seconds, nanoseconds = divmod(frame.rx_ns, 1_000_000_000)
    text = f"< frame {can_id} {seconds}.{nanoseconds // 1000:06d} {frame.data.hex().upper()} >"
    return text.encode("ascii")


def play(server: SocketcandServer, frames: Iterator[Frame], clock: Clock, orders: BinaryIO) -> int:
    """Send each frame when its t_ns has come, until there are no more or an order comes; returns how many."""
    sent = 0
    due: list[Frame] = []
    for frame in frames:
        while frame.t_ns > clock.t_ns():
            server.send(due)
            sent += len(due)
            due.clear()
            if server.serve(TICK_S, orders):
                return sent
        due.append(frame)
    server.send(due)
    return sent + len(due)


def main() -> None:
    """The demo's second process."""
    with open(0, "rb", buffering=0) as orders:  # unbuffered: select() must see what readline() has not read
        order = json.loads(orders.readline())
        machine = parse_machine(order["machine_text"])
        scenario = replace(from_json(order["scenario"]), clock_offset_s=0.0)
        truth = drive(machine, order["seed"], order["seconds"], scenario)
        server = open_server()
        tell({"port": server.port})
        tell({"sent": _play_truth(server, machine, truth, orders)})
        while not (server.serve(1.0, orders) and orders.readline() == b""):
            continue


def _play_truth(server: SocketcandServer, machine: Machine, truth: Truth, orders: BinaryIO) -> int:
    """Play from the moment that somebody listens; how many frames."""
    while not server.listening():
        if server.serve(0.02, orders):
            return 0
    clock = Clock()
    start_ns = (clock.t_ns() + START_DELAY_NS) // 10_000_000 * 10_000_000
    begun = replace(truth, scenario=replace(truth.scenario, utc_start_ns=start_ns))
    return play(server, traffic(machine, begun), clock, orders)


def tell(fact: Mapping[str, object]) -> None:
    """Say it to the process that started this one, as a line of JSON."""
    sys.stdout.write(json.dumps(fact) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
