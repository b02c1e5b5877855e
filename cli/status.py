"""`tilth status`: how the daemon that runs is, also for programs that watch it."""

import argparse

from tilth.cli.daemon_order import add_options, ask
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.states import RunHealth


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "status",
        help="say how the daemon that runs is",
        description="Say how the daemon that runs is: good, degraded or bad, and its problems. A container's "
        "health check: the exit status is 0 unless nothing is recorded (1) or nobody answers (2).",
    )
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """1 where nothing is recorded; raises WrongUse where no daemon answers."""
    answer = ask(args, "status")
    status = pb.Status.FromString(answer.payload)
    print(f"{answer.by}: {status.health}{', no run at present' if status.resting else ''}")
    for problem in status.problems:
        print(f"  {problem}")
    return int(status.health == RunHealth.BAD)
