"""`tilth mavlink`: the recommended estimate to an autopilot."""

import argparse
import math
import signal
import threading
import time

import zenoh

from tilth.cli import WrongUse
from tilth.cli.zenoh_options import add_daemon
from tilth.client import Client, Staleness
from tilth.client.latest import judge
from tilth.client.link import base_key, living, open_session
from tilth.client.mavlink import MavlinkSender
from tilth.schemas.mavlink import udp_address

EVERY_S = 1.0  # as often as an estimate comes, and a heartbeat must
RULE = Staleness(silence_s=3.0, data_s=math.inf)  # how old the data are is sent along


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "mavlink",
        help="send the parameters to a MAVLink autopilot",
        description="Sends the recommended estimate, with status and age, once a second as "
        "NAMED_VALUE_FLOAT and DEBUG_FLOAT_ARRAY. Numbers that must not be used are NaN. Until Ctrl-C.",
    )
    add_daemon(parser)
    parser.add_argument(
        "--to", required=True, metavar="udpout:HOST:PORT", help="the autopilot, or a router of its messages"
    )
    parser.add_argument(
        "--system", type=int, default=1, metavar="N", help="MAVLink system: the vehicle's (1)"
    )
    parser.add_argument(
        "--component", type=int, default=191, metavar="N", help="MAVLink component (191: onboard computer)"
    )


def run(args: argparse.Namespace) -> int:
    sender, session = _opened(args)
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    base = base_key(args.machine, args.prefix, args.replay) if args.machine else ""
    client = Client(session, base, "", RULE) if base else None
    began_s, reported = time.monotonic(), ""
    try:
        while True:
            if client is None and (found := living(session, args.prefix)):
                client = Client(session, found[0].base(args.prefix), "", RULE)
            unsent = sender.unsent
            latest = client.latest() if client else judge(None, math.inf, RULE)
            sender.send(latest, int((time.monotonic() - began_s) * 1e3))
            reported = _say(args.to, sender.reason if sender.unsent > unsent else "", latest.reason, reported)
            if stop.wait(EVERY_S):
                return 0
    finally:
        print(f"{sender.sent} messages, {sender.unsent} of them not sent", flush=True)
        if client is not None:
            client.close()
        session.close()
        sender.close()


def _opened(args: argparse.Namespace) -> tuple[MavlinkSender, zenoh.Session]:
    """Raises WrongUse."""
    for name, number in (("--system", args.system), ("--component", args.component)):
        if not 1 <= number <= 255:
            raise WrongUse(f"{name} {number}: give a number from 1 to 255")
    try:
        to = udp_address(args.to)
        if to.listening:
            raise ValueError(f"--to {args.to}: it sends only; give udpout:HOST:PORT")
        base_key(args.machine or "any", args.prefix, args.replay)
        session = open_session(args.connect, args.config)
    except ValueError as error:
        raise WrongUse(str(error)) from None
    try:
        return MavlinkSender(to, args.system, args.component), session
    except OSError as error:
        session.close()
        raise WrongUse(f"--to {args.to}: {error.strerror or error}; correct the host") from None


def _say(to: str, unsent: str, reason: str, before: str) -> str:
    """Print what has changed."""
    now = f"{to}: {unsent}; is it on?" if unsent else f"sends to {to}"
    now += f"; NaN: {reason}" if reason else "; all six may be used"
    shape = "".join(c for c in now if not c.isdigit())  # ages go on all the time
    if shape != before:
        print(now, flush=True)
    return shape
