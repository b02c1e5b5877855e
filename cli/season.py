"""`tilth season`: many days of logs, of several machines, identified and put together."""

import argparse
import json
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from tilth.analysis.season.season import SUMMARY, Season, SeasonProblem, finish, season
from tilth.analysis.season.table import NoParquet, require_parquet
from tilth.analysis.workers.dask import HUNG_S
from tilth.analysis.workers.parts import LostPart, Parts
from tilth.cli import WrongUse, say
from tilth.cli.log_errors import log_errors
from tilth.cli.log_options import add_machine, given_machine
from tilth.cli.parts_options import add_parts, parts_of
from tilth.cli.progress_bar import bars
from tilth.replay.readers.remote import is_remote
from tilth.schemas.invocation import command

_say = partial(say, "season")


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "season",
        help="identify many days of logs and combine them",
        description="Find the runs in folders and on sticks, identify each one, combine the runs of each "
        "tractor and implement in the order in which they were driven, and write a table of all stretches "
        "(DIR/stretches.parquet) and a summary (DIR/season.html). Finished runs are not computed again. "
        "The logs are only read.",
    )
    parser.add_argument(
        "logs", nargs="+", metavar="LOG", help="logs and folders of logs, also as s3://BUCKET/FOLDER"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="the season's folder")
    parser.add_argument("--retry", action="store_true", help="try failed runs again")
    add_machine(parser, "machine file for logs without one")
    add_parts(parser)
    parser.add_argument("--json", action="store_true", help="print the outcome as one JSON object")


def run(args: argparse.Namespace) -> int:
    """1 where a run failed, or could not be kept."""
    try:
        require_parquet()
    except NoParquet as error:
        raise WrongUse(str(error)) from None
    if args.out.exists() and not args.out.is_dir():
        raise WrongUse(f"--out {args.out}: is a file; give a folder, new or of the same season")
    for path in args.logs:
        if not is_remote(path) and not Path(path).exists():
            raise WrongUse(f"{path}: no such file or folder; give logs, or folders of logs")
    with log_errors(args.out, "what was finished is kept; give the same command again"):
        try:
            with ExitStack() as stack:
                made = season(
                    args.logs, args.out, partial(_parts, args), machine=given_machine(args),
                    retry=args.retry, progress=bars(stack),
                )  # fmt: skip
        except (SeasonProblem, LostPart) as error:
            raise WrongUse(str(error)) from None
        if made.rows is not None:
            from tilth.analysis.season.page import write_summary  # matplotlib takes a second

            write_summary(made, command("season", *args.logs, "--out", str(args.out)))
            finish(made)
    return _tell(made, args.json)


def _parts(args: argparse.Namespace, longest_s: float) -> Parts:
    """A worker that has not done a run in the time that it took to drive it hangs."""
    return parts_of(args, _say, max(HUNG_S, longest_s))


def _tell(made: Season, as_json: bool) -> int:
    done = made.done
    if as_json:
        print(json.dumps({**done, "out": str(made.out), "table": str(made.table), "computed": made.computed}))
    what = f"{done['runs']} runs, {done['rows']} rows"
    if made.rows is None:
        _say(f"nothing to do: {what} in {made.table}")
    else:
        _say(f"{what} in {made.table}, {made.computed} runs identified now; open {made.out / SUMMARY}")
    if done["look"]:
        _say(f"runs that deserve a look: {done['look']}; {SUMMARY} says why")
    if made.inventory.left_out:
        _say(f"files not used: {len(made.inventory.left_out)}; {SUMMARY} says why")
    if done["failed"]:
        _say(f"runs that failed: {done['failed']}; {SUMMARY} says why, --retry tries them again")
    if made.not_kept:
        _say(f"{made.not_kept}: the results of some runs could not be stored; free some space and repeat")
    return int(bool(done["failed"] or made.not_kept))
