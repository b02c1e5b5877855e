"""A drive with two steps, recorded with its results: what the tests of analysis read. Made once a process."""

import tempfile
from functools import cache
from pathlib import Path

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


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="tilth-recorded-")


@cache
def frames() -> tuple[Frame, ...]:
    return tuple(simulate(MACHINE, 3, SECONDS, STEPS))


def recorded(parts: int = 1) -> Live:
    """The drive as the daemon logs it, in so many files."""
    return _recorded(parts)


@cache
def _recorded(parts: int) -> Live:
    folder = Path(_folder().name) / f"parts{parts}"
    folder.mkdir()
    return record(folder, frames(), parts)


@cache
def marked() -> Path:
    """Frames of the drive, and marks of an operator; no results."""
    path = Path(_folder().name) / "marked.mcap"
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


@cache
def shared_cache() -> Path:
    """What tests keep for each other."""
    return Path(_folder().name) / "cache"


@cache
def cut() -> Path:
    """The recorded drive without its last fifth, as a power cut leaves it."""
    whole = recorded().parts[0]
    path = whole.with_name("cut.mcap")
    path.write_bytes(whole.read_bytes()[: whole.stat().st_size * 4 // 5])
    return path
