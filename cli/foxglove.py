"""`tilth foxglove`: what the daemon publishes, live in viewers of the Foxglove WebSocket protocol."""

import argparse
import signal
import threading
from http import HTTPStatus
from importlib import resources
from typing import TYPE_CHECKING

import zenoh

from tilth.cli import WrongUse
from tilth.cli.zenoh_options import add_address, add_daemon, check_address, say_who_reaches
from tilth.client.link import base_key, living, open_session
from tilth.monitor.addresses import urls
from tilth.monitor.origin import Refusal
from tilth.schemas.invocation import installing

if TYPE_CHECKING:  # an extra
    from tilth.monitor.foxglove_server import FoxgloveServer

PORT = 8765  # where such viewers look first
LOOK_S = 0.5
MOST_REFUSALS = 50  # said, of who is not let in
LAYOUTS = {"foxglove/tilth.json": "", "foxglove/experiment.json": ", beside `tilth experiment`"}


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "foxglove",
        help="show a running daemon in Foxglove or Lichtblick",
        description="Serves the publications of a running daemon over the Foxglove WebSocket protocol, as "
        "topics with the names and schemas of a log. Frames, measurements and fits, which only the log "
        "has, are not served. /experiment is served beside `tilth experiment`, and is in no log. It is "
        "a separate process that can start and stop without touching the recorder. Until Ctrl-C.",
    )
    add_daemon(parser)
    add_address(parser, PORT)
    parser.add_argument(
        "--allow-origin",
        action="append",
        default=[],
        metavar="ORIGIN",
        help="web origin of a viewer in a browser that may connect, such as https://app.foxglove.dev; "
        "viewers with their own window need none",
    )


class _Refusals:
    """Said once each: a page that is refused tries again and again."""

    def __init__(self) -> None:
        self._printed: set[str] = set()

    def __call__(self, refusal: Refusal, origin: str) -> None:
        who = f"a viewer at {origin[:80]}" if origin and origin.isprintable() else "a viewer"
        line = f"{who} is refused: {refusal.why}"
        if refusal.status == HTTPStatus.FORBIDDEN and who != "a viewer":
            line += f"; to let it in: --allow-origin {origin[:80]}"
        if line not in self._printed and len(self._printed) < MOST_REFUSALS:
            self._printed.add(line)
            print(line, flush=True)


def _opened(args: argparse.Namespace) -> "tuple[FoxgloveServer, zenoh.Session, str]":
    """The server, the network, and the key of the daemon where it is named. Raises WrongUse."""
    try:
        from tilth.monitor.foxglove_server import FoxgloveServer
    except ModuleNotFoundError as error:
        if error.name != "foxglove":
            raise
        raise WrongUse(f"this needs one package more: {installing('foxglove')}") from None
    try:
        base = base_key(args.machine, args.prefix, args.replay) if args.machine else ""
        session = open_session(args.connect, args.config)
    except ValueError as error:
        raise WrongUse(str(error)) from None
    try:
        return FoxgloveServer(args.host, args.port, args.allow_origin, _Refusals()), session, base
    except OSError as error:
        session.close()
        why = error.strerror or str(error)
        raise WrongUse(f"--host {args.host} --port {args.port}: {why}; give others") from None


def run(args: argparse.Namespace) -> int:
    check_address(args)
    server, session, base = _opened(args)
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    for url in urls("ws", args.host, server.port):
        print(f"{url}   open this connection in Foxglove or Lichtblick", flush=True)
    say_who_reaches(args.host, "may see what is served")
    for layout, when in LAYOUTS.items():
        print(f"and import this layout{when}: {resources.files('tilth.deploy').joinpath(layout)}", flush=True)
    try:
        if not base:
            print(f"looking for a daemon at {args.config or args.connect} …", flush=True)
        while not base and not stop.wait(LOOK_S):
            base = next((one.base(args.prefix) for one in living(session, args.prefix)), "")
        if base:
            server.follow(session, base)
            print(f"hears {base}", flush=True)
            stop.wait()
    finally:
        server.stop()
        session.close()
        print(f"{server.served} messages served", flush=True)
        for refusal, count in server.refused.items():
            print(f"{count} refused: {refusal}", flush=True)
    return 0
