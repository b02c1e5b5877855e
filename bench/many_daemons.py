"""Many daemons' publications through one Zenoh router to one recorder: what is lost, what it costs.

    python bench/many_daemons.py [--daemons 300] [--seconds 60] [--processes 2] [--drive 60] [--patient]
                                 [--together 1] [--pace 1.0]

What one daemon publishes is taken from a simulated drive of so many seconds, with its times. Each simulated
daemon has a sink of its own, as `tilth run` has, and puts it in real time, each a little later than the one
before; --together says how many share a session, that is a connection to the router. With --pace 0.25 all go
at a quarter of real time, for a computer that has not the cores of them all. The router is a Zenoh session in
router mode, the recorder a client that writes each payload to an MCAP file with its key; both are processes
of their own. Lost is what was put, less what is in the file.
"""

import argparse
import json
import multiprocessing
import socket
import tempfile
import time
from collections import Counter
from multiprocessing.synchronize import Event
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import zenoh
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from memory import resident_mb

from tilth.estimator import fold
from tilth.logger.zenoh.sink import ZenohSink
from tilth.schemas.channels import CHANNEL, payload
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import Scenario
from tilth.simulator.traffic import simulate

ROOT = "fleet"
SETTLES_S = 5.0

Put = tuple[float, str, bytes]  # seconds from the beginning, topic, payload


def published(seconds: float) -> list[Put]:
    """What a daemon puts on Zenoh in a drive, without its status."""
    state, puts, begin_ns = fold.initial(packaged_file().machine), list[Put](), 0
    for frame in simulate(state.machine, 1, seconds, Scenario(clock_offset_s=0.0)):
        begin_ns = begin_ns or frame.t_ns
        for one in fold.step(state, frame):
            if CHANNEL[one.topic].key is not None:
                puts.append(((frame.t_ns - begin_ns) * 1e-9, one.topic, payload(one)))
    return puts


def config_of(mode: str, endpoint: str, patient: bool = False) -> zenoh.Config:
    """patient: a value waits for room in the queue of a link for 0.1 s before it is dropped, not 1 ms."""
    config = zenoh.Config()
    settings: dict[str, Any] = {"mode": mode, "scouting/multicast/enabled": False}
    if patient:
        settings["transport/link/tx/queue/congestion_control/drop/wait_before_drop"] = 100_000
    settings["listen/endpoints" if mode == "router" else "connect/endpoints"] = [endpoint]
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def route(endpoint: str, patient: bool, ready: Event, over: Event, told: Any) -> None:
    """A process: the router."""
    with zenoh.open(config_of("router", endpoint, patient)):
        before = time.process_time()
        ready.set()
        over.wait()
        told.put(("router", time.process_time() - before, resident_mb()))


def record(endpoint: str, path: Path, ready: Event, over: Event, told: Any) -> None:
    """A process: the recorder."""
    came: SimpleQueue[Any] = SimpleQueue()
    with zenoh.open(config_of("client", endpoint)) as session, path.open("wb") as stream:
        writer, channels = Writer(stream, compression=CompressionType.ZSTD), dict[str, int]()
        writer.start()
        subscriber = session.declare_subscriber(f"{ROOT}/**", came.put)
        before = time.process_time()
        ready.set()
        while not over.is_set() or not came.empty():
            if came.empty():
                over.wait(0.02)
                continue
            sample = came.get()
            key, t_ns = str(sample.key_expr), time.time_ns()
            if key not in channels:
                channels[key] = writer.register_channel(key, "protobuf", 0)
            writer.add_message(channels[key], t_ns, sample.payload.to_bytes(), t_ns)
        subscriber.undeclare()
        writer.finish()
    told.put(("recorder", time.process_time() - before, resident_mb()))


def publish(
    endpoint: str,
    patient: bool,
    together: int,
    numbers: range,
    puts: list[Put],
    seconds: float,
    pace: float,
    ready: Event,
    begin: Event,
    told: Any,
) -> None:
    """A process: some daemons, in real time; tells how much each has put."""
    machine = parse_machine(packaged_file().text.replace('prefix = "tilth"', f'prefix = "{ROOT}"'))
    sessions = [zenoh.open(config_of("client", endpoint, patient)) for _ in numbers[::together]]
    sinks = []
    for k, number in enumerate(numbers):
        named = machine.machine.model_copy(update={"name": f"tractor{number:03d}"})
        of = machine.model_copy(
            update={"machine": named, "zenoh": machine.zenoh.model_copy(update={"prefix": ROOT})}
        )
        sinks.append(ZenohSink(of, session=sessions[k // together]))
    ready.set()
    begin.wait()
    before, began, count = time.process_time(), time.monotonic(), 0
    step = 1.0 / max(len(sinks), 1)
    order = sorted(
        (t + k * step, k, topic, data)
        for k in range(len(sinks))
        for t, topic, data in puts
        if t + k * step < seconds
    )
    latest = 0.0
    for at, k, topic, data in order:
        wait = began + at / pace - time.monotonic()
        if wait > 0.001:
            time.sleep(wait)
        latest = max(latest, -wait)
        sinks[k].put(topic, data)
        count += 1
    time.sleep(SETTLES_S)
    failures = sum(sink.failures for sink in sinks)
    told.put(("daemons", time.process_time() - before, resident_mb(), count, failures, latest))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--daemons", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--processes", type=int, default=2, help="for the daemons")
    parser.add_argument("--drive", type=float, default=60.0, help="seconds of the drive that is published")
    parser.add_argument("--patient", action="store_true", help="links wait 0.1 s before they drop, not 1 ms")
    parser.add_argument("--together", type=int, default=1, help="daemons that share a session")
    parser.add_argument("--pace", type=float, default=1.0, help="times real time")
    args = parser.parse_args()
    puts = published(args.drive)
    rate, size = len(puts) / args.drive, sum(len(data) for _, _, data in puts) / len(puts)
    print(f"a daemon puts {rate:.1f} values a second of {size:.0f} bytes on average", flush=True)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    context = multiprocessing.get_context("spawn")
    told, over, begin = context.Queue(), context.Event(), context.Event()
    with tempfile.TemporaryDirectory() as folder:
        path, ready = Path(folder) / "all.mcap", context.Event()
        for work, more in ((route, (args.patient,)), (record, (path,))):
            ready = context.Event()
            context.Process(target=work, args=(endpoint, *more, ready, over, told), daemon=True).start()
            ready.wait()
        readies = []
        share = -(-args.daemons // args.processes)
        for k in range(args.processes):
            numbers = range(k * share, min((k + 1) * share, args.daemons))
            readies.append(context.Event())
            words = (
                endpoint, args.patient, args.together, numbers, puts, args.seconds, args.pace, readies[-1],
                begin, told,
            )  # fmt: skip
            context.Process(target=publish, args=words, daemon=True).start()
        for one in readies:
            one.wait()
        time.sleep(1.0)
        begin.set()
        daemons = [told.get() for _ in range(args.processes)]
        over.set()
        others = [told.get() for _ in range(2)]
        with path.open("rb") as stream:
            came = Counter(channel.topic for _, channel, _ in make_reader(stream).iter_messages())
        written = path.stat().st_size
    sent, failures = sum(one[3] for one in daemons), sum(one[4] for one in daemons)
    got = sum(count for key, count in came.items() if not key.endswith("/rig"))
    machines = {key.split("/")[1] for key in came}
    took = args.seconds / args.pace
    print(
        f"{args.daemons} daemons, {took:.0f} s: {sent} put ({sent / took:.0f}/s), {failures} "
        f"refused, {got} in the file of {len(machines)} machines: {sent - got} lost "
        f"({100 * (sent - got) / sent:.2f} %); {written / max(got, 1):.0f} bytes each"
    )
    for name, cpu, megabytes, *_ in (*others, *daemons):
        each = f"{100 * cpu / took:.1f} % of a core, {1e6 * cpu / sent:.1f} us for each value of all"
        print(f"    {name}: {each}, {megabytes:.0f} MB")
    print(f"    the daemons were behind their time by {max(one[5] for one in daemons):.2f} s at most")


if __name__ == "__main__":
    main()
