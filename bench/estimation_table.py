"""Tables of figures: what was reached and must be, runs on several processes, shares with their intervals."""

import json
import math
import os
import time
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from estimation_study import Case
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn
from rich.table import Table
from spatial_logs import CACHE

from tilth.estimator.record.windows import WINDOWS
from tilth.logger.fitting import ONE_THREAD

Array = NDArray[np.float64]

Z: float = 1.959964  # of a 95 % interval


@dataclass(frozen=True, slots=True)
class Line:
    """One figure: what was measured, and whether that is what it must be."""

    figure: str
    reached: str
    reach: str = ""
    held: bool | None = None  # None: nothing that it must be
    values: Sequence[float] = ()  # for --json


@dataclass(slots=True)
class Bench:
    """Where runs are made. pool None: in this process."""

    runs: int | None = None
    pool: ProcessPoolExecutor | None = None
    progress: Progress | None = None
    scale: float = 1.0  # of a window and a drive: less only to try whether a row works
    made: list[int] = field(default_factory=list)  # how many runs each call made
    logs: Path = CACHE  # where those of spatial rows are
    kept: Path | None = None  # file of lines of JSON: results of runs, and of rows
    only_kept: bool = False  # no run is made

    def each(
        self, run: Callable[[int], Any], default: int, have: dict[int, Any] | None = None,
        then: Callable[[Any], None] = lambda made: None,
    ) -> list[Any]:  # fmt: skip
        """The results of seeds 0 to N - 1, in that order; with `only_kept`, of those that there are.

        have: what there is already, by seed. then: is given each result that is new, as soon as it is there.
        """
        n, results = self.runs or default, dict(have or {})
        self.made.append(n)
        if self.only_kept:
            return [results[seed] for seed in range(n) if seed in results]
        for seed, made in self._new(run, [seed for seed in range(n) if seed not in results]):
            results[seed] = made
            then(made)
        return [results[seed] for seed in range(n)]

    def _new(self, run: Callable[[int], Any], seeds: list[int]) -> Iterator[tuple[int, Any]]:
        """(seed, result) in the order in which they are made."""
        if self.pool is None:
            yield from ((seed, run(seed)) for seed in seeds)
            return
        waiting = {self.pool.submit(run, seed): seed for seed in seeds}
        task = self.progress.add_task(f"{len(seeds)} runs", total=len(seeds)) if self.progress else None
        for done in as_completed(waiting):
            yield waiting[done], done.result()
            if self.progress and task is not None:
                self.progress.advance(task)

    def case(self, case: Case) -> Case:
        """The case, its drive as long as asked for."""
        seconds = max(case.scenario.seconds * self.scale, 12.0 if self.scale < 1 else 0.0)
        return replace(case, scenario=replace(case.scenario, seconds=seconds))

    @property
    def window(self) -> int:
        """Stretches of 0.2 s."""
        return round(WINDOWS.longest * self.scale)


def append_line(path: Path, made: Any) -> None:
    """Add a line of JSON to a file, whose last line may have been cut short."""
    with path.open("a+b") as stream:
        if stream.tell():
            stream.seek(-1, 2)
            if stream.read() != b"\n":
                stream.write(b"\n")
        stream.write(json.dumps(made, ensure_ascii=False).encode() + b"\n")


@dataclass(frozen=True, slots=True)
class Row:
    name: str
    reach: str  # in words
    make: Callable[[Bench], list[Line]]


def figures(values: Sequence[float] | Array, digits: int = 2) -> str:
    return "  ".join("–" if not math.isfinite(v) else f"{v:.{digits}f}" for v in values)


def percents(values: Sequence[float] | Array, digits: int = 1) -> str:
    return figures(100 * np.asarray(values), digits) + " %"


def wilson(hits: int, n: int) -> tuple[float, float]:
    """The 95 % interval of a share."""
    if n == 0:
        return 0.0, 1.0
    share, z2 = hits / n, Z * Z
    middle = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = Z * math.sqrt(share * (1 - share) / n + z2 / (4 * n * n)) / (1 + z2 / n)
    return middle - half, middle + half


def coverage(z: Array, least: float, most: float = 1.0, name: str = "coverage") -> list[Line]:
    """Pooled and of each parameter. z: errors over sds, (n, 6), not a number where none was given."""
    hits, given = np.sum(np.abs(z) < Z, axis=0), np.sum(np.isfinite(z), axis=0)
    pooled, all_ = int(hits.sum()), int(given.sum())
    if all_ == 0:
        return [Line(name, "no number was given in any run")]
    low, high = wilson(pooled, all_)
    reach = f"{100 * least:.0f} to {100 * most:.0f} %" if most < 1 else f"≥ {100 * least:.0f} %"
    shares = hits / np.maximum(given, 1)
    each = "  ".join(f"{h}/{n}" for h, n in zip(hits, given, strict=True))
    intervals = [wilson(int(h), int(n)) for h, n in zip(hits, given, strict=True)]
    intervals_text = "  ".join(f"{100 * a:.0f}–{100 * b:.0f}" for a, b in intervals)
    return [
        Line(
            f"{name}, pooled", f"{100 * pooled / all_:.1f} % of {all_} ({100 * low:.1f} to {100 * high:.1f})",
            reach, least <= pooled / all_ <= most, (pooled / all_, low, high),
        ),
        Line(
            f"{name}, each", percents(shares), reach,
            bool(np.all((shares >= least) & (shares <= most) | (given == 0))), shares.tolist(),
        ),
        Line("  of runs; 95 % interval of that share", f"{each}; {intervals_text} %"),
        Line("  mean, and root mean square, error over sd",
             f"{figures(np.nanmean(z, axis=0))}; {figures(np.sqrt(np.nanmean(z**2, axis=0)))}"),
    ]  # fmt: skip


def table_of(row: Row, lines: list[Line], note: str) -> Table:
    table = Table(title=f"{row.name}  ({note})", title_justify="left")
    for heading in ("figure", "reached", "to reach", ""):
        table.add_column(heading)
    verdicts = {True: "[green]held[/]", False: "[red]missed[/]", None: ""}
    for line in lines:
        table.add_row(line.figure, line.reached, line.reach, verdicts[line.held])
    return table


# Command lines of benches of many drives.


def drives_parser(doc: str | None, count: int, keep: str, drives: str = "drives") -> ArgumentParser:
    """The options that all of them have. keep: name of the file of what is done."""
    parser = ArgumentParser(description=doc, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=count, help=drives)
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path(keep), help="file of what is done")
    parser.add_argument("--summary", action="store_true", help="only read what is there")
    return parser


def drives_asked(parser: ArgumentParser) -> Namespace:
    """What was asked for, all numbers in range."""
    args = parser.parse_args()
    minutes = getattr(args, "minutes", 1.0)
    if args.count < 1 or args.first < 0 or args.processes < 1 or not 0.0 < minutes <= 600.0:
        parser.error("give a count, minutes and processes above zero, and no negative --first")
    return args


def print_rows(args: Namespace, rows: Sequence[Row], scale: float = 1.0, width: int = 170) -> None:
    """Make the rows, or read what is there of them, and print each as soon as it is there. A run that is
    stopped goes on where it was."""
    os.environ.update(dict(ONE_THREAD.items()))  # of the processes that are started below
    console = Console(width=None if Console().is_terminal else width)
    bench = Bench(args.count, kept=args.keep, scale=scale, only_kept=args.summary)
    columns = (*Progress.get_default_columns(), TimeElapsedColumn())
    with (
        ProcessPoolExecutor(args.processes, get_context("spawn")) as pool,
        Progress(*columns, console=console, transient=True) as progress,
    ):
        for row in rows:
            began = time.perf_counter()
            lines = row.make(replace(bench, pool=pool, progress=progress))
            console.print(table_of(row, lines, f"{time.perf_counter() - began:.0f} s; {row.reach}"))
