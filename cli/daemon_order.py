"""Asks the daemon that runs to do something, over Zenoh: the options and the way that such commands share."""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import zenoh

from tilth.cli import WrongUse
from tilth.client.link import ENDPOINT, Alive, living
from tilth.client.refusal import holder_of, try_key
from tilth.logger.machine_file import read_machine
from tilth.schemas.invocation import command
from tilth.schemas.machine import Zenoh
from tilth.schemas.proto import tilth_pb2 as pb

WAIT_S = 10.0  # a disk may stall for some seconds before it takes what is asked for


def no_daemon(where: object, options: str = "") -> WrongUse:
    """What to say where nothing answers. options: which options to look at, a sentence."""
    return WrongUse(
        f"no daemon can be reached at {where}; is `{command('run')}` running? "
        f"{options}An endpoint looks like {ENDPOINT}"
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which daemon, and where."""
    parser.add_argument(
        "--machine",
        type=Path,
        metavar="MACHINE.toml",
        help="machine file of the daemon, if several are running or it has its own [zenoh] settings",
    )
    parser.add_argument("--endpoint", metavar="TCP/HOST:PORT", help="address of the daemon")
    parser.add_argument(
        "--config", type=Path, metavar="KEY.json", help="key from `tilth keys`, if the daemon requires one"
    )


class Answer(NamedTuple):
    """Of a daemon to an order. by: whose it is, since it may be another one than was thought of."""

    by: str
    payload: bytes


def ask(args: argparse.Namespace, key: str, payload: str = "") -> Answer:
    """What the daemon answers on a key below its prefix. Raises WrongUse where none does, or it refuses."""
    prefix, name, endpoints = Zenoh().prefix, "", Zenoh().listen
    if args.machine is not None:
        machine = read_machine(args.machine).machine
        prefix, name, endpoints = machine.zenoh.prefix, machine.name, machine.zenoh.listen
        if machine.zenoh.config is not None and args.config is None:
            raise WrongUse("this machine wants a key: give an operator's with --config")
    if args.config is not None:
        prefix, name = of_key(args.config, args.command)
    try:
        session = zenoh.open(client_config(args.config, [args.endpoint] if args.endpoint else endpoints))
    except zenoh.ZError:
        if args.config is not None:
            raise WrongUse(f"no daemon can be reached: {try_key(args.config).text}") from None
        where = args.endpoint or ", ".join(endpoints)
        raise no_daemon(where) from None
    with session:
        daemon = daemon_of(session, prefix, name, args.config)
        base = daemon.base(prefix)
        replies = _replies(session, f"{base}/{key}", payload)
    for reply in replies:
        if reply.ok:
            by = f"{daemon.machine}, a simulation" if daemon.replay else daemon.machine
            return Answer(by, reply.ok.payload.to_bytes())
        raise WrongUse(f"refused: {reply.err.payload.to_string() if reply.err else 'without a reason'}")
    raise WrongUse(f"no answer in {WAIT_S:.0f} s; look into the log before asking again")


def order(
    args: argparse.Namespace, key: str, text: str | None, told: Callable[[pb.Status, str], list[str]]
) -> int:
    """Give an order and print what became of it; without a text, print what a status tells. told: (status,
    whose it is), its lines. Raises WrongUse, as `ask`."""
    if text is not None:
        answer = ask(args, key, text)
        print(f"{answer.by}: {pb.Event.FromString(answer.payload).text}")
        return 0
    answer = ask(args, "status")
    for line in told(pb.Status.FromString(answer.payload), answer.by):
        print(line)
    return 0


def _replies(session: zenoh.Session, key: str, payload: str) -> list[zenoh.Reply]:
    """Of the daemon, [] where it gives none in WAIT_S. An order, which has a payload, is given once."""
    end_s = time.monotonic() + WAIT_S
    while (left_s := end_s - time.monotonic()) > 0:
        replies = list(session.get(key, payload=payload, encoding="text/plain", timeout=left_s))
        if replies or payload:
            return replies
        time.sleep(0.1)  # a daemon that has just started has nothing to say on this key yet
    return []


def daemon_of(session: zenoh.Session, prefix: str, name: str, key: Path | None) -> Alive:
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


def of_key(path: Path, order: str = "give orders") -> tuple[str, str]:
    """Prefix and machine that a key is for. order: what it is used for. Raises WrongUse."""
    try:
        holder = holder_of(path)
    except ValueError as error:
        raise WrongUse(str(error)) from None
    if holder.role != "operator":
        raise WrongUse(f"{path}: {holder.name} may hear and not {order}; ask for an operator's key")
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
