"""The options of the commands that hear a daemon over Zenoh, and of those that serve what they hear."""

import argparse
from pathlib import Path

from tilth.cli import WrongUse
from tilth.client.link import ENDPOINT
from tilth.monitor.addresses import is_loopback


def add_daemon(parser: argparse.ArgumentParser, also: str = "") -> None:
    """Which daemon to hear. also: what else --machine may be."""
    parser.add_argument(
        "--connect", default=ENDPOINT, metavar="ENDPOINT", help=f"address of the daemon ({ENDPOINT})"
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="a Zenoh configuration file instead")
    parser.add_argument(
        "--machine",
        default="",
        metavar="NAME",
        help=f"machine name of the machine file (the running one){also}",
    )
    parser.add_argument("--replay", action="store_true", help="with --machine: show its replay or simulation")
    parser.add_argument(
        "--prefix", default="tilth", metavar="P", help="prefix in [zenoh] of the machine file (tilth)"
    )


def add_address(parser: argparse.ArgumentParser, port: int) -> None:
    """Where to serve."""
    add_host(parser)
    parser.add_argument(
        "--port", type=int, default=port, metavar="N", help=f"port; 0 for any free one ({port})"
    )


def add_host(parser: argparse.ArgumentParser) -> None:
    """At which address to serve."""
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="address to serve at (127.0.0.1: only this computer can connect; 0.0.0.0: all in its networks)",
    )


def check_address(args: argparse.Namespace) -> None:
    """Raises WrongUse."""
    if not 0 <= args.port <= 65535:
        raise WrongUse(f"--port {args.port}: give a number from 0 to 65535")


def say_who_reaches(host: str, may: str) -> None:
    """Of a server on an address: nobody is asked for a key there."""
    if not is_loopback(host):
        print(f"everybody in the networks of this computer {may}", flush=True)
