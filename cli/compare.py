"""`tilth compare`: two logs, days, machine files or versions; what differs beyond chance. Or "
"published values."""

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
from tilth.analysis.fit.published_values import (
    BesidePublished,
    PublishedEntry,
    PublishedError,
    beside,
    own,
    parsed,
)
from tilth.analysis.fit.result import FitAnswer, as_json
from tilth.analysis.runs.nuisance_words import WORDS, nuisance_value
from tilth.analysis.runs.run import open_runs
from tilth.cli import WrongUse, say
from tilth.cli.log_errors import log_errors
from tilth.logger.machine_file import read_machine
from tilth.schemas.readable import reason_of
from tilth.schemas.spread import of_parameter, scale_of, unit_of

_say = partial(say, "compare")

OWN = "published"  # as the second: the table that comes with tilth
NO_FAULT = (
    "Of another rig, on other soil and at other loads, so a difference is no fault of either. "
    "Published sds are "
    "as their authors give them."
)


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "compare",
        help="show what differs beyond chance between two logs or fits, or compare a fit with published "
        "values",
        epilog="exit status: 1 if two logs or fits differ beyond chance; 0 with published values",
    )
    parser.add_argument(
        "first", type=Path, metavar="LOG|FIRST.json", help="a log, or the output of `tilth fit --json`"
    )
    parser.add_argument(
        "second", type=Path, metavar="LOG|SECOND.json|published|VALUES.toml",
        help="the same; or `published`, the table that comes with tilth; or a file of published values",
    )  # fmt: skip
    parser.add_argument(
        "--machine",
        action="append",
        default=[],
        type=Path,
        metavar="M.toml",
        help="machine file, instead of the one in the logs; give it twice for one each",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object to stdout")


def run(args: argparse.Namespace) -> int:
    """1 where something differs beyond chance."""
    if str(args.second) == OWN or args.second.suffix == ".toml":
        return _beside(args)
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


def _beside(args: argparse.Namespace) -> int:
    """A fit beside published values."""
    if len(args.machine) > 1:
        raise WrongUse("--machine: one log is compared; give it once")
    entries = _published(args.second)
    try:
        with log_errors():
            answer = _answer(args.first, args.machine[0] if args.machine else None)
    except CannotFit as error:
        raise WrongUse(str(error)) from None
    rows = [(entry, beside(answer, entry)) for entry in entries]
    if args.json:
        told = [
            {"title": e.title, "source": e.source, "where": e.where, "parameters": [*map(asdict, r)]}
            for e, r in rows
        ]
        print(json.dumps({"published": told}))
    else:
        _show_beside(rows)
    return 0


def _published(path: Path) -> tuple[PublishedEntry, ...]:
    """Raises WrongUse."""
    if str(path) == OWN:
        return own()
    try:
        return parsed(path.read_text(encoding="utf-8-sig"))
    except PublishedError as error:
        raise WrongUse(f"{path}: {error}") from None
    except UnicodeDecodeError:
        raise WrongUse(f"{path}: not UTF-8 text") from None
    except OSError as error:
        raise WrongUse(f"{path}: cannot be read ({reason_of(error)})") from None


def _show_beside(rows: list[tuple[PublishedEntry, tuple[BesidePublished, ...]]]) -> None:
    console = Console(highlight=False)
    for entry, found in rows:
        table = RichTable(title=f"{entry.title} ({entry.where})", title_justify="left")
        for heading in ("", "published, 95 %", "here, 95 %", "here over published", "sds apart"):
            table.add_column(heading)
        for one in found:
            ours = of_parameter(one.name, one.ours, one.ours_sd, bare=True)
            apart = "no sd" if one.apart is None else f"{one.apart:+.1f}"
            name = f"{one.name}, {unit_of(one.name)}"
            table.add_row(name, entry.told(one.name), ours, f"× {one.ratio:.2f}", apart)
        if found:
            console.print(table)
        else:
            console.print(f"{entry.title}: the fit has none of its numbers.")
        for what in filter(None, (entry.rig, entry.load, entry.tyre, entry.soil, entry.how)):
            console.print(f"  {what}", soft_wrap=True)
        console.print(f"  {entry.source}\n", soft_wrap=True)
    console.print(NO_FAULT)


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
