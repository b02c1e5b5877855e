"""`tilth offload`: copy finished runs to a stick or another folder, verified."""

import argparse
import errno
import os
from functools import partial
from pathlib import Path

from tilth.cli import WrongUse, say
from tilth.logger.log.offload import CannotCopy, offload
from tilth.logger.log.runs import StoredRun, stored_runs

_say = partial(say, "offload")


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "offload",
        help="copy finished runs to a USB stick or another folder, and verify the copies",
        description="Copy the files of finished runs to DEST, read each back and compare it, and note that "
        "it has a copy: such runs may be deleted when space is needed. If interrupted, the command "
        "continues where it was.",
    )
    parser.add_argument("dest", type=Path, metavar="DEST", help="an existing folder, such as a mounted stick")
    parser.add_argument("--log", type=Path, default=Path("logs"), metavar="DIR", help="the log folder (logs)")
    parser.add_argument(
        "--run",
        action="append",
        metavar="RUN",
        help="only this run, as `tilth logs` names it; may be repeated",
    )


def run(args: argparse.Namespace) -> int:
    """1 where something could not be copied."""
    if not args.dest.is_dir():
        raise WrongUse(f"{args.dest}: no such folder; mount the stick, or make the folder")
    if args.dest.resolve() == args.log.resolve():
        raise WrongUse(f"{args.dest}: is the log folder itself; give another")
    runs = chosen(args.log, args.run)
    if args.dest.stat().st_dev == args.log.stat().st_dev:
        _say(f"{args.dest} is on the same disk as the logs")
    left, not_noted = False, ""
    for one in runs:
        try:
            done = offload(one, args.dest.resolve(), lambda name: print(f"copying {name}"))
        except CannotCopy as error:  # nor can the next one
            _say(str(error))
            return 1
        except (ValueError, OSError) as error:
            _say(f"left: {one.name}: {error}")
            left = True
            continue
        told = [f"left: {why}" for why in done.not_copied]
        told += [f"copied as it is: {what}" for what in done.damaged]
        for text in told:
            _say(text)
        left, not_noted = left or bool(told), not_noted or done.not_noted
        files = "file" if done.copied == 1 else "files"
        print(f"{one.name}: {done.copied} {files} copied and compared, {done.there} there already")
    if not_noted:
        _say(f"{not_noted}; it cannot be noted there what was copied")
    return 1 if left else 0


def chosen(folder: Path, names: list[str] | None) -> list[StoredRun]:
    """The runs of those names, or all. Raises WrongUse."""
    if folder.is_file():
        raise WrongUse(f"{folder}: a file; name the folder that the logs are in")
    if not folder.is_dir():
        raise WrongUse(f"{folder}: no such folder; name the one that the logs are in")
    if not os.access(folder, os.R_OK | os.X_OK):  # looks empty to who may not look into it
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(folder))
    runs = stored_runs(folder)
    if not runs:
        raise WrongUse(f"{folder}: no run is in it; name the folder that the logs are in")
    known = {one.name: one for one in runs}
    for name in names or ():
        if name not in known:
            raise WrongUse(f"{name}: no such run in {folder}; there are {', '.join(known)}")
    return [known[name] for name in names] if names else runs
