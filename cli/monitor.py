"""`tilth monitor`: the live page, also of recorded runs."""

import argparse
import signal
from contextlib import ExitStack, suppress
from pathlib import Path

from tilth.cli import WrongUse, add_bus_names
from tilth.cli.zenoh_options import add_address, add_daemon, check_address, say_who_reaches
from tilth.monitor.addresses import listening_socket, urls
from tilth.monitor.daemon_data import DaemonData
from tilth.monitor.server import serve
from tilth.monitor.view import View

PORT = 8117
MARK = "mark: notes in the log of the run"


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "monitor",
        help="show a running daemon in a browser, or recorded runs",
        description="Serves a page that shows a running daemon: sensors, recording, map, parameters. It is "
        "a separate process that can start and stop without touching the recorder. Until Ctrl-C. With "
        "LOG or FOLDER the page plays recorded runs instead, at 1 to 100 times real time.",
    )
    parser.add_argument(
        "logs", nargs="*", type=Path, metavar="LOG|FOLDER", help="runs to play; nearly any kind of log"
    )
    add_daemon(parser, "; with LOG: a machine file, for logs without one")
    add_bus_names(parser)
    add_address(parser, PORT)


def run(args: argparse.Namespace) -> int:
    check_address(args)
    try:
        listener = listening_socket(args.host, args.port)
    except OSError as error:
        where = f"cannot serve at {args.host} port {args.port}: {error.strerror or error}"
        raise WrongUse(f"{where}; give another --port or --host") from None
    with ExitStack() as page, ExitStack() as stack:  # a player ends before the page that hears it
        stack.callback(listener.close)
        endpoint = str(args.config or args.connect)
        if args.logs:
            from tilth.cli.recorded_runs import play  # with the estimators: only who asks pays for it

            endpoint = play(args, stack)
        page.callback((daemon_data := _hear(args, endpoint)).close)
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        with suppress(KeyboardInterrupt):  # also before the server has begun: this is how it is meant to end
            host, port = listener.getsockname()[:2]
            for url in urls("http", host, port):
                print(f"{url}/", flush=True)
            say_who_reaches(host, f"may see the page and {'play' if args.logs else MARK}")
            serve(daemon_data, View(daemon_data, endpoint), listener)
    return 0


def _hear(args: argparse.Namespace, endpoint: str) -> DaemonData:
    try:
        if args.logs:
            return DaemonData(endpoint, None, args.prefix, "", False, gone_s=0.0)
        return DaemonData(args.connect, args.config, args.prefix, args.machine, args.replay)
    except ValueError as error:
        raise WrongUse(str(error)) from None
