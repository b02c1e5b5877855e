"""The virtual tractor in real time on a CAN bus over TCP: sends its sensors, steers by who commands.

`main` is a process of its own, as that of socketcand_server: it reads one JSON line (machine_text, seed,
seconds, scenario, listeners), answers with the port, drives from when so many clients listen, and tells lines
of JSON: where the implement is, ten times a second, and at the end what became of the commands. It ends early
at the next line, or when its input is closed.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import BinaryIO, Final

from tilth.logger.clock import Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.drive import drive
from tilth.simulator.scenario import STEP_S, Scenario, from_json
from tilth.simulator.socketcand_server import START_DELAY_NS, TICK_S, SocketcandServer, open_server, tell
from tilth.simulator.steered_rig import LiveDriver
from tilth.simulator.steering import REFUSALS
from tilth.simulator.tractor import COMPILED_FROM, Setting

BEHIND_NS: Final = 200_000_000  # later than this against the clock, the run is told to be late
TELL_S: Final = 0.1

Tell = Callable[[dict[str, object]], None]


class RunStopped(Exception):
    """Somebody wants the run to end."""


@dataclass(slots=True)
class RealTime:
    """The exchange of a LiveDriver: waits until it is time, and lets the bus have what has been sent."""

    server: SocketcandServer
    clock: Clock
    start_ns: int
    bus: str
    orders: BinaryIO
    tell: Tell
    driver: LiveDriver | None = None
    sent: int = 0
    late: int = 0  # steps that were behind the clock
    _next_report_s: float = 0.0

    def __call__(self, now: float, frames: list[Frame]) -> list[tuple[int, bytes]]:
        due_ns = self.start_ns + round(now * 1e9)
        self.late += self.clock.t_ns() - due_ns > BEHIND_NS
        while True:
            remaining_s = (due_ns - self.clock.t_ns()) * 1e-9
            if self.server.serve(min(max(remaining_s, 0.0), TICK_S), self.orders):
                raise RunStopped
            if remaining_s <= 0.0:
                break
        self.server.send(frames)
        self.sent += len(frames)
        received, self.server.received = self.server.received, []
        for one in received:
            t_ns = self.clock.t_ns()
            frame = Frame(t_ns, t_ns, self.bus, one.can_id, one.extended, False, one.data)
            self.server.send([frame], one.by)
        if self.driver is not None and now >= self._next_report_s:
            self._next_report_s += TELL_S
            self.tell({"at_s": round(now, 3), "implement": [round(v, 4) for v in self.driver.implement()]})
        return [(one.can_id, one.data) for one in received if one.extended]

    def commands(self) -> dict[str, object]:
        """What became of the commands so far; refusals in a person's words."""
        if self.driver is None:
            return {}
        ecu = self.driver.steering
        refused = {REFUSALS[reason]: count for reason, count in sorted(ecu.refused.items())}
        return {
            "commands": ecu.taken,
            "refused": refused,
            "let_go": ecu.let_go,
            "no_frame": self.server.refused,
        }


def drive_live(
    server: SocketcandServer,
    machine: Machine,
    seed: int,
    seconds: float,
    scenario: Scenario,
    orders: BinaryIO,
    tell: Tell,
) -> None:
    """Drive in real time until the end or until an order comes."""
    clock = Clock()
    start_ns = (clock.t_ns() + START_DELAY_NS) // 10_000_000 * 10_000_000
    wires = RealTime(server, clock, start_ns, machine.bus[0].name, orders, tell)

    def driver(setting: Setting) -> LiveDriver:
        wires.driver = LiveDriver(machine, setting, wires)
        return wires.driver

    stopped = False
    try:
        scenario = replace(scenario, utc_start_ns=start_ns, clock_offset_s=0.0)
        drive(machine, seed, seconds, scenario, driven_by=driver)
    except RunStopped:
        stopped = True
    tell({"sent": wires.sent, "late": wires.late, "stopped": stopped, **wires.commands()})


def main() -> None:
    with open(0, "rb", buffering=0) as orders:  # unbuffered: select() must see what readline() has not read
        order = json.loads(orders.readline())
        machine, server = parse_machine(order["machine_text"]), open_server()
        scenario = from_json(order["scenario"])
        if order["seconds"] >= COMPILED_FROM * STEP_S:  # or its first seconds would be late for the compiler
            drive(machine, order["seed"], COMPILED_FROM * STEP_S)
        tell({"port": server.port})
        while len(server.listening()) < order["listeners"]:
            if server.serve(0.02, orders):
                return
        drive_live(server, machine, order["seed"], order["seconds"], scenario, orders, tell)
        while not (server.serve(1.0, orders) and orders.readline() == b""):
            continue


if __name__ == "__main__":
    main()
