"""`tilth keys`: who may hear a machine on a shared network, and who may mark."""

import argparse
from datetime import UTC, datetime
from pathlib import Path

from tilth.cli import WrongUse
from tilth.client.refusal import try_key
from tilth.deploy import keys
from tilth.logger.clock import YEARS, Clock
from tilth.logger.machine_file import read_machine
from tilth.schemas.readable import reason_of


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "keys",
        help="manage who may listen to a machine on a shared network, and who may mark",
        description="Make and revoke keys for a shared network (mutual TLS). Use --machine and --host the "
        "first time. Without options, list who has keys. Everything is in FOLDER: keep it off the "
        "tractor, give daemon.json to the recorder and <name>.json to the person or program it is for.",
    )
    parser.add_argument("folder", type=Path, nargs="?", metavar="FOLDER", help="where the keys are kept")
    parser.add_argument("--machine", type=Path, metavar="MACHINE.toml", help="new keys, for this machine")
    parser.add_argument(
        "--host",
        action="append",
        default=[],
        metavar="ADDRESS",
        help="how others reach the recorder's computer",
    )
    ports = f"({keys.PORT}; of a router {keys.PORT + 1})"
    parser.add_argument("--port", type=int, metavar="N", help=ports)
    parser.add_argument(
        "--router",
        action="store_true",
        help="with --machine: a router takes the keys, and the recorder stays on its computer's loopback",
    )
    parser.add_argument("--operator", action="append", default=[], metavar="NAME", help="may hear and mark")
    parser.add_argument("--reader", action="append", default=[], metavar="NAME", help="may hear")
    parser.add_argument("--renew", action="append", default=[], metavar="NAME", help="a new certificate")
    parser.add_argument("--revoke", action="append", default=[], metavar="NAME", help="let in no longer")
    parser.add_argument("--days", type=int, default=keys.DAYS, metavar="N", help=f"a key lasts ({keys.DAYS})")
    parser.add_argument(
        "--try", dest="key", type=Path, metavar="KEY.json", help="say what a key opens, or why nothing"
    )


def run(args: argparse.Namespace) -> int:
    """1 where a key that is tried opens nothing."""
    try:
        if args.key is not None:
            verdict = try_key(args.key)
            print(verdict.text)
            return 0 if verdict.opens else 1
        _change(args)
        _list(args.folder)
    except (keys.KeysError, ValueError) as error:
        raise WrongUse(str(error)) from None
    except OSError as error:
        place = error.filename or args.folder
        raise WrongUse(f"{place}: {reason_of(error)}; give a folder of your own") from None
    return 0


def _change(args: argparse.Namespace) -> None:
    if args.folder is None:
        raise WrongUse("give the FOLDER of the keys, or --try KEY.json")
    port = keys.PORT + args.router if args.port is None else args.port
    if args.days < 1 or not 0 < port < 65536:
        raise WrongUse("give --days above zero and a --port from 1 to 65535")
    now = datetime.fromtimestamp(Clock().t_ns() // 1_000_000_000, UTC)
    if now.year not in YEARS:
        raise WrongUse(f"this computer's clock says {now:%Y-%m-%d}; set it, keys last from today")
    written: list[Path] = []
    if args.machine is not None:
        machine = read_machine(args.machine).machine
        inside = tuple(machine.zenoh.listen) if args.router else ()
        if any(one.endswith(f":{port}") for one in inside):
            raise WrongUse(f"--port {port}: the recorder listens there itself; give the router another")
        hosts = tuple(args.host)
        register = keys.Register(machine.name, machine.zenoh.prefix, hosts, port, recorder=inside)
        written += keys.make(args.folder, register, now)
    elif args.host or args.router:
        raise WrongUse("--host and --router go with --machine, when the keys are made")
    people = [*((n, "operator") for n in args.operator), *((n, "reader") for n in args.reader)]
    if args.revoke:
        written += keys.revoke(args.folder, args.revoke)
    if args.renew:
        written += keys.renew(args.folder, args.renew, now, args.days)
    if people:
        written += keys.admit(args.folder, people, now, args.days)
    routed = bool(written) and bool(keys.read_register(args.folder).recorder)
    for path in dict.fromkeys(written):
        print(f"wrote {path}{(_OF_ROUTER if routed else _WHAT_FOR).get(path.name, '')}")


_WHAT_FOR = {
    "ca.key": ": whoever has it can make keys; keep it off the tractor and off the network",
    "daemon.json": ': for the recorder, beside its machine file; there: [zenoh] config = "daemon.json"',
}
_OF_ROUTER = {**_WHAT_FOR, "daemon.json": ": for the router, python -m tilth.deploy.router daemon.json"}


def _list(folder: Path) -> None:
    register = keys.read_register(folder)
    print(f"{register.base} at {', '.join(register.hosts)}, port {register.port}")
    for party in register.parties:
        print(f"  {party.name:20} {party.role:9} until {party.until}")
    for name in register.revoked:
        print(f"  {name:20} revoked")
    if not register.parties:
        print("  nobody may hear it yet; see --reader and --operator")
