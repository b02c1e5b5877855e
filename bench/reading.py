"""How fast a log becomes arrays, beside what one would write with the mcap package.

    python bench/reading.py [--seconds 600]

A log of the demo's traffic (800 frames/s) with its results is read by
`tilth.replay.readers.arrays.read_frames` and by mcap's iter_messages; in turn, three times, by the
processor's time; the best of each counts.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from replay_speed import logged_drive

from tilth.replay.readers.arrays import read_frames
from tilth.schemas.proto.tilth_pb2 import CanFrame

ROUNDS = 3


def plain(path: Path) -> int:
    """As the documentation of mcap shows it, into the same arrays."""
    rows = []
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            if channel.topic.startswith("/can/"):
                raw = CanFrame.FromString(message.data)
                rows.append((message.log_time, raw.rx_ns, raw.can_id, raw.extended, raw.error))
    for kind, column in zip(
        (np.int64, np.int64, np.uint32, bool, bool), zip(*rows, strict=True), strict=True
    ):
        np.array(column, kind)
    return len(rows)


def seconds_of(way: Callable[[], int], frames: int) -> float:
    start = time.process_time()
    assert way() == frames
    return time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="of driving")
    seconds = parser.parse_args().seconds
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.mcap"
        _, _, rows = logged_drive(path, seconds)
        read_frames(path)  # compiles, once on a computer
        best = {"iter_messages": np.inf, "read_frames": np.inf}
        for _ in range(ROUNDS):
            best["iter_messages"] = min(best["iter_messages"], seconds_of(lambda: plain(path), len(rows)))
            best["read_frames"] = min(
                best["read_frames"], seconds_of(lambda: len(read_frames(path)), len(rows))
            )
        print(f"{len(rows)} frames, {path.stat().st_size / 1e6:.1f} MB with results")
    for name, took in best.items():
        hour = took * 3600 / seconds
        print(f"{name:14} {took:6.2f} s {len(rows) / took:11,.0f} frames/s, an hour in {hour:5.1f} s")
    print(f"{best['iter_messages'] / best['read_frames']:.0f} times as fast")


if __name__ == "__main__":
    main()
