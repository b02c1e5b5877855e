"""`tilth fit`: the six parameters of each run in logs, and of all together."""

import argparse
import json
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial

from rich.console import Console
from rich.table import Table as RichTable

from tilth.analysis.fit.fitting import CannotFit, NoSteering, check_same_rig, choose, fit_all
from tilth.analysis.fit.result import FitAnswer, as_json
from tilth.analysis.fit.summary import latex, rows_of, title_of, write_csv
from tilth.analysis.runs.run import Run
from tilth.analysis.runs.segments import KINDS
from tilth.cli import WrongUse, add_bus_names, add_processes, log_path, say
from tilth.cli.log_errors import log_errors
from tilth.cli.log_options import add_machine, add_segments, given_machine, runs_of
from tilth.cli.progress_bar import bars
from tilth.replay.estimates_json import ParameterEntry
from tilth.schemas.flow import PARAMETERS, Status
from tilth.schemas.machine_difference import differing
from tilth.schemas.spread import of_parameter, unit_of

_say = partial(say, "fit")


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "fit", help="estimate the parameters of each manoeuvre in logs, and of all together"
    )
    parser.add_argument("logs", nargs="+", type=log_path, metavar="LOG")
    add_machine(parser)
    add_segments(
        parser,
        "fit from A to B, in seconds since the start of the N-th run (1); default: marks, "
        "or else the segments found",
    )
    parser.add_argument(
        "--kind",
        action="append",
        default=[],
        choices=KINDS,
        help="only segments of this kind; may be repeated",
    )
    parser.add_argument("--two-step", action="store_true", help="add the dissertation's two-step method")
    add_processes(parser, "--jobs")
    add_bus_names(parser)
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument("--json", action="store_true", help="one JSON object to stdout, in SI units")
    shown.add_argument(
        "--csv", action="store_true", help="the table as CSV to stdout: estimates and 95 %% intervals"
    )
    shown.add_argument("--latex", action="store_true", help="the table as a LaTeX tabular to stdout")
    shown.add_argument("--all", action="store_true", help="a separate table for each segment")


def run(args: argparse.Namespace) -> int:
    """1 where nothing could be fitted."""
    if args.segment and (args.mark or args.kind):
        raise WrongUse("--segment names all that is fitted; leave out --mark and --kind beside it")
    try:
        with log_errors(), ExitStack() as stack:
            show = bars(stack)
            runs = runs_of(args, given_machine(args), _say, partial(show, "reading"))
            wanted = choose(runs, args.segment, args.kind, args.mark)
            _check_same_rig([one.run for one in wanted])
            progress = partial(show, "fitting")
            fitted = fit_all(wanted, two_step=args.two_step, jobs=args.jobs, progress=progress)
    except CannotFit as error:
        by_hand = "; `--segment A:B` names a stretch, in seconds since the log began"
        text = f"{error}{by_hand if isinstance(error, NoSteering) else ''}"
        if args.segment or len(args.logs) > 1:
            raise WrongUse(text) from None
        _say(text)
        return 1
    answer = as_json(fitted)
    if args.json:
        print(json.dumps(answer))
    elif args.csv:
        write_csv(answer, sys.stdout)
    elif args.latex:
        print(latex(answer))
    else:
        _show(answer, each=args.all)
    if fitted.joint is None:
        return 1
    for reason in filter(None, dict.fromkeys(map(_withheld, runs))):
        _say(f"beware: at the end of a log no number is published, since {reason}")
    return 0


def _withheld(run: Run) -> str:
    """Why no number stands at the end of a run; "" where one does, or where nothing was published."""
    last = run.estimates()
    none = (Status.UNESTIMATED, Status.INVALID)
    if not last.rows or any(last[f"{name}_status"][-1] not in none for name in PARAMETERS):
        return ""
    return str(last[f"{PARAMETERS[0]}_reason"][-1])


def _check_same_rig(runs: Sequence[Run]) -> None:
    """Raises CannotFit, which says by which keys the first two differ."""
    try:
        check_same_rig(runs)
    except CannotFit as error:
        texts = {run.machine_file.text: run for run in runs}  # they may differ by their DBC files alone
        other = [*texts.values(), runs[-1]][1]
        keys = differing(runs[0].machine, other.machine)
        raise CannotFit(f"{error}. They differ in {keys}") from None


def _show(answer: FitAnswer, each: bool) -> None:
    """each: with a table for each segment, all reasons in it."""
    console = Console()
    if each:
        for run in answer["runs"]:
            console.print(_table(title_of(run), run["parameters"]))
            if run["determined"]:
                console.print(f"determined: {', '.join(run['determined'])}")
    if answer["joint"] is None or answer["agreement"] is None:
        _reasons(console, answer)
        console.print("No segment told anything; the reasons stand above.")
        return
    if not each or len(answer["runs"]) > 1:
        console.print(_summary(answer))
    _reasons(console, answer)
    if len(answer["runs"]) > 1:
        console.print(answer["agreement"]["sentence"])


def _summary(answer: FitAnswer) -> RichTable:
    """All segments, groups and all together: at most 80 columns."""
    table = RichTable(title="estimate and 95 % interval", title_justify="left", padding=0)
    table.add_column("segment", overflow="fold", max_width=16)
    for name in PARAMETERS:
        table.add_column(f"{name}\n{unit_of(name)}", justify="right", no_wrap=True)
    for row in rows_of(answer):
        table.add_row(
            row.title, *(_cell(name, row.parameters[name]) for name in PARAMETERS), end_section=row.is_last
        )
    return table


def _cell(name: str, one: ParameterEntry) -> str:
    if one["value"] is None or one["sd"] is None:
        return "–"
    value, _, spread = of_parameter(name, one["value"], one["sd"], bare=True).partition(" ")
    return f"{value}\n{spread.replace(' ', '')}"


def _reasons(console: Console, answer: FitAnswer) -> None:
    """Why there is no number, each reason once."""
    said: dict[str, dict[str, list[str]]] = {}
    for row in rows_of(answer):
        for name, one in row.parameters.items():
            if one["value"] is None:
                said.setdefault(one["reason"], {}).setdefault(row.name, []).append(name)
    for reason, where in said.items():
        told = "; ".join(f"{place}: {', '.join(names)}" for place, names in where.items())
        console.print(f"– {told}: {reason}")


def _table(title: str, parameters: dict[str, ParameterEntry]) -> RichTable:
    table = RichTable(title=title, title_justify="left")
    for heading in ("", "estimate", "status", "reason"):
        table.add_column(heading, overflow="fold")
    for name in PARAMETERS:
        row = parameters[name]
        text = (
            "-" if row["value"] is None or row["sd"] is None else of_parameter(name, row["value"], row["sd"])
        )
        table.add_row(name, text, row["status"], row["reason"])
    return table
