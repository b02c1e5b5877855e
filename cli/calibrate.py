"""`tilth calibrate`: what a drive tells of a rig, into its machine file; from logs, or while driving."""

import argparse
from pathlib import Path

from tilth.cli import REPORT_SUFFIXES, WrongUse, add_bus_names, check_folder
from tilth.client.link import ENDPOINT


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "calibrate",
        help="find what a drive reveals about a rig, and write it into its machine file",
        description="Find the positions of the receivers, yaw of the antenna pairs, hitch, drawbar, wheel "
        "angle, latency and roll zeros from a drive of a quarter of an hour; docs/calibrate.md says "
        "what to drive. With --live, show the driver what to drive and how far it has got, here and on "
        "the page. The old file is kept.",
    )
    parser.add_argument(
        "logs",
        nargs="*",
        type=Path,
        metavar="LOG",
        help="logs of one rig, in order; with --live: earlier logs",
    )
    parser.add_argument(
        "--live", action="store_true", help="guide the driver stage by stage, beside a running daemon"
    )
    parser.add_argument(
        "--machine", type=Path, metavar="M.toml", help="machine file, instead of the one in the logs"
    )
    parser.add_argument("--out", type=Path, metavar="CALIBRATED.toml", help="the machine file to write")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="write the report to this file")
    parser.add_argument("--yes", action="store_true", help="change an existing file without asking")
    add_bus_names(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object to stdout")
    live = parser.add_argument_group("with --live")
    live.add_argument("--connect", default=ENDPOINT, metavar="ENDPOINT", help=f"the daemon ({ENDPOINT})")
    live.add_argument("--config", type=Path, metavar="KEY.json", help="an operator's key from `tilth keys`")
    live.add_argument(
        "--prefix", default="tilth", metavar="P", help="prefix in [zenoh] of the machine file (tilth)"
    )


def run(args: argparse.Namespace) -> int:
    """1 where the drive tells nothing, or nothing was written that was to be, or a live drive was ended."""
    _check_outputs(args)
    if args.live:
        from tilth.cli.calibrate_live import run_live  # with Zenoh, without the desk

        return run_live(args)
    if not args.logs:
        raise WrongUse("give the LOG of a drive, or --live beside a running daemon")
    if args.config is not None or args.connect != ENDPOINT or args.prefix != "tilth":
        raise WrongUse("--connect, --config and --prefix are for --live")
    from tilth.cli.calibrate_logs import run_logs

    return run_logs(args)


def _check_outputs(args: argparse.Namespace) -> None:
    """Before a drive, or a computation of minutes, is lost to a name. Raises WrongUse."""
    if args.report is not None and args.report.suffix.lower() not in REPORT_SUFFIXES:
        raise WrongUse(f"--report {args.report}: give a name that ends in .html")
    for path in filter(None, (args.out, args.report)):
        if path.is_dir():
            raise WrongUse(f"{path}: a folder; give the name of a file in it")
        check_folder(path.parent)
    if args.out is not None and args.out.exists() and not _is_text(args.out):
        raise WrongUse(f"--out {args.out}: exists, and is no machine file; give another name")


def _is_text(path: Path) -> bool:
    """Looks at its beginning: a log may be large."""
    try:
        with path.open(encoding="utf-8") as stream:
            stream.read(1)
    except UnicodeDecodeError:
        return False
    return True
