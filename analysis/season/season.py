"""A season of logs: looked at, identified, put together, written down. What is done is not done again.

What a run gave lies in the season's folder under a name that is made of the hashes of its logs and machine
file, the version and the settings; it is there whole or not at all. So who is interrupted goes on with what
is missing, and the same season gives the same table.
"""

import errno
import fcntl
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tilth.analysis.runs.kept import key_of, load, packed, unpacked
from tilth.analysis.season.identified import Identified, RunTask, identified
from tilth.analysis.season.inventory import Inventory, Progress, SeasonRun, take_inventory
from tilth.analysis.season.stretches import DrivenRun, SeasonRow, driven, rows_of
from tilth.analysis.season.table import FORM as TABLE_FORM
from tilth.analysis.season.table import write_table
from tilth.analysis.workers.parts import LostPart, Parts
from tilth.logger.log import whole_file
from tilth.logger.log.software import software
from tilth.replay.readers.remote import is_remote
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.readable import reason_of

FORM: Final = 1  # of what is kept of a run; grows when its meaning changes
TABLE, SUMMARY, DONE, RUNS = "stretches.parquet", "season.html", "season.json", "runs"
_NO_ROOM: Final = (errno.ENOSPC, errno.EDQUOT)


class SeasonProblem(Exception):
    """The season cannot go on; one sentence that says what to do."""


@dataclass(frozen=True, slots=True)
class Season:
    """rows, runs: None where there was nothing to do. done: what season.json says."""

    out: Path
    done: dict[str, object]
    inventory: Inventory
    rows: tuple[SeasonRow, ...] | None = None
    runs: tuple[DrivenRun, ...] | None = None
    computed: int = 0  # runs
    not_kept: str = ""  # why what came of some runs could not be kept

    @property
    def table(self) -> Path:
        return self.out / TABLE


def season(
    paths: Sequence[str],
    out: Path,
    parts: Callable[[float], Parts],
    *,
    machine: MachineFile | None = None,
    retry: bool = False,
    progress: Progress = lambda what, done, of: None,
) -> Season:
    """paths: logs and folders of them, or URLs. parts: who computes, given the seconds that a run takes at
    most. machine: of logs that hold no machine file. retry: compute what has failed once more. Raises
    SeasonProblem, LostPart where nothing can be computed, OSError."""
    out.mkdir(parents=True, exist_ok=True)
    with _alone(out):
        (out / RUNS).mkdir(exist_ok=True)
        inventory = take_inventory(paths, out, machine, progress)
        if not inventory.runs:  # a season that is there stays as it is
            why = "".join(f"; {path}: {reason}" for path, reason in inventory.left_out)
            raise SeasonProblem(f"{', '.join(paths)}: no run was found; give logs, or folders of logs{why}")
        tasks = {run: _task(run, inventory) for run in inventory.runs}
        key = key_of("season", FORM, TABLE_FORM, *(task.key for task in tasks.values()), inventory.left_out)
        done = _done(out)
        if (
            done.get("key") == key
            and (out / TABLE).exists()
            and (out / SUMMARY).exists()
            and not (retry and done.get("failed"))
        ):
            return Season(out, done, inventory)
        found, computed, not_kept = _identify(tasks, out, parts, retry, progress)
        runs = driven(inventory, found)
        rows = rows_of(inventory, runs)
        write_table(out / TABLE, rows, inventory.machines)
        done = {
            "key": key, "runs": len(runs), "failed": sum(bool(one.found.failure) for one in runs),
            "rows": len(rows), "left_out": len(inventory.left_out),
            "look": sum(bool(one.look) for one in runs),
            "seconds": round(sum(one.seconds for one in runs), 3), "software": software()["version"],
        }  # fmt: skip
        return Season(out, done, inventory, tuple(rows), tuple(runs), computed, not_kept)


def finish(one: Season) -> None:
    """After all that is written of a season: it need not be made again. Raises OSError."""
    if not one.not_kept:
        whole_file.write(one.out / DONE, (json.dumps(one.done, indent=1) + "\n").encode())


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """One season at a time writes into a folder; what a killed one has left half is removed."""
    with (out / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SeasonProblem(f"{out}: another season is being written there; wait for it") from None
        except OSError:  # a file system without locks
            pass
        for half in out.rglob(".*.part"):
            half.unlink(missing_ok=True)
        yield


def _done(out: Path) -> dict[str, object]:
    with suppress(OSError, ValueError):
        found = json.loads((out / DONE).read_text(encoding="utf-8"))
        if isinstance(found, dict):
            return found
    return {}


def _task(run: SeasonRun, inventory: Inventory) -> RunTask:
    text, dbc = inventory.machines.get(run.machine, ("", None))
    shas = [file.sha256 for file in run.files]
    key = key_of("run", FORM, software()["estimator"], run.machine, *shas)
    paths = tuple(
        file.path if is_remote(file.path) and not file.read_at
        else str(Path(file.read_at or file.path).absolute())  # workers are elsewhere
        for file in run.files
    )  # fmt: skip
    return RunTask(key, paths, text, dbc)


def _identify(
    tasks: dict[SeasonRun, RunTask],
    out: Path,
    parts: Callable[[float], Parts],
    retry: bool,
    progress: Progress,
) -> tuple[dict[SeasonRun, Identified], int, str]:
    """(what came of each run; how many were computed; why some could not be kept)."""
    found: dict[SeasonRun, Identified] = {}
    missing: dict[RunTask, SeasonRun] = {}
    for run, task in tasks.items():
        kept = load(_file(out, task), Identified)
        if kept is not None and not (retry and kept.failure):
            found[run] = kept
        elif not task.machine_text:
            found[run] = Identified("no machine file is in this log; give --machine M.toml")
        else:
            missing[task] = run
    size = sum(run.size for run in tasks) or 1
    done = sum(run.size for run in found)
    progress("identifying", done, size)
    longest_s = max(
        ((run.files[-1].last_ns - run.files[0].first_ns) * 1e-9 for run in missing.values()), default=0.0
    )
    not_kept = ""
    largest_first = sorted(missing, key=lambda task: (-missing[task].size, task.key))
    with closing(parts(longest_s)(identified, largest_first)) as results:
        for task, stored in results:
            run = missing[task]
            if isinstance(stored, LostPart):
                stored = packed(Identified(str(stored)))
            one = unpacked(stored, Identified)
            assert one is not None
            found[run] = one
            try:
                whole_file.write(_file(out, task), stored)
            except OSError as error:
                not_kept = f"{out}: {reason_of(error)}"
                if error.errno not in _NO_ROOM:
                    raise
            done += run.size
            progress("identifying", done, size)
    return found, len(missing), not_kept


def _file(out: Path, task: RunTask) -> Path:
    return out / RUNS / f"{task.key}.kept"
