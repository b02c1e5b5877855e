"""`tilth mark`: note an event in the log of the daemon that runs."""

import argparse

from tilth.cli.daemon_order import add_options, ask
from tilth.logger.clock import EARLIEST_NS, utc_text
from tilth.schemas.proto import tilth_pb2 as pb


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "mark",
        help="write a note into the log of the running daemon",
        description="Write a text, with time and place, into the log of the running daemon. The command "
        "ends when the text is on the daemon's disk.",
    )
    parser.add_argument("text", metavar="TEXT", help="one line, at most 1 kB")
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """2 where no daemon answers or it refuses."""
    answer = ask(args, "mark", args.text)
    event = pb.Event.FromString(answer.payload)
    print(f"{_when(event)} marked: {event.text} (in the log of {answer.by})")
    return 0


def _when(event: pb.Event) -> str:
    if event.HasField("utc_ns"):
        return utc_text(event.utc_ns)
    # A daemon of before told its own clock alone; one of now that tells no UTC does not know it yet.
    return utc_text(event.t_ns) if event.t_ns >= EARLIEST_NS else "at a time that is not known yet,"
