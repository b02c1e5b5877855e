"""The recorded runs in folders and files, each with its length, its place and what was learned in it.

Read from the logs' indexes, as `tilth logs` does.
"""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from tilth.logger.clock import DATED_NS, utc_text
from tilth.logger.log.runs import stored_runs
from tilth.replay.glance import FileState, Glance, glance
from tilth.replay.readers.any_log import MCAP, open_log
from tilth.replay.readers.log import EmptyLog, ForeignLog, LogError
from tilth.replay.simulated import simulated_by
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.readable import readable

BESIDE: Final = frozenset({".json", ".csv", ".toml", ".txt", ".html", ".png"})  # in a folder no logs, mostly

_PART: Final = re.compile(r"(?<=\dZ)_\d{3,}$")  # at the end of a name, of a file of a run


@dataclass(frozen=True, slots=True)
class CatalogueRun:
    """A run's files, in their order."""

    name: str
    paths: tuple[Path, ...]
    notes: tuple[str, ...] = ()


def run_files(paths: Sequence[Path]) -> list[CatalogueRun]:
    """The runs in these files and folders, the newest last. Files of one run are put together; so are files
    that others wrote, given by name. Raises LogError where there is none."""
    found: list[CatalogueRun] = []
    for path in paths:
        if path.is_dir():
            found += _in_folder(path)
        else:
            _add_file(found, path)
    return _named_apart(found)


def _in_folder(folder: Path) -> list[CatalogueRun]:
    stored = stored_runs(folder)
    found = []
    for run in stored:
        notes = list[str]()
        with suppress(ValueError, OSError):
            notes = run.sidecar().notes
        found.append(CatalogueRun(readable(run.name), run.files, tuple(notes)))
    known = {path for run in stored for path in run.files}
    for path in sorted(folder.iterdir()):
        if path in known or not path.is_file() or path.suffix in BESIDE:
            continue
        with suppress(LogError):
            open_log(path).file.close()
            found.append(CatalogueRun(readable(path.stem), (path,)))
    if not found:
        raise ForeignLog(f"{folder}: no run is in it; name the folder that the logs are in")
    return found


def _add_file(found: list[CatalogueRun], path: Path) -> None:
    """Raises LogError."""
    with suppress(EmptyLog):
        open_log(path).file.close()
    run, part = _run_part(path)
    for number, other in enumerate(found):
        parts = [_run_part(one) for one in other.paths]
        if parts[0][0] == run and (not run or (run, part) not in parts):  # a copy, or another replay, is none
            found[number] = replace(other, paths=(*other.paths, path))
            return
    found.append(CatalogueRun(readable(_PART.sub("", path.stem)), (path,)))


def _run_part(path: Path) -> tuple[str, str]:
    """Of one of Tilth's own logs; "" of any other."""
    if not _is_mcap(path):
        return "", ""
    found = glance(path)
    return found.run, found.part


def _is_mcap(path: Path) -> bool:
    try:
        log = open_log(path)
    except LogError:
        return False
    log.file.close()
    return log.form == MCAP


def _named_apart(found: Sequence[CatalogueRun]) -> list[CatalogueRun]:
    names = [run.name for run in found]
    return [
        replace(run, name=f"{run.name} ({number})") if names.count(run.name) > 1 else run
        for number, run in enumerate(found, 1)
    ]


def has_results(paths: Sequence[Path]) -> bool:
    """Whether poses were logged, so that it can be played as it is. Raises OSError."""
    return any(_is_mcap(path) and glance(path).pose is not None for path in paths)


def listing(run: CatalogueRun, prepared: Path | None = None) -> pb.RunListing:
    """What is told of a run. prepared: what a replay gave of it, where that is there. Raises OSError."""
    own = [glance(path) for path in run.paths if _is_mcap(path)]
    found, row = own, pb.RunListing(name=run.name)
    if prepared is not None and prepared.exists() and not any(one.pose for one in own):
        found = [replace(glance(prepared), machine="", note="")]
    row.state = _state(own, found)
    dated = [one for one in found if one.last_ns]
    if dated:
        _tell_times(row, dated)
    if pose := next((one.pose for one in found if one.pose is not None), None):
        row.latitude_deg, row.longitude_deg = pose.origin_latitude_deg, pose.origin_longitude_deg
    if estimate := next((one.estimate for one in reversed(found) if one.estimate is not None), None):
        row.learned.CopyFrom(estimate)
    row.simulated = bool(simulated_by(run.paths))
    row.machine = next((one.machine for one in own if one.machine), "")
    row.notes.extend(dict.fromkeys([*(one.note for one in own if one.note), *run.notes]))
    return row


def _state(own: Sequence[Glance], found: Sequence[Glance]) -> str:
    """What is to be said of a run. found: of the replayed log where its own holds no results."""
    states = {one.state for one in own}
    for state, words in (
        (FileState.BEING_WRITTEN, "is being recorded now"),
        (FileState.UNFINISHED, "cut off: plays as far as it is whole"),
        (FileState.DAMAGED, "damaged: plays what can be read"),
    ):
        if state in states:
            return words
    if any(one.pose for one in found) or found is not own:
        return ""
    holds = "frames and no result" if own else "frames of another program"
    return f"holds {holds}: replayed when it is opened"


def _tell_times(row: pb.RunListing, dated: Sequence[Glance]) -> None:
    row.length_s = (dated[-1].last_ns - dated[0].first_ns) * 1e-9
    began_ns = dated[0].first_ns + dated[-1].utc_minus_ns
    row.began = utc_text(began_ns) if began_ns >= DATED_NS else ""
