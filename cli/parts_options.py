"""Options of commands that compute in parts: processes here, or the workers of a Dask cluster."""

import argparse
import os
from collections.abc import Callable

from tilth.analysis.workers.dask import HUNG_S, Certificates, caution, on_dask
from tilth.analysis.workers.parts import Parts, here
from tilth.cli import WrongUse, add_processes


def add_parts(parser: argparse.ArgumentParser, only: str = "") -> None:
    """only: in words, with which other option they mean something."""
    parser.add_argument(
        "--dask",
        metavar="ADDRESS",
        help=f"{only}compute on the workers of a Dask scheduler, such as tcp://127.0.0.1:8786",
    )
    parser.add_argument(
        "--dask-tls",
        nargs=3,
        metavar=("CA", "CERT", "KEY"),
        help=f"{only}with --dask tls://host:8786: certificates, PEM files of the authority and of this end",
    )
    add_processes(parser, "--workers")


def parts_of(args: argparse.Namespace, say: Callable[[str], None], hung_s: float = HUNG_S) -> Parts:
    """Who computes. hung_s: as of on_dask. Raises WrongUse."""
    if not args.dask:
        if args.dask_tls:
            raise WrongUse("--dask-tls needs --dask tls://host:8786")
        return here(args.workers or os.cpu_count() or 1)
    if text := caution(args.dask):
        say(text)
    return on_dask(args.dask, Certificates(*args.dask_tls) if args.dask_tls else None, hung_s=hung_s)
