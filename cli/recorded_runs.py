"""The recorded runs that `tilth monitor` plays: found, opened, and published for its page."""

import argparse
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import zenoh

from tilth.cli import WrongUse, say
from tilth.cli.log_errors import log_errors
from tilth.cli.progress_bar import stages
from tilth.logger.machine_file import read_machine
from tilth.logger.zenoh.session import free_endpoint, open_session, why
from tilth.replay.catalogue import CatalogueRun, listing, run_files
from tilth.replay.player_service import PlayerService, Sources
from tilth.replay.prepared import OpenedRun, Opening
from tilth.replay.readers.log import LogError
from tilth.schemas.machine import Machine, MachineError, Zenoh
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.readable import readable

_say = partial(say, "monitor")

ANY_PORT = "tcp/127.0.0.1:0"


def play(args: argparse.Namespace, stack: ExitStack, aloud: bool = True) -> str:
    """Start a player; the stack ends it. Where it can be heard. aloud: it says so on the terminal, with how
    far it is. Raises CommandFailed, WrongUse."""
    if args.config is not None or args.replay:
        raise WrongUse("--config and --replay are of a daemon that runs: leave them out where you give logs")
    given = read_machine(Path(args.machine)) if args.machine else None
    opening = Opening(kept_logs(), args.prefix, given, tuple(args.bus), _say)
    with log_errors():
        runs = {one.name: one for one in run_files(args.logs)}
        opened = _opened(opening, next(iter(runs.values())), aloud) if len(runs) == 1 else None
    machine = opened.machine if opened else _any_machine(opening, list(runs.values()))

    def listings() -> Iterator[pb.RunListing]:
        return (_listing(opening, one) for one in reversed(runs.values()))

    sources = Sources(tuple(runs), lambda name, progress: opening.open(runs[name], progress), listings)
    here = machine.model_copy(update={"zenoh": Zenoh(prefix=args.prefix, listen=[free_endpoint(ANY_PORT)])})
    try:
        session, endpoints, _ = open_session(here)
    except zenoh.ZError as error:
        raise WrongUse(f"Zenoh cannot be started ({why(error)})") from None
    stack.callback(session.close)
    player = PlayerService(session, machine, sources, time.monotonic)
    player.start(opened)
    stack.callback(player.close)
    if aloud:
        _say(f"publishing under {args.prefix}/{machine.name}/replay at {endpoints[0]}")
    return endpoints[0]


def _opened(opening: Opening, run: CatalogueRun, aloud: bool) -> OpenedRun:
    """With a progress bar where there is somebody to see it. Raises LogError, OSError."""
    with ExitStack() as stack:
        return opening.open(run, stages(stack) if aloud else lambda text, share: None)


def _any_machine(opening: Opening, runs: list[CatalogueRun]) -> Machine:
    """Of the newest run that has one."""
    for run in reversed(runs):
        try:
            return opening.machine(run)
        except (LogError, MachineError):
            continue
    raise WrongUse("no machine file is in these logs; give --machine M.toml")


def _listing(opening: Opening, run: CatalogueRun) -> pb.RunListing:
    try:
        return listing(run, opening.prepared(run))
    except (LogError, MachineError) as error:
        row = listing(run)
        row.state = readable(error)
        return row


def kept_logs() -> Path:
    """The folder of the logs that a replay gave."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / "tilth" / "replays"
