"""How fast logs are replayed, beside what one would write with the libraries alone.

    python bench/replay_speed.py [--seconds 120] [--own] [--rounds 3] [--since COMMIT]

A log of the demo's traffic (800 frames/s: four receivers, wheel angle, and as many frames again that nobody
wants; with --own only the rig's) is recorded with its results, as the daemon does it, and read back in
several ways. All ways run in turn; the best round of each counts. Times are of the processor, of all threads
and processes: other programs that run beside it make them up to twice as long. Kernels are compiled before.
Last come the first words of all commands. An hour: --seconds 3600 --own --rounds 1. With --since only replays
and fits, by the code of a commit and by that of here in turn, each with its own log, and the ratio.
"""

import argparse
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from tilth.cli import COMMANDS
from tilth.estimator.filters.likelihood import likelihood_at, search_of
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.states import DT
from tilth.estimator.methods import pem
from tilth.logger.fit_worker import make
from tilth.logger.fitting import InPlace
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.replay.compare import Comparison
from tilth.replay.offline import ReplayOutputs, replay
from tilth.replay.readers.any_log import frames
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto.tilth_pb2 import CanFrame
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import Scenario
from tilth.simulator.traffic import simulate

ROUNDS = 3
FASTER = {"replay of frames alone, fits made": 100.0, "replay": 150.0}  # than real time: what is aimed at

# What a script that only wants positions, speeds, attitudes and angles would have: PGN -> layout.
LAYOUTS = {
    65267: struct.Struct("<II"),
    65256: struct.Struct("<HHHH"),
    129025: struct.Struct("<ii"),
    129026: struct.Struct("<BBHHH"),
    127250: struct.Struct("<BHhhB"),
    127251: struct.Struct("<BixB"),
    127257: struct.Struct("<BhhhB"),
}
WHEEL_ID = 0x18FF0B15


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=120.0, help="of simulated driving")
    parser.add_argument("--own", action="store_true", help="the rig's own frames only")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--since", help="a commit to compare with")
    parser.add_argument("--told", action="store_true", help="only what --since asks for, as JSON")
    args = parser.parse_args()
    seconds = args.seconds
    if args.since:
        since(args.since, seconds, args.rounds)
        return
    if args.told:
        print(json.dumps(short(seconds)))
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "demo.mcap"
        machine, text, rows = logged_drive(path, seconds, args.own)
        per_s = len(rows) / seconds
        size = path.stat().st_size / 1e6
        print(f"{len(rows)} frames in {seconds:g} s ({per_s:.0f}/s), {size:.1f} MB with results")
        times = measure(ways(path, machine, text, rows, Path(folder)), args.rounds)
        report(times, len(rows), per_s)
        of_a_fit(machine, rows)
        first_words(Path(folder) / "one.mcap", machine, text, rows)


def since(commit: str, seconds: float, rounds: int) -> None:
    """Seconds of the processor by the code of a commit and by that of here, each the least of the rounds."""
    here = Path(__file__).resolve().parents[1]
    with tempfile.TemporaryDirectory() as folder:
        old = Path(folder) / "tilth"
        old.mkdir()
        packed = subprocess.run(["git", "-C", here, "archive", commit], check=True, capture_output=True)
        subprocess.run(["tar", "-x", "-C", old], input=packed.stdout, check=True)
        shutil.copytree(here / "estimator/kernels", old / "estimator/kernels", dirs_exist_ok=True)
        times: list[dict[str, float]] = [{}, {}]
        command = [sys.executable, str(Path(__file__)), "--told", f"--seconds={seconds}"]
        for _, which in product(range(rounds), (0, 1)):
            env = os.environ | ({"PYTHONPATH": folder} if which == 0 else {})
            told = subprocess.run(command, check=True, capture_output=True, env=env, text=True)
            for name, took in json.loads(told.stdout).items():
                times[which][name] = min(took, times[which].get(name, took))
    print(f"{'seconds of the processor':50} {commit[:9]:>9} {'here':>9} {'ratio':>6}")
    for name, took in times[0].items():
        print(f"{name:50} {took:9.3f} {times[1][name]:9.3f} {took / times[1][name]:6.2f}")


def short(seconds: float) -> dict[str, float]:
    """What `since` compares, by the code that runs."""
    with tempfile.TemporaryDirectory() as folder:
        path, alone = Path(folder) / "demo.mcap", Path(folder) / "alone.mcap"
        machine, text, rows = logged_drive(path, seconds)
        frames_alone(alone, machine, text, rows)
        found = {
            name: cpu_seconds(partial(replay, [log], MachineFile(machine, text)))
            for name, log in (("replay", path), ("replay of frames alone, fits made", alone))
        }
        jobs = jobs_of(machine, rows)
    for number, job in enumerate(jobs, start=1):
        took = cpu_seconds(partial(make, machine, pem.METHOD, job))
        found[f"fit {number}, of {len(job.record.ticks) * DT:.0f} s"] = took
    return found


def logged_drive(path: Path, seconds: float, own: bool = False) -> tuple[Machine, str, list[Frame]]:
    """Drive the packaged machine and log it as the daemon does, with its results. own: the
    rig's frames alone."""
    machine, text = packaged_file()
    rows = list(simulate(machine, 1, seconds, Scenario(other_traffic=False) if own else None))
    fold = GuardedFold(machine)
    writer = LogWriter(path, MachineFile(machine, text), RunPart("bench", 1, 0))
    for frame in rows:
        writer.frame(frame)
        for publication, data in fold.take(frame):
            writer.message(publication.topic, publication.t_ns, data)
    writer.close()
    return machine, text, rows


def ways(
    path: Path, machine: Machine, text: str, rows: list[Frame], folder: Path
) -> dict[str, Callable[[], object]]:
    def with_out() -> None:
        out = fresh(folder / "out.mcap")
        writer = LogWriter(out, MachineFile(machine, text), RunPart("bench", 1, 0))
        replay([path], MachineFile(machine, text), outputs=ReplayOutputs(writer=writer))
        writer.close()

    def fresh(out: Path) -> Path:
        out.unlink(missing_ok=True)
        out.with_suffix(".json").unlink(missing_ok=True)
        return out

    def decode(some: Iterable[Frame]) -> int:
        decoder = Decoder(machine)
        return sum(len(decoder.measurements(frame)) for frame in some)

    alone = folder / "alone.mcap"

    def record() -> None:
        out = LogWriter(folder / "live.mcap", MachineFile(machine, text), RunPart("bench", 1, 0))
        fold = GuardedFold(machine, fitter=NoFits(machine))
        for frame in rows:
            out.frame(frame)
            for publication, data in fold.take(frame):
                out.message(publication.topic, publication.t_ns, data)
        out.close()
        (folder / "live.mcap").unlink()

    frames_alone(alone, machine, text, rows)
    return {
        "plain: iter_messages": lambda: sum(1 for _ in bare_frames(path)),
        "plain: iter_messages, struct per PGN": lambda: bare_decode(path),
        "readers.frames": lambda: sum(1 for _ in frames(path)),
        "Decoder.measurements alone": lambda: decode(rows),
        "readers.frames, Decoder.measurements": lambda: decode(frames(path)),
        "daemon's fold and log, its fits beside": record,
        "replay of frames alone, fits made": lambda: replay([alone], MachineFile(machine, text)),
        "replay": lambda: replay([path], MachineFile(machine, text)),
        "replay --verify": lambda: replay(
            [path], MachineFile(machine, text), outputs=ReplayOutputs(comparison=Comparison())
        ),
        "replay --out": with_out,
        "tilth report, start included": lambda: subprocess.run(
            [sys.executable, "-m", "tilth.cli", "report", path, "--out", fresh(folder / "report.html")],
            check=True,
            capture_output=True,
        ),
    }


class NoFits(InPlace):
    """A worker beside makes them."""

    def made(self, method: str, job: Any) -> Any:
        return None


def frames_alone(path: Path, machine: Machine, text: str, rows: list[Frame]) -> None:
    writer = LogWriter(path, MachineFile(machine, text), RunPart("bench", 1, 0))
    for frame in rows:
        writer.frame(frame)
    writer.close()


def jobs_of(machine: Machine, rows: list[Frame]) -> list[pem.Job]:
    """The fits that a drive asks for, with none of them made."""
    jobs: list[pem.Job] = []

    class Kept(NoFits):
        def made(self, method: str, job: Any) -> Any:
            jobs.extend([job] if method == pem.METHOD else [])
            return super().made(method, job)

    fold = GuardedFold(machine, fitter=Kept(machine))
    for frame in rows:
        fold.take(frame)
    return jobs


def of_a_fit(machine: Machine, rows: list[Frame]) -> None:
    """Computing time of each fit of the drive, beside one run of its filter without any derivative."""
    setup = rig_setup(machine)
    for job in jobs_of(machine, rows):
        search = search_of(job.record, setup, job.mean, job.covariance)
        run, fit = (
            cpu_seconds(way)
            for way in (partial(likelihood_at, search, job.mean), partial(make, machine, pem.METHOD, job))
        )
        print(
            f"fit of {len(job.record.ticks) * DT:.1f} s: {fit * 1e3:.0f} ms, {fit / run:.0f} runs of its "
            f"filter of {run * 1e3:.1f} ms"
        )


def first_words(path: Path, machine: Machine, text: str, rows: list[Frame]) -> None:
    """Until each command says its first word (`run`, `check` and `demo` say it before they import more), and
    until a replay has its first frame, beside what reading any machine file takes."""
    frames_alone(path, machine, text, rows[:1])
    ours = {name: [name, "--help"] for name, _ in COMMANDS}
    ours["replay of one frame"] = ["replay", str(path)]
    programs = {name: ["-m", "tilth.cli", *words] for name, words in ours.items()}
    programs["(import numpy, pydantic)"] = ["-c", "import numpy, pydantic"]
    took = {
        name: cpu_seconds(partial(subprocess.run, [sys.executable, *words], check=True, capture_output=True))
        for name, words in programs.items()
    }
    least = took.pop("(import numpy, pydantic)")
    for name, seconds in sorted(took.items(), key=lambda row: -row[1]):
        aim = 1.5 if name == "replay of one frame" else 1.0
        print(f"{name:38} {seconds:6.2f} s of {aim:g} s, {seconds / least:4.1f} times those imports")


def cpu_seconds(way: Callable[[], object]) -> float:
    """The least of ROUNDS."""
    times = []
    for _ in range(ROUNDS):
        start = processor_s()
        way()
        times.append(processor_s() - start)
    return min(times)


def processor_s() -> float:
    """Of this process, and of those that it has waited for."""
    of = os.times()
    return time.process_time() + of.children_user + of.children_system


def bare_frames(path: Path) -> Iterable[Frame]:
    """Every frame, as the documentation of mcap shows it; file order, which is its quicker one."""
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            if channel.topic.startswith("/can/"):
                raw = CanFrame.FromString(message.data)
                bus = channel.topic[5:]
                yield Frame(message.log_time, raw.rx_ns, bus, raw.can_id, raw.extended, raw.error, raw.data)


def bare_decode(path: Path) -> int:
    """Numbers of single frames only: no fast packets, no identity, no not-available rules, no units."""
    values = 0
    for frame in bare_frames(path):
        pgn = frame.can_id >> 8 & 0x3FFFF
        if frame.can_id == WHEEL_ID:
            values += len(struct.unpack_from(">h", frame.data))
        elif pgn in LAYOUTS:
            values += len(LAYOUTS[pgn].unpack_from(frame.data))
    return values


def measure(every: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Seconds of each way, the best round."""
    best = dict.fromkeys(every, float("inf"))
    for _ in range(rounds):
        for name, way in every.items():
            start = processor_s()
            way()
            best[name] = min(best[name], processor_s() - start)
    return best


def report(times: dict[str, float], count: int, per_s: float) -> None:
    print(f"{'':38} {'us/frame':>9} {'frames/s':>9} {'x real time':>12} {'% of a core':>10}")
    for name, seconds in times.items():
        rate = count / seconds
        aim = f"   {rate / per_s / FASTER[name]:.2f} of what is aimed at" if name in FASTER else ""
        print(f"{name:38} {1e6 / rate:9.2f} {rate:9.0f} {rate / per_s:12.0f} {100 * per_s / rate:10.1f}{aim}")
    whole = times["replay"] + times["tilth report, start included"]
    print(f"{count / per_s:.0f} s of driving replayed and reported: {whole:.0f} s; an hour is to take 45 s")
    reading = times["plain: iter_messages"] / times["readers.frames"]
    decoding = times["plain: iter_messages, struct per PGN"] / times["readers.frames, Decoder.measurements"]
    print(
        f"reading is {reading:.1f} times as fast as iter_messages, reading and decoding {decoding:.1f} times"
    )


if __name__ == "__main__":
    main()
