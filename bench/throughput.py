"""Is the daemon fast enough, and does it stay small? Four figures, on the computer that this runs on.

    python bench/throughput.py [--quick]

(a) frame to logged, decoded and folded: the daemon's own `take`, over the demo's traffic
(b) 7,500 frames/s over four loopback buses: sent against logged, and what that costs
(c) frame to Zenoh subscriber, in another process, over the demo's traffic in real time
(d) resident memory over an hour of simulated driving

The mix of (a) and (c), frames/s: two StarFire-like receivers 102, two NMEA 2000 ones 116, wheel angle 100,
tractor ECU 30, and 452 that nobody wants: 800 together. (b) plays the same on each bus, 2.3 times as fast.
"""

# ruff: noqa: E402
from memory import resident_mb

from tilth.logger.can.lean_can import import_can

import_can()  # as `tilth run` does, before anybody else imports python-can

import argparse
import json
import multiprocessing
import os
import platform
import socket
import tempfile
import time
from collections.abc import Iterator
from itertools import cycle, islice
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import can
import numpy as np
import zenoh
from mcap.reader import make_reader

from tilth.logger import compiling
from tilth.logger.daemon import Daemon, run_daemon
from tilth.logger.display import NoDisplay
from tilth.logger.run_summary import RunSummary
from tilth.logger.zenoh.sink import SIMULATED_SUFFIX
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.simulator.packaged import packaged_file
from tilth.simulator.traffic import simulate

GROUP = "239.74.163.2"
RATE = 7500.0  # frames/s, four full buses of 250 kbit/s
BUSES = 4
SETTLE_S = 1.0


def free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def rig(ports: list[int]) -> tuple[Machine, str]:
    """The demo's machine with as many loopback buses."""
    text = packaged_file().text
    start, end = text.index("[[bus]]"), text.index("[[receiver]]")
    buses = "".join(
        f'[[bus]]\nname = "can{i}"\ninterface = "udp_multicast"\nchannel = "{GROUP}"\n'
        f"options = {{ port = {port}, hop_limit = 0 }}\n\n"
        for i, port in enumerate(ports)
    )
    listen = f'listen = ["tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"]'
    text = text[:start] + buses + text[end:].replace("[zenoh]", f"[zenoh]\n{listen}")
    return parse_machine(text), text


def send(ports: list[int], frames: int, rate: float | None, seconds: float, told: Connection) -> None:
    """A process: so many frames at a rate on all buses in turn, or the demo's in real time."""
    buses = [can.Bus(interface="udp_multicast", channel=GROUP, port=p, hop_limit=0) for p in ports]
    some = list(simulate(rig(ports)[0], 1, min(seconds, 60.0)))
    told.send("ready")
    told.recv()
    began, zero_ns, sent = time.monotonic(), some[0].t_ns, 0
    for number, frame in enumerate(islice(cycle(some), frames) if rate else some):
        due = number / rate if rate else (frame.t_ns - zero_ns) * 1e-9
        wait = began + due - time.monotonic()
        if wait > 0.0005:
            time.sleep(wait)  # the buses' pace
        message = can.Message(arbitration_id=frame.can_id, is_extended_id=True, data=frame.data)
        buses[number % len(buses)].send(message)
        sent += 1
    told.send((sent, time.monotonic() - began))
    for bus in buses:
        bus.shutdown()


def subscribe(endpoints: list[str], key: str, told: Connection) -> None:
    """A process: every sample of a key with the time it came, ns since 1970."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps(endpoints))
    config.insert_json5("scouting/multicast/enabled", "false")
    heard: list[tuple[bytes, int]] = []
    with zenoh.open(config) as session:
        subscriber = session.declare_subscriber(
            key, lambda sample: heard.append((sample.payload.to_bytes(), time.time_ns()))
        )
        told.send("ready")
        told.recv()
        subscriber.undeclare()
    told.send(heard)


class Child:
    """A second process and the line to it."""

    def __init__(self, target: Any, *args: Any) -> None:
        self.line, far = multiprocessing.Pipe()
        context = multiprocessing.get_context("spawn")
        self.process = context.Process(target=target, args=(*args, far), daemon=True)
        self.process.start()

    def ready(self) -> None:
        assert self.line.recv() == "ready"

    def go(self) -> None:
        self.line.send("go")

    def answer(self) -> Any:
        result = self.line.recv()
        self.process.join()
        return result


def quantiles(values: Any, unit: str) -> str:
    if len(values) == 0:
        return "nothing to measure"
    p50, p99 = np.percentile(values, [50, 99])
    return f"mean {np.mean(values):.1f}, p50 {p50:.1f}, p99 {p99:.1f}, worst {np.max(values):.1f} {unit}"


def per_frame(seconds: float) -> None:
    machine, text = rig([free_port(socket.SOCK_DGRAM)])
    frames = list(simulate(machine, 1, seconds))
    with tempfile.TemporaryDirectory() as folder:
        daemon = Daemon(MachineFile(machine, text), Path(folder), "", NoDisplay())
        costs = np.empty(len(frames))
        began = time.perf_counter()
        for number, frame in enumerate(frames):
            before = time.perf_counter()
            daemon.take(frame)
            costs[number] = time.perf_counter() - before
            if number % 800 == 0:
                daemon.turn(0.0)  # once a second: flush, status
        all_s = time.perf_counter() - began
        summary = daemon.close()
    counts = f"{summary.measurements} measurements, {summary.poses} poses"
    print(f"(a) {len(frames)} frames of {seconds:.0f} s, {counts}")
    print(f"    frame to logged, decoded, folded, put on Zenoh: {quantiles(costs * 1e6, 'us')}")
    print(f"    with flush and status once a second: mean {all_s / len(frames) * 1e6:.1f} us")


def load(seconds: float) -> None:
    ports = [free_port(socket.SOCK_DGRAM) for _ in range(BUSES)]
    machine, text = rig(ports)
    child = Child(send, ports, int(RATE * seconds), RATE, seconds)
    child.ready()
    with tempfile.TemporaryDirectory() as folder:
        began, cpu = time.monotonic(), time.process_time()
        summary, sent, took_s, _ = _until_sent(machine, text, Path(folder), child)
        share = (time.process_time() - cpu) / (time.monotonic() - began)
        size = sum(path.stat().st_size for path in summary.log_files)
    lost = f"{sent - summary.recorded} lost ({summary.lost} of them known to the kernel)"
    print(f"(b) {sent} frames sent on {BUSES} buses in {took_s:.1f} s ({sent / took_s:.0f}/s),")
    print(f"    {summary.recorded} logged, {lost}, {share * 100:.0f} % of a core,")
    print(f"    {size / summary.recorded:.1f} bytes a frame with results")


def latency(seconds: float) -> None:
    ports = [free_port(socket.SOCK_DGRAM)]
    machine, text = rig(ports)
    child = Child(send, ports, 0, None, seconds)
    child.ready()
    key = f"{machine.zenoh.prefix}/{machine.name}/{SIMULATED_SUFFIX}/pose"  # of a simulation, as this is
    listener = Child(subscribe, machine.zenoh.listen, key)
    with tempfile.TemporaryDirectory() as folder:
        cpu = time.process_time()
        summary, sent, took_s, driving = _until_sent(machine, text, Path(folder), child, listener)
        share = (time.process_time() - cpu) / took_s
        listener.go()
        heard = listener.answer()
        caused = [row for path in summary.log_files for row in _poses(path)]
    came = dict(heard)
    waits = np.array([came[data] - rx_ns for data, rx_ns in caused if data in came]) * 1e-6
    print(
        f"(c) {len(waits)} of {len(caused)} poses heard; from the kernel's stamp of the frame that caused it"
    )
    print(f"    to the subscriber: {quantiles(waits, 'ms')}")
    print(f"    all that the daemon does at {sent / took_s:.0f} frames/s: {driving * 100:.1f} % of a core, "
          f"with start and end {share * 100:.1f} %; 6 % is aimed at")  # fmt: skip


def memory(minutes: int) -> None:
    """Simulated driving through the daemon as fast as it goes; files rotate each few seconds."""
    machine, text = rig([free_port(socket.SOCK_DGRAM)])
    machine = machine.model_copy(update={"log": machine.log.model_copy(update={"rotate_minutes": 0.1})})
    child = Child(drive, minutes)
    child.ready()
    child.go()
    with tempfile.TemporaryDirectory() as folder:
        daemon = Daemon(MachineFile(machine, text), Path(folder), "", NoDisplay())
        before = resident_mb()
        sizes = []
        while rows := child.line.recv():
            for row in rows:
                daemon.take(Frame(row[0], row[1], "can0", row[2], True, False, row[3]))
            daemon.turn(0.0)
            sizes.append(resident_mb())
        frames = daemon.close().recorded
    child.process.join()
    tenths = " ".join(f"{size:.0f}" for size in sizes[:: max(len(sizes) // 10, 1)])
    print(f"(d) {minutes} simulated minutes, {frames} frames; resident MB: {before:.0f}, then {tenths}")


def drive(minutes: int, told: Connection) -> None:
    """A process: the demo's traffic minute by minute, a second at a time, then an empty list."""
    machine, _ = rig([1])
    told.send("ready")
    told.recv()
    ahead_ns = 0
    for minute in range(minutes):
        rows = [
            (f.t_ns + ahead_ns, f.rx_ns + ahead_ns, f.can_id, f.data) for f in simulate(machine, minute, 60.0)
        ]
        for first in range(0, len(rows), 800):
            told.send(rows[first : first + 800])
        ahead_ns += 61_000_000_000
    told.send([])


def _until_sent(
    machine: Machine, text: str, folder: Path, child: Child, listener: Child | None = None
) -> tuple[RunSummary, int, float, float]:
    """Its summary, frames sent, for how many seconds, and the share of a core meanwhile."""
    state: dict[str, Any] = {"turns": 0, "answer": None, "end": 0.0, "cpu": 0.0}

    def stop() -> bool:
        """Begin when the buses are open and whoever listens is there; end a little after the last frame."""
        state["turns"] += 1
        if state["turns"] == 10:
            if listener is not None:
                listener.ready()
            child.go()
            state["cpu"] = time.process_time()
        if state["answer"] is None and state["turns"] > 10 and child.line.poll():
            state["answer"], state["end"] = child.answer(), time.monotonic() + SETTLE_S
            state["cpu"] = time.process_time() - state["cpu"]
        return state["answer"] is not None and time.monotonic() > state["end"]

    summary = run_daemon(
        MachineFile(machine, text), log_folder=folder, simulated="bench/throughput.py", stop=stop
    )
    sent, took_s = state["answer"]
    return summary, sent, took_s, state["cpu"] / took_s


def _poses(path: Path) -> Iterator[tuple[bytes, int]]:
    """Each pose's bytes with the rx_ns of the frame that caused it."""
    rx_ns = 0
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            if channel.topic.startswith("/can/"):
                rx_ns = pb.CanFrame.FromString(message.data).rx_ns
            elif channel.topic == "/pose":
                yield message.data, rx_ns


def processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor()


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed and memory of the daemon.")
    parser.add_argument("--quick", action="store_true", help="seconds instead of minutes")
    parser.add_argument("--seconds", type=float, default=60.0, help="of (b) and (c)")
    args = parser.parse_args()
    seconds = 8.0 if args.quick else args.seconds
    print(f"{os.cpu_count()} cores ({processor()}), Python {platform.python_version()}, {platform.release()}")
    compiling.prepare(
        rig([1])[0], lambda share: None
    )  # so that each daemon estimates from its first frame on
    memory(3 if args.quick else 60)  # first, while this process holds nothing else
    per_frame(20.0 if args.quick else 120.0)
    load(seconds)
    latency(seconds)


if __name__ == "__main__":
    main()
