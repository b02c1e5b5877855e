"""The options of the commands that hear a daemon over Zenoh."""

import argparse
from pathlib import Path

from tilth.client.link import ENDPOINT


def add_daemon(parser: argparse.ArgumentParser) -> None:
    """Which daemon to hear."""
    parser.add_argument(
        "--connect", default=ENDPOINT, metavar="ENDPOINT", help=f"where the daemon listens ({ENDPOINT})"
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="a Zenoh configuration instead")
    parser.add_argument(
        "--machine", default="", metavar="NAME", help="of the machine file (the one that runs)"
    )
    parser.add_argument("--replay", action="store_true", help="with --machine: its replay or simulation")
    parser.add_argument(
        "--prefix", default="tilth", metavar="P", help="of the machine file's [zenoh] (tilth)"
    )
