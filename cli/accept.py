"""`tilth accept`: what the daemon has found moved is as it is now."""

import argparse

from tilth.cli.daemon_order import add_options, order
from tilth.schemas.proto import tilth_pb2 as pb


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "accept",
        help="accept the present position of what the running daemon has found moved",
        description="Accept the present position of what the running daemon has found moved: the daemon "
        "logs the new value, then uses it. Without NAME, show the findings.",
    )
    parser.add_argument("name", metavar="NAME", nargs="?", help="as in the event, such as tractor_front")
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """2 where no daemon answers or it refuses."""
    return order(args, "accept", args.name, _moved)


def _moved(status: pb.Status, by: str) -> list[str]:
    moved = [f"{' or '.join(one.names)}: {one.text}" for one in status.moved]
    return moved or [f"Nothing of {by} has been found moved."]
