"""`tilth status`: the state of the running daemon, also for programs that watch it."""

import argparse

from tilth.cli.daemon_order import add_options, ask
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.states import RunHealth


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "status",
        help="show the state of the running daemon",
        description="Show the state of the running daemon: good, degraded or bad, with its problems. "
        "For health checks: the exit status is 1 if nothing is recorded, 2 if no daemon answers.",
    )
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """1 if nothing is recorded. Raises WrongUse if no daemon answers."""
    answer = ask(args, "status")
    status = pb.Status.FromString(answer.payload)
    print(f"{answer.by}: {status.health}{', no run at present' if status.resting else ''}")
    for problem in status.problems:
        print(f"  {problem}")
    return int(status.health == RunHealth.BAD)
