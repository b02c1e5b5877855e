"""What `tilth sensitivity --global` adds: sensitivities over many rigs, with progress and the time left."""

import argparse
import math
from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Final, cast

import numpy as np
from rich.console import Console
from rich.table import Table as RichTable

from tilth.analysis.runs.kept import cache_folder, caches, has_room
from tilth.analysis.runs.run import open_runs
from tilth.analysis.sensitivity.answers import GlobalEntry, GlobalRow, LocalEntry, SensitivityAnswer
from tilth.analysis.sensitivity.designs import (
    DISSERTATION,
    Design,
    Grid,
    LogNormal,
    ParameterBox,
    Uniform,
    described,
)
from tilth.analysis.sensitivity.global_answer import global_answer, with_indices
from tilth.analysis.sensitivity.global_page import outputs_with_indices, with_interval
from tilth.analysis.sensitivity.indices_answer import indices_answer
from tilth.analysis.sensitivity.knowledge import of_run
from tilth.analysis.sensitivity.outputs import SIX
from tilth.analysis.sensitivity.run_batches import GlobalPlan, run
from tilth.analysis.workers.parts import LostPart
from tilth.cli import WrongUse, at_least, say
from tilth.cli.desk_options import check_name
from tilth.cli.parts_options import add_parts, parts_of
from tilth.cli.progress_bar import bars
from tilth.estimator.models.parameters import Rig
from tilth.estimator.models.step_responses import FIELDS
from tilth.schemas.log_settings import Log

_say = partial(say, "sensitivity")

FEWEST: Final = 100  # points


def add_global(parser: argparse.ArgumentParser) -> None:
    """The options of a global analysis."""
    parser.add_argument(
        "--global",
        dest="over_all",
        action="store_true",
        help="also over many rigs: the grid of 390,625 of the dissertation's table 6.2, minutes per speed; "
        "an interrupted computation continues where it was",
    )
    parser.add_argument(
        "--points",
        type=at_least(FEWEST),
        metavar="N",
        help="with --global: N random rigs of the box instead of the grid",
    )
    parser.add_argument(
        "--box",
        action="append",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="with --global: vary only this parameter, within these limits, in SI units; may be repeated",
    )
    parser.add_argument(
        "--from",
        dest="log",
        type=Path,
        metavar="LOG",
        help="with --global: draw rigs from the log's last estimates and their covariance",
    )
    parser.add_argument(
        "--no-indices",
        dest="indices",
        action="store_false",
        help="with --global: without each output's Sobol' indices, Morris's effects and bounds by "
        "derivatives",
    )
    add_parts(parser, "with --global: ")


def design_of(args: argparse.Namespace) -> Design | None:
    """None without --global. Raises WrongUse, LogError, OSError."""
    if not args.over_all:
        given = {
            "--points": args.points, "--box": args.box, "--from": args.log,
            "--no-indices": not args.indices, "--dask": args.dask,
            "--dask-tls": args.dask_tls,
        }  # fmt: skip
        for option, value in given.items():
            if value:
                raise WrongUse(f"{option} needs --global")
        return None
    if args.log is not None:
        if args.box:
            raise WrongUse("--box and --from: give one of them")
        *_, last = open_runs([args.log], say=_say)
        try:
            known = of_run(last)
        except ValueError as error:
            raise WrongUse(str(error)) from None
        rows = [k for k, name in enumerate(known.names) if name in FIELDS]
        covariance = known.log_covariance[np.ix_(rows, rows)]
        return LogNormal(
            tuple(known.names[k] for k in rows),
            tuple(known.median[rows].tolist()),
            tuple(map(tuple, covariance.tolist())),
            args.points or 10_000,
        )
    box = _box(args.box) if args.box else DISSERTATION
    return Uniform(box, args.points) if args.points else Grid(box)


def _box(texts: list[str]) -> ParameterBox:
    ranges: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, _, both = text.partition("=")
        check_name("--box", name, FIELDS)
        try:
            low, high = (float(part) for part in both.split(":"))
        except ValueError:
            raise WrongUse(f"--box {text}: give NAME=LOW:HIGH, SI units") from None
        if not 0.0 < low < high < math.inf:
            raise WrongUse(f"--box {text}: give a range above zero, the lower end first")
        ranges[name] = (low, high)
    lows, highs = zip(*ranges.values(), strict=True)
    return ParameterBox(tuple(ranges), lows, highs)


def _check_room() -> None:
    """Raises WrongUse, OSError."""
    if not has_room(cache_folder(), Log()):
        raise WrongUse(
            f"{caches(cache_folder(), Log()).no_room()}; make room, or name another disk by XDG_CACHE_HOME"
        )


def add_answers(answer: SensitivityAnswer, rig: Rig, design: Design, args: argparse.Namespace) -> None:
    """The global answers join each entry of "speeds". Raises WrongUse, OSError."""
    parts = parts_of(args, _say)
    answer["design"] = described(design)
    with ExitStack() as stack:
        bar = bars(stack)
        for entry in answer["speeds"]:
            asked = tuple(entry["outputs"]) if args.outputs else SIX
            plan = GlobalPlan(
                entry["model"], rig, entry["speed"], entry["seconds"], design, asked, args.input
            )
            shown = partial(bar, f"{entry['speed']:g} m/s")
            try:
                _check_room()
                part, _ = run(plan, cache_folder() / "sensitivity", parts, progress=shown)
                found = global_answer(plan, part)
                if args.indices:
                    with_indices(found, indices_answer(plan, entry["outputs"], args.workers))
                entry.update(cast("LocalEntry", found))
            except (ValueError, LostPart) as error:
                raise WrongUse(str(error)) from None


def show_global(console: Console, entry: GlobalEntry) -> None:
    """To a terminal."""
    title = f"over {entry['points']} rigs at {entry['speed']:g} m/s, {entry['model']} model"
    table = RichTable(title=title, title_justify="left")
    for heading in ("", "mean", "median", "5 %", "95 %", "mean of stable ones"):
        table.add_column(heading, justify="right" if heading else "left")
    for name, row in sorted(entry["global"].items(), key=lambda pair: -(pair[1]["median"] or 0.0)):
        values = [row[key] for key in ("mean", "median", "q05", "q95")]
        values.append(entry["global_stable"][name]["mean"])
        table.add_row(name, *("–" if value is None else f"{value:.3g}" for value in values))
    console.print(table)
    for output, rows in outputs_with_indices(entry).items():
        console.print(_indices_table(output, rows))
    console.print(
        f"{100 * entry['unstable_share']:.2g} % of the rigs are unstable; {entry['unstable_where']}."
    )
    if entry["unstable_domain"]:
        console.print(f"{entry['unstable_domain']['text']}.")


def _indices_table(output: str, rows: Mapping[str, GlobalRow]) -> RichTable:
    table = RichTable(title=f"what makes the variance of {output}", title_justify="left")
    for heading in ("", "Sobol', first order", "Sobol', total", "Morris", "bound by derivatives"):
        table.add_column(heading, justify="right" if heading else "left")
    for name, row in rows.items():
        effects = row["morris"]
        table.add_row(
            name,
            with_interval(row["sobol_first"]),
            with_interval(row["sobol_total"]),
            "–" if effects is None else f"{effects['size']:.3g}",
            "–" if row["dgsm_bound"] is None else f"{row['dgsm_bound']:.3g}",
        )
    return table
