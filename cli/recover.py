"""`tilth recover`: finish log files that a power cut or a full disk has left unfinished."""

import argparse
from functools import partial
from pathlib import Path

from tilth.cli import WrongUse, say
from tilth.logger.clock import DATED_NS, utc_text
from tilth.logger.log.recovery import Finished, NoLog, finish, rescue
from tilth.schemas.readable import reason_of

_say = partial(say, "recover")


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "recover",
        help="finish log files that a power cut left unfinished",
        description="Finish log files that a power cut or a full disk has left unfinished, so that any "
        "MCAP reader opens them. Nothing is removed from them. A file that is intact, or damaged in "
        "its middle, is not changed. The daemon does the same at its start.",
    )
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="NEW.mcap",
        help="leave FILE as it is, and write its readable part here",
    )


def run(args: argparse.Namespace) -> int:
    """1 where one of them could not be finished."""
    status = 0
    if args.out is not None and len(args.files) != 1:
        raise WrongUse("--out takes what can be read of one FILE; give one")
    for path in args.files:
        try:
            print(_words(finish(path)) if args.out is None else _written(rescue(path, args.out), args.out))
        except FileExistsError as error:
            raise WrongUse(
                f"--out {error.filename}: exists; nothing is overwritten, give another name"
            ) from None
        except NoLog as error:
            _say(str(error))
            status = 1
        except OSError as error:
            what = error.filename or args.out or path
            _say(f"{what}: {reason_of(error)}")
            status = 1
    return status


def _written(done: Finished, out: Path) -> str:
    return f"{out}: what can be read of {done.path}: {done.messages} messages{_span(done)}{_damaged(done)}"


def _words(done: Finished) -> str:
    what = "was whole" if done.was_whole else "finished now"
    return f"{done.path}: {what}: {done.messages} messages{_span(done)}{_damaged(done)}"


def _damaged(done: Finished) -> str:
    return f"; {done.unreadable_bytes} bytes of it cannot be read" if done.unreadable_bytes else ""


def _span(done: Finished) -> str:
    """From when to when, as it follows the number of messages."""
    first_ns, last_ns = done.first_ns + done.utc_minus_ns, done.last_ns + done.utc_minus_ns
    if not done.messages:
        return ""
    if first_ns < DATED_NS:  # the computer woke in 1970, and nobody had told it better by then
        return f", {(last_ns - first_ns) * 1e-9:.1f} s at a time that is not known"
    return f", {utc_text(first_ns)} to {utc_text(last_ns)}"
