"""`tilth implement`: which implement is hitched on, and what it carries."""

import argparse

from tilth.cli import WrongUse
from tilth.cli.daemon_order import add_options, order
from tilth.logger.fold_orders import LOAD
from tilth.logger.hitched import KEY
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.spread import plus_minus


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "implement",
        help="tell the daemon which implement is hitched, or what it carries",
        description="Tell the running daemon which implement is hitched: its run ends, and one with that "
        "implement begins. Or tell it what the implement carries. Without either, show what is known.",
    )
    parser.add_argument("name", metavar="NAME", nargs="?", help="name in [implement] of its file")
    parser.add_argument(
        "--load", metavar="LOAD", help='full, half, empty, unknown, or a mass with its unit, such as "6.2 t"'
    )
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """2 where no daemon answers or it refuses."""
    if args.name is None:
        return order(args, LOAD, args.load, _known)
    if args.load is not None:
        raise WrongUse(f"first `tilth implement {args.name}`, and the load when its run has begun")
    return order(args, KEY, args.name, _known)


def _known(status: pb.Status, by: str) -> list[str]:
    lines = [f"{name}  (hitched on)" if name == status.implement else name for name in status.implements]
    lines = lines or [f"{by} has one implement{': ' if status.implement else ''}{status.implement}."]
    if status.HasField("load"):
        lines.append(f"{_carries(status.load)} It is full with {status.full_load / 1e3:.1f} t.")
    return lines


def _carries(load: pb.Carried) -> str:
    if load.source == "nobody":
        return "Nobody has said what it carries."
    said = "a scale" if load.source == "scale" else "the operator"
    return f"It carries {plus_minus(load.mass / 1e3, load.sd / 1e3, 't')}, as {said} has said."
