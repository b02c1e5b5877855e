"""How fast a log becomes Parquet files, beside what one would write with the libraries.

    python bench/export.py [LOG] [--seconds 600] [--rounds 3]

The log, or one of the demo's traffic (800 frames/s) with its results, is read and written by `tilth export`
(hash of the log, units, a file for each channel), and by mcap's iter_messages, the same Protobuf classes and
pandas' to_parquet, drawings aside in both; in turn, in one process, by its processor's time; the best of each
counts. At the end the most memory that a process of `tilth export` alone takes.
"""

import argparse
import math
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas
from google.protobuf.descriptor import FieldDescriptor
from mcap.reader import make_reader
from replay_speed import logged_drive

from tilth.analysis import open as open_runs
from tilth.analysis.export.export import ExportPlan, export
from tilth.analysis.export.naming import NAMES
from tilth.schemas.channels import CHANNEL
from tilth.schemas.proto.tilth_pb2 import CanFrame

CHILD = """
import sys
from tilth.cli import main
main(sys.argv[1:])
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""  # ru_maxrss would be that of the process which started it


def plain(log: Path, out: Path) -> int:
    """As the documentation of mcap and pandas shows it; frames and results of each topic in a table."""
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    with log.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            kind: Any = CanFrame if channel.topic.startswith("/can/") else None
            if channel.topic in CHANNEL and not channel.topic.startswith("/drawing"):
                kind = CHANNEL[channel.topic].message
            if kind is not None:
                row = {"t_s": message.log_time * 1e-9}
                _flat(kind.FromString(message.data), "", row)
                rows[channel.topic].append(row)
    out.mkdir()
    for topic, found in rows.items():
        pandas.DataFrame(found).to_parquet(out / f"{topic.strip('/').replace('/', '_')}.parquet")
    return sum(map(len, rows.values()))


def _flat(message: Any, before: str, row: dict[str, Any]) -> None:
    """The fields of a message that are there, and of those in it."""
    for field, value in message.ListFields():
        name = before + field.name
        if field.name == "parameters":
            for parameter in value:
                _flat(parameter, f"{parameter.name}_", row)
        elif field.type == FieldDescriptor.TYPE_MESSAGE:
            if not field.is_repeated and field.message_type.file.package == "tilth":
                _flat(value, f"{name}_", row)
        else:
            row[name] = list(value) if field.is_repeated else value


def ours(log: Path, out: Path) -> int:
    (run,) = open_runs(log)
    return sum(export(run, ExportPlan("parquet", NAMES), out).rows.values())


def seconds_of(way: Callable[[Path, Path], int], log: Path, folder: Path) -> tuple[float, int]:
    """Processor's time, and rows."""
    out = folder / "out"
    start = time.process_time()
    rows = way(log, out)
    took = time.process_time() - start
    shutil.rmtree(out)
    return took, rows


def megabytes(log: Path, folder: Path, *words: str) -> int:
    """The most that a process of its own had in memory."""
    words = ("export", str(log), "--to", "parquet", "--out", str(folder / "alone"), *words)
    said = subprocess.run([sys.executable, "-c", CHILD, *words], capture_output=True, text=True, check=True)
    shutil.rmtree(folder / "alone")
    return int(said.stdout.splitlines()[-1]) // 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", nargs="?", type=Path)
    parser.add_argument("--seconds", type=float, default=600.0, help="of driving")
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, log = Path(name), args.log or Path(name) / "drive.mcap"
        if args.log is None:
            logged_drive(log, args.seconds)
        seconds_of(ours, log, folder)  # compiles, once on a computer
        best, rows = {"plain": math.inf, "tilth export": math.inf}, {}
        for _ in range(args.rounds):
            for what, way in (("plain", plain), ("tilth export", ours)):
                took, rows[what] = seconds_of(way, log, folder)
                best[what] = min(best[what], took)
        assert len(set(rows.values())) == 1, rows
        print(f"{log.stat().st_size / 1e6:.1f} MB, {rows['plain']} rows")
        for what, took in best.items():
            print(f"{what:14} {took:7.2f} s {rows[what] / took:11,.0f} rows/s")
        print(f"{best['plain'] / best['tilth export']:.1f} times as fast")
        at_clock = megabytes(log, folder, "--clock", "20ms")
        print(f"at most {megabytes(log, folder)} MB of memory, {at_clock} MB with --clock 20ms")


if __name__ == "__main__":
    main()
