"""A driver who is prompted, in real time on the wires of a real rig: nothing here knows the plant.

virtual tractor ─CAN─► daemon ─Zenoh─► `tilth experiment` ─Zenoh─► the driver ─CAN─► the tractor's steering

The tractor and the prompter are processes of their own, the daemon is the caller's; the driver is a thread
with a Zenoh session of his own, as a page has it: he sees what is shown, hears poses, presses and steers.
"""

import json
import math
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final

import can
import numpy as np

from tilth.client.link import base_key, open_session
from tilth.client.received import pose_of
from tilth.estimator.models.nonlinear import STATES
from tilth.estimator.pose.geometry import to_degrees, to_plane
from tilth.logger.daemon import run_daemon
from tilth.logger.run_summary import RunSummary
from tilth.logger.zenoh.session import free_endpoint
from tilth.schemas.decode import encode, frames_of
from tilth.schemas.flow import Word
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.simulator.demo import on_loopback
from tilth.simulator.prompted_driver import ARM, Bar, Person, PromptedDriver
from tilth.simulator.scenario import Scenario, as_json
from tilth.simulator.steering import ADDRESS, COMMAND

TURN_S: Final = 0.05
SOURCE: Final = 0x1C
WHEELBASE: Final = 2.9
AT: Final = {name: k for k, name in enumerate(STATES)}
SILENT_S: Final = 2.0  # without anything shown nobody prompts any more


@dataclass(slots=True)
class Driver:
    """Hears and steers until `stop`. lane: as of PromptedDriver."""

    base: str
    endpoint: str
    port: int
    person: Person
    lane: tuple[float, float, float, float]
    seed: int
    arms: bool = True  # else somebody else does
    states: list[pb.ExperimentState] = field(default_factory=list)  # each time that something was new
    stopping: bool = False
    _state: pb.ExperimentState = field(default_factory=pb.ExperimentState)
    _shown_s: float = -math.inf
    _x: np.ndarray | None = None
    _origin: tuple[float, float] | None = None  # of the plane that the lane is in
    _angle: float = 0.0

    def run(self) -> None:
        with ExitStack() as stack:
            session = stack.enter_context(open_session(self.endpoint))
            bus = can.Bus(interface="socketcand", host="127.0.0.1", port=self.port, channel="can0")
            stack.callback(bus.shutdown)
            session.declare_subscriber(f"{self.base}/pose", self._take_pose)
            session.declare_subscriber(f"{self.base}/experiment", self._take_state)
            who, began = PromptedDriver(self.person, self.lane, self.seed), time.monotonic()
            sent_s = 0.0
            while not self.stopping:
                now = time.monotonic() - began
                while bus.recv(0.0) is not None:
                    pass
                x, bar = self._x, self._bar()
                wanted = 0.0
                if x is not None:
                    pressed = who.look(now, bar, x)
                    if pressed and (self.arms or pressed != ARM):
                        order = pb.ExperimentOrder(kind=pressed).SerializeToString()
                        list(session.get(f"{self.base}/experiment/order", payload=order, timeout=2.0))
                    wanted = who.hands(now, bar, x)
                most = self.person.rate * (now - sent_s) * 0.9
                self._angle += min(max(wanted - self._angle, -most), most)
                sent_s = now
                self._send(bus)
                time.sleep(TURN_S)

    def _send(self, bus: can.BusABC) -> None:
        words: dict[str, Word] = {
            "commanded_curvature_per_m": math.tan(self._angle) / WHEELBASE,
            "command_status": "intended",
        }
        for can_id, data in frames_of(COMMAND, encode(COMMAND, words), SOURCE, ADDRESS):
            bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=True), 0.2)

    def _bar(self) -> Bar:
        state = self._state if time.monotonic() - self._shown_s < SILENT_S else pb.ExperimentState()
        room = all(one.met for one in state.conditions if one.name == "room")
        return Bar(state.phase, state.wanted, state.speed, room)

    def _take_pose(self, sample: Any) -> None:
        pose = pose_of(sample.payload.to_bytes(), str(sample.encoding))
        body = pose.tractor
        if body.x is None or body.y is None or body.heading is None:
            return
        origin = pose.origin_latitude_deg, pose.origin_longitude_deg
        self._origin = self._origin or origin
        north, east = body.x, body.y
        if origin != self._origin:  # a daemon that was restarted; the lane is where it was
            north, east = to_plane(self._origin, *to_degrees(origin, body.x, body.y))
        x = np.zeros(len(STATES))
        x[AT["x_t"]], x[AT["y_t"]], x[AT["psi_t"]] = north, east, body.heading
        self._x = x

    def _take_state(self, sample: Any) -> None:
        state = pb.ExperimentState.FromString(sample.payload.to_bytes())
        before, self._state, self._shown_s = self._state, state, time.monotonic()
        if (before.phase, before.text) != (state.phase, state.text) or len(before.learned) != len(
            state.learned
        ):
            self.states.append(state)


@dataclass(slots=True)
class Cab:
    """A virtual tractor on its bus and a driver in it; both wait for a daemon of this machine."""

    machine: Machine
    text: str  # of the machine file, with the bus and the endpoint
    endpoint: str
    driver: Driver
    rig: subprocess.Popen[bytes]
    reading: threading.Thread
    facts: list[dict[str, Any]]  # what the rig told at its end

    @property
    def over(self) -> bool:
        """Whether the tractor has stopped by itself."""
        return self.rig.poll() is not None

    def stop(self) -> int:
        """Ends the drive; how many steps of the tractor came late."""
        self.driver.stopping = True
        assert self.rig.stdin is not None
        with suppress(BrokenPipeError):
            self.rig.stdin.write(b'{"stop": true}\n')
            self.rig.stdin.close()
        self.reading.join(30.0)
        return int(self.facts[-1].get("late", 0)) if self.facts else 0


@contextmanager
def virtual_cab(
    machine_text: str, scenario: Scenario, person: Person, seed: int, seconds: float,
    lane: tuple[float, float, float, float], arms: bool = True,
) -> Iterator[Cab]:  # fmt: skip
    """Drives on for so many seconds from when a daemon listens. arms: whether the driver does by himself."""
    with ExitStack() as stack:
        rig = subprocess.Popen(
            [sys.executable, "-m", "tilth.simulator.real_time_rig"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True,
        )  # fmt: skip
        stack.callback(_close, rig)
        port = int(_told(rig, machine_text, seed, seconds, scenario)["port"])
        facts: list[dict[str, Any]] = []
        assert rig.stdout is not None
        reading = threading.Thread(target=_read, args=(rig.stdout, facts), daemon=True)
        reading.start()  # it tells ten times a second where the implement is, and must not wait
        text = on_loopback(machine_text, port)
        endpoint = free_endpoint(parse_machine(text).zenoh.listen[0])
        text = text.replace("[zenoh]\n", f'[zenoh]\nlisten = ["{endpoint}"]\n')
        machine = parse_machine(text)
        base = base_key(machine.name, machine.zenoh.prefix, True)
        driver = Driver(base, endpoint, port, person, lane, seed, arms)
        thread = threading.Thread(target=driver.run, name="driver", daemon=True)
        thread.start()
        stack.callback(thread.join, 10.0)
        cab = Cab(machine, text, endpoint, driver, rig, reading, facts)
        stack.callback(setattr, driver, "stopping", True)
        yield cab


@dataclass(frozen=True, slots=True)
class Live:
    """What came of it."""

    summaries: tuple[RunSummary, ...]  # one of each start of the daemon
    states: tuple[pb.ExperimentState, ...]
    said: str  # by the prompter's process
    status: int  # its exit status
    late: int  # steps of the tractor that came late


def drive_plan(
    machine_text: str, plan: Path, scenario: Scenario, person: Person, seed: int, seconds: float,
    lane: tuple[float, float, float, float], log_folder: Path,
    restart: Callable[[Sequence[pb.ExperimentState]], bool] = lambda states: False,
    watch: Callable[[str], object] = lambda endpoint: None,
) -> Live:  # fmt: skip
    """Until the prompter's process has ended, at most so many seconds. restart: whether the daemon is to be,
    once, by what was shown so far. watch: told the Zenoh endpoint."""
    with virtual_cab(machine_text, scenario, person, seed, seconds, lane) as cab:
        watch(cab.endpoint)
        prompter: list[subprocess.Popen[str]] = []
        began = time.monotonic()

        def over() -> bool:
            if not prompter and time.monotonic() - began > 3.0:
                prompter.append(_prompter(plan, cab.endpoint))
            return bool(prompter and prompter[0].poll() is not None) or cab.over

        summaries: list[RunSummary] = []

        def stop() -> bool:
            return over() or (not summaries and restart(cab.driver.states))

        while not summaries or (len(summaries) == 1 and not over()):
            made = run_daemon(
                MachineFile(cab.machine, cab.text),
                log_folder=log_folder,
                simulated="bench/prompted_live.py",
                stop=stop,
            )
            summaries.append(made)
        cab.driver.stopping = True
        if prompter[0].poll() is None:
            prompter[0].terminate()
        said, _ = prompter[0].communicate(timeout=30.0)
        late = cab.stop()
        return Live(tuple(summaries), tuple(cab.driver.states), said, prompter[0].returncode, late)


def _told(rig: subprocess.Popen[bytes], text: str, seed: int, seconds: float, scenario: Scenario) -> Any:
    order = {
        "machine_text": text, "seed": seed, "seconds": seconds, "scenario": as_json(scenario), "listeners": 2,
    }  # fmt: skip
    assert rig.stdin is not None and rig.stdout is not None
    rig.stdin.write(json.dumps(order).encode() + b"\n")
    rig.stdin.flush()
    return json.loads(rig.stdout.readline())


def _read(lines: IO[bytes], facts: list[dict[str, Any]]) -> None:
    for line in lines:
        fact = json.loads(line)
        if "sent" in fact:
            facts.append(fact)


def _prompter(plan: Path, endpoint: str) -> subprocess.Popen[str]:
    """As a person starts it, without a terminal: the page's orders arm."""
    start = "import sys; from tilth.cli import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", start, "experiment", str(plan), "--connect", endpoint],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True,
    )  # fmt: skip


def _close(rig: subprocess.Popen[bytes]) -> None:
    assert rig.stdin is not None and rig.stdout is not None
    with suppress(BrokenPipeError):
        rig.stdin.close()
    rig.terminate()
    rig.wait(30.0)
    rig.stdout.close()
