"""What does a raw frame cost, from the socket to the disk? Buses and log alone, without the estimation.

    python bench/recorder.py [--seconds N]              # four full buses, 7,600 frames/s, through loopback
    python bench/recorder.py soak [--seconds N]         # the whole daemon under that load: nothing lost?
    python bench/recorder.py record MACHINE.toml FOLDER # until Ctrl-C; used in the virtual machine

Where the kernel has no CAN, datagram sockets of loopback stand in for the raw ones: same code, same struct
can_frame in them. `pytest -m vm_systemd -n 0 tests/vm/test_beside.py` sets it beside `candump -L` and
`python -m can.logger` on a vcan.
"""

# ruff: noqa: E402
from memory import resident_mb

from tilth.logger.can.lean_can import import_can

import_can()  # as `tilth run` does, before anybody else imports python-can

import argparse
import gc
import json
import multiprocessing
import signal
import socket
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from tilth.logger.can.bus_opening import open_port
from tilth.logger.can.buses import Buses
from tilth.logger.can.port import Tally
from tilth.logger.can.port_threads import Opener
from tilth.logger.can.socketcan import CAN_FRAME, EXTENDED, SocketCanPort
from tilth.logger.clock import Clock
from tilth.logger.log.run_log import Recording
from tilth.logger.status import bus_status
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Event
from tilth.schemas.machine import Bus, Machine
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.notices import Notice
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.sentences import event_sentence
from tilth.simulator.packaged import packaged_file

BUSES = 4
RATE = 7600.0  # frames/s: four full buses of 250 kbit/s
TURN_S = 0.1
SECOND_NS = 1_000_000_000


class Recorder:
    """Buses and log, with their events and states in it: the daemon without what it computes."""

    def __init__(self, machine: Machine, text: str, folder: Path, opener: Opener = open_port) -> None:
        self.clock = Clock()
        self.events: list[tuple[str, Notice]] = []
        self.recording = Recording(folder, MachineFile(machine, text), self.clock, self._report, lambda: "{}")
        self.buses = Buses(machine.bus, self.clock, self._report, opener)
        self.status = pb.Status()  # of this second
        self._next_ns = self.clock.t_ns()

    def turn(self, timeout_s: float = TURN_S) -> int:
        frames = self.buses.read(timeout_s)
        record = self.recording.frame
        for frame in frames:
            record(frame)
        t_ns = self.clock.t_ns()
        while self.events:
            event = Event(t_ns, *self.events.pop(0))
            self.recording.message("/event", t_ns, CHANNEL["/event"].encode(event))
            print(event_sentence(event), flush=True)
        if t_ns >= self._next_ns:
            self._next_ns = t_ns + SECOND_NS
            self.status = pb.Status(t_ns=t_ns, buses=[bus_status(one, t_ns) for one in self.buses.live_buses])
            self.recording.message("/status", t_ns, CHANNEL["/status"].encode(self.status))
        self.recording.tick(t_ns)
        return len(frames)

    def close(self) -> None:
        while self.turn(0.0):
            continue
        self.buses.close()
        self.recording.close()

    def _report(self, kind: str, told: Notice) -> None:
        self.events.append((kind, told))


def status_words(status: pb.Status) -> str:
    """A line for a script to wait for."""
    buses = (f"{bus.name} {bus.state} {bus.controller}: {bus.reason}" for bus in status.buses)
    return " | ".join(("status", *buses))


def record(machine_path: Path, folder: Path) -> None:
    """Until SIGINT, a line each second; then one of JSON: frames and the CPU time they cost."""
    text = machine_path.read_text()
    recorder = Recorder(parse_machine(text), text, folder)
    ended: list[int] = []
    signal.signal(signal.SIGINT, lambda number, frame: ended.append(number))
    before, told_ns = time.process_time(), 0
    while not ended:
        recorder.turn()
        if recorder.status.t_ns != told_ns:
            told_ns = recorder.status.t_ns
            print(status_words(recorder.status), flush=True)
    spent = time.process_time() - before
    recorder.close()
    print(json.dumps({"frames": recorder.recording.frames, "cpu_s": spent}), flush=True)


def rig() -> tuple[Machine, str]:
    """The demo's machine with four SocketCAN buses."""
    text = packaged_file().text
    start, end = text.index("[[bus]]"), text.index("[[receiver]]")
    row = '[[bus]]\nname = "can{0}"\ninterface = "socketcan"\nchannel = "can{0}"\n\n'
    text = text[:start] + "".join(row.format(i) for i in range(BUSES)) + text[end:]
    return parse_machine(text), text


def stand_ins() -> tuple[Opener, dict[str, tuple[str, int]]]:
    """Ports on sockets of loopback, and the address of each bus."""
    sockets = {f"can{i}": socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for i in range(BUSES)}
    for one in sockets.values():
        one.bind(("127.0.0.1", 0))

    def opener(config: Bus, clock: Clock, tally: Tally) -> SocketCanPort:
        return SocketCanPort(sockets[config.name], clock, tally, config)

    return opener, {name: one.getsockname() for name, one in sockets.items()}


def send(addresses: list[tuple[str, int]], rate: float, seconds: float, told: Connection) -> None:
    """A process: random frames on all buses in turn, as from controllers that fill their bus."""
    rng = np.random.default_rng(1)
    wires = []
    for address in addresses:
        wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        wire.connect(address)
        wires.append(wire)
    noise = rng.integers(0, 256, (4096, 8), dtype=np.uint8)
    frames = [CAN_FRAME.pack(0x18FF0000 + i % 50 | EXTENDED, 8, row.tobytes()) for i, row in enumerate(noise)]
    told.send("ready")
    told.recv()
    began, count = time.monotonic(), int(rate * seconds)
    for number in range(count):
        if number % 4 == 0:  # the buses send at the same instants
            wait = began + number / rate - time.monotonic()
            if wait > 0.0002:
                time.sleep(wait)  # the buses' pace
        wires[number % len(wires)].send(frames[number % 4096])
    told.send((count, time.monotonic() - began))


class Load:
    """A second process that fills four buses, begun and waited for from here."""

    def __init__(self, seconds: float) -> None:
        self.opener, addresses = stand_ins()
        self._line, far = multiprocessing.Pipe()
        context = multiprocessing.get_context("spawn")
        job = (list(addresses.values()), RATE, seconds, far)
        self._child = context.Process(target=send, args=job, daemon=True)
        self._child.start()
        self._told: tuple[int, float] | None = None
        self._end = 0.0

    def begin(self) -> None:
        assert self._line.recv() == "ready"
        gc.collect()
        gc.freeze()
        self._line.send("go")

    def over(self) -> bool:
        """Whether all is sent, and half a second has passed since."""
        if self._told is None and self._line.poll():
            self._told, self._end = self._line.recv(), time.monotonic() + 0.5
        return self._told is not None and time.monotonic() > self._end

    def sent(self) -> tuple[int, float]:
        """Frames, and the seconds that took."""
        assert self._told is not None
        return self._told


def cost(seconds: float) -> None:
    """What recording costs, and how long the loop was ever away."""
    load = Load(seconds)
    machine, text = rig()
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(machine, text, Path(folder), load.opener)
        for _ in range(20):
            recorder.turn(0.01)
        away = []
        load.begin()
        recorder.turn()
        before, last = time.process_time(), time.monotonic()
        while not load.over():
            recorder.turn()
            now = time.monotonic()
            away.append(now - last)
            last = now
        spent = time.process_time() - before
        recorder.close()
        size = sum(path.stat().st_size for path in Path(folder).glob("*.mcap"))
    sent, took_s = load.sent()
    got, lost = recorder.recording.frames, sum(bus.traffic.lost for bus in recorder.buses.live_buses)
    gaps = np.array([gap for gap in away if gap < 0.9 * TURN_S]) * 1e3  # without those that waited in vain
    print(f"{sent} frames sent on {BUSES} buses in {took_s:.1f} s ({sent / took_s:.0f}/s): {got} recorded,")
    print(f"    {sent - got} lost ({lost} of them known to the kernel), {size / got:.1f} bytes each")
    each = f"{spent / got * 1e6:.2f} us of CPU each, socket to disk"
    print(f"    {each} ({spent / took_s * 100:.1f} % of a core)")
    worst = f"worst {gaps.max():.1f} ms, {np.percentile(gaps, 99.9):.1f} ms in 999 of 1000"
    print(f"    from one turn of the loop to the next: {worst} ({len(gaps)} turns)")


def soak(seconds: float) -> None:
    """The daemon with all that it computes, for as long as asked; one line of JSON."""
    from tilth.logger import compiling
    from tilth.logger.daemon import Daemon  # takes minutes to load in the virtual machine
    from tilth.logger.display import NoDisplay

    load = Load(seconds)
    machine, text = rig()
    compiling.prepare(machine, lambda share: None)  # estimates from the first frame on
    with tempfile.TemporaryDirectory() as folder:
        daemon = Daemon(MachineFile(machine, text), Path(folder), None, NoDisplay(), opener=load.opener)
        for _ in range(20):
            daemon.turn(0.01)
        load.begin()
        before, began, sizes = time.process_time(), time.monotonic(), [resident_mb()]
        while not load.over():
            daemon.turn()
            if time.monotonic() - began > len(sizes) * seconds / 10:
                sizes.append(resident_mb())
        while daemon.turn():  # what a busy computer has not yet taken
            continue
        share = (time.process_time() - before) / (time.monotonic() - began)
        summary = daemon.close()
        files = [path.stat().st_size for path in summary.log_files]
    sent, took_s = load.sent()
    said = {
        "sent": sent,
        "per_s": round(sent / took_s),
        "recorded": summary.recorded,
        "lost": sent - summary.recorded,
        "lost_in_kernel": summary.lost,
        "core": round(share, 3),
        "resident_mb": [round(size) for size in sizes],
        "files": len(files),
        "bytes_per_frame": round(sum(files) / max(summary.recorded, 1), 1),
    }
    print(json.dumps(said))


def main() -> None:
    parser = argparse.ArgumentParser(description="What a raw frame costs from the socket to the disk.")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("words", nargs="*", help="soak, or record MACHINE.toml FOLDER")
    args = parser.parse_args()
    if args.words[:1] == ["record"] and len(args.words) == 3:
        record(Path(args.words[1]), Path(args.words[2]))
    elif args.words == ["soak"]:
        soak(args.seconds)
    elif args.words:
        parser.error("soak, or record MACHINE.toml FOLDER")
    else:
        cost(args.seconds)


if __name__ == "__main__":
    main()
