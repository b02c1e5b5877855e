"""`tilth recover`: finish log files that a power cut or a full disk has left unfinished."""

import argparse
import sys
from pathlib import Path

from tilth.logger.clock import DATED_NS, utc_text
from tilth.logger.log.recovery import Finished, NoLog, finish


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "recover",
        help="finish log files that a power cut left unfinished",
        description="Finish, in place, log files that a power cut or a full disk has left unfinished: then "
        "any reader of MCAP opens them. Nothing is taken out of them. The daemon does so at its start.",
    )
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")


def run(args: argparse.Namespace) -> int:
    """1 where one of them could not be finished."""
    status = 0
    for path in args.files:
        try:
            print(_words(finish(path)))
        except NoLog as error:
            print(f"tilth recover: {error}", file=sys.stderr)
            status = 1
        except OSError as error:
            print(f"tilth recover: {path}: {(error.strerror or str(error)).lower()}", file=sys.stderr)
            status = 1
    return status


def _words(done: Finished) -> str:
    what = "was whole" if done.was_whole else "finished now"
    first_ns, last_ns = done.first_ns + done.utc_minus_ns, done.last_ns + done.utc_minus_ns
    if not done.messages:
        span = ""
    elif first_ns < DATED_NS:  # the computer woke in 1970, and nobody had told it better by then
        span = f", {(last_ns - first_ns) * 1e-9:.1f} s at a time that is not known"
    else:
        span = f", {utc_text(first_ns)} to {utc_text(last_ns)}"
    damaged = f"; {done.unreadable_bytes} bytes of it cannot be read" if done.unreadable_bytes else ""
    return f"{done.path}: {what}: {done.messages} messages{span}{damaged}"
