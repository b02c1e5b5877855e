"""What is on folders and sticks: which files are logs, of which runs, whole or cut, copies of one another.

Each file is looked at once; what was seen is kept by its path, size and time of change. The originals are
only read: what can be read of a log that was cut is written into the season's own folder.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from tilth.analysis.runs.kept import packed, sha256_of, unpacked
from tilth.analysis.runs.log_file import DAEMON_RUN
from tilth.analysis.runs.run import read_file
from tilth.logger.clock import DATED_NS
from tilth.logger.log import whole_file
from tilth.logger.log.recovery import COPY, NoLog, rescue
from tilth.replay.catalogue import BESIDE
from tilth.replay.glance import FileState, brief
from tilth.replay.readers.any_log import MCAP, open_log
from tilth.replay.readers.any_log import readable as forms_read
from tilth.replay.readers.log import ForeignLog, LogError
from tilth.replay.readers.remote import at_hand, files_at, is_remote
from tilth.replay.readers.rig import machine_in
from tilth.replay.simulated import REPLAY
from tilth.schemas.flow import Frame
from tilth.schemas.machine import MachineError
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.readable import readable, reason_of

SEEN: Final = "files.kept"  # in the season's folder
RECOVERED: Final = "recovered"
LOG_ENDINGS: Final = frozenset({".mcap", ".asc", ".blf", ".log", ".trc", ".mf4", ".pcap", ".pcapng", ".db3"})
"""Of a file in a folder that should be a log: one that is none is told of."""
_YEAR_2000_NS: Final = 946_684_800_000_000_000

Progress = Callable[[str, float, float], None]  # what, done, of all


@dataclass(frozen=True, slots=True)
class SeenFile:
    """What was seen of a file. Times of the log's clock, ns."""

    path: str
    size: int
    changed_ns: int  # when the file was changed; on storage elsewhere a number of its own for each version
    sha256: str = ""
    problem: str = ""  # why it cannot be used, a sentence
    told: str = ""  # what a person should know of it though it is used
    read_at: str = ""  # the file to be read instead: what was recovered
    first_ns: int = 0
    last_ns: int = 0
    utc_minus_ns: int | None = None
    run: str = ""  # id and start; "" where it tells of no run
    of_daemon: bool = False  # the id of the run is one that no other run has
    part: int = 0
    machine: str = ""  # SHA-256 of the machine file
    simulated: bool = False

    @property
    def utc_ns(self) -> int | None:
        """UTC of the first message; None where nobody told."""
        if self.utc_minus_ns is None or self.first_ns + self.utc_minus_ns < DATED_NS:
            return None
        return self.first_ns + self.utc_minus_ns


@dataclass(slots=True)
class SeenFiles:
    """All that was seen. machines: SHA-256 -> text and, where there is one, DBC file."""

    files: dict[str, SeenFile] = field(default_factory=dict)  # path ->
    machines: dict[str, tuple[str, str | None]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SeasonRun:
    """The files of one run, in order."""

    name: str
    files: tuple[SeenFile, ...]

    @property
    def utc_ns(self) -> int | None:
        """When it began."""
        return self.files[0].utc_ns

    @property
    def machine(self) -> str:
        """SHA-256 of the machine file: of the first part that has one."""
        return next((one.machine for one in self.files if one.machine), "")

    @property
    def size(self) -> int:
        return sum(one.size for one in self.files)


@dataclass(frozen=True, slots=True)
class Inventory:
    """Runs in order: by time, then by name, those without a time last. left_out: (path, why)."""

    runs: tuple[SeasonRun, ...]
    left_out: tuple[tuple[str, str], ...]
    machines: Mapping[str, tuple[str, str | None]]


def take_inventory(
    paths: Sequence[str], out: Path, given: MachineFile | None, progress: Progress
) -> Inventory:
    """paths: files and folders, on storage elsewhere as URLs. out: the season's folder. given: the machine
    file of logs that hold none.
    Raises OSError where nothing can be kept in it."""
    found, left_out = _files(paths, out)
    seen = unpacked(_kept(out / SEEN), SeenFiles) or SeenFiles()
    machines = dict(seen.machines)
    if given is not None:
        machines[given.sha256] = (given.text, given.machine.dbc_text)
    files: list[SeenFile] = []
    whole = sum(size for _, size, _, _ in found) or 1
    done = 0
    for path, size, changed_ns, named in found:
        progress("looking at files", done, whole)
        done += size
        before = seen.files.get(path)
        if before is None or (before.size, before.changed_ns) != (size, changed_ns) or before.problem:
            before = _look(SeenFile(path, size, changed_ns), out, machines)
            seen.files[path] = before
        if before.problem and not named and Path(path).suffix.lower() not in LOG_ENDINGS:
            continue  # a photo on a stick
        if not before.machine and given is not None and not before.problem:
            before = replace(before, machine=given.sha256)
        files.append(before)
    progress("looking at files", whole, whole)
    seen.machines = machines
    whole_file.write(out / SEEN, packed(seen))
    return _in_runs(files, left_out, machines)


def _kept(path: Path) -> bytes:
    with suppress(OSError):
        return path.read_bytes()
    return b""


def _files(paths: Sequence[str], out: Path) -> tuple[list[tuple[str, int, int, bool]], list[tuple[str, str]]]:
    """((path, bytes, time of change, whether it was given by name) of each file; (path, why not))."""
    found: dict[str, tuple[str, int, int, bool]] = {}
    left_out: list[tuple[str, str]] = []
    own = out.resolve()
    for given in paths:
        if is_remote(given):
            _list(given, found, left_out)
            continue
        for path in _walk(Path(given), left_out):
            resolved = path.resolve()
            if str(resolved) in found or own in resolved.parents:
                continue
            try:
                told = path.stat()
            except OSError as error:
                left_out.append((readable(str(path)), f"cannot be read ({reason_of(error)})"))
                continue
            found[str(resolved)] = (str(path), told.st_size, told.st_mtime_ns, path == Path(given))
    return list(found.values()), left_out


def _list(url: str, found: dict[str, tuple[str, int, int, bool]], left_out: list[tuple[str, str]]) -> None:
    """What storage elsewhere has. found, left_out: gain it."""
    try:
        for url_of, size, changed in files_at(url):
            below = url_of.removeprefix(url).split("/")
            if not any(name.startswith(".") for name in below) and not _is_beside(below[-1]):
                found.setdefault(url_of, (url_of, size, changed, url_of == url))
    except ForeignLog as error:
        left_out.append((readable(url), str(error).removeprefix(f"{url}: ")))


def _is_beside(name: str) -> bool:
    return name.endswith(COPY) or Path(name).suffix.lower() in BESIDE


def _walk(given: Path, left_out: list[tuple[str, str]]) -> Iterator[Path]:
    """Files of a folder and of those in it; a file itself."""
    if not given.is_dir():
        yield given
        return

    def cannot(error: OSError) -> None:
        left_out.append((readable(str(error.filename)), f"cannot be read ({reason_of(error)})"))

    for folder, names, files in os.walk(given, onerror=cannot):
        names[:] = sorted(name for name in names if not name.startswith("."))
        for name in sorted(files):
            if not (name.startswith(".") or _is_beside(name)):
                yield Path(folder) / name


def _look(file: SeenFile, out: Path, machines: dict[str, tuple[str, str | None]]) -> SeenFile:
    """What a file is. machines: gains its machine file."""
    shown = file.path
    try:
        with at_hand(file.path) as path:
            shown = str(path)
            with open_log(path).file as stream:
                stream.read(1)
            file = replace(file, sha256=sha256_of(path))
            return _of_tilth(file, path, out, machines) if _is_mcap(path) else _of_others(file, path)
    except (LogError, MachineError, NoLog) as error:
        text = str(error).removeprefix(f"{file.path}: ").removeprefix(f"{shown}: ")
        text = text.removesuffix(f"; {forms_read()}")  # long, and there may be many such files
        return replace(file, problem=readable(text))
    except OSError as error:
        return replace(file, problem=f"cannot be read ({reason_of(error)})")


def _is_mcap(path: Path) -> bool:
    log = open_log(path)
    with log.file:
        return log.form == MCAP


def _of_tilth(file: SeenFile, path: Path, out: Path, machines: dict[str, tuple[str, str | None]]) -> SeenFile:
    """Raises LogError, MachineError, NoLog, OSError."""
    told, state = "", brief(path).state
    if state is FileState.BEING_WRITTEN:
        raise NoLog("it is being recorded now; it counts when that run has ended")
    read = path
    if state is not FileState.WHOLE:
        read = out / RECOVERED / f"{file.sha256[:32]}.mcap"
        told = f"{'cut off' if state is FileState.UNFINISHED else 'damaged'}: what can be read of it is used"
        if not read.exists():
            _rescue(path, read)
    try:
        machine = machine_in([read])
    except ForeignLog:  # of an MCAP file of others; --machine may tell
        machine = None
    found = read_file(read)
    if not found.last_ns:
        raise NoLog("nothing was recorded in it, or all of it was cut off; copy it again if there is another")
    run = found.metadata.get("run", {})
    clock = found.metadata.get("clock", {}).get("utc_minus_t_ns", "")
    if clock.lstrip("-").isdecimal():
        ahead: int | None = int(clock)
    else:
        ahead = 0 if found.first_ns > _YEAR_2000_NS else None
    of_run = run.get("id", "") and REPLAY not in found.metadata
    if machine is not None:
        machines[machine.sha256] = (machine.text, machine.machine.dbc_text)
    return replace(
        file, told=told, read_at=str(read) if read != path else "", first_ns=found.first_ns,
        last_ns=found.last_ns, utc_minus_ns=ahead,
        run=f"{run.get('id', '')} {run.get('started_utc', '')}" if of_run else "",
        of_daemon=bool(DAEMON_RUN.fullmatch(run.get("id", ""))),
        part=int(run["part"]) if run.get("part", "").isdecimal() else 0,
        machine=machine.sha256 if machine is not None else "", simulated=bool(run.get("simulated")),
    )  # fmt: skip


def _rescue(path: Path, to: Path) -> None:
    """All of it under its name, or nothing. Raises NoLog, OSError."""
    to.parent.mkdir(exist_ok=True)
    part = to.with_name(f".{to.name}.{os.getpid()}.part")
    part.unlink(missing_ok=True)
    try:
        rescue(path, part)
        part.replace(to)
    finally:
        part.unlink(missing_ok=True)


def _of_others(file: SeenFile, path: Path) -> SeenFile:
    """A log that another program wrote; it holds no machine file. Raises LogError."""
    log = open_log(path)
    with log.file:
        first_ns = next((one.t_ns for one in log.records if isinstance(one, Frame)), 0)
    ahead = 0 if first_ns > _YEAR_2000_NS else None
    return replace(file, first_ns=first_ns, last_ns=first_ns, utc_minus_ns=ahead)


def _in_runs(
    files: Sequence[SeenFile],
    left_out: list[tuple[str, str]],
    machines: Mapping[str, tuple[str, str | None]],
) -> Inventory:
    left_out = [*left_out, *((readable(one.path), one.problem) for one in files if one.problem)]
    groups: dict[str, list[SeenFile]] = {}
    by_content: dict[str, SeenFile] = {}
    for one in sorted((one for one in files if not one.problem), key=lambda one: one.path):
        other = by_content.setdefault(one.sha256, one)
        if other is not one:
            left_out.append((readable(one.path), f"a copy of {readable(other.path)}"))
        else:
            groups.setdefault(_key(one, groups), []).append(one)
    runs = [_run(group, left_out) for group in groups.values()]
    ordered = sorted(runs, key=lambda run: (run.utc_ns is None, run.utc_ns or 0, run.name, run.files[0].path))
    return Inventory(tuple(ordered), tuple(sorted(left_out)), machines)


def _key(one: SeenFile, groups: Mapping[str, Sequence[SeenFile]]) -> str:
    """By which parts of a run are known to be of it. What a simulation or a replay wrote is a run by itself,
    where its number is one that another file has."""
    taken = one.part in [other.part for other in groups.get(one.run, ())]
    return one.run if one.run and (one.of_daemon or not taken) else one.path


def _run(group: Sequence[SeenFile], left_out: list[tuple[str, str]]) -> SeasonRun:
    """Of two files that hold the same part, as of a run of which a stick has the first half, the longer."""
    best: dict[int, SeenFile] = {}
    for one in group:
        other = best.get(one.part)
        if other is None or (other.last_ns, other.size) < (one.last_ns, one.size):
            best[one.part] = one
    for one in group:
        kept = best[one.part]
        if kept is not one:
            left_out.append((readable(one.path), f"holds less of the same driving as {readable(kept.path)}"))
    files = tuple(best[part] for part in sorted(best))
    stem = Path(files[0].path).stem
    return SeasonRun(readable(stem.removesuffix(f"_{files[0].part:03d}")), files)
