"""`tilth report`: one HTML file of a drive, with its numbers beside it, for any computer and for paper."""

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

from tilth.analysis.report.given import ALL, MOST_FITTED, given_segments
from tilth.analysis.runs.run import Run
from tilth.analysis.runs.segments import DrivenSegment
from tilth.cli import (
    WrongUse,
    add_bus_names,
    as_given,
    at_least,
    check_folder,
    check_out,
    exists,
    log_path,
    say,
)
from tilth.cli.log_errors import log_errors
from tilth.cli.log_options import add_machine, add_segments, given_machine, runs_of
from tilth.cli.progress_bar import Steps, bars
from tilth.schemas.invocation import command, installing

if TYPE_CHECKING:  # at run time wrong use is told before these imports
    from tilth.analysis.report.data import Answers, ReportData

Segments = list[tuple[DrivenSegment, ...]]  # of each run
_say = partial(say, "report")


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "report",
        help="report what was driven and found, in one HTML file",
        description="Write one HTML file about logs that opens anywhere, and a JSON file with every "
        "number: the run at a glance, segments, parameters with their uncertainty, what is not "
        "determined, what differs from the machine file. Logs of a run become one part of the report.",
    )
    parser.add_argument(
        "logs", nargs="+", type=log_path, metavar="LOG", help="logs of any kind that replay reads"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.html", help="a new file")
    parser.add_argument("--pdf", action="store_true", help="also write FILE.pdf")
    parser.add_argument(
        "--figures", type=Path, metavar="DIR", help="write each figure as SVG and PDF into a new folder"
    )
    add_machine(
        parser, "machine file, instead of the one in the log; required if tilth did not write the log"
    )
    add_segments(parser, "report these seconds of the N-th log instead of the segments found")
    parser.add_argument(
        "--fit",
        type=_most_fitted,
        metavar="N|all",
        help=f"fit at most N of the segments found in each log ({MOST_FITTED}), those that steer most; "
        "without this option all runs of a plan of experiments, and all named segments, are fitted",
    )
    add_bus_names(parser)
    parser.add_argument(
        "--json", action="store_true", help="also write the report as one JSON object to stdout"
    )


def _most_fitted(text: str) -> int:
    return ALL if text == "all" else at_least(1, "number of segments or all")(text)


def run(args: argparse.Namespace) -> int:
    """1 if a log is cut off or damaged, or gives no poses."""
    _check_outputs(args)
    with log_errors(args.out, "nothing was written"):
        with ExitStack() as stack:
            runs = runs_of(args, given_machine(args), _say, partial(bars(stack), "replay"))
        driven = [one for one in runs if one.poses.rows]
        for one in runs:
            if not one.poses.rows:
                _say(_no_poses(one))
        if not driven:
            return 1
        segments = _given(driven, args)
        with ExitStack() as stack:
            answers = _answers(driven, segments, args, bars(stack))
        return max(_write(driven, segments, answers, args), 1 if len(driven) < len(runs) else 0)


def _check_outputs(args: argparse.Namespace) -> None:
    """Before a long replay. Raises WrongUse."""
    if args.segment and args.mark:
        raise WrongUse("--segment names all that is fitted; leave out --mark beside it")
    check_out(args.out, (".json", ".pdf") if args.pdf else (".json",))
    if args.figures is not None:
        check_folder(args.figures.parent)
    if args.figures is not None and _holds_something(args.figures):
        raise WrongUse(f"--figures {args.figures}: give a new or an empty folder")
    if any(times.log > len(args.logs) for times in args.segment):
        raise WrongUse(f"--segment: there are {len(args.logs)} logs; give the number of one of them")
    if args.pdf:
        from tilth.analysis.report.paper import NoTypst, require_typst

        try:
            require_typst()
        except NoTypst:
            raise WrongUse(f"--pdf needs typst: {installing('report')}") from None


def _holds_something(folder: Path) -> bool:
    """A folder with something in it, or a file."""
    return folder.exists() and (not folder.is_dir() or any(folder.iterdir()))


def _no_poses(one: Run) -> str:
    path = one.sources[0]
    return (
        f"{path}: no pose could be computed from it, so there is nothing to report; "
        f"`{command('replay', str(path))}` says what was rejected; give the right machine file with --machine"
    )


def _given(runs: Sequence[Run], args: argparse.Namespace) -> Segments:
    try:
        return [given_segments(one, args.logs, args.segment) for one in runs]
    except ValueError as error:
        raise WrongUse(f"--segment: {error}") from None


def _answers(runs: Sequence[Run], segments: Segments, args: argparse.Namespace, steps: Steps) -> "Answers":
    from tilth.analysis.report.answers import answers_of  # wrong use is told before these imports

    found = answers_of(runs, segments, steps, args.fit, args.mark)
    for note in found["notes"]:
        _say(note)
    return found


def _write(
    runs: Sequence[Run],
    segments: Segments,
    answers: "Answers",
    args: argparse.Namespace,
) -> int:
    from tilth.analysis.report.document import as_json
    from tilth.analysis.report.gather import facts_of
    from tilth.analysis.report.made import SIMULATED, warnings_of
    from tilth.analysis.report.sections import (
        report_of,  # matplotlib takes a second: wrong use is told before
    )
    from tilth.analysis.report.writing import json_text, write

    facts = [facts_of(one, given) for one, given in zip(runs, segments, strict=True)]
    data = {"command": command("report", *_words(args)), "runs": facts, **answers}
    report = report_of(cast("ReportData", data))
    content = as_json(report)
    try:
        written = write(report, content, args.out, with_pdf=args.pdf, figures=args.figures)
    except FileExistsError as error:
        raise exists(error.filename) from None
    for one in facts:
        for text in warnings_of(one):
            if text != SIMULATED:  # said when the logs were opened
                _say(f"{one['id']}: {text}")
    shown = [path for path in written if args.figures is None or path.parent != args.figures]
    _say(f"wrote {', '.join(map(str, shown))}" + (f", and figures in {args.figures}" if args.figures else ""))
    if args.json:
        print(json_text(content), end="")
    unknown = bool(args.mark) and "fit" not in answers  # no marks of that name
    return 1 if unknown or any(one["skipped"] or not one["origin"]["whole"] for one in facts) else 0


def _words(args: argparse.Namespace) -> list[str]:
    """The command line, as it would be given again."""
    words = [*map(str, args.logs), *as_given(args, "out", "pdf", "figures", "machine")]
    if args.fit is not None:
        words += ["--fit", "all" if args.fit == ALL else str(args.fit)]
    for log, start_s, end_s in args.segment:
        words += ["--segment", f"{log}:{start_s:g}:{end_s:g}"]
    return words + as_given(args, "mark", "bus")
