"""A drive with two steps, recorded with its results: what the tests of analysis read. Made once a run."""

import fcntl
import os
import pickle
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar

from logs import MACHINE, MACHINE_TEXT, SECOND, Live, record

from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.schemas.flow import Event, Frame, Publication
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import in_words
from tilth.simulator.scenario import Scenario
from tilth.simulator.traffic import simulate

SECONDS = 52.0
STEPS = Scenario(
    other_traffic=False, speed=4.5, steering=((6.0, 0.0), (16.0, 7.0), (6.0, 0.0), (16.0, -7.0), (8.0, 0.0))
)
MARKS = ((5.0, "west step start"), (23.5, "west step end"))  # s since the first frame


RUN_FOLDER = "TILTH_TESTS_RUN"
"""Variable: a folder that all processes of this run of the tests share (conftest.py)."""

Made = TypeVar("Made")


@cache
def _own() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="tilth-recorded-")


def _folder() -> Path:
    return Path(os.environ.get(RUN_FOLDER) or _own().name)


def once(name: str, make: Callable[[Path], Made]) -> Made:
    """What `make` gives of a folder: made by the first process that asks, kept for the others."""
    folder = _folder() / name
    with _folder().joinpath(f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        kept = folder / "made.pickle"
        if not kept.exists():
            folder.mkdir()
            kept.write_bytes(pickle.dumps(make(folder)))
    made: Made = pickle.loads(kept.read_bytes())
    return made


@cache
def frames() -> tuple[Frame, ...]:
    return once("frames", lambda folder: tuple(simulate(MACHINE, 3, SECONDS, STEPS)))


def recorded(parts: int = 1) -> Live:
    """The drive as the daemon logs it, in so many files."""
    return _recorded(parts)


@cache
def _recorded(parts: int) -> Live:
    return once(f"parts{parts}", lambda folder: record(folder, frames(), parts))


@cache
def marked() -> Path:
    """Frames of the drive, and marks of an operator; no results."""
    return once("marked", _marked)


def _marked(folder: Path) -> Path:
    path = folder / "marked.mcap"
    start_ns = frames()[0].t_ns
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("marked", 1, start_ns))
    waiting = [(start_ns + round(at_s * SECOND), text) for at_s, text in MARKS]
    for frame in frames():
        while waiting and frame.t_ns >= waiting[0][0]:
            t_ns, text = waiting.pop(0)
            writer.publications([Publication(t_ns, "/event", Event(t_ns, "mark", in_words(text)))])
        writer.frame(frame)
    writer.close()
    return path


def shared_cache() -> Path:
    """What tests keep for each other."""
    return _folder() / "cache"


@cache
def cut() -> Path:
    """The recorded drive without its last fifth, as a power cut leaves it."""
    return once("cut", _cut)


def _cut(folder: Path) -> Path:
    whole, path = recorded().parts[0], folder / "cut.mcap"
    path.write_bytes(whole.read_bytes()[: whole.stat().st_size * 4 // 5])
    return path
