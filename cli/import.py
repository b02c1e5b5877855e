"""`tilth import`: a log from a table of measurements, which all other commands take."""

import argparse
import json
from dataclasses import asdict
from functools import partial
from pathlib import Path

from tilth.analysis.table_import import ImportProblem, import_table, read_map
from tilth.cli import WrongUse, say, say_unusual
from tilth.logger.machine_file import read_machine
from tilth.schemas.invocation import command

_say = partial(say, "import")


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "import",
        help="make a log from a table of measurements",
        description="Make a log from a table (.csv, .parquet, .mat) of positions and wheel angles over "
        "time. docs/logs.md shows a map file: which column is what, in which unit.",
    )
    parser.add_argument("table", type=Path, metavar="TABLE")
    parser.add_argument("--map", type=Path, required=True, metavar="MAP.toml", help="which column is what")
    parser.add_argument(
        "--machine", type=Path, required=True, metavar="M.toml", help="the rig that was driven"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="LOG.mcap", help="new file")
    parser.add_argument("--json", action="store_true", help="one JSON object to stdout")


def run(args: argparse.Namespace) -> int:
    if args.out.suffix != ".mcap":
        raise WrongUse(f"--out {args.out}: give a name that ends in .mcap")
    if args.out.exists():
        raise WrongUse(f"{args.out}: exists; a log is never overwritten, give another name")
    machine_file = read_machine(args.machine)
    say_unusual("import", machine_file.machine)
    try:
        found = import_table(args.table, read_map(args.map), machine_file, args.out)
    except FileNotFoundError as error:
        raise WrongUse(f"{error.filename}: there is no such file") from None
    except ImportProblem as error:
        raise WrongUse(str(error)) from None
    if args.json:
        print(json.dumps(asdict(found)))
    else:
        print(
            f"{args.out}: {found.rows} rows, {found.seconds:.0f} s, {found.frames} frames. "
            f"Next: {command('fit', str(args.out))}"
        )
    return 0
