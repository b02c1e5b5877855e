"""Logs for the tests of replay: written as the daemon writes them, read back whole."""

import contextlib
import importlib
import re
import struct
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from paths import MACHINE_FILE as MACHINE_FILE

from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.logger.machine_file import read_machine
from tilth.replay.compare import IDENTICAL
from tilth.replay.readers.any_log import frames, open_log
from tilth.replay.readers.log import LogError, Logged, OpenLog
from tilth.schemas.channels import CHANNEL, TIE_TOPIC
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine, Quantity
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.simulator.simulate import Candump

if TYPE_CHECKING:
    import can

MACHINE, MACHINE_TEXT = read_machine(MACHINE_FILE)
OTHER_TEXT = re.sub(r'(name = "[0-9A-F]{13})[0-9A-F](..")', r"\g<1>A\2", MACHINE_TEXT)
"""The machine file of a rig like it, whose devices have other numbers."""
SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND
SECONDS = 18.0  # of the simulated run


def some_frames(count: int, seed: int = 7) -> list[Frame]:
    rng = np.random.default_rng(seed)
    return [
        Frame(
            t_ns=START_NS + i * 1_234_000,
            rx_ns=START_NS + i * 1_234_000 - int(rng.integers(900_000)),
            bus=("can0", "implement")[int(rng.integers(2))],
            can_id=int(rng.integers(1 << 29)),
            extended=True,
            error=False,
            data=rng.bytes((0, 3, 8, 8, 8)[int(rng.integers(5))]),
        )
        for i in range(count)
    ]


def frames_in(path: Path) -> int:
    """How many a log holds by now, which may still be written."""
    count = 0
    with contextlib.suppress(LogError):
        for _ in frames(path):
            count += 1
    return count


def with_exact_lengths(machine: Machine) -> Machine:
    """The same, sure of hitch and drawbar: a simulation draws them no more."""
    sure = {
        body: part.model_copy(update={key: Quantity(value=getattr(part, key).value) for key in keys})
        for body, part, keys in (("tractor", machine.tractor, "c"), ("implement", machine.implement, "de"))
    }
    return machine.model_copy(update=sure)


def write_mcap(
    path: Path,
    rows: Iterable[Frame],
    chunk_kilobytes: int = 1,
    finish: bool = True,
    text: str = MACHINE_TEXT,
    run: str = "run",
) -> Path:
    """As the daemon does; where it does not finish, as a kill leaves it. text: of the machine file in it.
    run: its id."""
    log = MACHINE.log.model_copy(update={"chunk_kilobytes": chunk_kilobytes})
    writer = LogWriter(
        path, MachineFile(MACHINE.model_copy(update={"log": log}), text), RunPart(run, 1, START_NS)
    )
    for row in rows:
        writer.frame(row)
    if finish:
        writer.close()
    else:
        writer.flush()
        writer.abandon()
    return path


def write_candump(path: Path, rows: Iterable[Frame]) -> Path:
    """As another program logs them."""
    writer = Candump(path)
    for row in rows:
        writer.frame(row)
    writer.close()
    return path


def drained(path: Path) -> tuple[list[Frame], OpenLog]:
    log = open_log(path)
    return [record for record in log.records if isinstance(record, Frame)], log


def messages(count: int) -> "list[can.Message]":
    """Of two channels; every seventh is short with an 11-bit identifier."""
    import can  # here, since conftest.py says how it is imported

    return [
        can.Message(
            timestamp=1_700_000_000 + i * 0.00125,
            arbitration_id=0x18FEF300 + i % 40 if i % 7 else 0x123,
            is_extended_id=i % 7 != 0,
            data=bytes((i + k) % 256 for k in range(8 if i % 7 else 2)),
            channel=i % 2,
        )
        for i in range(count)
    ]


def write_with_can(path: Path, rows: "list[can.Message]") -> Path:
    import can.io.mf4

    if path.suffix == ".mf4":
        importlib.reload(can.io.mf4)  # with asammdf now, which only this needs
    with can.Logger(str(path)) as writer:
        for row in rows:
            writer.on_message_received(row)
    return path


@dataclass(frozen=True, slots=True)
class Live:
    """A run as the daemon logs it: each frame, then what it gave; a state at the head of further parts."""

    rows: list[Frame]
    parts: list[Path]
    results: int


def record(folder: Path, rows: Sequence[Frame], parts: int, run: str = "r") -> Live:
    fold = GuardedFold(MACHINE)
    paths = []
    results = 0
    each = -(-len(rows) // parts)
    for part in range(parts):
        path = folder / f"{run}_{part + 1:03d}.mcap"
        writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart(run, part + 1, rows[0].t_ns))
        if part:
            writer.snapshot(rows[part * each].t_ns, fold.renew())
        for row in rows[part * each : (part + 1) * each]:
            writer.frame(row)
            for publication, data in fold.take(row):
                writer.message(publication.topic, publication.t_ns, data)
                results += publication.topic != TIE_TOPIC
        writer.close()
        paths.append(path)
    return Live(list(rows), paths, results)


def results_of(paths: Sequence[Path], topics: frozenset[str] = IDENTICAL) -> dict[str, list[Logged]]:
    found: dict[str, list[Logged]] = defaultdict(list)
    for path in paths:
        for row in open_log(path, topics).records:
            if isinstance(row, Logged):
                found[row.topic].append(row)
    return dict(found)


def altered(live: Live, folder: Path, topic: str, count: int, change: str) -> Path:
    """The first part with result number `count` of a topic changed, left out, or there twice."""
    path = folder / "altered.mcap"
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("r", 1, 0))
    observed = 0
    for row in open_log(live.parts[0], IDENTICAL).records:
        if isinstance(row, Frame):
            writer.frame(row)
        elif isinstance(row, Logged):
            observed += row.topic == topic
            hit = row.topic == topic and observed == count
            data = row.data
            if hit and change == "value":
                message = CHANNEL[topic].message.FromString(data)
                assert isinstance(message, pb.Pose)
                message.tractor.heading += 1e-12
                data = message.SerializeToString()
            if not (hit and change == "missing"):
                writer.message(row.topic, row.t_ns + (hit and change == "time"), data)
            if hit and change == "twice":
                writer.message(row.topic, row.t_ns, data)
    writer.close()
    return path


def chunk_ends(content: bytes) -> list[int]:
    """Where the chunks of a file end."""
    ends, at = [], 8
    while at < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, at)
        at += 9 + length
        if opcode == 6:
            ends.append(at)
    return ends
