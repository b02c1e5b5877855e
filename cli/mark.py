"""`tilth mark`: note an event in the log of the daemon that runs."""

import argparse
import json
from pathlib import Path

import zenoh

from tilth.cli import WrongUse
from tilth.client.link import ENDPOINT, Alive, living
from tilth.client.refusal import holder_of, try_key
from tilth.logger.clock import EARLIEST_NS, utc_text
from tilth.logger.machine_file import read_machine
from tilth.schemas.invocation import command
from tilth.schemas.machine import Zenoh
from tilth.schemas.proto import tilth_pb2 as pb

WAIT_S = 10.0  # a disk may stall for some seconds before it takes the mark


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "mark",
        help="note an event in the log of the daemon that runs",
        description="Note a text, with time and place, in the log of the daemon that runs; done when it is "
        "on the disk there.",
    )
    parser.add_argument("text", metavar="TEXT", help="one line, at most 1 kB")
    parser.add_argument(
        "--machine",
        type=Path,
        metavar="MACHINE.toml",
        help="of the daemon, where several are heard or it has [zenoh] settings of its own",
    )
    parser.add_argument("--endpoint", metavar="TCP/HOST:PORT", help="where the daemon listens")
    parser.add_argument(
        "--config", type=Path, metavar="KEY.json", help="of `tilth keys`, where the daemon wants one"
    )


def run(args: argparse.Namespace) -> int:
    """1 where no daemon answers or it refuses."""
    prefix, name, endpoints = Zenoh().prefix, "", Zenoh().listen
    if args.machine is not None:
        machine, _ = read_machine(args.machine)
        prefix, name, endpoints = machine.zenoh.prefix, machine.name, machine.zenoh.listen
        if machine.zenoh.config is not None and args.config is None:
            raise WrongUse("this machine wants a key: give an operator's with --config")
    if args.config is not None:
        prefix, name = of_key(args.config)
    try:
        session = zenoh.open(client_config(args.config, [args.endpoint] if args.endpoint else endpoints))
    except zenoh.ZError:
        if args.config is not None:
            raise WrongUse(f"no daemon can be reached: {try_key(args.config).text}") from None
        where = args.endpoint or ", ".join(endpoints)
        raise WrongUse(
            f"no daemon can be reached at {where}; is `{command('run')}` running? "
            f"An endpoint looks like {ENDPOINT}"
        ) from None
    with session:
        key = _daemon(session, prefix, name, args.config).base(prefix) + "/mark"
        replies = list(session.get(key, payload=args.text, encoding="text/plain", timeout=WAIT_S))
    for reply in replies:
        if reply.ok:
            event = pb.Event.FromString(reply.ok.payload.to_bytes())
            print(f"{_when(event)} marked: {event.text}")
            return 0
        raise WrongUse(f"refused: {reply.err.payload.to_string() if reply.err else 'without a reason'}")
    raise WrongUse(f"no answer in {WAIT_S:.0f} s; look into the log before marking again")


def _when(event: pb.Event) -> str:
    if event.HasField("utc_ns"):
        return utc_text(event.utc_ns)
    # A daemon of before told its own clock alone; one of now that tells no UTC does not know it yet.
    return utc_text(event.t_ns) if event.t_ns >= EARLIEST_NS else "at a time that is not known yet,"


def _daemon(session: zenoh.Session, prefix: str, name: str, key: Path | None) -> Alive:
    """The one daemon that is meant: on a tractor, or else in a simulation. Raises WrongUse."""
    found = living(session, prefix, name)
    meant = [one for one in found if one.replay == found[0].replay]
    if len(meant) == 1:
        return meant[0]
    if meant:
        names = ", ".join(one.machine for one in meant)
        raise WrongUse(f"several daemons are heard: {names}; say with --machine which of them")
    if key is not None:
        raise WrongUse(try_key(key).text)
    raise WrongUse(f"no daemon is heard on {prefix}/{name or '*'}; is `{command('run')}` running?")


def of_key(path: Path) -> tuple[str, str]:
    """Prefix and machine that a key is for."""
    try:
        holder = holder_of(path)
    except ValueError as error:
        raise WrongUse(str(error)) from None
    if holder.role != "operator":
        raise WrongUse(f"{path}: {holder.name} may hear and not mark; ask for an operator's key")
    return holder.prefix, holder.machine


def client_config(file: Path | None, endpoints: list[str]) -> zenoh.Config:
    if file is not None:
        config = zenoh.Config.from_file(str(file))
    else:
        config = zenoh.Config()
        config.insert_json5("connect/endpoints", json.dumps(endpoints))
    for key, value in (
        ("mode", "client"),
        ("scouting/multicast/enabled", False),
        ("connect/timeout_ms", 2000),
        ("connect/exit_on_failure", True),
    ):
        config.insert_json5(key, json.dumps(value))
    return config
