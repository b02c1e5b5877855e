"""`tilth monitor`: the live page."""

import argparse

from tilth.cli import WrongUse
from tilth.cli.zenoh_options import add_address, add_daemon, check_address, say_who_reaches
from tilth.monitor.addresses import urls
from tilth.monitor.daemon_data import DaemonData
from tilth.monitor.server import listening_socket, serve

PORT = 8117


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "monitor",
        help="show a running daemon in a browser",
        description="Serves a page that shows what a running daemon says: sensors, recording, map, "
        "parameters. A process of its own: it can come and go without touching the recorder. Until Ctrl-C.",
    )
    add_daemon(parser)
    add_address(parser, PORT)


def run(args: argparse.Namespace) -> int:
    check_address(args)
    try:
        listener = listening_socket(args.host, args.port)
    except OSError as error:
        where = f"cannot serve at {args.host} port {args.port}: {error.strerror or error}"
        raise WrongUse(f"{where}; give another --port or --host") from None
    try:
        daemon_data = DaemonData(args.connect, args.config, args.prefix, args.machine, args.replay)
    except ValueError as error:
        listener.close()
        raise WrongUse(str(error)) from None
    host, port = listener.getsockname()[:2]
    for url in urls("http", host, port):
        print(f"{url}/", flush=True)
    say_who_reaches(host, "may see the page and mark: notes in the log of the run")
    try:
        serve(daemon_data, str(args.config or args.connect), listener)
    finally:
        daemon_data.close()
    return 0
