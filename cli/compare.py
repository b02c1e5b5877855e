"""`tilth compare`: two logs, days, machine files or versions; what differs beyond chance."""

import argparse
import json
import math
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import cast

from rich.console import Console
from rich.table import Table as RichTable

from tilth.analysis.fit.compare import FitComparison, NotComparable, compare
from tilth.analysis.fit.fitting import CannotFit, choose, fit_all
from tilth.analysis.fit.result import FitAnswer, as_json
from tilth.analysis.runs.nuisance_words import WORDS, nuisance_value
from tilth.analysis.runs.run import open_runs
from tilth.cli import WrongUse, say
from tilth.cli.log_errors import log_errors
from tilth.logger.machine_file import read_machine
from tilth.schemas.spread import scale_of, unit_of

_say = partial(say, "compare")


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser("compare", help="what differs beyond chance between two logs or fits")
    for name in ("first", "second"):
        parser.add_argument(
            name, type=Path, metavar=f"LOG|{name.upper()}.json", help="a log, or what `tilth fit --json` gave"
        )
    parser.add_argument(
        "--machine",
        action="append",
        default=[],
        type=Path,
        metavar="M.toml",
        help="instead of the one in the logs; twice: one for each",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object to stdout")


def run(args: argparse.Namespace) -> int:
    """1 where something differs beyond chance."""
    if len(args.machine) > 2:
        raise WrongUse("--machine: give it once for both, or twice")
    machines = (args.machine * 2)[:2] if len(args.machine) == 1 else args.machine or [None, None]
    try:
        with log_errors():
            first, second = (
                _answer(path, machine)
                for path, machine in zip((args.first, args.second), machines, strict=True)
            )
            found = compare(first, second)
    except (CannotFit, NotComparable) as error:
        raise WrongUse(str(error)) from None
    if args.json:
        print(json.dumps(asdict(found)))
    else:
        _show(found)
    return int(found.differ)


def _answer(path: Path, machine: Path | None) -> FitAnswer:
    """What `tilth fit --json` gives of a log, or gave. Raises WrongUse, LogError, CannotFit, OSError."""
    if path.suffix == ".json":
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            found = None
        if not isinstance(found, dict) or "joint" not in found:
            raise WrongUse(f"{path}: not what `tilth fit --json` writes")
        return cast("FitAnswer", found)
    runs = open_runs(path, machine=read_machine(machine) if machine else None, say=_say)
    return as_json(fit_all(choose(runs)))


def _show(found: FitComparison) -> None:
    console = Console()
    table = RichTable()
    for heading in ("", "first", "second", "change", "beyond chance"):
        table.add_column(heading)
    for one in found.parameters:
        values = (f"{scale_of(one.name) * value:.4g}" for value in (one.first, one.second))
        told = "yes" if one.beyond_chance else "no"
        table.add_row(f"{one.name}, {unit_of(one.name)}", *values, f"× {math.exp(one.change):.2f}", told)
    for one in found.nuisances:
        if one.beyond_chance:
            texts = (nuisance_value(one.name, value) for value in (one.first, one.second))
            table.add_row(f"{WORDS[one.name].words} ({one.name})", *texts, "", "yes")
    console.print(table)
    if found.missing:
        console.print(f"Not given by both: {', '.join(found.missing)}")
    console.print(found.sentence)
