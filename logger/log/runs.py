"""The runs in a log folder: which files are whose, what people have noted of them, what may be deleted.

What a person or a copy adds after a run stands beside its files in <run>.json: `keep`, `notes`, and for each
file that was copied off its size, SHA-256 and where to. The log files themselves are never touched again.
"""

import calendar
import json
import re
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tilth.logger.clock import EARLIEST_NS, utc_text
from tilth.logger.log import whole_file
from tilth.logger.log.disk import sync_folder
from tilth.schemas.readable import readable

STAMP = "%Y%m%dT%H%M%SZ"
_FILE = re.compile(r"(?P<run>.+_(?P<stamp>\d{8}T\d{6}Z))_(?P<part>\d{3,})\.mcap", re.DOTALL)
DAY_NS = 86_400_000_000_000


@dataclass(frozen=True, slots=True)
class Copied:
    """A file that was copied off, and that the copy was read back and compared."""

    size: int
    sha256: str
    to: str


@dataclass(slots=True)
class Sidecar:
    """What people and copies add to a run after it: <run>.json next to its files."""

    keep: bool = False
    notes: list[str] = field(default_factory=list)
    copied: dict[str, Copied] = field(default_factory=dict)  # file name -> its copy

    @property
    def text(self) -> str:
        """As it stands in the file; a file name that is not UTF-8 is escaped."""
        return readable(json.dumps(asdict(self), indent=1, ensure_ascii=False))


@dataclass(frozen=True, slots=True)
class StoredRun:
    """A run's files in order, and the time in its name; 0 where that cannot be right."""

    folder: Path
    name: str
    started_ns: int
    files: tuple[Path, ...]

    @property
    def missing_parts(self) -> list[int]:
        """Numbers of missing parts before the last one."""
        there = {int(path.stem.rpartition("_")[2]) for path in self.files}
        return sorted(set(range(1, max(there))) - there)

    @property
    def sidecar_path(self) -> Path:
        return self.folder / f"{self.name}.json"

    def sidecar(self) -> Sidecar:
        """Read the sidecar. Raises ValueError where it cannot be understood, and OSError."""
        try:
            plain: dict[str, Any] = json.loads(whole_file.read(self.sidecar_path).decode())
            copied = {name: Copied(**copy) for name, copy in plain["copied"].items()}
            return Sidecar(bool(plain["keep"]), [readable(note) for note in plain["notes"]], copied)
        except FileNotFoundError:
            return Sidecar()
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise ValueError(
                f"{self.sidecar_path}: cannot be understood ({error}); mend or remove it"
            ) from None

    def write_sidecar(self, sidecar: Sidecar) -> None:
        """Write the sidecar: all or nothing, also in a power cut. Raises OSError."""
        whole_file.write(self.sidecar_path, sidecar.text.encode())
        sync_folder(self.folder)


def run_name(machine: str, utc_ns: int) -> str:
    """<machine>_<UTC>, from ns since 1970."""
    return f"{machine}_{utc_text(utc_ns, STAMP)}"


def unused_name(folder: Path, machine: str, utc_ns: int) -> str:
    """<machine>_<UTC>, a second later while a run has that name: a computer without a battery-backed clock
    starts every day at the same instant."""
    while folder.is_dir() and any(folder.glob(f"{run_name(machine, utc_ns)}_*.mcap")):
        utc_ns += 1_000_000_000
    return run_name(machine, utc_ns)


def file_name(run: str, part: int) -> str:
    """<run>_<part>.mcap, the part with three digits."""
    return f"{run}_{part:03d}.mcap"


def stored_runs(folder: Path) -> list[StoredRun]:
    """Every run in a folder, oldest first; those whose time is not known come first."""
    files: dict[str, list[tuple[int, Path]]] = {}
    started: dict[str, int] = {}
    for path in folder.glob("*.mcap"):
        match = _FILE.fullmatch(path.name)
        if match is not None and path.is_file():
            run = match["run"]
            files.setdefault(run, []).append((int(match["part"]), path))
            started[run] = _started_ns(match["stamp"])
    runs = [
        StoredRun(folder, run, started[run], tuple(path for _, path in sorted(paths)))
        for run, paths in files.items()
    ]
    return sorted(runs, key=lambda run: (run.started_ns, run.name))


def _started_ns(stamp: str) -> int:
    try:
        utc_ns = calendar.timegm(time.strptime(stamp, STAMP)) * 1_000_000_000
    except ValueError:  # a name of somebody's own
        return 0
    return utc_ns if utc_ns >= EARLIEST_NS else 0


def may_go(run: StoredRun, utc_ns: int | None, expire_days: float | None) -> bool:
    """Whether the run may be deleted: it was copied off, or has expired.

    utc_ns: now, None where that is not known: then no run is too old, and neither is one of unknown time.
    """
    try:
        sidecar = run.sidecar()
    except (ValueError, OSError):
        return False
    if sidecar.keep:
        return False
    copies = (sidecar.copied.get(path.name) for path in run.files)
    if all(
        copy is not None and copy.size == path.stat().st_size
        for copy, path in zip(copies, run.files, strict=True)
    ):
        return True
    if utc_ns is None or expire_days is None or not run.started_ns:
        return False
    return utc_ns - run.started_ns > expire_days * DAY_NS


def delete(run: StoredRun) -> int:
    """Remove a run's files; how many bytes that gave. Raises OSError."""
    size = 0
    for path in run.files:
        size += path.stat().st_size
        path.unlink()
    run.sidecar_path.unlink(missing_ok=True)
    sync_folder(run.folder)
    return size
