"""`tilth implement`: which implement is hitched on."""

import argparse

from tilth.cli.daemon_order import add_options, ask
from tilth.logger.hitched import KEY
from tilth.schemas.proto import tilth_pb2 as pb


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "implement",
        help="say which implement is hitched on",
        description="Say to the daemon that runs which implement is hitched on: its run ends, and one with "
        "that implement begins. Without a NAME, say which there are.",
    )
    parser.add_argument("name", metavar="NAME", nargs="?", help="as [implement] name in its file")
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """2 where no daemon answers or it refuses."""
    if args.name is not None:
        answer = ask(args, KEY, args.name)
        print(f"{answer.by}: {pb.Event.FromString(answer.payload).text}")
        return 0
    answer = ask(args, "status")
    status = pb.Status.FromString(answer.payload)
    if not status.implements:
        print(f"{answer.by} has one implement{': ' if status.implement else ''}{status.implement}.")
    for name in status.implements:
        print(f"{name}  (hitched on)" if name == status.implement else name)
    return 0
