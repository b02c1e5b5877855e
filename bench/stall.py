"""How long the recorder holds the daemon's loop at a stretch while chunks are synced and files change.

    python bench/stall.py [--seconds 20]

Frames at 7,600/s, as four buses at full load give them, are recorded as the daemon does it, a new file each
two seconds; beside it a plain writer of the mcap package that syncs in the loop each 0.4 s. Two numbers of
each: by the clock, which also counts what other programs of this computer took, and by the loop's own
processor time, which does not count waiting for the disk.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from mcap.writer import CompressionType, Writer

from tilth.logger.clock import Clock
from tilth.logger.log.run_log import FLUSH_NS, Recording
from tilth.schemas.flow import Frame
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.proto.tilth_pb2 import CanFrame
from tilth.simulator.packaged import packaged_file

PER_S = 7600


def paced(seconds: float, take: Callable[[Frame], None], tick: Callable[[int], None]) -> tuple[float, float]:
    """The longest turn of a loop, by the clock and by its processor time, s."""
    clock = Clock()
    began_ns = next_ns = clock.t_ns()
    longest = longest_cpu = 0.0
    while (now_ns := clock.t_ns()) < began_ns + seconds * 1e9:
        before, before_cpu = time.perf_counter(), time.thread_time()
        for _ in range(100):  # no more of a turn is the frames' than as many as a bus gives at once
            if next_ns > now_ns:
                break
            take(Frame(next_ns, next_ns, "can0", 0x18FF0001, True, False, next_ns.to_bytes(8, "little")))
            next_ns += 1_000_000_000 // PER_S
        tick(now_ns)
        longest = max(longest, time.perf_counter() - before)
        longest_cpu = max(longest_cpu, time.thread_time() - before_cpu)
        time.sleep(0.001)  # the pace of the loop: frames of so long make a turn
    return longest, longest_cpu


def recorder(folder: Path, seconds: float) -> tuple[float, float]:
    text = packaged_file().text
    text = text.replace("[log]", "[log]\nrotate_minutes = 0.034")
    recording = Recording(
        folder, MachineFile(parse_machine(text), text), Clock(), lambda *message: None, lambda: "{}"
    )
    found = paced(seconds, recording.frame, recording.tick)
    recording.close()
    assert recording.missed == 0
    return found


def baseline(folder: Path, seconds: float) -> tuple[float, float]:
    due_ns = 0
    with (folder / "plain.mcap").open("wb") as stream:
        writer = Writer(stream, chunk_size=65536, compression=CompressionType.ZSTD)
        writer.start()
        channel = writer.register_channel(
            "/can/can0", "protobuf", writer.register_schema("x", "protobuf", b"")
        )

        def take(frame: Frame) -> None:
            raw = CanFrame(rx_ns=frame.rx_ns, can_id=frame.can_id, extended=True, data=frame.data)
            writer.add_message(channel, frame.t_ns, raw.SerializeToString(), frame.rx_ns)

        def tick(now_ns: int) -> None:
            nonlocal due_ns
            if now_ns >= due_ns:
                due_ns = now_ns + FLUSH_NS
                writer.flush()
                stream.flush()
                os.fdatasync(stream.fileno())

        found = paced(seconds, take, tick)
        writer.finish()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parser.parse_args().seconds
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:  # a real disk: /tmp may be memory
        for name, way in (("plain writer", baseline), ("recorder", recorder)):
            by_clock, ours = way(Path(folder), seconds)
            print(
                f"{name:13} longest turn {by_clock * 1e3:6.1f} ms by the clock, {ours * 1e3:.1f} ms its own"
            )


if __name__ == "__main__":
    main()
