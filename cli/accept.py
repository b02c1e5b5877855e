"""`tilth accept`: what the daemon has found moved is as it is now."""

import argparse

from tilth.cli.daemon_order import add_options, ask
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
    if args.name is None:
        answer = ask(args, "status")
        status = pb.Status.FromString(answer.payload)
        for moved in status.moved:
            print(f"{' or '.join(moved.names)}: {moved.text}")
        if not status.moved:
            print(f"Nothing of {answer.by} has been found moved.")
        return 0
    answer = ask(args, "accept", args.name)
    print(f"{answer.by}: {pb.Event.FromString(answer.payload).text}")
    return 0
