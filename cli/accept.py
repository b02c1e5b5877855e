"""`tilth accept`: what the daemon has found moved is as it is now."""

import argparse

from tilth.cli.daemon_order import add_options, order
from tilth.schemas.proto import tilth_pb2 as pb


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "accept",
        help="accept what the daemon that runs has found moved as it is now",
        description="Accept what the daemon that runs has found moved as it is now: the daemon logs the new "
        "value, then uses it. Without a NAME, say what that is.",
    )
    parser.add_argument("name", metavar="NAME", nargs="?", help="as the event says, such as tractor_front")
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """2 where no daemon answers or it refuses."""
    return order(args, "accept", args.name, _moved)


def _moved(status: pb.Status, by: str) -> list[str]:
    moved = [f"{' or '.join(one.names)}: {one.text}" for one in status.moved]
    return moved or [f"Nothing of {by} has been found moved."]
