"""Writes what runs hold to files that other programs read, chunk by chunk as the logs are read.

A run gets a folder of its own, which has its name only once all is in it: OUT/<run>/pose.parquet, a file for
each channel, or one file for all on a common clock. `export.json` beside them says what they are.
"""

import contextlib
import json
import math
import os
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from tilth.analysis.export.clock import MOST_TICKS, ChannelSenders, ClockTable, Ticks, ages, ticks_of
from tilth.analysis.export.columns import ExportColumn, ExportRows, rows_of, rows_of_frames
from tilth.analysis.export.facts import described, facts_of
from tilth.analysis.export.files import FORMATS, ExportError, TableFile
from tilth.analysis.export.naming import CAN, TOPICS, channels_in
from tilth.analysis.runs.kept import Progress, no_progress
from tilth.analysis.runs.run import Run
from tilth.analysis.runs.table import Table
from tilth.replay.readers.arrays import frame_parts
from tilth.replay.readers.log import EmptyLog
from tilth.schemas.frame_columns import FrameColumns
from tilth.schemas.readable import readable, reason_of

CLOCK: Final = "clock"  # the file of all channels
ABOUT: Final = "export.json"
FRAMES_AT_ONCE: Final = 50_000
SPREADSHEET_ROWS: Final = 1_048_576  # that spreadsheets show


@dataclass(frozen=True, slots=True)
class ExportPlan:
    """What is exported, and how. Times s since the run began."""

    form: str  # a row of FORMATS
    channels: tuple[str, ...]
    clock_ns: int | None = None  # of a common clock
    from_s: float = 0.0
    until_s: float = math.inf

    @property
    def cut(self) -> bool:
        """Whether not the whole run is wanted."""
        return self.from_s > 0 or self.until_s < math.inf


@dataclass(slots=True)
class Exported:
    """One run, exported."""

    run: str
    folder: Path
    rows: dict[str, int] = field(default_factory=dict)  # file -> rows
    skipped: Counter[str] = field(default_factory=Counter)  # what could not be read -> count
    late: int = 0  # rows that came too late for the clock


def folders_of(runs: Sequence[Run], out: Path) -> list[Path]:
    """A folder for each run, named after it; a second run of that name gets a number. Raises ExportError
    where one exists."""
    names: list[str] = []
    for run in runs:
        plain = re.sub(r"[^\w.-]", "_", run.id).lstrip(".") or "run"
        name, number = plain, 1
        while name in names:
            number += 1
            name = f"{plain}_{number}"
        names.append(name)
    for name in names:
        if (out / name).exists() or (out / name).is_symlink():
            raise ExportError(f"{out / name}: exists; nothing is overwritten, give another folder with --out")
    return [out / name for name in names]


def check(run: Run, plan: ExportPlan) -> None:
    """Find out before anything is written that nothing would be. Raises ExportError, OSError."""
    if plan.from_s > run.duration_s:
        raise ExportError(f"{run.id} lasts {run.duration_s:.1f} s; --from {plan.from_s:g} is behind its end")
    there = channels_in(run)
    if there is not None and not set(there) & set(plan.channels):
        raise ExportError(f"{run.id}: {', '.join(plan.channels)}: not in it; there are {', '.join(there)}")
    if plan.clock_ns and len(_ticks(run, plan)) > MOST_TICKS:
        raise ExportError(f"{run.id}: --clock would give {len(_ticks(run, plan)):,} rows; give a longer one")


def export(run: Run, plan: ExportPlan, folder: Path, progress: Progress = no_progress) -> Exported:
    """Write a run to a new folder. progress: takes (done, all) of bytes.

    Raises ExportError, OSError; then nothing is left, as after an interrupt.
    """
    with _unfinished(folder) as place:
        facts = facts_of(run) | {"from_s": plan.from_s, "until_s": min(plan.until_s, run.duration_s)}
        if plan.clock_ns is not None:
            facts["clock"] = {"period_s": plan.clock_ns / 1e9, "oldest_s": ages([*plan.channels])}
        done = Exported(run.id, folder)
        with contextlib.closing(_Files(plan, place, facts, folder.name)) as files:
            passes = _Passes(run, plan, progress)
            if plan.clock_ns is None:
                _each_channel(run, plan, passes, files)
            else:
                done.late = _on_clock(run, plan, passes, files)
            files.finish()
        if not files.rows:
            raise ExportError(
                f"{run.id}: of {', '.join(plan.channels)} nothing is in it there; nothing written"
            )
        done.rows, done.skipped = files.rows, passes.skipped()
        about = {**facts, "skipped": dict(done.skipped), "files": files.about()}
        text = readable(json.dumps(about, indent=2, ensure_ascii=False))
        (place / ABOUT).write_text(text + "\n", encoding="utf-8")
    return done


@contextlib.contextmanager
def _unfinished(folder: Path) -> Iterator[Path]:
    """A folder that gets its name at the end; a failure or an interrupt leaves neither, nor one above that
    was made for it."""
    made = [parent for parent in folder.parents if not parent.exists()]
    place = folder.with_name(f"{folder.name}.{os.getpid()}.part")
    try:
        try:
            place.mkdir(parents=True)
        except PermissionError:
            raise
        except OSError as error:
            raise ExportError(
                f"{folder.parent}: no folder can be made in it ({reason_of(error)}); give another"
            ) from None
        yield place
        if folder.exists():
            raise ExportError(f"{folder}: exists by now; nothing is overwritten")
        place.rename(folder)
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        for parent in made:
            with contextlib.suppress(OSError):
                parent.rmdir()
        raise


class _Files:
    """The files of a run, each made when the first rows come."""

    def __init__(self, plan: ExportPlan, place: Path, facts: dict[str, object], run: str) -> None:
        self._plan, self._place, self._facts, self._run = plan, place, facts, run
        self._filled: dict[str, frozenset[str]] = {}
        self._empty: dict[str, list[str]] = {}
        self._open: dict[str, TableFile] = {}
        self._columns: dict[str, Sequence[ExportColumn]] = {}
        self.rows: dict[str, int] = {}

    def look(self, name: str, rows: ExportRows) -> None:
        """Rows that will be written: which columns of the file will hold anything."""
        self._filled[name] = self._filled.get(name, frozenset()) | rows.filled()

    def know(self, name: str, rows: ExportRows, empty: frozenset[str]) -> None:
        """Instead of `look`: that only these columns will hold nothing."""
        self._filled[name] = frozenset(column.name for column in rows.columns) - empty

    def write(self, name: str, rows: ExportRows) -> None:
        """Add rows to the file of a channel, without columns that stay empty in all of it."""
        if not len(rows):
            return
        file = f"{name}.{self._plan.form}"
        empty = frozenset(column.name for column in rows.columns) - self._filled[name]
        self._empty[file] = sorted(empty)
        rows = rows.but(empty).of_run(self._run)
        if file not in self._open:
            facts = {**self._facts, "columns": described(rows.columns)}
            self._open[file] = FORMATS[self._plan.form](self._place / file, rows.columns, facts)
            self._columns[file], self.rows[file] = rows.columns, 0
        self._open[file].write(rows)
        self.rows[file] += len(rows)

    def finish(self) -> None:
        for name in list(self._open):
            self._open[name].close()
            del self._open[name]

    def close(self) -> None:
        """Let go of what was not finished."""
        for file in self._open.values():
            file.abandon()

    def about(self) -> dict[str, object]:
        return {
            name: {"rows": rows, "columns": described(self._columns[name]), "empty": self._empty[name]}
            for name, rows in self.rows.items()
        }


class _Passes:
    """Reads a run, once or twice, and says how far it is."""

    def __init__(self, run: Run, plan: ExportPlan, progress: Progress) -> None:
        self._run, self._plan, self._progress = run, plan, progress
        self._size = sum(file.path.stat().st_size for file in run.files)
        self._topics = {TOPICS[name]: name for name in plan.channels if name in TOPICS}
        of_tables = 0 if not self._topics else 2 if plan.clock_ns is None else 3
        self._all = self._size * (of_tables + (CAN in plan.channels))
        self._before = 0
        self._of_frames: dict[str, int] = {}

    @property
    def no_day(self) -> frozenset[str]:
        """Columns that are empty where the run does not know UTC."""
        return frozenset() if self._run.reader.clock.utc_minus_ns is not None else frozenset({"utc_s", "utc"})

    def _heard(self, read: int) -> None:
        self._progress(self._before + read, self._all)

    def tables(self) -> Iterator[tuple[str, Table]]:
        """(channel, rows of the span, and on a clock those before it) of all but raw frames."""
        if not self._topics:
            return
        plan, reader = self._plan, self._run.reader
        reader.skipped.clear()
        lead_s = 0.0 if plan.clock_ns is None else max(ages([*plan.channels]).values())
        for topic, table in reader.tables([*self._topics], self._heard):
            if plan.cut:
                table = table.between(plan.from_s - lead_s, plan.until_s)
            if table.rows:
                yield self._topics[topic], table
        self._before += self._size

    def frames(self) -> Iterator[ExportRows]:
        """Raw frames."""
        plan, buses = self._plan, dict[str, int]()
        for part in self._frame_parts(buses):
            rows = rows_of_frames(part, tuple(buses), self._run.reader.clock)
            if plan.cut:
                t_s = rows.named("t_s")
                rows = rows.take((t_s >= plan.from_s) & (t_s < plan.until_s))
            yield rows

    def _frame_parts(self, buses: dict[str, int]) -> Iterator[FrameColumns]:
        """Some chunks at once: a small part costs more than its rows."""
        gathered: list[FrameColumns] = []
        for file in self._run.files:
            try:
                for part in frame_parts(file.path, buses, self._of_frames, self._heard):
                    gathered.append(part)
                    if sum(len(one.t_ns) for one in gathered) >= FRAMES_AT_ONCE:
                        yield _joined(gathered)
                        gathered.clear()
            except EmptyLog:  # results alone
                pass
            self._before += file.path.stat().st_size
        if gathered:
            yield _joined(gathered)

    def skipped(self) -> Counter[str]:
        """What could not be read: of two passes over the same, the one that saw more."""
        found = Counter({what: count for what, count in self._run.reader.skipped.items() if count})
        for what, count in self._of_frames.items():
            found[what] = max(found[what], count)
        return found


def _joined(parts: Sequence[FrameColumns]) -> FrameColumns:
    return FrameColumns._make(map(np.concatenate, zip(*parts, strict=True)))


def _each_channel(run: Run, plan: ExportPlan, passes: _Passes, files: _Files) -> None:
    for name, table in passes.tables():
        files.look(name, rows_of(table))
    for name, table in passes.tables():
        files.write(name, rows_of(table))
    if CAN in plan.channels:
        for rows in passes.frames():  # of these only the time of day can be empty: they are read once
            files.know(CAN, rows, passes.no_day)
            files.write(CAN, rows)


def _on_clock(run: Run, plan: ExportPlan, passes: _Passes, files: _Files) -> int:
    """All in one file; how many rows came too late."""
    senders = ChannelSenders()
    for name, table in passes.tables():
        senders.take(name, table)
    if not senders.found:
        return 0
    for use in (files.look, files.write):
        made = ClockTable(senders, _ticks(run, plan), run.reader.clock)
        for name, table in passes.tables():
            for rows in made.take(name, table):
                use(CLOCK, rows)
        for rows in made.end():
            use(CLOCK, rows)
    return made.late


def _ticks(run: Run, plan: ExportPlan) -> Ticks:
    assert plan.clock_ns is not None
    return ticks_of(plan.clock_ns, plan.from_s, plan.until_s, run.duration_s)
